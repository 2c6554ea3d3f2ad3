"""Tasks on the workers of a Dask scheduler; Dask is an optional extra and is imported only here."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from thermofit.core.digest import source_digest
from thermofit.core.errors import NumericsError, StudyError
from thermofit.records.progress import mute
from thermofit.records.tasks import LOSSES, Task, answer_of, lost_text

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_S = 10.0
"""How long the scheduler has to answer, s."""
FIRST_WORKER_S = 30.0
"""How long a scheduler without workers is waited for, s."""
NO_WORKER_S = 120.0
"""How long a run goes on waiting after its last worker is lost, s."""
_LOOK_S = 5.0
_BUSY = threading.Lock()


def run_on_scheduler(tasks: Sequence[Task], address: str, threads: int, done: Callable[[int, Any], None]) -> None:
    """Run tasks on the workers; `done(index, answer)` for each. Dask itself repeats a task whose worker is lost.

    StudyError where Dask is not installed, the scheduler cannot be reached, has no worker, or its workers run other sources of
    thermofit; NumericsError where workers are lost again and again, or for good.
    """
    with _connected(address) as client:
        run, digest = uuid.uuid4().hex, source_digest()
        pending: dict[Future, int] = {
            client.submit(remote_answer, task, threads, digest, key=f"thermofit-{run}-{index}", pure=False): index
            for index, task in enumerate(tasks)
        }
        alone_since: float | None = None
        try:
            while pending:
                finished = _finished(list(pending), address)
                alone_since = _alone_since(client, address, alone_since if not finished else None)
                for future in finished:
                    index = pending.pop(future)
                    good, answer = _result(future, tasks[index], address)
                    if not good:
                        raise answer
                    done(index, answer)
        finally:
            client.cancel(list(pending))


def remote_answer(task: Task, threads: int, digest: str) -> tuple[bool, Any]:
    """The answer of a task in a Dask worker whose sources are those of the command; one task at a time in a process."""
    if source_digest() != digest:
        return False, StudyError(
            "--scheduler: a worker runs other sources of thermofit (or other effect files, THERMOFIT_EFFECTS) than this command; expected "
            "the same: install the same version for the workers and start them again"
        )
    mute()
    with _BUSY:  # the threads of a worker share kernels that are not made for several callers at once
        return answer_of(task, threads)


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    """A client of the scheduler, which has at least one worker."""
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
            yield client


def _finished(pending: list[Future], address: str) -> list[Future]:
    """The tasks that have ended, after waiting a moment for the first one. NumericsError where the scheduler is gone."""
    from concurrent.futures import CancelledError

    from distributed import wait

    try:
        return list(wait(pending, timeout=_LOOK_S, return_when="FIRST_COMPLETED").done)
    except TimeoutError:
        return []
    except CancelledError as error:  # so Dask calls it when the connection is lost
        raise NumericsError(
            f"--scheduler {address}: the connection was lost ({_line(error)}); what is finished is kept: start scheduler and workers, and "
            "the same command resumes"
        ) from error


def _line(error: BaseException) -> str:
    """The text of an error of Dask in one short line."""
    return " ".join(str(error).split())[:160] or type(error).__name__


def _alone_since(client: Client, address: str, since: float | None) -> float | None:
    """When the scheduler was first seen without workers, None while it has some. NumericsError where it stays so."""
    if client.scheduler_info()["workers"]:
        return None
    now = time.monotonic()
    if since is not None and now - since > NO_WORKER_S:
        raise NumericsError(
            f"--scheduler {address}: the last worker was lost and none has joined for {NO_WORKER_S:.0f} s; what is finished is kept: start "
            "workers, and the same command resumes"
        )
    return now if since is None else since


def _result(future: Future, task: Task, address: str) -> tuple[bool, Any]:
    """Answer or error of an ended task."""
    from distributed import KilledWorker

    if future.status == "finished":
        good, answer = future.result()
        return bool(good), answer
    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        return False, NumericsError(lost_text(task.label, f"by the scheduler's count, which gives up after {LOSSES}"))
    found = f"its state is '{future.status}'" if error is None else f"{type(error).__name__}: {_line(error)}"
    return False, NumericsError(
        f"--scheduler {address}: {task.label} was given up by Dask ({found}); what is finished is kept: see to scheduler and workers, and "
        "the same command resumes"
    )
