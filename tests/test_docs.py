"""The documentation: generated pages are those of the program, sentences are short, words are the field's, the tutorial runs as written."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from prose import sentences, words

import thermofit

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = (*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md")
LONGEST = 30
"""Words of a sentence."""

PRIVATE = re.compile(
    r"\b(mend(s|ed|ing)?|felt|feels?|errs?|erred|such that|h[au]ngs? together|told by|nobody's|point-times?|the house|"
    r"m(ade|akes?) up for|st(ands?|ood) in for|cannot carry)\b",
    re.IGNORECASE,
)
"""Words of this project's own; the field has others (docs/terms.md)."""


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def test_generated_pages_are_those_of_the_program(scripts: Any) -> None:
    made = scripts("write_pages").pages()
    stale = [name for name, text in made.items() if (DOCS / "reference" / name).read_text(encoding="utf-8") != text]
    assert stale == [], "run `make schema`"
    assert set(made) == {path.name for path in (DOCS / "reference").iterdir()}
    assert "### close-loop" in made["commands.md"] and "`--max-effects N`" in made["commands.md"]
    assert "| `newton_tolerance` |" in made["keys.md"] and "`clamp_drift`" in made["catalogue.md"]


def test_every_number_of_the_diagnosis_has_an_origin(scripts: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A number without an entry, or an entry without a number, is an error that names it."""
    pages = scripts("write_pages")
    numbers = pages.thresholds()
    assert numbers["score.ALIKE"][0] == "ALIKE = 0.9" and "held_out.SURE" in numbers
    monkeypatch.setattr(pages, "thresholds", lambda: {**numbers, "score.NEW": ("NEW = 1", "what it means")})
    with pytest.raises(ValueError, match=r"score\.NEW"):
        pages.thresholds_page()


def long_sentences(text: str) -> list[str]:
    return [sentence for sentence in sentences(text) if words(sentence) > LONGEST]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_sentences_are_short(page: Path) -> None:
    assert long_sentences(page.read_text(encoding="utf-8")) == []


def test_a_long_sentence_is_seen() -> None:
    many = " ".join(["word"] * 31)
    quoted = f"`{many.capitalize()}` is code."
    page = (
        f"# {many}\n\n    {many}\n\nShort one. {many.capitalize()}. {quoted}\n\n* {many}\n* few\n\n| {many} | few |\n\n```\n{many}\n```\n"
    )
    assert [words(sentence) for sentence in long_sentences(page)] == [31, 31, 31]
    assert list(sentences("See [a b](c d.md), e.g. `x y`. `z` is 1.5 mm; and so on. Not before.")) == [
        "See a b, eg Code.",
        "Code is 1.5 mm; and so on.",
        "Not before.",
    ]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_pages_use_the_words_of_the_field(page: Path) -> None:
    assert [sentence for sentence in sentences(page.read_text(encoding="utf-8")) if PRIVATE.search(sentence)] == []


def messages(tree: ast.AST) -> Iterator[str]:
    """Texts of a source that are no docstrings: remarks, verdicts, errors, help."""
    silent = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in silent and " " in node.value:
            yield node.value


def test_messages_use_the_words_of_the_field() -> None:
    texts = {path: list(messages(ast.parse(path.read_text(encoding="utf-8")))) for path in sorted((ROOT / "thermofit").rglob("*.py"))}
    assert [f"{name_of(path)}: {text}" for path, found in texts.items() for text in found if PRIVATE.search(text)] == []
    made_up = list(messages(ast.parse('"""The start errs."""\nx = f"the start cannot carry {y} N"')))
    assert made_up == ["the start cannot carry ", " N"] and PRIVATE.search(made_up[0])


def test_every_page_is_found_from_another_and_the_readme_is_short() -> None:
    """By the navigation of the site or by a link. Links that lead nowhere are found by `make docs`."""
    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    leads = {ROOT / "docs" / name for name in re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))}
    leads |= {(page.parent / to).resolve() for page, text in texts.items() for to in re.findall(r"\]\(([^):#]+\.md)", text)}
    assert {name_of(page) for page in PAGES if DOCS in page.parents and page not in leads} == set()
    assert len(texts[ROOT / "README.md"].splitlines()) < 120


def test_links_of_the_pages_outside_the_site_lead_somewhere() -> None:
    for page in PAGES[-3:]:
        for target in re.findall(r"\]\(([^):#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            assert (ROOT / target).exists(), f"{name_of(page)}: {target}"


BLOCK = re.compile(r'^```(bash|yaml title="([^"]+)")\n(.*?)^```$', re.DOTALL | re.MULTILINE)
EXIT = re.compile(r"#\s*exit code (\d+)\s*$")


def blocks_of(page: Path) -> list[tuple[str, str]]:
    """The blocks that a reader carries out: (name of the file, its text), or ("", command) line by line."""
    found: list[tuple[str, str]] = []
    for _, file, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        found += [(file, text)] if file else [("", line) for line in text.splitlines() if line.strip()]
    return found


def test_blocks_of_the_tutorial_are_found() -> None:
    commands = [text.split()[1] for file, text in blocks_of(DOCS / "tutorial.md") if not file and text.startswith("thermofit ")]
    assert commands == ["simulate", "inspect", "new", "run", "close-loop", "run", "export", "show"]


@pytest.mark.slow
@pytest.mark.as_written
def test_tutorial_runs_as_written(tmp_path: Path) -> None:
    """Every block in its order in one folder, with the exit code that the page tells; the answers are those of the page."""
    program = tmp_path / "bin" / "thermofit"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m thermofit.cli "$@"\n')
    program.chmod(0o755)
    paths = {
        "PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
    }
    folder = tmp_path / "work"
    folder.mkdir()
    told = []
    for file, text in blocks_of(DOCS / "tutorial.md"):
        if file:
            (folder / file).write_text(text)
            continue
        done = subprocess.run(["sh", "-c", text], cwd=folder, env={**os.environ, **paths}, capture_output=True, text=True, check=False)
        expected = int(found.group(1)) if (found := EXIT.search(text)) else 0
        assert done.returncode == expected, f"{text}: exit {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        told.append(done.stdout)
    said = "\n".join(told)
    for words_of_page in ("ready for a study", "not verified: dtheta is 1.3 times its noise", "added clamp_drift", "heat of pieces"):
        assert words_of_page in said
    loop = thermofit.open_run(folder / "runs" / "study").record("close-loop")
    jaws, kappa = loop.parameters["clamp_drift.rate"], loop.parameters["kappa"]
    assert abs(jaws.value - 0.02) < 3.0 * jaws.sigma and 120.0 < kappa.value < 160.0
    before = thermofit.open_run(folder / "runs" / "study").record("identify-thermal").parameters["kappa"]
    assert before.value < 30.0, "the page tells of 18"
    assert (folder / "runs" / "study" / "export" / "results.json").is_file()
