"""Progress: on a terminal only, nestable, transparent to exceptions."""

from __future__ import annotations

import io
from contextlib import redirect_stderr

import pytest

from thermofit.records import progress as module
from thermofit.records.progress import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    for name in ("NO_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    return Terminal()


def test_silent_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("frames", 2) as advance:
        advance()
        advance(1, "note")
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_silent_when_quiet(terminal: Terminal) -> None:
    with redirect_stderr(terminal), progress("frames", 2, quiet=True) as advance:
        advance()
    assert terminal.getvalue() == ""


def test_shows_description_count_and_note_as_they_are(terminal: Terminal, capsys: pytest.CaptureFixture[str]) -> None:
    with redirect_stderr(terminal), progress("frames [bold]", 3) as advance:
        advance(2)
        advance(note="file [3]")
    text = terminal.getvalue()
    assert "frames [bold]" in text and "3/3" in text and "file [3]" in text
    assert capsys.readouterr().out == ""


def test_nested_use_shares_the_display(terminal: Terminal) -> None:
    with redirect_stderr(terminal), progress("outer", 1) as outer:
        for name in ("first", "second"):
            with progress(name, None) as inner:
                inner(5)
                assert len(module.displays[0].tasks) == 2
            assert len(module.displays[0].tasks) == 1
        outer()
    assert not module.displays
    assert "outer" in terminal.getvalue()


def test_interrupt_passes_through_and_closes_the_display(terminal: Terminal) -> None:
    with pytest.raises(KeyboardInterrupt), redirect_stderr(terminal), progress("outer", 1), progress("inner", 1):
        raise KeyboardInterrupt
    assert not module.displays
    with redirect_stderr(terminal), progress("again", 1) as advance:
        advance()
    assert "again" in terminal.getvalue()
