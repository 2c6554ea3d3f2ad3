"""Logs beside artefacts: what a stage does is told line by line, to others and after a kill; plain lines where they are asked for."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.identify.solve import Follower
from thermofit.identify.variables import fit_variables
from thermofit.records.log import alive, events_of, has_ended, line_of, log_path
from thermofit.records.progress import progress, set_verbosity
from thermofit.records.staging import Made, job, produce


@pytest.fixture(autouse=True)
def plain() -> Iterator[None]:
    yield
    set_verbosity(0)


def stage(folder: Path, make: Any = None, *, force: bool = False) -> Path:
    """A stage of three iterations; returns the path of its log."""

    def usual() -> Made:
        with progress("fit 2x2x1", None) as advance:
            for k in range(3):
                advance(1, f"{2.0 - 0.5 * k:.3g} times the noise", {"objective_over_noise": 2.0 - 0.5 * k, "parameters": {"F": 0.4 + k}})
        return Made({}, {"verdict": "identified F"})

    task = job(folder, "identify-plastic", {"mesh": "coarse"}, {})
    produce(task, make or usual, force=force)
    return log_path(task.path)


def test_a_stage_leaves_its_log(tmp_path: Path) -> None:
    path = stage(tmp_path)
    assert path.name == "identify-plastic.log.jsonl"
    events = events_of(path)
    assert [e["event"] for e in events] == ["begin", "step", "step", "step", "end"]
    assert [e.get("done") for e in events[1:4]] == [1.0, 2.0, 3.0] and events[3]["parameters"] == {"F": 2.4}
    assert events[-1]["verdict"] == "identified F" and events[-1]["trustworthy"] is True
    assert all(a["elapsed_s"] <= b["elapsed_s"] for a, b in itertools.pairwise(events))
    assert has_ended(path) and not alive(events)


def test_fresh_stages_leave_their_log_and_forced_ones_begin_anew(tmp_path: Path) -> None:
    path = stage(tmp_path)
    before = path.read_text()
    assert stage(tmp_path).read_text() == before
    assert len(events_of(stage(tmp_path, force=True))) == 5
    assert path.read_text() != before


def test_errors_are_logged_and_pass(tmp_path: Path) -> None:
    def fails() -> Made:
        raise NumericsError("no equilibrium\nat 3 s")

    with pytest.raises(NumericsError):
        stage(tmp_path, fails)
    assert events_of(tmp_path / "identify-plastic.log.jsonl")[-1] | {"time": "", "elapsed_s": 0} == {
        "time": "", "elapsed_s": 0, "event": "error", "text": "no equilibrium at 3 s",
    }  # fmt: skip


def test_a_killed_stage_goes_on_with_its_log(tmp_path: Path) -> None:
    path = stage(tmp_path)
    whole = path.read_text().splitlines(keepends=True)
    path.write_text("".join(whole[:3]) + whole[3][:20])  # killed in the midst of a line
    assert len(events_of(path)) == 3 and not has_ended(path)
    events = events_of(stage(tmp_path, force=True))
    assert [e["event"] for e in events].count("begin") == 2 and events[-1]["event"] == "end"


def test_mere_counts_are_thinned(tmp_path: Path) -> None:
    def counts() -> Made:
        with progress("verify", 1000) as advance:
            for _ in range(1000):
                advance()
        return Made({}, {})

    steps = [e for e in events_of(stage(tmp_path, counts)) if e["event"] == "step"]
    assert 2 <= len(steps) < 20 and steps[-1]["done"] == 1000.0


def test_plain_lines_only_where_they_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stage(tmp_path)
    assert capsys.readouterr() == ("", "")
    set_verbosity(1)
    stage(tmp_path, force=True)
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 3 and "fit 2x2x1: 2  1.5 times the noise" in err
    set_verbosity(-1)
    stage(tmp_path, force=True)
    assert capsys.readouterr() == ("", "")


def test_iterations_tell_error_over_noise_and_what_moves() -> None:
    told: list[tuple[str, Any]] = []
    follow = Follower(lambda n=1, note="", more=None: told.append((note, more)), ("E", "nu"), fit_variables(("E", "nu"), Parameters.of({})))
    for x, f in (((6.0e4, 0.3), 400.0), ((6.0e4, 0.31), 100.0)):
        follow(SimpleNamespace(x=np.array(x), f=f), np.zeros(100))
    follow(SimpleNamespace(x=np.array((6.0e4, 0.4)), f=np.inf), None)
    assert told[0][0] == "2 times the noise; E 60000, nu 0.3"
    assert told[1] == ("1 times the noise; nu 0.31", {"objective_over_noise": 1.0, "parameters": {"E": 6.0e4, "nu": 0.31}})
    assert told[2][0] == "failed"


def watch(*arguments: Any) -> Any:
    return CliRunner().invoke(app, ["watch", *(str(a) for a in arguments)])


def test_watch_tells_what_has_been_done(tmp_path: Path) -> None:
    stage(tmp_path)
    seen = watch(tmp_path, "--once", "--last", 9)
    assert seen.exit_code == 0 and len(seen.stdout.splitlines()) == 5
    assert "identify-plastic   fit 2x2x1: 3  1 times the noise" in seen.stdout and "identified F" in seen.stdout
    raw = [json.loads(line) for line in watch(tmp_path, "--once", "--json").stdout.splitlines()]
    assert [e["event"] for e in raw] == ["step", "step", "end"] and raw[0]["stage"] == "identify-plastic"


def test_watch_of_nothing_is_told(tmp_path: Path) -> None:
    assert watch(tmp_path, "--once").exit_code == 2
    assert "no folder" in watch(tmp_path / "nothing").stderr


def test_watch_tells_of_a_process_that_has_gone(tmp_path: Path) -> None:
    path = stage(tmp_path)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    text = "".join(path.read_text().splitlines(keepends=True)[:3])
    path.write_text(re.sub(r'"process": ?\d+', f'"process": {gone.pid}', text))
    assert not alive(events_of(path))
    assert "without a word" in watch(tmp_path, "--once").stderr


def test_watch_follows_a_run_of_another_process(tmp_path: Path) -> None:
    """It shows steps as they are written and ends by itself when nothing is at work."""
    path = tmp_path / "verify.log.jsonl"

    def line(event: str, **more: Any) -> str:
        return json.dumps({"time": "", "elapsed_s": 1.0, "event": event, **more}) + "\n"

    path.write_text(line("begin", stage="verify", process=os.getpid(), host=os.uname().nodename))

    def write() -> None:
        for k in range(3):
            time.sleep(0.6)
            with path.open("a") as stream:
                stream.write(line("step", what="verify", done=k + 1, total=3, note=""))
        with path.open("a") as stream:
            stream.write(line("end", verdict="verified"))

    writer = threading.Thread(target=write)
    writer.start()
    seen = watch(tmp_path, "--wait", 1.0)
    writer.join()
    assert [text for k in (1, 2, 3) if (text := f"verify: {k} of 3") not in seen.stdout] == []
    assert seen.stdout.splitlines()[-1] == line_of("verify", events_of(path)[-1])
