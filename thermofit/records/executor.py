"""Where independent long tasks run: here one after another, in local processes, or on the workers of a Dask scheduler.

A task is a call that any process can make. Its answer comes back by value; what it keeps on disk for a run after a kill is its own
matter. A task whose worker is lost runs again elsewhere.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from thermofit.core.errors import NumericsError, StudyError
from thermofit.records.progress import mute
from thermofit.records.tasks import LOSSES, answer_of, lost_text
from thermofit.records.tasks import Task as Task

OnDone = Callable[[int, Any], None]
"""Told of the number of a task in its list and of its answer, in the order in which they end."""


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

    if where.scheduler is not None:
        from thermofit.records.executor_dask import run_on_scheduler

        run_on_scheduler(tasks, where.scheduler, where.threads, done)
    elif where.serial or len(tasks) == 1:
        for index, task in enumerate(tasks):
            done(index, task.function(*task.arguments))
    else:
        _run_in_processes(tasks, where, done)
    return [answers[index] for index in range(len(tasks))]


@dataclass
class _Worker:
    """A local process, the pipe to it, and the number of its task (None: idle)."""

    process: BaseProcess
    pipe: Connection
    busy: int | None = None


@dataclass
class _Crew:
    """The local processes, the tasks that wait, and how often each has lost its worker."""

    tasks: Sequence[Task]
    where: Executor
    waiting: deque[int]
    workers: list[_Worker] = field(default_factory=list)
    losses: dict[int, int] = field(default_factory=dict)

    def occupy(self) -> None:
        """Give waiting tasks to idle workers; start as many of these as are needed and allowed."""
        while self.waiting:
            idle = next((worker for worker in self.workers if worker.busy is None), None)
            if idle is None and len(self.workers) >= self.where.jobs:
                return
            if idle is None:
                idle = _started()
                self.workers.append(idle)
            idle.busy = self.waiting.popleft()
            try:
                idle.pipe.send((self.tasks[idle.busy], self.where.threads))
            except (BrokenPipeError, ConnectionResetError):
                self.lost(idle)

    def lost(self, worker: _Worker) -> None:
        """A worker has ended in the middle of its task: the task is the next one again. NumericsError after LOSSES times."""
        self.workers.remove(worker)
        worker.pipe.close()
        worker.process.join()
        assert worker.busy is not None
        self.losses[worker.busy] = self.losses.get(worker.busy, 0) + 1
        if self.losses[worker.busy] >= LOSSES:
            raise NumericsError(lost_text(self.tasks[worker.busy].label, f"its process ended with code {worker.process.exitcode}"))
        self.waiting.appendleft(worker.busy)

    def dismiss(self) -> None:
        """End all workers, whatever they are doing."""
        for worker in self.workers:
            worker.pipe.close()
            worker.process.kill()
        for worker in self.workers:
            worker.process.join()


def _run_in_processes(tasks: Sequence[Task], where: Executor, done: OnDone) -> None:
    crew = _Crew(tasks, where, deque(range(len(tasks))))
    open_tasks = len(tasks)
    try:
        while open_tasks:
            crew.occupy()
            by_pipe = {worker.pipe: worker for worker in crew.workers if worker.busy is not None}
            for pipe in wait(list(by_pipe)):
                worker = by_pipe[pipe]  # type: ignore[index]
                try:
                    good, answer = worker.pipe.recv()
                except (EOFError, ConnectionResetError):
                    crew.lost(worker)
                    continue
                if not good:
                    raise answer
                assert worker.busy is not None
                index, worker.busy = worker.busy, None
                open_tasks -= 1
                done(index, answer)
    finally:
        crew.dismiss()


def _started() -> _Worker:
    """A new process: spawned, because a fork of a process with OpenMP threads hangs."""
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there,), daemon=True)
    process.start()
    there.close()  # now the end of the process is the end of the pipe
    return _Worker(process, here)


def _serve(pipe: Connection) -> None:
    """Work on tasks until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it too, and ends this process
    sys.stdout = sys.stderr  # the standard output belongs to the result
    mute()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            task, threads = pipe.recv()
        except EOFError:
            return
        pipe.send(answer_of(task, threads))


def _end_with_parent() -> None:
    """A killed parent must not leave workers behind that go on writing into its run folder."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
