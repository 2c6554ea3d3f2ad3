"""A log beside every artefact, `<stage>.log.jsonl`: one JSON object a line, so that others see what a long stage does while it does it.

Every line has `time` (UTC), `elapsed_s` since the stage began and `event`:

    begin   stage, process, host            step   what, done, total (null: unknown), note; of a fit objective_over_noise and parameters
    end     verdict, trustworthy, wall_s    error  text

A stage that is run anew begins its log anew, unless the last one ended without a word: then it resumes, and so does the log.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

ENDING = ".log.jsonl"
END, ERROR = "end", "error"


def log_path(artefact: Path) -> Path:
    """Where the log of an artefact lies."""
    return artefact.with_name(artefact.stem + ENDING)


class Log:
    """An open log; every event is one write, so that a reader never sees half a line of another process."""

    def __init__(self, stream: IO[str]) -> None:
        self.stream, self.begin = stream, time.monotonic()

    def event(self, event: str, **content: Any) -> None:
        """Append one line."""
        from thermofit.core.jsonable import json_text  # numpy comes with it, which a command that only helps must not pay

        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"time": now, "elapsed_s": round(time.monotonic() - self.begin, 3), "event": event, **content}
        self.stream.write(json_text(line).replace("\n", " ") + "\n")
        self.stream.flush()


_open: list[Log] = []
"""Logs of the stages that are at work in this process, the innermost last."""


def current_log() -> Log | None:
    """The log of the innermost stage at work; None outside of any."""
    return _open[-1] if _open else None


@contextmanager
def logged(artefact: Path, stage: str) -> Iterator[Log | None]:
    """Log a stage while the block runs. Trial artefacts, whose names begin with a dot, write into the log of the stage that tries them.

    None where no log can be written: the artefact beside it cannot be written either, and that is told. Exceptions are logged and pass.
    """
    if artefact.name.startswith("."):
        yield current_log()
        return
    path = log_path(artefact)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = "w" if not path.exists() or has_ended(path) else "a"
        cut = mode == "a" and not path.read_bytes().endswith(b"\n")
        stream: IO[str] = path.open(mode, encoding="utf-8")
        stream.write("\n" if cut else "")  # the line at which the last one was killed
    except OSError:
        yield None
        return
    with stream:
        log = Log(stream)
        log.event("begin", stage=stage, process=os.getpid(), host=platform.node())
        _open.append(log)
        try:
            yield log
        except BaseException as error:
            log.event(ERROR, text=" ".join(str(error).split()) or type(error).__name__)
            raise
        finally:
            _open.remove(log)


def events_of(path: Path) -> list[Mapping[str, Any]]:
    """The events of a log as far as it is written; a line that is not whole yet is left out."""
    found: list[Mapping[str, Any]] = []
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
    except FileNotFoundError:
        return []
    for line in lines:
        try:
            event = json.loads(line) if line.endswith("\n") else None
        except json.JSONDecodeError:
            event = None
        if isinstance(event, dict) and "event" in event:
            found.append(event)
    return found


def has_ended(path: Path) -> bool:
    """Whether the last event of a log is an end or an error."""
    events = events_of(path)
    return bool(events) and events[-1]["event"] in (END, ERROR)


def alive(events: list[Mapping[str, Any]]) -> bool:
    """Whether the process that writes a log is at work; taken for granted where it runs on another machine."""
    begun = [event for event in events if event["event"] == "begin"]
    if not begun or events[-1]["event"] in (END, ERROR):
        return False
    if begun[-1].get("host") != platform.node():
        return True
    try:
        os.kill(int(begun[-1]["process"]), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def line_of(stage: str, event: Mapping[str, Any]) -> str:
    """One event as a plain line for a reader."""
    kind, lead = event["event"], f"{event['elapsed_s']:9.1f} s  {stage:<17}"
    if kind == "begin":
        return f"{lead}  begins (process {event.get('process')} on {event.get('host')})"
    if kind == END:
        return f"{lead}  {event.get('verdict', '')}"
    if kind == ERROR:
        return f"{lead}  error: {event.get('text', '')}"
    count = f"{event.get('done', 0):g}" + (f" of {event['total']:g}" if event.get("total") is not None else "")
    return f"{lead}  {event.get('what', '')}: {count}  {event.get('note', '')}".rstrip()
