"""Sentences of a page of Markdown: what a reader reads as prose, for rules on its length and words."""

from __future__ import annotations

import re
from collections.abc import Iterator

WORD = re.compile(r"[^\W\d_][\w'./-]*|\d[\w.,]*")
_END = re.compile(r"(?<=[.!?])[\"')*\]]*\s+(?=[\"'(*\[]*(?:[A-Z0-9]|--))")
_ABBREVIATED = re.compile(r"\b(e\.g|i\.e|cf|approx|vs|Fig|Eq|No|max|min)\.\s", re.IGNORECASE)


def blocks(text: str) -> Iterator[str]:
    """Paragraphs, points of lists and cells of tables; code, formulas and headings are left out."""
    text = re.sub(r"<!--.*?-->|^(```|~~~).*?^\1", "\n\n", text, flags=re.DOTALL | re.MULTILINE)
    held: list[str] = []
    for line in (*text.splitlines(), ""):
        bare = line.strip()
        alone = not bare or bare.startswith(("|", "#", "--8<--"))
        point = re.match(r"([*+-]|\d+\.)\s+", bare)
        if held and (alone or point):
            yield " ".join(held)
            held = []
        if bare.startswith("|"):
            yield from (cell.strip() for cell in re.split(r"(?<!\\)\|", bare.strip("|")))
        elif not alone and (held or point or not line.startswith("    ")):
            held.append(bare[point.end() :] if point else bare)


def sentences(text: str) -> Iterator[str]:
    """Sentences of a page. Code in a line counts as one word, a link as its text."""
    for block in blocks(text):
        plain = re.sub(r"`[^`]*`", "Code", block.replace("<br>", ". "))
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", plain)
        plain = _ABBREVIATED.sub(lambda found: found.group().replace(".", ""), plain)
        yield from (part for part in _END.split(plain) if part.strip())


def words(sentence: str) -> int:
    """Number of words and numbers."""
    return len(WORD.findall(sentence))
