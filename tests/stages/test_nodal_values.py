"""`interpolate` by projection, which is the default, and by three points, which stays selectable."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import tiny

from thermofit.experiment import interpolated
from thermofit.observe.interpolation import interpolate_displacements
from thermofit.read.raw import read_experiment
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study

StudyOf = Callable[..., Study]


def test_three_points_stay_selectable(study_of: StudyOf) -> None:
    study = study_of("evaluation.interpolation=three-point")
    record = tiny.stage_run("interpolate")(study).record
    dic = read_experiment(study.experiment, ("dic",)).dic
    assert dic is not None
    expected = interpolate_displacements(dic, record["u/xy"].value)
    np.testing.assert_array_equal(record["u/value"].value, expected.value[:, :, :2])
    assert not record.has("u/moments") and not record.has("theta/moments")


def test_the_default_uses_all_and_says_so(study_of: StudyOf) -> None:
    record = tiny.stage_run("interpolate")(study_of()).record
    u, theta = record.summary["nodal_values"]
    assert (u["field"], u["data"], theta["field"], theta["data"]) == ("u", "points", "theta", "pixels")
    assert u["share_used"] > 0.95 and theta["share_used"] > 0.95
    assert theta["standard_error"] == pytest.approx(theta["best"], rel=0.02)
    assert theta["standard_error"] < 0.5 * record.summary["temperature"]["noise_K"]
    for name in ("u", "theta"):
        mask, moments = record[f"{name}/mask"].value.astype(bool), record[f"{name}/moments"].value
        assert np.isfinite(moments).all() and (moments[~mask] == 0.0).all() and np.abs(moments[mask]).max() > 0.01


def test_nodes_without_points_of_their_own_are_told(study_of: StudyOf) -> None:
    """A mesh of comparison that is finer than the points leaves patches empty, which is said with numbers; a wider one says nothing."""
    wide = tiny.stage_run("interpolate")(study_of("evaluation.nodes={n_x: 4, n_y: 28, n_z: 1}")).record.summary
    assert not any("of their own" in text for text in wide["remarks"])
    fine = tiny.stage_run("interpolate")(study_of()).record.summary
    (said,) = [text for text in fine["remarks"] if text.startswith("u: ") and "of their own" in text]
    assert f"{fine['displacement']['masked']} of " in said and "nodes always" in said and "mm apart" in said


def test_the_course_of_the_force_between_the_steps_is_kept(study_of: StudyOf) -> None:
    """It goes through all load steps and misses the smoothed force by a hundredth of what their chords miss."""
    record = tiny.stage_run("interpolate")(study_of()).record
    time, force = record["course/time"].value, record["course/force"].value
    for name in ("displacement", "temperature", "all"):
        steps = record[f"steps/{name}/time"].value
        assert np.isin(steps, time).all()
        assert np.interp(steps, time, force) == pytest.approx(record[f"steps/{name}/force"].value, abs=1e-9)
    at, smooth = record["force/time"].value, record["force/smooth"].value
    chords = np.interp(at, record["steps/all/time"].value, record["steps/all/force"].value)
    held = at <= time[-1]
    missed, left = (np.abs(line - smooth)[held].max() for line in (chords, np.interp(at, time, force)))
    assert missed > 0.5 and left < 0.01 * missed, (missed, left)


def test_times_on_a_chord_of_the_force_are_left_out_and_counted(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of either field, before the load steps are made; the rest stays as it is."""
    study = study_of()
    record = tiny.stage_run("interpolate")(study).record
    whole = {name: record[name].value for name in ("u/time", "u/value", "theta/time", "theta/value", "elongation/time")}
    artefact_path(study.run_dir, "interpolate").unlink()
    stage, frame = float(whole["u/time"][5]), float(whole["theta/time"][8])
    chords = ((stage - 0.01, stage + 0.01), (frame - 0.01, frame + 0.01))
    monkeypatch.setattr(interpolated, "cut_knees", lambda smooth: chords)
    left = tiny.stage_run("interpolate")(study).record
    for name, gone in (("u", 5), ("theta", 8)):
        np.testing.assert_array_equal(left[f"{name}/time"].value, np.delete(whole[f"{name}/time"], gone))
        np.testing.assert_array_equal(left[f"{name}/value"].value, np.delete(whole[f"{name}/value"], gone, axis=0))
    assert len(left["elongation/time"].value) == len(whole["elongation/time"])
    said = [text for text in left.summary["notes"] if "not compared" in text]
    assert [text[: text.index(" s)")] for text in said] == [
        f"u: 1 of {len(whole['u/time'])} times ({stage:.2f}",
        f"theta: 1 of {len(whole['theta/time'])} times ({frame:.2f}",
    ]
