"""`interpolate` takes the noise from the rest before loading where there is enough of it; else by differences, and says so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny

from thermofit.records.staging import each
from thermofit.study.study import Study

StudyOf = Callable[..., Study]
REST = (0.0, 0.7, 1.4, 2.1)


def more_rest(folder: Path, name: str, head: int, noise: np.ndarray) -> None:
    """The first stage or frame of a raw folder at the times REST, with noise of its own in each, before those of the loading."""
    files = sorted(folder.glob("*.csv"))
    texts = [path.read_text() for path in files]
    first = texts[0].splitlines()
    value = np.loadtxt(first[head:], delimiter=",", ndmin=2)
    at_rest = []
    for k, t in enumerate(REST):
        scattered = value + noise * np.random.default_rng(k).normal(size=value.shape)
        rows = [",".join(f"{x:.6g}" if j or head == 1 else f"{x:.0f}" for j, x in enumerate(row)) for row in scattered]
        at_rest.append("\n".join([f"# time_s: {t:.3f}", *first[1:head], *rows]) + "\n")
    later = [text for text in texts if float(text.splitlines()[0].split(":")[1]) > 3.1]
    for path in files:
        path.unlink()
    for k, text in enumerate([*at_rest, *later]):
        (folder / f"{name}_{k:04d}.csv").write_text(text)


def on_noise(summary: dict[str, Any]) -> list[str]:
    """Remarks and notes but for the one on nodes between the points of so small a test."""
    return [text for text in (*summary["remarks"], *summary["notes"]) if "of their own" not in text]


def test_too_few_stages_at_rest_are_said(study_of: StudyOf) -> None:
    said = tiny.stage_run("interpolate")(study_of()).record.summary
    assert said["displacement"]["noise_method"].startswith("second differences in time")
    u, theta = on_noise(said)
    assert u.startswith("displacement noise is estimated by second differences in time") and "before loading at 3.0 s" in u
    assert theta.startswith("temperature noise is estimated by second differences in time") and "frames with" in theta
    assert "only 2 " in u and "only 1 " in theta and "record 3 or more" in u


def test_noise_of_the_study_needs_no_rest(study_of: StudyOf) -> None:
    said = tiny.stage_run("interpolate")(study_of("noise.displacement=0.003", "noise.temperature=0.03")).record.summary
    assert on_noise(said) == []


def test_enough_rest_gives_the_noise(study_of: StudyOf) -> None:
    """More than twice the noise at rest as later on: the rest is what counts, and nothing is remarked on."""
    study = study_of()
    more_rest(study.experiment / "dic", "stage", 2, np.array([0, 0, 0, 0, 0.005, 0.005, 0.005]))
    more_rest(study.experiment / "ir", "frame", 1, np.array([0.06]))
    for stage in ("calibrate-ir", "interpolate"):
        said = tiny.stage_run(stage)(study).record.summary
    assert on_noise(said) == []
    for channel in ("displacement", "temperature"):
        assert said[channel]["noise_method"].startswith("4 stages before loading")
    # The first stage itself is in all four: only what was put on it differs.
    assert said["displacement"]["noise_mm"] == pytest.approx([0.005, 0.005], rel=0.1)
    assert said["temperature"]["noise_K"] == pytest.approx(0.06, rel=0.1)


def test_remarks_of_several_experiments_name_them(study_of: StudyOf, tmp_path: Path) -> None:
    study = study_of()
    outcome = tiny.stage_run("interpolate")(study)

    class Several:
        fitted, held_out, run_dir = ("a", "b"), (), tmp_path

        def one_of(self, name: str) -> str:
            (tmp_path / name).mkdir(exist_ok=True)
            (tmp_path / name / "interpolate.h5").write_bytes(b"record")
            return name

    listed = each(Several(), "interpolate", lambda one, force: outcome, lambda one: True)  # type: ignore[arg-type]
    assert [text.split(":")[0] for text in on_noise(listed.record.summary)] == ["a", "a", "b", "b"]


def test_noise_that_hangs_together_raises_the_sigma_of_nodal_values(study_of: StudyOf) -> None:
    """Means of points whose noise is the same over millimetres scatter more than those of independent ones: their sigma says so."""
    study = study_of("evaluation.nodes={n_x: 4, n_y: 20, n_z: 1}")
    plain = tiny.stage_run("interpolate")(study).record
    assert plain.summary["displacement"]["scatter_over_noise"] < 1.1
    rng = np.random.default_rng(9)
    for path in sorted((study.experiment / "dic").glob("*.csv")):
        lines = path.read_text().splitlines()
        rows = np.array([[float(x) for x in line.split(",")] for line in lines[2:]])
        away = np.linalg.norm(rows[:, None, 1:3] - rows[None, :, 1:3], axis=2)
        smooth = np.exp(-0.5 * (away / 2.0) ** 2)
        smooth /= np.linalg.norm(smooth, axis=1)[:, None]
        rows[:, 4:6] += 0.01 * smooth @ rng.normal(size=(len(rows), 2))
        body = [f"{row[0]:.0f}," + ",".join(f"{x:.6f}" for x in row[1:]) for row in rows]
        path.write_text("\n".join([*lines[:2], *body]) + "\n")
    for stage in ("calibrate-ir", "interpolate"):
        record = tiny.stage_run(stage)(study).record
    ratio = record.summary["displacement"]["scatter_over_noise"]
    assert ratio > 1.5 and any(text.startswith("u: nodal values scatter") for text in record.summary["remarks"])
    nodes = record.summary["nodal_values"][0]
    assert nodes["field"] == "u" and nodes["standard_error"] == pytest.approx(nodes["best"], rel=0.1)
    one = float(np.mean(record.summary["displacement"]["noise_mm"]))
    assert nodes["standard_error"] > 1.4 * one / np.sqrt(nodes["in_window"] / (nodes["nodes"] * len(record["u/time"].value)))
