"""Remarks ask for something, notes do not; they part when a summary is made."""

from __future__ import annotations

from thermofit.records.staging import Note, as_one, named, sorted_out


def test_remarks_and_notes_part() -> None:
    found = sorted_out(("shorten the window", Note("the window was found"), "", Note("")))
    assert found == {"remarks": ["shorten the window"], "notes": ["the window was found"]}


def test_a_note_stays_one_when_its_experiment_is_named() -> None:
    assert sorted_out([named("first", Note("a")), named("", Note("b")), named("second", "c")]) == {
        "remarks": ["second: c"],
        "notes": ["first: a", "b"],
    }


def test_texts_are_a_note_where_all_of_them_are() -> None:
    assert as_one(["", Note("a"), Note("b")]) == "a; b"
    assert sorted_out([as_one([Note("a"), Note("b")]), as_one([Note("c"), "d"]), as_one([])]) == {"remarks": ["c; d"], "notes": ["a; b"]}
