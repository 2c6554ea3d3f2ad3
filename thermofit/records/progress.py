"""Progress of a long job on stderr, where a human looks at it; silent everywhere else."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.progress import Progress

displays: list[Progress] = []
"""The display on the terminal, if any: an inner progress becomes a further line of the outer one."""
_muted = False


class Advance(Protocol):
    """Report n more units done, with a short note."""

    def __call__(self, n: float = 1, note: str = "") -> None: ...


@contextmanager
def progress(description: str, total: float | None, quiet: bool = False) -> Iterator[Advance]:
    """Show a job of `total` units (None: unknown) while the block runs; gives `advance(n=1, note="")`.

    Silent where `quiet` or where stderr is no terminal. Exceptions, KeyboardInterrupt among them, pass through after the
    line has been closed.
    """
    if quiet or _muted or not sys.stderr.isatty():
        yield _silent
        return
    with _display() as display:
        task = display.add_task(description, total=total, note="")

        def advance(n: float = 1, note: str = "") -> None:
            display.update(task, advance=n, note=note)

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


def _silent(n: float = 1, note: str = "") -> None:
    """Nobody looks."""


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
