"""Programmes ranked by what they would tell, and the sentence about it."""

from __future__ import annotations

from typing import Any

from thermofit.report.identifiability import programme_rows
from thermofit.stages.identifiability import compare_verdict


def row(name: str, kind: str, d: float) -> dict[str, Any]:
    return {"programme": name, "kind": kind, "said": "", "D": d, "A": d, "E": d, "E_modulus": d}


def test_what_tells_little_comes_after_what_tells_all_and_before_what_leaves_something_open() -> None:
    found = [row("cycles", "valley", 0.01), row("hold", "failed", float("nan")), row("slow", "weak", 0.05), row("fast", "unique", 0.09)]
    rows = programme_rows([*found, row("faster", "undetermined", float("inf")), row("both", "unique", 0.02)])
    assert [r["programme"] for r in rows] == ["both", "fast", "slow", "cycles", "faster", "hold"]
    assert [r["rank"] for r in rows] == [1, 2, 3, 4, 5, None]
    verdict = compare_verdict(rows, ["E_modulus"])
    assert verdict.startswith("both tells most: E_modulus to 2 % (rms)")
    assert verdict.endswith("; slow tells too little of a direction; cycles, faster leave something open")


def test_where_no_programme_tells_all() -> None:
    rows = programme_rows([row("cycles", "valley", 0.01), row("slow", "weak", 0.05), row("fast", "weak", 0.03)])
    assert [r["programme"] for r in rows] == ["fast", "slow", "cycles"]
    verdict = compare_verdict(rows, ["E_modulus"])
    assert verdict == "no programme determines E_modulus; fast, slow tell too little of a direction; cycles leaves something open"
