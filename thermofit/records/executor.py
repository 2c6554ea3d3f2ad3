"""Where independent long tasks run: here one after another, in local processes, or on the workers of a Dask scheduler.

A task is a call that any process can make. Its answer comes back by value; what it keeps on disk for a run after a kill is its own
matter. A task whose worker is lost runs again elsewhere.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import active_children, get_context, parent_process
from typing import TYPE_CHECKING, Any, Protocol

from thermofit.core.digest import source_digest
from thermofit.core.errors import NumericsError, StudyError, ThermofitError
from thermofit.records.lock import lend
from thermofit.records.progress import mute
from thermofit.study.reading import Key, read_by, reading

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

    from distributed import Client

LOSSES = 3
"""How many times a task may lose its worker before it is given up."""
CONNECT_S = 10.0
"""How long a scheduler has to answer, s."""
FIRST_WORKER_S = 30.0
"""How long a scheduler without workers is waited for, s."""
NO_WORKER_S = 120.0
"""How long a run goes on waiting after its last worker is lost, s."""
_LOOK_S = 5.0
_BUSY = threading.Lock()
Answer = tuple[bool, Any]
"""(True, answer) or (False, error) of a task."""
OnDone = Callable[[int, Any], None]
"""Told of the number of a task in its list and of its answer, in the order in which they end."""


@dataclass(frozen=True)
class Task:
    """`function(*arguments)`; the function stands at the top of a module of thermofit, the arguments are plain data (pickled).

    `label` names it for the user: "start 3".
    """

    label: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    reading: Key | None = None
    """The key of the record that it is for, by which the study may be read; set where the tasks are begun."""

    def answer(self) -> Any:
        """What the function gives."""
        with reading(self.reading):
            return self.function(*self.arguments)


@dataclass(frozen=True)
class Executor:
    """`jobs` local processes (1: this one), or the Dask scheduler at an address such as tcp://host:8786; `threads` of the kernels in
    every worker. StudyError for a number below one, and where processes and a scheduler are both asked for."""

    jobs: int = 1
    scheduler: str | None = None
    threads: int = 1

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise StudyError(f"--jobs is {self.jobs}; expected the number of processes to use, 1 or more")
        if self.scheduler is not None and self.jobs > 1:
            raise StudyError(
                f"--jobs {self.jobs} and --scheduler {self.scheduler} are both given; expected one of them: leave out --jobs, the workers "
                "of the scheduler are counted there"
            )

    @property
    def serial(self) -> bool:
        """True where everything runs in this process."""
        return self.jobs == 1 and self.scheduler is None


SERIAL = Executor()


def run_all(tasks: Sequence[Task], where: Executor = SERIAL, on_done: OnDone | None = None) -> list[Any]:
    """The answers of all tasks, in their order.

    An error of a task ends the others and is raised here (a ThermofitError as it is). StudyError where a scheduler cannot be used;
    NumericsError where a task has lost its worker LOSSES times, or no worker is left.
    """
    answers: dict[int, Any] = {}

    def done(index: int, answer: Any) -> None:
        answers[index] = answer
        if on_done is not None:
            on_done(index, answer)

    if where.serial or (where.scheduler is None and len(tasks) == 1):
        for index, task in enumerate(tasks):
            done(index, task.function(*task.arguments))
    else:
        tasks = [replace(task, reading=read_by()) for task in tasks]
        with _processes(where) if where.scheduler is None else _scheduler(where.scheduler, where.threads) as pool:
            _collect(tasks, pool, done)
    return [answers[index] for index in range(len(tasks))]


class _Pool(Protocol):
    """Workers elsewhere."""

    def submit(self, task: Task) -> Future[Answer] | None:
        """Begin a task; None where every worker is busy."""

    def lost(self, future: Future[Answer], task: Task, error: Exception) -> None:
        """A task has ended without an answer: returns where it is to run again, else raises."""

    def look(self, quiet: bool) -> None:
        """Called now and then; `quiet`: no task has ended since. Raises where none will."""


def _collect(tasks: Sequence[Task], pool: _Pool, done: OnDone) -> None:
    """Keep the workers busy until every task has its answer."""
    waiting, running = deque(range(len(tasks))), dict[Future[Answer], int]()
    try:
        while waiting or running:
            while waiting and (future := pool.submit(tasks[waiting[0]])) is not None:
                running[future] = waiting.popleft()
            ended = wait(running, timeout=_LOOK_S, return_when=FIRST_COMPLETED).done
            pool.look(not ended)
            for future in ended:
                index = running.pop(future)
                try:
                    good, answer = future.result()
                except Exception as error:
                    pool.lost(future, tasks[index], error)
                    waiting.appendleft(index)
                    continue
                if not good:
                    raise answer
                done(index, answer)
    finally:
        for future in running:
            future.cancel()


def answer_of(task: Task, threads: int) -> Answer:
    """What a task gives in a worker; an unexpected error comes as a text with its place."""
    from thermofit.core.jit import set_threads

    try:
        set_threads(threads)
        return True, task.answer()
    except ThermofitError as error:
        return False, error
    except MemoryError as error:
        return False, NumericsError(
            f"{task.label}: the memory of its worker does not suffice{f' ({error})' if str(error) else ''}; what is finished is kept: give "
            "each worker more memory or run fewer at once, and the same command resumes"
        )
    except OSError as error:
        return False, error
    except Exception:
        return False, RuntimeError(f"{task.label}, in a worker:\n{traceback.format_exc()}")


def _lost_for_good(task: Task, how: str) -> NumericsError:
    """What the user reads of a task that cannot keep a worker."""
    return NumericsError(
        f"{task.label}: its worker was lost {LOSSES} times ({how}), which a kill or too little memory does; what is finished is kept: give "
        "each worker more memory or run fewer at once, and the same command resumes"
    )


class _Worker:
    """A local process in a pool of its own: where it is lost, no other task ends with it."""

    def __init__(self) -> None:
        # Spawned, because a fork of a process with OpenMP threads hangs.
        self.pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin)
        self.process: BaseProcess | None = None

    def submit(self, task: Task, threads: int) -> Future[Answer]:
        before = set(active_children())
        future = self.pool.submit(answer_of, task, threads)
        self.process = next(iter(set(active_children()) - before), self.process)
        return future

    def dismiss(self) -> None:
        """End the process, whatever it is doing."""
        if self.process is not None:
            self.process.kill()
        self.pool.shutdown(cancel_futures=True)


class _Processes:
    """At most `jobs` local processes, started as they are needed."""

    def __init__(self, where: Executor) -> None:
        self.where, self.losses = where, Counter[int]()
        self.idle: list[_Worker] = []
        self.busy: dict[Future[Answer], _Worker] = {}

    def submit(self, task: Task) -> Future[Answer] | None:
        """Give the task to an idle process, or to a new one; None where all `jobs` of them are busy."""
        for future in [future for future in self.busy if future.done()]:
            self.idle.append(self.busy.pop(future))
        if len(self.busy) == self.where.jobs:
            return None
        worker = self.idle.pop() if self.idle else _Worker()
        try:
            future = worker.submit(task, self.where.threads)
        except BrokenProcessPool:  # lost while it was idle
            return self.submit(task)
        self.busy[future] = worker
        return future

    def lost(self, future: Future[Answer], task: Task, error: Exception) -> None:
        """End the process of a task without an answer. NumericsError where its process has died `LOSSES` times; else the task may be given
        again. Any other error of the pool is raised as it is."""
        worker = self.busy.pop(future)
        worker.dismiss()
        if not isinstance(error, BrokenProcessPool):
            raise error
        self.losses[id(task)] += 1
        if self.losses[id(task)] == LOSSES:
            code = None if worker.process is None else worker.process.exitcode
            raise _lost_for_good(task, f"its process ended with code {code}") from None

    def look(self, quiet: bool) -> None:
        """A process that ends is noticed by itself."""


@contextmanager
def _processes(where: Executor) -> Iterator[_Processes]:
    pool = _Processes(where)
    try:
        yield pool
    finally:
        for worker in (*pool.idle, *pool.busy.values()):
            worker.dismiss()


def _begin() -> None:
    """What a new local process does first."""
    for name in ("SIGINT", "SIGTERM", "SIGUSR1"):  # the parent hears it too, and ends this process
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    sys.stdout = sys.stderr  # the standard output belongs to the result
    mute()
    lend()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A killed parent must not leave workers behind that go on writing into its run folder."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def remote_answer(task: Task, threads: int, digest: str) -> Answer:
    """The answer of a task in a Dask worker whose sources are those of the command; one task at a time in a process."""
    if source_digest() != digest:
        return False, StudyError(
            "--scheduler: a worker runs other sources of thermofit (or other effect files, THERMOFIT_EFFECTS) than this command; expected "
            "the same: install the same version for the workers and start them again"
        )
    mute()
    lend()
    with _BUSY:  # the threads of a worker share kernels that are not made for several callers at once
        return answer_of(task, threads)


class _Scheduler:
    """The workers of a Dask scheduler, which itself repeats a task whose worker is lost."""

    def __init__(self, client: Client, address: str, threads: int) -> None:
        self.client, self.address, self.threads, self.digest = client, address, threads, source_digest()
        self.pool = client.get_executor(pure=False)
        self.alone_since: float | None = None

    def submit(self, task: Task) -> Future[Answer]:
        """Give the task to the scheduler."""
        future: Future[Answer] = self.pool.submit(remote_answer, task, self.threads, self.digest)
        return future

    def lost(self, future: Future[Answer], task: Task, error: Exception) -> None:
        """NumericsError that says why the scheduler gives no answer to a task."""
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):
            raise _lost_for_good(task, f"by the scheduler's count, which gives up after {LOSSES}") from None
        while self.client.status == "connecting":  # it tries to; where it cannot it closes by itself, without a word
            time.sleep(0.1)
        self.look(True)
        found = f"{type(error).__name__}: {' '.join(str(error).split())[:160]}".removesuffix(": ")
        raise self.failed(f"{task.label} was given up by Dask ({found})", "see to scheduler and workers") from error

    def look(self, quiet: bool) -> None:
        """Asked now and then; `quiet`: nothing arrives. NumericsError where the connection is lost, or all workers for NO_WORKER_S."""
        if self.client.status not in ("running", "connecting"):
            raise self.failed("the connection was lost", "start scheduler and workers")
        if not quiet or self.client.status == "connecting" or self.client.scheduler_info()["workers"]:
            self.alone_since = None
            return
        now = time.monotonic()
        self.alone_since = self.alone_since or now
        if now - self.alone_since > NO_WORKER_S:
            raise self.failed(f"the last worker was lost and none has joined for {NO_WORKER_S:.0f} s", "start workers")

    def failed(self, what: str, remedy: str) -> NumericsError:
        return NumericsError(f"--scheduler {self.address}: {what}; what is finished is kept: {remedy}, and the same command resumes")


@contextmanager
def _scheduler(address: str, threads: int) -> Iterator[_Scheduler]:
    """A scheduler that has at least one worker. StudyError where Dask is not installed, nobody answers there or no worker joins."""
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise StudyError(f"--scheduler needs Dask, which is not installed ({error.name}): pip install 'thermofit[dask]'") from None
    # Every task carries its data, which may be many megabytes: that is meant.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "4 GiB"}):
        try:
            client = Client(address, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            reason = str(error) or f"no answer within {CONNECT_S:g} s"
            raise StudyError(
                f"--scheduler {address}: no Dask scheduler answers there ({reason}); expected an address such as tcp://host:8786: start "
                "one by `dask scheduler` and workers by `dask worker ADDRESS --nthreads 1`"
            ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=FIRST_WORKER_S)
            except TimeoutError:
                raise StudyError(
                    f"--scheduler {address}: no worker has joined it within {FIRST_WORKER_S:.0f} s; start some by `dask worker {address} "
                    "--nthreads 1`"
                ) from None
            yield _Scheduler(client, address, threads)
