"""The joint fit at the end of the chain: it takes nothing for exact, and leaves the parameters alone where the model lacks something."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from virtual_pulls import TRUTH, data, pulled, study

from thermofit.core.parameters import THERMOCOUPLES, Parameters, param
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.discretisation import OF_A_SPECIMEN
from thermofit.experiment.fields import Measured
from thermofit.experiment.joint import FORCE_NOISE
from thermofit.experiment.prescribed import AREA_THICKNESS, AREA_WIDTH, CALIBRATION, INFRARED, SCALE
from thermofit.experiment.priors import LANDMARKS, is_of_pose, pose_bounds
from thermofit.fit import budget as causes_of_fits
from thermofit.fit.budget import Budget
from thermofit.identify import refine as module
from thermofit.identify.budget import EARLIER, budget_datasets, earlier_moves, helps_most
from thermofit.identify.refine import refined
from thermofit.records.artefact import Dataset, ParameterResult
from thermofit.records.staging import Made, job

FREE = {
    "identify-elastic": ("E", "nu"),
    "identify-plastic": ("M_y0", "M_yinf", "H_exp", "F"),
    "identify-thermal": ("c0", "kappa", "alpha_air"),
}
STAGED = {**TRUTH, "E": 69000.0, "M_y0": 130.5, "kappa": 139.0, "alpha_air": 14.2, "c0": 2.23}


def records(over_noise: float = 1.0) -> dict[str, Any]:
    """What the stages left: values a little off, noise alone in their errors."""
    out = {}
    for stage, names in FREE.items():
        results = {n: ParameterResult(STAGED[n], 0.01, param(n).unit, True, False, 1.5 * STAGED[n], *bounds(n)) for n in names}
        channels = {"du": {"chi2_reduced": over_noise**2}}
        out[stage] = SimpleNamespace(parameters=results, summary={"channels": channels, "converged": True, "drive": "force"})
    return out


def bounds(name: str) -> tuple[float, float]:
    return param(name).lower, param(name).upper


def made(folder: Path, measured: Measured, over_noise: float = 1.0) -> Made:
    case = study()
    base = Parameters.of({name: STAGED[name] for name in STAGED})
    return refined(case, BodyExperiment(case, given=measured), base, job(folder, "refine", {}, {}), records(over_noise))


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """The jaws' thermocouple reads 0.1 K too much."""
    measured = data()
    return made(tmp_path_factory.mktemp("refine"), replace(measured, theta_clamp=measured.theta_clamp + 0.1))


def test_all_parameters_come_back_within_their_combined_uncertainty(one: Made) -> None:
    assert one.summary["refined"], one.summary["verdict"]
    free = {name: p for name, p in one.parameters.items() if p.free}
    assert set(free) == {*(n for names in FREE.values() for n in names), "theta_air", "theta_clamp"}
    z = {name: (p.value - TRUTH[name]) / p.sigma for name, p in free.items() if p.sigma}
    assert max(map(abs, z.values())) < 3.0 and len(z) == len(free), z
    assert abs(free["kappa"].value - STAGED["kappa"]) > 1.0 and free["kappa"].value != STAGED["kappa"], "it has moved from where it began"


def test_a_reading_is_a_datum_and_its_error_reaches_what_it_acts_on(one: Made) -> None:
    causes = {c["cause"]: c["share"] for c in one.summary["budget"]["theta_clamp"]}
    assert causes["theta_clamp"] > 0.2 and sum(causes.values()) == pytest.approx(1.0)
    assert one.parameters["theta_clamp"].sigma == pytest.approx(0.1, rel=0.3), "no better than it was read: 40 s tell little of it"
    shares = {c["cause"]: c["share"] for c in one.summary["budget"]["E"]}
    assert {"noise", "time steps"} <= set(shares)
    assert shares.get("mesh", 0.0) < 0.05, "data of the same mesh hold nothing of its error"
    assert one.summary["helps_most"]
    assert one.summary["exact"] == ["force_class", "thickness", "width", "camera_scale", "infrared_gain"]


LANDMARK_ERRORS = {
    "ir_registration.shift_y": 3.0, "ir_registration.shift_x": 0.3, "ir_registration.rotation": 5e-3, "ir_registration.scale": 5e-3,
}  # fmt: skip


def test_the_camera_lies_beside_the_specimen_by_an_error_of_its_landmarks(tmp_path: Path) -> None:
    """Its pose is fitted with everything else, a datum within bounds; of 5 mm along the load half comes back at least."""
    found = made(tmp_path, replace(pulled(beside=5.0), registration=LANDMARK_ERRORS))
    assert found.summary["refined"], found.summary["verdict"]
    free, shift = {name: p for name, p in found.parameters.items() if p.free}, "ir_registration.shift_y"
    assert {name: (p.lower, p.upper) for name, p in free.items() if is_of_pose(name)} == pose_bounds(study(), LANDMARK_ERRORS)
    truth = {**TRUTH, **dict.fromkeys(LANDMARK_ERRORS, 0.0), shift: 5.0}
    z = {name: (p.value - truth[name]) / p.sigma for name, p in free.items() if p.sigma}
    assert max(map(abs, z.values())) < 3.0 and len(z) == len(free), z
    assert free[shift].value > 2.5 and (free[shift].sigma or np.inf) < 0.6 * 3.0, "the data tell more than the landmarks"
    causes = {c["cause"]: c["share"] for c in found.summary["budget"]["ir_registration.shift_x"]}
    assert causes[LANDMARKS] > 0.5 and sum(causes.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "cause",
    [
        *(value for name, value in vars(causes_of_fits).items() if name.isupper() and isinstance(value, str)),
        *(CALIBRATION, AREA_THICKNESS, AREA_WIDTH, SCALE, INFRARED, LANDMARKS, FORCE_NOISE),
        *OF_A_SPECIMEN,
        *THERMOCOUPLES,
    ],
)
def test_every_cause_has_a_measurement_that_helps(cause: str) -> None:
    """It is named where that cause makes the most; what a stage left to a later one is told better there."""
    budget = Budget(("kappa",), {cause: np.array([[1.0]])}, np.zeros(1, dtype=bool))
    told = helps_most(budget)
    assert told.startswith(f"{cause} makes 100 % of the variances, on average: what helps most is ") and "refine" not in told
    earlier = helps_most(replace(budget, parts={f"{EARLIER}identify-plastic": np.array([[1.0]])}))
    assert "the parameters of identify-plastic told better" in earlier


def test_what_would_help_most_helps_what_is_asked_for() -> None:
    """A landmark may make all of the error of a pose; what is asked for is the material."""
    parts = {"noise": np.array([[2.0], [0.0], [0.0]]), LANDMARKS: np.array([[1.0], [0.3], [0.1]])}
    both = Budget(("kappa", "ir_registration.shift_y", "ir_registration.scale"), parts, np.zeros(3, dtype=bool))
    assert helps_most(both).startswith("noise makes 80 % of the variances")
    only = replace(both, parts={**parts, "noise": 0.1 * parts["noise"]})
    assert f"{LANDMARKS} makes" in helps_most(only) and "landmarks of the infrared camera that are found to less" in helps_most(only)


def test_what_the_stages_had_stays_in_the_record(one: Made) -> None:
    assert one.summary["staged"]["E"] == {"value": STAGED["E"], "sigma": 0.01}
    assert one.parameters["E"].start == 1.5 * STAGED["E"]
    covariance = one.datasets["covariance"].value
    sigma = [one.parameters[str(n)].sigma for n in one.datasets["evaluations/names"].value]
    assert np.allclose(np.sqrt(np.diag(covariance)), sigma)
    assert not any(name.startswith(("u/", "theta/")) for name in one.datasets), "corrected data are no measured ones"
    assert {"numerical/u", "numerical/theta"} <= set(one.datasets)


def test_where_the_model_lacks_something_the_parameters_of_the_stages_stay(tmp_path: Path) -> None:
    found = made(tmp_path, data(), over_noise=2.0)
    assert not found.summary["refined"] and "2 times its noise" in found.summary["verdict"]
    assert {name: p.value for name, p in found.parameters.items()} == {n: STAGED[n] for names in FREE.values() for n in names}


def test_a_joint_fit_that_does_not_come_to_its_end_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "EVALUATIONS", 1)
    found = made(tmp_path, data())
    assert not found.summary["refined"] and "the joint fit does not come to an end" in found.summary["verdict"]
    assert found.parameters["kappa"].value == STAGED["kappa"]


def test_a_joint_fit_that_leaves_more_than_noise_is_not_taken(tmp_path: Path) -> None:
    """A lamp that the model does not know warms one side by 0.3 K."""
    measured = data()
    assert measured.temperature is not None
    warm = measured.temperature
    lit = 0.3 * np.linspace(0.0, 1.0, len(warm.time))[:, None, None] * np.sign(warm.xy[:, 0])[:, None]
    found = made(tmp_path, replace(measured, temperature=replace(warm, value=warm.value + lit)))
    assert not found.summary["refined"] and "leaves dtheta at" in found.summary["verdict"]
    assert found.parameters["E"].value == STAGED["E"]


def test_a_budget_goes_through_a_record_and_joins_the_stages() -> None:
    """Noise of each stage is its own, and so is what its residual shows beyond; what they share moves them together."""
    first = Budget(
        ("E",), {"noise": np.array([[2.0]]), "misfit": np.array([[7.0]]), "force noise": np.array([[1.0, 3.0]])}, np.zeros(1, dtype=bool)
    )
    second = Budget(("M_y0",), {"noise": np.array([[5.0]]), "force noise": np.array([[4.0]]), "theta_air": np.array([[0.5]])}, first.open)
    read = {}
    for stage, budget in (("a", first), ("b", second)):
        found = {**budget_datasets(budget), "evaluations/names": Dataset(np.array(budget.names), "1", ("parameter",))}
        result = {name: SimpleNamespace(free=True) for name in budget.names}
        read[stage] = _Stored(found, result)
    names, parts = earlier_moves(read)  # type: ignore[arg-type]
    assert names == ("E", "M_y0")
    assert np.array_equal(parts["force noise"], [[1.0, 3.0], [4.0, 0.0]])
    assert np.array_equal(parts["noise of a"], [[2.0, 7.0], [0.0, 0.0]]) and np.array_equal(parts["theta_air"], [[0.0], [0.5]])
    assert "noise makes" in helps_most(second) and "more stages and frames" in helps_most(second)
    seen = replace(second, noise_of={"du": np.array([0.2]), "dtheta": np.array([0.8])})
    assert "80 % of it is that of dtheta" in helps_most(seen) and "infrared camera with less noise" in helps_most(seen)


class _Stored(dict[str, Dataset]):
    def __init__(self, found: dict[str, Dataset], parameters: dict[str, Any]) -> None:
        super().__init__(found)
        self.parameters, self.names = parameters, tuple(found)
