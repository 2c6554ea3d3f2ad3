"""Tasks give the same answers wherever they run; lost workers are replaced, errors are raised, nothing survives its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import local_dask
import pytest
import worker_tasks

from thermofit.core.errors import NumericsError, StudyError
from thermofit.records import executor
from thermofit.records.executor import SERIAL, Executor, Task, run_all

ROOT = Path(__file__).resolve().parents[2]
TWO = Executor(jobs=2)


@pytest.fixture(autouse=True)
def _workers_find_the_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(ROOT / "tests" / "support")]))


def squares(n: int) -> list[Task]:
    return [Task(f"start {i}", worker_tasks.square, (i,)) for i in range(n)]


@pytest.mark.parametrize("where", [SERIAL, TWO], ids=["serial", "processes"])
def test_answers_come_in_the_order_of_the_tasks(where: Executor) -> None:
    seen: dict[int, int] = {}
    assert run_all(squares(5), where, seen.__setitem__) == [0, 1, 4, 9, 16]
    assert seen == {0: 0, 1: 1, 2: 4, 3: 9, 4: 16}
    assert run_all([], where) == []


def test_processes_are_others_with_their_threads() -> None:
    found = run_all([Task(f"{i}", worker_tasks.process_and_threads) for i in range(2)], Executor(jobs=2, threads=1))
    assert len({pid for pid, _ in found}) <= 2 and all(threads == 1 for _, threads in found)
    assert os.getpid() not in {pid for pid, _ in found}


def test_processes_work_side_by_side(tmp_path: Path) -> None:
    """Each of two tasks ends only after the other has begun."""
    tasks = [Task("a", worker_tasks.meet, (str(tmp_path), "a", "b")), Task("b", worker_tasks.meet, (str(tmp_path), "b", "a"))]
    assert run_all(tasks, TWO) == ["met", "met"]


def test_a_lost_worker_is_replaced(tmp_path: Path) -> None:
    tasks = [*squares(2), Task("start 3", worker_tasks.killed_at_first, (str(tmp_path / "once"), 3)), *squares(2)]
    assert run_all(tasks, TWO) == [0, 1, 3, 0, 1]


def test_a_task_that_always_loses_its_worker_is_named() -> None:
    with pytest.raises(NumericsError, match=r"start 7: its worker was lost 3 times \(its process ended with code -9\)"):
        run_all([Task("start 7", worker_tasks.always_killed), *squares(1)], TWO)


@pytest.mark.parametrize("where", [SERIAL, TWO], ids=["serial", "processes"])
def test_errors_for_the_user_arrive_as_they_are(where: Executor) -> None:
    with pytest.raises(StudyError, match=r"^key 'a' is wrong$"):
        run_all([Task("start 1", worker_tasks.refused), Task("start 2", worker_tasks.square, (1,))], where)


def test_unexpected_errors_say_where_they_came_from() -> None:
    with pytest.raises(RuntimeError, match=r"(?s)start 1, in a worker:.*worker_tasks\.py.*ZeroDivisionError"):
        run_all([Task("start 1", worker_tasks.mistaken), *squares(1)], TWO)


def test_wishes_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(StudyError, match="--jobs is 0; expected"):
        Executor(jobs=0)
    with pytest.raises(StudyError, match="--jobs 2 and --scheduler tcp://a:1 are both given"):
        Executor(jobs=2, scheduler="tcp://a:1")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to tell a dead process from a living one")
def test_workers_end_with_their_killed_parent(tmp_path: Path) -> None:
    code = f"import worker_tasks, pathlib; worker_tasks.run_two_that_write({str(tmp_path)!r})"
    process = subprocess.Popen([sys.executable, "-c", code])
    alive = [tmp_path / "0", tmp_path / "1"]
    wait_until(lambda: all(path.exists() for path in alive), process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    pids = [int(path.read_text().split()[0]) for path in alive]
    deadline = time.monotonic() + 20.0
    while any(Path(f"/proc/{pid}").exists() and "Z" not in Path(f"/proc/{pid}/stat").read_text().split()[2] for pid in pids):
        assert time.monotonic() < deadline, "workers outlive their parent"
        time.sleep(0.05)


def wait_until(condition: object, process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():  # type: ignore[operator]
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A Dask scheduler with four workers, each a process of its own, and its address. It gives up a task that two of them die of."""
    pytest.importorskip("distributed", reason="needs the extra dask")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "support")])}
    environment["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "1"
    with local_dask.cluster_of(tmp_path_factory.mktemp("dask"), environment, 4) as found:
        yield found.address


@pytest.mark.slow
def test_dask_gives_the_same_answers(cluster: str, tmp_path: Path) -> None:
    where = Executor(scheduler=cluster)
    assert run_all(squares(4), where) == [0, 1, 4, 9]
    with pytest.raises(StudyError, match=r"^key 'a' is wrong$"):
        run_all([Task("start 1", worker_tasks.refused)], where)
    # The task goes on on another worker.
    assert run_all([*squares(1), Task("start 2", worker_tasks.killed_at_first, (str(tmp_path / "once"), 5))], where) == [0, 5]
    with pytest.raises(NumericsError, match="start 9: its worker was lost"):
        run_all([Task("start 9", worker_tasks.always_killed)], where)


@pytest.mark.slow
def test_scheduler_that_is_killed_is_one_sentence_and_the_next_one_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra dask")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "support")])}
    begun = tmp_path / "begun"
    for name in ("first", "next"):
        (tmp_path / name).mkdir()
    with local_dask.cluster_of(tmp_path / "first", environment, 1) as cluster:

        def kill() -> None:
            while not begun.exists():
                time.sleep(0.01)
            cluster.scheduler.kill()

        thread = threading.Thread(target=kill)
        thread.start()
        with pytest.raises(NumericsError, match=r"the connection was lost; what is finished is kept: .*the same command resumes"):
            run_all([Task("start 1", worker_tasks.write_on, (str(begun),))], Executor(scheduler=cluster.address))
        thread.join()
    with local_dask.cluster_of(tmp_path / "next", environment, 1) as cluster:
        assert run_all(squares(2), Executor(scheduler=cluster.address)) == [0, 1]


def test_scheduler_that_does_not_answer_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="needs the extra dask")
    monkeypatch.setattr(executor, "CONNECT_S", 0.5)
    with pytest.raises(StudyError, match=r"--scheduler tcp://127\.0\.0\.1:1: no Dask scheduler answers there"):
        run_all(squares(1), Executor(scheduler="tcp://127.0.0.1:1"))
    with pytest.raises(StudyError, match=r"--scheduler nonsense://x: no Dask scheduler answers there"):
        run_all(squares(1), Executor(scheduler="nonsense://x"))


def test_dask_that_is_not_installed_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(StudyError, match=r"--scheduler needs Dask, which is not installed \(dask\): pip install 'thermofit\[dask\]'"):
        run_all(squares(1), Executor(scheduler="tcp://127.0.0.1:1"))
