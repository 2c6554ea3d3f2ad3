"""How a command ends before its time: at once by SIGINT, at the next kept evaluation by SIGTERM and SIGUSR1.

A batch system announces the end of a job by a signal (Slurm: `--signal=USR1@120`, then SIGTERM, then SIGKILL after 30 s). The command
finishes the evaluation that it is at, keeps it, and ends with exit code 130; the same command then resumes behind it. Where no evaluations
are kept there is nothing to wait for, and it ends at once. What is written is whole or not there at any moment in any case (`core.files`).
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any
from weakref import WeakSet

GRACE_S = 20.0
"""How long after SIGTERM an evaluation may go on, s; batch systems wait 30 s before they kill."""
_AGAIN_S = 0.05
_keepers: WeakSet[Any] = WeakSet()
"""What keeps evaluations in this process."""
_asked = ""
"""Name of the signal that asked for the end; empty where none has."""


class Stopped(KeyboardInterrupt):
    """The end that a signal has asked for; the text names it."""


def keeps(keeper: object) -> None:
    """From now on, as long as this object lives, there are evaluations worth waiting for."""
    _keepers.add(keeper)


def kept() -> None:
    """An evaluation has been kept, or a stage is done: Stopped where the end was asked for."""
    if _asked:
        raise Stopped(_asked)


@contextmanager
def stoppable() -> Iterator[None]:
    """Hear the signals while the block runs; does nothing outside of the main thread, which alone hears them."""
    global _asked
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: dict[str, Callable[[int, FrameType | None], Any]] = {
        "SIGINT": _on_interrupt,
        "SIGTERM": _on_signal,
        "SIGUSR1": _on_signal,
        "SIGALRM": _on_alarm,
    }
    there = {name: handler for name, handler in heard.items() if hasattr(signal, name)}
    before = {name: signal.signal(getattr(signal, name), handler) for name, handler in there.items()}
    hook, sys.unraisablehook = sys.unraisablehook, _again(sys.unraisablehook)
    try:
        yield
    except Exception as error:
        if _asked:  # a library has made an error of its own of the interrupt
            raise Stopped(_asked) from error
        raise
    finally:
        _asked = ""
        sys.unraisablehook = hook
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for name, handler in before.items():
            signal.signal(getattr(signal, name), signal.SIG_DFL if handler is None else handler)


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    """At once."""
    global _asked
    _asked = signal.Signals(number).name
    raise Stopped(_asked)


def _on_signal(number: int, frame: FrameType | None) -> None:
    """Asked for the first time: at the next kept evaluation; again: at once."""
    global _asked
    again, _asked = bool(_asked), signal.Signals(number).name
    if again or not _keepers:
        raise Stopped(_asked)
    if number == signal.SIGTERM:
        signal.setitimer(signal.ITIMER_REAL, GRACE_S)


def _on_alarm(number: int, frame: FrameType | None) -> None:
    """The evaluation takes longer than is left."""
    raise Stopped(_asked or "SIGALRM")


def _again(hook: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """An interrupt that came within a finaliser, where Python can only drop it, is raised once more behind it."""

    def dropped(unraisable: Any) -> None:
        if isinstance(unraisable.exc_value, KeyboardInterrupt) and hasattr(signal, "setitimer"):
            global _asked
            _asked = _asked or "SIGINT"
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        else:
            hook(unraisable)

    return dropped
