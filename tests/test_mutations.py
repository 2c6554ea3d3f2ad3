"""The kept list of wrong edits still applies to the sources, is large enough, and the runner tells what the tests said."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
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
    seen: list[str] = []

    def ran(tree: Path, tests: tuple[str, ...]) -> tuple[int, str]:
        seen.append((tree / FILE).read_text(encoding="utf-8"))
        return (1, "FAILED tests/test_one.py") if bites else (0, "")

    monkeypatch.setattr(mutations, "ran", ran)
    noticed, by = mutations.judged(tmp_path, one)
    assert noticed is bites and bool(by) is bites and one.room == "effects"
    answer = mutations.Answer(one.name, one.room, noticed, by, "", "", 1.0)
    assert mutations.by_room([answer]) == {"effects": (int(bites), 1)}
    assert "1.0 - x" in seen[0] and "1.0 + x" in (tmp_path / FILE).read_text(encoding="utf-8")


def test_the_test_that_noticed_it_before_is_run_first(mutations: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (one,) = mutations.listed(made_up(tmp_path), tmp_path)
    before = mutations.Answer(one.name, one.room, True, "FAILED tests/test_one.py::test_sign", "", "", 1.0)
    asked = []

    def ran(tree: Path, tests: Sequence[str]) -> tuple[int, str]:
        asked.append(tuple(tests))
        return (mutations.NOT_THERE, "") if "::" in tests[0] else (1, "FAILED tests/test_one.py::test_other")

    monkeypatch.setattr(mutations, "ran", ran)
    assert mutations.judged(tmp_path, one, before) == (True, "FAILED tests/test_one.py::test_other")
    assert asked == [("tests/test_one.py::test_sign",), one.tests], "one that is gone does not judge"


def test_an_answer_holds_until_entry_file_tests_or_their_helpers_change(mutations: ModuleType, tmp_path: Path) -> None:
    path = made_up(tmp_path)
    (one,) = mutations.listed(path, tmp_path)
    helper = tmp_path / "tests" / "support" / "helper.py"
    helper.parent.mkdir()
    helper.write_text("", encoding="utf-8")
    (tmp_path / "tests" / "test_one.py").write_text("from helper import made\n", encoding="utf-8")
    found = [mutations.holds_for(one, tmp_path)]
    (tmp_path / "thermofit" / "effects" / "two.py").write_text("", encoding="utf-8")
    assert mutations.holds_for(one, tmp_path) == found[0], "other files of the package do not matter"
    for name in ("tests/support/helper.py", "tests/test_one.py", FILE):
        with (tmp_path / name).open("a", encoding="utf-8") as file:
            file.write("# changed\n")
        found.append(mutations.holds_for(one, tmp_path))
    found.append(mutations.holds_for(mutations.listed(made_up(tmp_path, new="1.0 - 2.0 * x"), tmp_path)[0], tmp_path))
    assert len(set(found)) == 5


def test_answers_are_kept_in_the_order_of_the_list_and_those_of_gone_entries_go(mutations: ModuleType, tmp_path: Path) -> None:
    every = mutations.listed(made_up(tmp_path), tmp_path)
    rows = {name: mutations.Answer(name, "effects", True, "", "a", "b", 1.0) for name in ("gone", "sign")}
    mutations.write_rows(tmp_path / "rows.jsonl", rows, every)
    assert mutations.known_rows(tmp_path / "rows.jsonl") == {"sign": rows["sign"]}


def test_a_copy_follows_its_tree(mutations: ModuleType, tmp_path: Path) -> None:
    root, to = tmp_path / "root", tmp_path / "copy"
    root.mkdir()
    made_up(root)
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    mutations.copied(root, to)
    (to / ".cache").mkdir()
    (to / ".cache" / "kernel").write_text("", encoding="utf-8")
    (root / "tests" / "test_one.py").unlink()
    mutations.copied(root, to)
    assert (to / FILE).is_file() and (to / ".cache" / "kernel").is_file() and not (to / "tests" / "test_one.py").exists()


def test_a_run_without_end_is_stopped_by_its_time_of_the_processor(mutations: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "test_endless.py").write_text("def test_endless():\n    while True:\n        pass\n", encoding="utf-8")
    assert mutations.ran(tmp_path, ["test_endless.py"], limit=2.0) == (mutations.FAILED, "stopped after 2 s of CPU")
