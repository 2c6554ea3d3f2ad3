"""Strips without a force through the commands: what is planted comes back, what is not stays silent, the measured ones end honestly."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_studies import call, told
from strip_rows import study

from thermofit.records.artefact import open_record

PROFILE = {"heating_profile.fall": 1.2e-3}
RATE = {"rate_logarithmic.C": 0.03, "rate_logarithmic.reference": 1e-3}


def added(found: dict[str, Any]) -> set[str]:
    return set(found["accepted"])


def test_the_chain_says_what_strains_without_a_force_tell(tmp_path: Path) -> None:
    """Hardening in units of the prescribed yield stress comes back; the elastic stage has nothing to tell."""
    path = study(tmp_path, {**PROFILE, **RATE}, 1, {**PROFILE, **RATE})
    told("run", path, "--until", "identify-plastic")
    record = open_record(tmp_path / "run" / "identify-plastic.h5")
    for name, true in (("M_yinf", 110.0), ("H_exp", 5.0)):
        one = record.parameters[name]
        assert one.sigma is not None and abs(one.value - true) < 4.0 * one.sigma < 0.05 * true, (name, one)
    assert record.summary["channels"]["strain"]["chi2_reduced"] == pytest.approx(1.0, abs=0.25)
    assert told("identifiability", path)["parameters"]


def test_rate_and_profile_are_found_and_predict_the_held_out_strip(tmp_path: Path) -> None:
    """The law of the rate may be taken for its like, and then a rest of it is told as unlisted: strains without a force know its size, the
    profile and the hardening by their ratios alone."""
    result = call("close-loop", study(tmp_path, {**PROFILE, **RATE}, 2), "--json")
    found = json.loads(result.stdout)
    assert result.exit_code == (5 if found["unlisted"] else 0)
    assert "heating_profile" in added(found) and added(found) & {"rate_logarithmic", "rate_power"}
    record = open_record(tmp_path / "run" / "close-loop.h5")
    assert record.parameters["heating_profile.fall"].value == pytest.approx(PROFILE["heating_profile.fall"], rel=0.2)
    before, after = (float(text) for text in re.findall(r"held-out strain@record strip-2 (\S+) -> (\S+) times", found["verdict"])[0])
    assert after < 1.5 < 0.05 * before, found["verdict"]


@pytest.mark.parametrize("seed", [3, 4])
def test_nothing_is_named_where_nothing_is_missing(tmp_path: Path, seed: int) -> None:
    found = told("close-loop", study(tmp_path, PROFILE, seed, PROFILE), code=0)
    assert not found["accepted"] and found["unlisted"] is None and found["grade"] == "complete"


def test_measured_strips_are_read(tmp_path: Path) -> None:
    data = os.environ.get("THERMOFIT_DATA")
    if not data or not (Path(data) / "real" / "hot-strips-dic-strain").is_dir():
        pytest.skip("THERMOFIT_DATA does not hold real/hot-strips-dic-strain")
    told("interpolate", Path(__file__).parents[2] / "configs" / "real-strips.yaml", "--run-dir", tmp_path)
    record = open_record(tmp_path / "interpolate.h5")
    assert len(record.summary["tests"]) == 5 * 11
    names = {one["section"]["row"] for one in record.summary["tests"]}
    assert names == {"450-01", "450-25", "400-25", "500-01", "500-25"}
    remarks = " ".join(record.summary["remarks"])
    assert "450-01: 5419 of 75213 values are lost" in remarks and "500-25: 2744 of 32880" in remarks
    last = np.array([record[f"records/{k}/strain"].value[-1] for k in range(11)])
    assert np.argmax(last) in (4, 5, 6) and last.max() < np.expm1(0.3)
