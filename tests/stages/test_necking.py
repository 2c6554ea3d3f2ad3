"""A made-up necking test: sections of unlike area in equal force, past the maximum; the planted law comes back. Its study and its file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.optimize import brentq

from thermofit.cli.app import app
from thermofit.core.errors import DataError, StudyError
from thermofit.identify.necking import (
    HardeningLaw,
    SectionStrains,
    fit_sections,
    held_strain,
    necking_linearised,
    necking_problem,
    other_rates,
    section_states,
    sections_of,
)
from thermofit.read.section_strain import SectionStrain
from thermofit.records.staging import Outcome
from thermofit.stages.necking import run, sections
from thermofit.study.study import Study, load_study

R, H_EXP, H_LIN = 0.6, 12.0, 0.3
START = 0.03
"""Strain of the thinnest section in the first frame."""
AREAS = 1.0 + np.array([0.030, 0.022, 0.014, 0.008, 0.003, 0.0, 0.002, 0.006, 0.012, 0.020, 0.028, 0.034])
ROWS, COLUMNS, PITCH, NOISE = 49, 7, 20.0, 0.02


def stress(strain: float) -> float:
    return 1.0 + R * (1.0 - float(np.exp(-H_EXP * strain))) + H_LIN * strain


def hardening(strain: float) -> float:
    return R * H_EXP * float(np.exp(-H_EXP * strain)) + H_LIN


CONSIDERE = brentq(lambda e: hardening(e) - stress(e), 0.01, 0.6)
TRUE_CONSIDERE = CONSIDERE - START
TRUE_RATE = hardening(START) / stress(START)


def force(strain: float) -> float:
    return stress(strain) * float(np.exp(-strain))


def followed(area: float, carried: float) -> float:
    """Strain of a thicker section under a force."""
    return float(brentq(lambda e: area * force(e) - carried, -0.05, CONSIDERE))


def courses(n_frames: int = 80) -> np.ndarray:
    """Total strain (n_frames, n_s) of the sections: force through the thinnest, which necks, equals that through each other; a section
    whose force would have to fall keeps its strain."""
    neck = START + (1.7 * TRUE_CONSIDERE) * np.linspace(0.0, 1.0, n_frames)
    out = np.empty((n_frames, len(AREAS)))
    for k, strain in enumerate(neck):
        carried = force(min(strain, CONSIDERE))
        out[k] = [strain if a == 1.0 else followed(a, carried) for a in AREAS]
    return out


def made_up(noise: float = 1e-4, seed: int = 1) -> SectionStrain:
    total = courses()
    axial = total - total[0]
    axial = axial + np.random.default_rng(seed).normal(0.0, noise, axial.shape)
    axial[0] = 0.0
    n = axial.shape[1]
    at = 100.0 * np.arange(n)
    return SectionStrain(axial, -0.5 * axial, np.full(n, max(noise, 1e-7)), at, 200.0, np.arange(len(axial)), "px", 0)


def at_strain(strain: SectionStrain, fraction: float) -> SectionStrains:
    """Sections fitted up to this fraction of the Considere strain."""
    neck = int(np.argmax(strain.axial[-1]))
    return sections_of(strain, int(np.argmax(strain.axial[:, neck] > fraction * TRUE_CONSIDERE)))


def test_law_is_the_law_of_the_models() -> None:
    law = HardeningLaw(TRUE_CONSIDERE, H_EXP, TRUE_RATE)
    x = np.linspace(-0.02, 0.1, 7)
    np.testing.assert_allclose(law.stress(x), [stress(START + e) / stress(START) for e in x], rtol=1e-12)
    assert law.linear == pytest.approx(H_LIN / stress(START))
    assert law.slope(np.array([law.considere]))[0] == pytest.approx(0.0, abs=1e-12)


def test_sections_follow_the_neck_and_stop_at_the_maximum() -> None:
    total = courses()
    axial, law = total - total[0], HardeningLaw(TRUE_CONSIDERE, H_EXP, TRUE_RATE)
    others = np.flatnonzero(AREAS > 1.0)
    offset = total[0, others] - START
    found = held_strain(law, offset, axial[:, 5])
    np.testing.assert_allclose(found, axial[:, others], atol=1e-6)
    falling = np.append(axial[:, 5], 0.0)
    assert np.array_equal(held_strain(law, offset, falling)[-1], found[-1])
    assert section_states(law, offset, falling)[-1, 0] < found[-1, 0]


def test_exact_derivatives() -> None:
    found = at_strain(made_up(), 0.8)
    x = necking_problem(found, TRUE_RATE, 1.4, 8.0).start
    _, matrix = necking_linearised(found, TRUE_RATE, x)
    for k in (0, 1, 2, 5, len(x) - 1):
        step = np.zeros(len(x))
        step[k] = 1e-6
        numeric = (necking_linearised(found, TRUE_RATE, x + step)[0] - necking_linearised(found, TRUE_RATE, x - step)[0]) / 2e-6
        np.testing.assert_allclose(matrix[:, k], numeric, rtol=1e-5, atol=1e-5 * np.abs(matrix[:, k]).max())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_planted_law_comes_back_within_its_intervals(seed: int) -> None:
    fit = fit_sections(at_strain(made_up(seed=seed), 0.8), TRUE_RATE)
    assert fit.result.converged
    assert 0.0 < fit.sigma("considere_strain") < 0.1 * TRUE_CONSIDERE
    assert abs(fit.law.considere - TRUE_CONSIDERE) < 3.0 * fit.sigma("considere_strain")
    assert abs(fit.law.exponent - H_EXP) < 3.0 * fit.sigma("H_exp")
    true_voce = R * np.exp(-H_EXP * START) / stress(START)
    assert fit.law.voce == pytest.approx(true_voce, rel=0.15)


def test_size_of_hardening_is_not_felt_but_the_considere_strain_is() -> None:
    found = at_strain(made_up(), 0.9)
    right = fit_sections(found, TRUE_RATE)
    for row in other_rates(found, TRUE_RATE)[1:]:
        assert row["s2"] == pytest.approx(right.covariance.s2, rel=0.05)
        assert row["considere_strain"] == pytest.approx(TRUE_CONSIDERE, rel=0.12)
        assert row["M_yinf/M_y0"] - 1.0 > 1.7 * right.law.voce


def test_sections_that_stopped_are_left_out_and_counted() -> None:
    strain = made_up()
    whole = sections_of(strain, len(strain.axial))
    neck_end = int(np.argmax(courses()[:, 5] > CONSIDERE))
    assert whole.neck == 5 and whole.end[5] == len(strain.axial)
    ends = whole.end[AREAS > 1.0]
    assert abs(float(np.median(ends)) - neck_end) <= 2 and ends.min() > 0.9 * neck_end
    assert whole.excluded >= int((len(strain.axial) - ends).sum()) > 250
    assert at_strain(strain, 0.5).excluded == 0


def write_grid(path: Path, lose: tuple[int, int] | None = None) -> None:
    """Rows of points along y: elements of a section stretch alike; noise of every point in px."""
    axial = courses() - courses()[0]
    rng = np.random.default_rng(7)
    stretch = np.repeat(np.exp(axial), (ROWS - 1) // len(AREAS), axis=1)
    lines = ["frame,node,x_ref_px,y_ref_px,u_px,v_px"]
    y_ref = PITCH * np.arange(ROWS)
    for k in range(len(axial)):
        y = np.concatenate([[0.0], np.cumsum(PITCH * stretch[k])])
        width = np.exp(-0.5 * np.append(np.log(stretch[k]), np.log(stretch[k][-1])))
        for i in range(ROWS):
            for j in range(COLUMNS):
                x = PITCH * (j - 3)
                u, v = x * (width[i] - 1.0) + rng.normal(0, NOISE), y[i] - y_ref[i] + rng.normal(0, NOISE)
                text = "nan,nan" if lose == (i, j) else f"{u:.5f},{v:.5f}"
                lines.append(f"{k},{i * COLUMNS + j},{x:.1f},{y_ref[i]:.1f},{text}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("necking")
    write_grid(path / "grid.csv")
    return path


def tree(folder: Path, **changes: Any) -> dict[str, Any]:
    necking = {"file": str(folder / "grid.csv"), "load_axis": "y", "fit_frames": [0, 40], "hardening_rate": round(TRUE_RATE, 4)}
    return {"name": "neck", "run_dir": str(folder / "run"), "necking": {**necking, **changes}}


def study_in(folder: Path, **changes: Any) -> Study:
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(tree(folder, **changes)), encoding="utf-8")
    return load_study(path)


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Outcome:
    return run(study_in(folder))


def test_record_of_the_stage(folder: Path, outcome: Outcome) -> None:
    record = outcome.record
    found = record.parameters["considere_strain"]
    assert found.sigma is not None and abs(found.value - TRUE_CONSIDERE) < 3.0 * found.sigma < 0.5 * TRUE_CONSIDERE
    assert record.parameters["M_yinf_over_M_y0"].sigma is None
    assert Path(str(record.summary["picture"])).stat().st_size > 10000
    seen, test = record.summary["localisation"], record.summary["held_out"]
    assert seen is not None and abs(seen["strain"] - TRUE_CONSIDERE) < 0.2 * TRUE_CONSIDERE
    assert test["rms"] < 0.35 * test["gain"]
    np.testing.assert_allclose(record["strain/width"].value[-1], -0.5 * record["strain/axial"].value[-1], atol=8e-3)
    assert run(study_in(folder)).fresh


def test_chain_has_this_link_only(
    folder: Path, outcome: Outcome, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    study_in(folder)
    monkeypatch.setattr("sys.argv", ["thermofit", "run", str(folder / "study.yaml"), "--json"])
    assert outcome.record.path.exists()
    with pytest.raises(SystemExit) as end:
        app(prog_name="thermofit")
    assert end.value.code in (0, 5)
    result = json.loads(capsys.readouterr().out)
    assert [step["stage"] for step in result["steps"]] == ["necking"]
    assert {row["name"] for row in result["table"]} == {"considere_strain", "H_exp"}


def test_lost_column_is_left_out(folder: Path, tmp_path: Path) -> None:
    write_grid(tmp_path / "grid.csv", lose=(4, 2))
    found = sections(study_in(tmp_path))
    assert found.strain.lost == 1
    whole = sections(study_in(folder))
    np.testing.assert_allclose(found.strain.axial, whole.strain.axial, atol=2e-3)


def test_noise_of_sections_is_that_of_the_points(folder: Path) -> None:
    found = sections(study_in(folder))
    expected = NOISE * np.sqrt(2.0) / (4.0 * PITCH) / np.sqrt(COLUMNS)
    assert float(np.median(found.strain.sigma)) == pytest.approx(expected, rel=0.3)
    assert np.all(sections(study_in(folder, noise=3e-4)).strain.sigma == 3e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fit_frames": [0, 200]}, "necking.fit_frames' ends at 200, but the file has 80"),
        ({"rows": [0, 60]}, "necking.rows' ends at 60, but the file has 49"),
        ({"rows_per_section": 20}, "expected at least 2 columns and 3 sections"),
        ({"load_axis": "x"}, "make 1 sections of 4"),
        ({"file": "absent.csv"}, "no such file"),
    ],
)
def test_wrong_data_are_one_sentence(folder: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises(DataError) as error:
        run(study_in(folder, **change), force=True)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hardening_rate": 0.9}, "hardening_rate"),
        ({"fit_frames": [40, 10]}, "first and the last one"),
        ({"frames": 3}, "frames"),
        ({"file": "${NOT_SET_ANYWHERE}/grid.csv"}, "NOT_SET_ANYWHERE is not set"),
    ],
)
def test_wrong_study_is_one_sentence(folder: Path, change: dict[str, Any], words: str) -> None:
    with pytest.raises(StudyError) as error:
        run(study_in(folder, **change), force=True)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_alone_in_its_study(folder: Path) -> None:
    path = folder / "both.yaml"
    path.write_text(yaml.safe_dump({**tree(folder), "experiment": "lab"}), encoding="utf-8")
    with pytest.raises(StudyError, match="a study of its own"):
        load_study(path)


def test_real_images(tmp_path: Path) -> None:
    data = os.environ.get("THERMOFIT_DATA")
    if not data or not (Path(data) / "real" / "tension-necking-dic-images").is_dir():
        pytest.skip("THERMOFIT_DATA does not hold real/tension-necking-dic-images")
    study = load_study(Path(__file__).parents[2] / "configs" / "real-necking.yaml", (f"run_dir={tmp_path}",))
    record = run(study).record
    found = record.parameters["considere_strain"]
    assert found.sigma is not None and 0.08 < found.value < 0.13 and found.sigma < 0.01
    seen, test = record.summary["localisation"], record.summary["held_out"]
    assert 55 <= seen["frame"] <= 66 and found.value < seen["strain"]
    assert test["rms"] < 0.5 * test["gain"]
