"""verify: noise where the parameters are the true ones, the guilty channel and phase where they are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import verify_fixtures as made

from thermofit.body.solve.march import History
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import field_datasets
from thermofit.records.artefact import Dataset, Record
from thermofit.records.result import result_of
from thermofit.stages import verify
from thermofit.study.study import Study

ALL = ("identify-elastic", "identify-plastic", "identify-thermal")


@pytest.fixture(scope="module")
def history() -> History:
    return made.coupled_run()


def verified(folder: Path, history: History, parameters: Parameters = made.TRUTH, stages: tuple[str, ...] = ALL, **how: bool) -> Record:
    study = made.study_in(folder)
    made.write_all(study, made.interpolated(history, **how), *(made.identified(name, parameters) for name in stages))
    return verify.run(study).record


@pytest.fixture(scope="module")
def true_record(tmp_path_factory: pytest.TempPathFactory, history: History) -> Record:
    return verified(tmp_path_factory.mktemp("true"), history)


def test_true_parameters_leave_only_noise(true_record: Record) -> None:
    result = result_of(true_record)
    assert result["trustworthy"] is True and result["verdict"].startswith("verified: du ")
    channels = result["channels"]
    assert set(channels) == {"du", "du_x", "du_y", "dtheta", "u", "theta"}
    for name in ("du", "du_x", "du_y", "dtheta"):
        c = channels[name]
        # Three of 70 degrees of freedom per time are taken by the rigid motion; sampling error of chi-square 3 sqrt(2/n).
        lost = 3.0 / 70.0 if name.startswith("du") else 0.0
        assert c["judged"] and c["chi2_reduced"] == pytest.approx(1.0 - lost, abs=3.5 * np.sqrt(2.0 / c["n"]) + 0.02), name
        assert c["rms"] == pytest.approx(c["floor_rms"] * np.sqrt(c["chi2_reduced"]), rel=1e-3)
    assert channels["du"]["n"] == 2 * (len(made.TIME) * len(made.XY) - 1) == channels["du_x"]["n"] + channels["du_y"]["n"]
    # Three frames before loading make the reference; the point lost later is not lost here.
    assert channels["dtheta"]["n"] == (len(made.TIME) - 3) * len(made.XY) - 1
    assert channels["dtheta"]["lag1_noise"] == pytest.approx(0.25, abs=1e-6)
    assert channels["dtheta"]["lag1"] == pytest.approx(0.25, abs=0.12)
    assert abs(channels["du"]["lag1"]) < 0.12
    # What is shown for information holds the rigid motion and the offset of the camera.
    assert not channels["u"]["judged"] and channels["u"]["chi2_reduced"] > 100.0
    assert channels["theta"]["mean"] == pytest.approx(-made.OFFSET, abs=0.01)


def test_phases_hold_every_value_once(true_record: Record) -> None:
    rows = true_record.summary["phases"]
    assert [r["phase"] for r in rows if r["channel"] == "du"] == ["rest", "elastic", "loading", "unloading", "cooling"]
    assert "rest" not in [r["phase"] for r in rows if r["channel"] == "dtheta"]
    for name, c in true_record.summary["channels"].items():
        assert not c["judged"] or sum(r["n"] for r in rows if r["channel"] == name) == c["n"]


def test_the_run_is_coupled(true_record: Record, history: History) -> None:
    """With the true parameters it is the run that made the data; a one-way run lacks the thermal expansion of the heating, 1 um."""
    u, theta = made.seen(history)
    np.testing.assert_allclose(true_record["u/predicted"].value, u - u[0], atol=2e-5)
    np.testing.assert_allclose(true_record["theta/predicted"].value, theta, atol=1e-4)


def test_energy_and_curves(true_record: Record, history: History) -> None:
    energy = true_record.summary["energy_mJ"]
    assert energy["dissipated"] == pytest.approx(history.total("dissipated"), rel=1e-4) and energy["dissipated"] > 100.0
    assert abs(energy["heat_defect"]) < 1e-6 * energy["dissipated"]
    assert true_record.summary["smallest_dissipation_mJ_mm3"] >= 0.0
    assert true_record["energy/work"].value[0] == 0.0 and true_record["energy/work"].value[-1] == pytest.approx(energy["work"])
    curve = {name: true_record[f"curves/stress_stretch/{name}"].value for name in ("stress", "stretch", "stretch_sigma", "stretch_model")}
    np.testing.assert_allclose(curve["stress"], made.FORCE / 30.0)
    assert np.all(np.abs(curve["stretch"] - curve["stretch_model"]) < 5.0 * curve["stretch_sigma"])
    assert curve["stretch_model"].max() > 1.01
    elastic = (made.TIME > 3.0) & (made.TIME < 7.0)
    stiffness = curve["stress"][elastic] / (curve["stretch_model"][elastic] - curve["stretch_model"][2])
    np.testing.assert_allclose(stiffness, made.VALUES["E"], rtol=0.01)


def test_temperature_curves_are_those_of_dtheta(true_record: Record) -> None:
    names = ("xy", "measured", "model", "reference", "reference_model", "step_model")
    get = {name: true_record[f"curves/temperature/{name}"].value for name in names}
    np.testing.assert_allclose(get["xy"], [[0.0, -20.0], [0.0, 0.0], [0.0, 20.0]], atol=1e-9)
    np.testing.assert_allclose(get["reference"] - get["reference_model"], made.OFFSET, atol=0.05)
    point = true_record["curves/temperature/point"].value
    residual = true_record["residual/dtheta"].value[3:, point, 0]
    sigma = true_record["curves/temperature/sigma"].value[3:]
    np.testing.assert_allclose((get["model"] - get["measured"])[3:], residual * sigma, atol=1e-9)
    np.testing.assert_allclose(get["step_model"], get["model"], atol=1e-9)  # every step is an observation here
    np.testing.assert_allclose(get["measured"][:3].mean(axis=0), 0.0, atol=1e-12)


def test_maps_and_snapshots(true_record: Record) -> None:
    z = true_record["residual/du"].value
    assert np.isnan(z[8, 11]).all() and np.isfinite(np.delete(z.reshape(-1, 2), 8 * len(made.XY) + 11, axis=0)).all()
    np.testing.assert_allclose(true_record["maps/du"].value, np.sqrt(np.nanmean(z**2, axis=0)))
    assert true_record["snapshots/name"].value.tolist() == ["end of elastic range", "largest force", "end of unloading", "end"]
    assert true_record["snapshots/du/time"].value.tolist() == [7.0, 30.0, 33.5, 60.0]
    np.testing.assert_allclose(true_record["snapshots/du/error"].value[1] / made.SIGMA_U, z[11])


def test_fitted_parameters_are_those_of_the_stages(true_record: Record) -> None:
    assert {name for name, p in true_record.parameters.items() if p.free} == {name for names in made.FREE.values() for name in names}
    assert true_record.parameters["kappa"].value == 133.0 and true_record.parameters["kappa"].sigma == pytest.approx(1.33)
    assert not true_record.parameters["H_lin"].free


@pytest.mark.parametrize(("changes", "guilty", "innocent"), [({"beta": 0.4}, "dtheta", "du"), ({"H_exp": 11.6}, "du", "dtheta is")])
def test_wrong_parameter_is_seen_in_its_channel(
    tmp_path: Path, history: History, changes: dict[str, float], guilty: str, innocent: str
) -> None:
    record = verified(tmp_path, history, made.TRUTH.replace(**changes))
    assert record.summary["trustworthy"] is False
    assert record.summary["verdict"].startswith(f"not verified: {guilty} is ")
    assert innocent not in record.summary["verdict"]
    assert "most in " in record.summary["verdict"]
    assert record.summary["channels"][guilty]["lag1"] > record.summary["channels"][guilty]["lag1_noise"] + 0.3


def test_coupling_error_is_the_difference_to_the_stored_prediction(tmp_path: Path, history: History) -> None:
    study = made.study_in(tmp_path)
    _, theta = made.observations(history)
    record = verified(tmp_path, history)
    shifted = record["theta/predicted"].value + 0.01
    shifted[5, 3] += 0.04
    shifted[8, 11] = np.nan  # a lost observation has no prediction in the artefact
    part = theta.between(3.0, 40.0)
    keep = (made.TIME >= 3.0) & (made.TIME <= 40.0)
    stored = {**field_datasets(part), "theta/predicted": Dataset(shifted[keep], "K", ("time", "point", "component"))}
    made.write_all(study, made.identified("identify-thermal", made.TRUTH, **stored))
    error = verify.run(study).record.summary["coupling_error"]
    assert error["n"] == int(keep.sum()) * len(made.XY) - 1
    assert error["max_K"] == pytest.approx(0.05, abs=1e-9) and error["at_s"] == made.TIME[5]
    assert error["rms_K"] == pytest.approx(np.sqrt((0.01**2 * (error["n"] - 1) + 0.05**2) / error["n"]), rel=1e-6)


def test_without_infrared_and_with_missing_stages(tmp_path: Path, history: History) -> None:
    """Only the mechanics identified: thermal parameters keep their start, and no temperature is needed."""
    record = verified(tmp_path, history, stages=ALL[:2], infrared=False)
    assert set(record.summary["channels"]) == {"du", "du_x", "du_y", "u"}
    assert any("identify-thermal has not run" in r for r in record.summary["remarks"])
    assert record.summary["coupling_error"] is None and not record.has("curves/temperature/time")
    assert record.parameters["kappa"].value == pytest.approx(1.05 * 133.0) and not record.parameters["kappa"].free


def test_force_is_a_channel_where_the_crosshead_drives(tmp_path: Path, history: History) -> None:
    """The crosshead of the same test: its force comes back, and a softer material shows in the force, not in the mean strain alone."""
    study = made.study_in(tmp_path, force={"drives": "crosshead"})
    for stiffness, within in ((1.0, True), (0.9, False)):
        stages = (made.identified(name, made.TRUTH.replace(M_yinf=stiffness * 293.0)) for name in ALL)
        made.write_all(study, made.interpolated(history), *stages)
        summary = verify.run(study).record.summary
        force = summary["channels"]["force"]
        assert force["judged"] and force["n"] == len(made.TIME) and force["unit"] == "N"
        assert (force["chi2_reduced"] < 1.0) is within
        assert summary["trustworthy"] is within and ("force is" in summary["verdict"]) is not within
    assert verify.run(study).fresh and not verify.run(made.study_in(tmp_path)).fresh


def test_fresh_until_an_identification_changes(tmp_path: Path, history: History) -> None:
    study = made.study_in(tmp_path)
    verified(tmp_path, history, stages=ALL[:2], infrared=False)
    assert verify.run(study).fresh
    made.write_all(study, made.identified("identify-plastic", made.TRUTH.replace(F=0.36)))
    assert not verify.run(study).fresh


def test_missing_artefacts_name_their_command(tmp_path: Path, history: History) -> None:
    study = made.study_in(tmp_path)
    with pytest.raises(StudyError, match=r"`thermofit interpolate study\.yaml`"):
        verify.run(study)
    made.write_all(study, made.interpolated(history))
    with pytest.raises(StudyError, match=r"`thermofit identify-elastic study\.yaml`"):
        verify.run(study)


def test_a_model_that_cannot_carry_the_force_is_an_error(tmp_path: Path, history: History) -> None:
    with pytest.raises(NumericsError, match="coupled run with the parameters identified so far"):
        verified(tmp_path, history, made.TRUTH.replace(M_yinf=140.0, M_y0=120.0))


def test_refinement_beside_the_check(study_of: Callable[..., Study]) -> None:
    """Errors of mesh and steps at the optimum of the chain, fresh where nothing changed; the check itself stays as it was."""
    study = study_of()
    plain = verify.run(study)
    outcome = verify.run(study, refine=True)
    assert outcome.record.stage == "refinement" and verify.run(study).fresh and verify.run(study, refine=True).fresh
    result = result_of(outcome.record)
    assert {row["channel"] for row in result["refined"]} == {"du", "dtheta"} and result["evaluations"]["forward"] == 6
    for row in result["refined"]:
        assert 0.0 < row["steps_over_noise"] < row["mesh_over_noise"] < 3.0, "24 elements"
        assert row["steps_index"] >= 1.25 * row["steps_error"] > 0.0
    rows = {row["parameter"]: row for row in result["drawn_off"]}
    assert rows["c0"]["sigma"] == plain.record.parameters["c0"].sigma and rows["theta_air"]["sigma"] is None
    assert rows["c0"]["mesh_index"] > rows["c0"]["steps_index"] > 0.0
    assert "error of mesh + steps: du " in result["verdict"]
