"""What a long job tells while it runs: a display on a terminal, plain lines elsewhere if they are asked for, and the log of its stage."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from thermofit.records.log import current_log, line_of

if TYPE_CHECKING:
    from rich.progress import Progress

displays: list[Progress] = []
"""The display on the terminal, if any: an inner progress becomes a further line of the outer one."""
_EVERY_S = 1.0
"""Seconds between two lines of a job that counts without telling numbers."""
_muted = False
_verbosity = 0


class Advance(Protocol):
    """Report n more units done, with a short note; `told` holds the numbers of an iteration, which a log keeps."""

    def __call__(self, n: float = 1, note: str = "", told: Mapping[str, Any] | None = None) -> None: ...


def set_verbosity(level: int) -> None:
    """-1: show nothing; 0: a display on a terminal, nothing elsewhere; 1: one plain line per iteration where there is no terminal."""
    global _verbosity
    _verbosity = level


@contextmanager
def progress(description: str, total: float | None, quiet: bool = False) -> Iterator[Advance]:
    """Show a job of `total` units (None: unknown) while the block runs; gives `advance(n=1, note="", told=None)`.

    Shows nothing where `quiet`, and where stderr is no terminal unless lines are asked for; the log is written in any case. Exceptions,
    KeyboardInterrupt among them, pass through after the line has been closed.
    """
    if _muted:
        yield _silent
        return
    lines = _Lines(description, total, shown=not quiet and _verbosity > 0 and not sys.stderr.isatty())
    if quiet or _verbosity < 0 or not sys.stderr.isatty():
        yield lines
        return
    with _display() as display:
        task = display.add_task(description, total=total, note="")

        def advance(n: float = 1, note: str = "", told: Mapping[str, Any] | None = None) -> None:
            display.update(task, advance=n, note=note)
            lines(n, note, told)

        try:
            yield advance
        finally:
            display.stop_task(task)
            if len(display.tasks) > 1:
                display.remove_task(task)


def mute() -> None:
    """Show nothing in this process from now on: a worker shares the terminal with the process that reports for all."""
    global _muted
    _muted = True


def _silent(n: float = 1, note: str = "", told: Mapping[str, Any] | None = None) -> None:
    """Nobody looks."""


class _Lines:
    """Writes the steps of a job into the log of its stage and, if `shown`, as plain lines: every iteration that tells numbers, of mere
    counts one a second and the last."""

    def __init__(self, description: str, total: float | None, *, shown: bool) -> None:
        self.description, self.total, self.shown = description, total, shown
        self.begin = time.monotonic()
        self.done, self.last = 0.0, self.begin - _EVERY_S

    def __call__(self, n: float = 1, note: str = "", told: Mapping[str, Any] | None = None) -> None:
        self.done += n
        now = time.monotonic()
        if told is None and self.done != self.total and now - self.last < _EVERY_S:
            return
        self.last = now
        step = {"what": self.description, "done": self.done, "total": self.total, "note": note, **(told or {})}
        if self.total and 0.0 < self.done < self.total:
            step["left_s"] = round((now - self.begin) * (self.total - self.done) / self.done, 1)
        log = current_log()
        if log is not None:
            log.event("step", **step)
        if self.shown:
            sys.stderr.write(line_of("", {"event": "step", "elapsed_s": now - self.begin, **step}) + "\n")


@contextmanager
def _display() -> Iterator[Progress]:
    """The running display, or a new one on stderr."""
    if displays:
        yield displays[0]
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    # Notes and descriptions are data (file names, channel names): square brackets in them are no markup.
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True)) as display:
        displays.append(display)
        try:
            yield display
        finally:
            displays.clear()
