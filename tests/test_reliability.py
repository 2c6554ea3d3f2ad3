"""The page of reliability: figures of what has run on these sources, a word where nothing has, failures by name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ANSWERS: dict[str, Any] = {
    "numerics": {"tests": 40, "failed": ["tests.body.test_heat.test_fin"], "skipped": 1, "figures": {"NAFEMS T3, degC (36.60)": "36.58"}},
    "inputs": {
        **{"inputs": 2000, "refused": 1500, "accepted": 499, "internal": 1, "slow": 0, "largest_memory_MB": 300},
        "bad": [{"number": 7, "file": "force.csv", "kind": "internal", "said": "KeyError", "s": 0.1}],
    },
    "signals": {
        **{"injected": 50, "survived": 49, "commands": {"verify": [2, 1]}},
        "wrong": [{"command": "verify", "signal": "SIGKILL", "moment_s": 1.5, "code": -9, "wrong": "left behind: .lock"}],
    },
    "same": {"run to run": {"compared": 243, "differing": 0, "largest_relative": 0.0, "where": ""}, "parameters": 9e-10},
    "kept": {"tried": 1, "wrong": [], "cases": [{"name": "a pipe", "code": 3, "cpu_s": 2.1, "MB": 318, "said": "", "wrong": ""}]},
    "large": {
        "fits": {"identifications": 200, "early_MB": 275.8, "late_MB": 276.1, "growth_percent": 0.12, "s": 66.0},
        **{"fields": {"stages": 1000}, "frames": "1000 frames"},
        "meshes": [
            {"elements": 480, "degrees_of_freedom": 3444, "steps": 20, "cpu_s": 1.0, "peak_MB": 300},
            {"elements": 3840, "error": "no"},
        ],
    },
    "mutations": {"noticed": 0.97, "earlier": 1, "rooms": {"law": {"all": 3, "noticed": 3}}, "answers": [{"name": "x", "noticed": False}]},
}


def test_page_tells_what_was_found(scripts: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = scripts("reliability")
    monkeypatch.setattr(module, "KEPT", tmp_path)
    monkeypatch.setattr(module, "state", lambda part: "now")
    for name, answer in ANSWERS.items():
        (tmp_path / f"{name}.json").write_text(json.dumps({"state": "now", "seconds": 12.0, "code": 0, **answer}), encoding="utf-8")
    (tmp_path / "faults.json").write_text(json.dumps({"state": "now", "seconds": 1.0, "code": 2, "error": "no pytest"}), encoding="utf-8")
    before = {"state": "before", "seconds": 1.0, "code": 0, **ANSWERS["numerics"]}
    (tmp_path / "hostile.json").write_text(json.dumps(before), encoding="utf-8")
    page = module.page()
    for text in (
        "| NAFEMS T3, degC (36.60) | 36.58 |",
        "* failed: `tests.body.test_heat.test_fin`",
        "| 2000 | 1500 | 499 | 1 | 0 | 300 |",
        "50 signals (SIGKILL, SIGINT, SIGTERM, SIGUSR1) while a command ran, 49 survived.",
        "| verify | 2 | 1 |",
        "verify SIGKILL at 1.50 s: left behind: .lock",
        "| run to run | 243 | 0 | 0.0e+00 |",
        "9.0e-10 apart at most (1e-8)",
        "1 commands: 1 refused in a sentence, 0 accepted, 0 wrong. At most 2.1 s of CPU (20) and 318 MB (2048).",
        "| a pipe | 3 | 2.1 | 318 |",
        "0.12 % more (limit 5 %)",
        "97.0 % of 1 noticed (95 %), of the diagnosis 0.0 % (90 %).",
        "1 of them were judged on earlier sources",
        "Not noticed: x",
        "Not finished: `no pytest`",
    ):
        assert text in page, text
    assert page.count("Not run (") == len(module.PARTS) - len(ANSWERS) - 2 and page.count("Of earlier sources.") == 1
    assert "Of earlier sources." in page.partition("## Hostile files")[2].partition("## ")[0]
    hostile = next(part for part in module.PARTS if part.name == "hostile")
    assert module.kept(hostile) is None, "an answer of other sources is run again"


def test_parts_name_what_is_there(scripts: Any) -> None:
    module = scripts("reliability")
    for part in module.PARTS:
        for name in (*part.tests, *(f"scripts/{one}" for one in part.script[:1])):
            assert (module.ROOT / name).exists(), name


def test_a_part_is_known_by_the_package_and_its_own_tests_or_scripts(scripts: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    module = scripts("reliability")
    parts = {part.name: part for part in module.PARTS}
    before = {name: module.state(part) for name, part in parts.items()}
    assert len(set(before.values())) == len(parts)
    list_of = module.with_helpers
    monkeypatch.setattr(module, "with_helpers", lambda root, tests: list_of(root, (*tests, "tests/bench/test_bench.py")))
    after = {name: module.state(part) for name, part in parts.items()}
    assert {name for name in parts if before[name] != after[name]} == {name for name, part in parts.items() if part.tests}
    monkeypatch.setattr(module, "sources", lambda *_: "edited")
    assert not set(after.values()) & {module.state(part) for part in module.PARTS}


def test_bill_of_materials_knows_every_requirement(scripts: Any) -> None:
    module = scripts("bill_of_materials")
    found = module.needed("thermofit", {})
    assert {"numba", "llvmlite", "h5py", "meshio", "typer", "click"} - {"click"} <= set(found)
    assert all(module.licence_of(one) for one in found.values())


def test_no_script_bears_the_name_of_what_numba_asks_for(scripts: Any) -> None:
    """numba imports `coverage` where there is one: a script of that name, first on the path of all other scripts, ended them."""
    folder = scripts("reliability").ROOT / "scripts"
    code = f"import sys; sys.path.insert(0, {str(folder)!r}); import numba"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not (folder / "coverage.py").exists(), done.stderr[-500:]
