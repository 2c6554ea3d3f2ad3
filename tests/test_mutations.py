"""The kept list of wrong edits still applies to the sources, is large enough, and the runner tells what the tests said."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FILE = "thermofit/effects/one.py"


@pytest.fixture(scope="module")
def mutations(scripts: Any) -> ModuleType:
    return scripts("mutations")


def test_every_mutation_of_the_list_applies(mutations: ModuleType) -> None:
    found = mutations.listed(mutations.LIST, ROOT)
    assert len(found) >= 60 and all(one.breaks for one in found)


def made_up(tmp_path: Path, old: str = "1.0 + x", new: str = "1.0 - x", tests: str = "[tests]") -> Path:
    """A tree with one effect and one test, and a list with one mutation."""
    for name, text in ((FILE, "def act(x):\n    return 1.0 + x\n"), ("tests/test_one.py", "")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    path = tmp_path / "list.yaml"
    entry = f"- {{name: sign, file: {FILE}, old: '{old}', new: '{new}', breaks: sign, tests: {tests}}}"
    path.write_text(f"mutations:\n  {entry}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "tests", "said"),
    [
        ("2.0 + x", "1.0", "[tests]", "sign: the old text is 0 times"),
        ("x", "y", "[tests]", "sign: the old text is 2 times"),
        ("1.0 + x", "1.0 + x", "[tests]", "old and new text are the same"),
        ("1.0 + x", "1.0", "[tests/test_two.py]", "expected files of tests that exist"),
        ("1.0 + x", "1.0", "[]", "expected files of tests that exist"),
    ],
)
def test_a_list_that_has_rotted_is_refused(mutations: ModuleType, tmp_path: Path, old: str, new: str, tests: str, said: str) -> None:
    with pytest.raises(mutations.Wrong, match=said):
        mutations.listed(made_up(tmp_path, old, new, tests), tmp_path)


@pytest.mark.parametrize("bites", [True, False])
def test_a_mutation_is_noticed_where_a_test_fails_and_the_copy_is_left_as_it_was(
    mutations: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bites: bool
) -> None:
    (one,) = mutations.listed(made_up(tmp_path), tmp_path)
    seen = []

    def ran(tree: Path, tests: tuple[str, ...]) -> tuple[int, str]:
        seen.append((tree / FILE).read_text(encoding="utf-8"))
        return (1, "FAILED tests/test_one.py") if bites else (0, "")

    monkeypatch.setattr(mutations, "ran", ran)
    answer = mutations.judged(tmp_path, one)
    assert answer.noticed is bites and answer.room == "effects" and mutations.by_room([answer]) == {"effects": (int(bites), 1)}
    assert "1.0 - x" in seen[0] and "1.0 + x" in (tmp_path / FILE).read_text(encoding="utf-8")
