"""YAML as it is read: numbers, keys given twice, and texts that stand for more than they hold."""

from __future__ import annotations

import pytest

from thermofit.core.errors import StudyError
from thermofit.core.files import TEXT_LIMIT
from thermofit.core.yaml_text import LARGEST_TREE, parse_yaml


def test_numbers_and_dates() -> None:
    assert parse_yaml("a: 1e-4\nb: 2026-01-02\nc: 1.5E3", "s", StudyError) == {"a": 1e-4, "b": "2026-01-02", "c": 1500.0}
    assert parse_yaml("# nothing", "s", StudyError) is None
    with pytest.raises(StudyError, match=r"s, line 2: the key 'a' is given twice"):
        parse_yaml("a: 1\na: 2", "s", StudyError)


def test_aliases_stand_for_what_they_name() -> None:
    text = "a: &a {x: 1}\nb: [*a, *a]\nc: {<<: *a, y: 2}"
    assert parse_yaml(text, "s", StudyError) == {"a": {"x": 1}, "b": [{"x": 1}, {"x": 1}], "c": {"x": 1, "y": 2}}


def test_aliases_of_aliases_are_refused_at_once() -> None:
    text = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
    with pytest.raises(StudyError, match=rf"s, line 6: with its aliases written out this holds more than {LARGEST_TREE} values"):
        parse_yaml(text, "s", StudyError)


@pytest.mark.parametrize("text", ["a: &a [1, *a]", "a: &a {b: {c: *a}}"])
def test_an_alias_of_the_section_that_holds_it_is_refused(text: str) -> None:
    with pytest.raises(StudyError, match="s, line 1: an alias stands for a section that holds it"):
        parse_yaml(text, "s", StudyError)


def test_a_text_that_is_too_long_is_refused() -> None:
    with pytest.raises(StudyError, match=f"found {TEXT_LIMIT + 1} characters of YAML, expected at most {TEXT_LIMIT}"):
        parse_yaml("#" * (TEXT_LIMIT + 1), "s", StudyError)
