"""What a stage says besides its verdict: remarks, on which a user may have to act, and notes, which ask for nothing."""

from __future__ import annotations

from collections.abc import Iterable


class Note(str):
    """A remark that asks for nothing: it is printed with --verbose and stands in the report."""

    __slots__ = ()


def named(name: str, text: str) -> str:
    """The text with the name of its experiment before it; a note stays a note, and what has no name is as it is."""
    return type(text)(f"{name}: {text}") if name else text


def as_one(texts: Iterable[str]) -> str:
    """Texts as one, "" where there are none: a note where all of them are."""
    kept = [text for text in texts if text]
    line = "; ".join(kept)
    return Note(line) if kept and all(isinstance(text, Note) for text in kept) else line


def sorted_out(texts: Iterable[str]) -> dict[str, list[str]]:
    """The keys `remarks` and `notes` of a summary; empty texts are left out."""
    kept = [text for text in texts if text]
    return {"remarks": [t for t in kept if not isinstance(t, Note)], "notes": [str(t) for t in kept if isinstance(t, Note)]}
