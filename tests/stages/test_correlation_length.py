"""How far the noise of the fields hangs together, from `interpolate` to what the diagnosis reads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from thermofit.experiment.fields import measured_of
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path


def test_both_lengths_are_in_mm_and_the_larger_one_counts(finished: Path) -> None:
    record, pose = open_record(artefact_path(finished, "interpolate")), open_record(artefact_path(finished, "calibrate-ir")).summary["pose"]
    of_points, of_camera = record.summary["displacement"], record.summary["temperature"]
    assert of_camera["correlation_length_mm"] == pytest.approx(of_camera["correlation_length_px"] * pose["scale_mm_per_px"])
    lengths = (of_points["correlation_length_mm"], of_camera["correlation_length_mm"])
    assert measured_of(record).correlation_length == max(lengths) > 0.0
    for name in ("displacement", "temperature"):
        summary = {**record.summary, name: {**record.summary[name], "correlation_length_mm": 7.5}}
        assert measured_of(replace(record, summary=summary)).correlation_length == 7.5
    unknown = {**record.summary, "displacement": {**of_points, "correlation_length_mm": None}, "temperature": {}}
    assert measured_of(replace(record, summary=unknown)).correlation_length == 0.0, "a record that does not know them"
