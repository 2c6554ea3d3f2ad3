"""Faults of the machine: signals at the command line, a full disk, a folder that cannot be written, a clock that goes back, too little
memory, a second process. After each: one sentence, no damaged artefact, and the same command ends with the same result."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import tiny
from record_studies import call

from thermofit.core.errors import DataError, NumericsError, StudyError
from thermofit.records.artefact import open_record, write_record
from thermofit.records.executor import Executor, Task, run_all
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study

StudyOf = Callable[..., Study]
ROOT = Path(__file__).parents[2]
SUPPORT = ROOT / "tests" / "support"


def command(*words: str) -> list[str]:
    return [sys.executable, "-c", "from thermofit.cli import main; main()", *words]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)])}


def sentence(found: Any, code: int, text: str) -> None:
    """One sentence on stderr, and the exit code."""
    assert found.exit_code == code, found.output
    assert text in found.stderr and found.stderr.count("error: ") == 1 and "Traceback" not in found.output, found.output


@contextmanager
def another(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A second process that works in a folder."""
    code = "import sys; from pathlib import Path; from thermofit.records.lock import locked\n"
    code += "with locked(Path(sys.argv[1])):\n    print('has it', flush=True)\n    sys.stdin.read()"
    words = [sys.executable, "-c", code, str(folder)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment()) as process:
        assert process.stdin is not None and process.stdout is not None and process.stdout.readline() == "has it\n"
        yield process
        process.stdin.close()


def left_behind(study: Study) -> list[str]:
    return [path.name for path in study.run_dir.rglob(".*")]


@pytest.mark.parametrize(
    "number",
    [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow), pytest.param(signal.SIGUSR1, marks=pytest.mark.slow)],
)
def test_signal_at_the_command_line(study_of: StudyOf, number: signal.Signals) -> None:
    """During start-up, and among the evaluations of a stage; what was kept then is used, and the result is that of the undisturbed run."""
    study = study_of("stages.plastic.method=trust-region")
    words = ("identify-plastic", str(study.source), "--force", "--set", "stages.plastic.method=trust-region")
    path = artefact_path(study.run_dir, "identify-plastic")
    whole = tiny.stage_run("identify-plastic")(study, force=True).record
    values = {name: p.value for name, p in whole.parameters.items()}
    before = path.read_bytes()
    with subprocess.Popen(command("--help"), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment()) as process:
        time.sleep(0.15)
        process.send_signal(number)
        said = process.communicate()[1]
        assert process.returncode in (130, 0, -number) and "Traceback" not in said, "-number: Python itself had not begun"
    with subprocess.Popen(command(*words), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment()) as process:
        deadline = time.monotonic() + 120.0
        while len(list(study.run_dir.glob(".identify-plastic.*/*.npz"))) < 3:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.002)
        process.send_signal(number)
        said = process.communicate()[1]
    assert process.returncode == 130 and f"interrupted by {number.name}; finished evaluations are kept" in said
    assert path.read_bytes() == before
    again = tiny.stage_run("identify-plastic")(study, force=True).record
    assert again.summary["evaluations"]["replayed"] >= 3
    assert {name: p.value for name, p in again.parameters.items()} == values and not left_behind(study)


@contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[None]:
    """A file system of that size in a folder; skips where none can be mounted."""
    folder.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "none", str(folder)], capture_output=True, check=False)
    if done.returncode != 0:
        pytest.skip("a small file system can be mounted by root alone")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=False)


@pytest.mark.parametrize("kilobytes", [4, 60, 300])
def test_full_disk(study_of: StudyOf, tmp_path: Path, kilobytes: int) -> None:
    """Whatever the first file is that does not fit, one sentence, and nothing that looks like a result."""
    study = study_of()
    small = tmp_path / "small"
    with small_disk(small, kilobytes):
        found = call("run", str(study.source), "--run-dir", str(small / "run"), "--until", "identify-elastic")
        sentence(found, 2, "space")
        for path in (small / "run").glob("*.h5"):
            open_record(path)
        assert not list(small.rglob("*.partial"))


def test_folder_that_cannot_be_written(study_of: StudyOf, tmp_path: Path) -> None:
    """Results that are there can be shown, and are fresh; new ones are refused by one sentence. A folder in the place of a file stands for
    missing rights, which root does not miss."""
    study = study_of()
    (study.run_dir / "verify.h5").mkdir()
    sentence(call("verify", str(study.source)), 2, "verify.h5")
    (study.run_dir / "verify.h5").rmdir()
    file = tmp_path / "file"
    file.touch()
    sentence(call("simulate", str(study.source), "--run-dir", str(file / "run")), 2, "file")


def test_clock_that_goes_back(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is fresh is told by contents: neither times of files nor the clock count."""
    study = study_of()
    for number, path in enumerate(study.run_dir.rglob("*")):
        moment = (0.0, 4e9)[number % 2]
        os.utime(path, (moment, moment))
    monkeypatch.setattr(time, "time", lambda: 1e6)
    for stage in tiny.CHAIN:
        assert tiny.stage_run(stage)(study).fresh, stage
    made = tiny.stage_run("identify-elastic")(study, force=True)
    os.utime(made.record.path, (0.0, 0.0))
    assert tiny.stage_run("identify-elastic")(study).fresh
    frame = next((study.run_dir / "raw" / "ir").iterdir())
    state, text = frame.stat(), frame.read_text()
    frame.write_text(text.replace("1", "2"))
    os.utime(frame, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert not tiny.stage_run("calibrate-ir")(study).fresh, "changed with its old time and size"


def too_large() -> float:
    raise MemoryError("Unable to allocate 8.00 TiB")


def test_worker_without_memory_is_one_sentence() -> None:
    with pytest.raises(NumericsError, match=r"start [12]: the memory of its worker does not suffice .*8.00 TiB.*the same command resumes"):
        run_all([Task("start 1", too_large), Task("start 2", too_large)], Executor(jobs=2))


def test_second_process_is_refused(study_of: StudyOf) -> None:
    study = study_of()
    with another(study.run_dir) as process:
        sentence(call("run", str(study.source)), 2, f"is in use by process {process.pid} on ")
        sentence(call("identify-elastic", str(study.source), "--force"), 2, "in use by process")
        assert call("show", str(study.run_dir)).exit_code == 0, "looking is free"
    assert call("identify-elastic", str(study.source)).exit_code == 0 and not left_behind(study)


def test_turned_bit_is_noticed_by_the_stage_that_reads(study_of: StudyOf) -> None:
    """Exit 3 of a single stage; the chain makes it anew and says so."""
    study = study_of()
    path = artefact_path(study.run_dir, "identify-elastic")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"identify-elastic\.h5: its content is not what was written there"):
        tiny.stage_run("identify-plastic")(study)
    sentence(call("identify-plastic", str(study.source)), 3, "its content is not what was written there")
    made = tiny.stage_run("identify-elastic")(study)
    assert not made.fresh and any("made anew" in text for text in made.record.summary["remarks"])


def test_what_cannot_be_written_is_told_with_its_path(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    from thermofit.records.artefact import RecordContent

    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    study = study_of()
    with pytest.raises(StudyError, match=r"artefact '.*verify\.h5' cannot be written .*No space left"):
        write_record(artefact_path(study.run_dir, "verify"), RecordContent("verify", {}, {}, {}))
    assert not left_behind(study)
