"""Honest numbers of data: white residuals are worth all their values, smooth ones as many as they have independent pieces."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose.comparing import criteria, independent, length_scale, time_scale
from thermofit.diagnose.held_out import Rows, split_by_experiment
from thermofit.experiment.model import StageModel
from thermofit.experiment.verification import literature_rows
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation
from thermofit.records.artefact import ParameterResult

N_T, N_S = 120, 150
XY = np.random.default_rng(1).uniform([-10.0, -20.0], [10.0, 20.0], size=(N_S, 2))


def smoothed(z: np.ndarray, width: int) -> np.ndarray:
    """Moving sum over time of a field (n_t, n_s), of unit variance."""
    kernel = np.ones(width) / np.sqrt(width)
    return np.apply_along_axis(lambda v: np.convolve(v, kernel, "same"), 0, z)


def test_correlation_in_time_and_over_distance_is_counted() -> None:
    rng = np.random.default_rng(2)
    white = rng.normal(size=(N_T, N_S, 1))
    assert time_scale(white) == pytest.approx(1.0, abs=0.1) and length_scale(white, XY) == pytest.approx(1.0, abs=0.1)
    # A moving sum of 5 has the correlation 1 - k/5: 1 + 2 (4 + 3 + 2 + 1)/5 = 5.
    slow = smoothed(white[..., 0], 5)[..., None]
    assert time_scale(slow) == pytest.approx(5.0, rel=0.1) and length_scale(slow, XY) == pytest.approx(1.0, abs=0.15)
    cell = (XY // 5.0).astype(int)
    _, group = np.unique(cell, axis=0, return_inverse=True)
    blocks = rng.normal(size=(N_T, group.max() + 1))[:, group.ravel()][..., None]
    size = float(np.mean(np.bincount(group.ravel())[group.ravel()]))
    assert length_scale(blocks, XY) == pytest.approx(size, rel=0.35)


def test_a_common_misfit_is_worth_one_value_a_piece() -> None:
    wave = np.sin(np.linspace(0.0, 6.0 * np.pi, N_T))[:, None, None] * np.ones((1, N_S, 1))
    seen = FieldObservation("theta", np.arange(float(N_T)), XY, 0.0 * wave, np.ones(wave.shape), np.ones(wave.shape[:2], dtype=bool), "K")
    model = StageModel(lambda _: {"theta": 10.0 * wave}, (plain(seen),), {"theta": seen}, "")
    found = independent(model, model.residual(Parameters.of({})))
    assert 1.0 <= found["theta"] < 60.0


def test_criteria_take_a_misfit_as_one() -> None:
    good, bad = (criteria({"du": q}, {"du": 100.0}, k) for q, k in ((0.98, 5), (9.0, 4)))
    assert good.deviance == pytest.approx(98.0) and good.aic == pytest.approx(108.0)
    assert bad.deviance == pytest.approx(100.0 * (np.log(9.0) + 1.0)) and bad.bic == pytest.approx(bad.deviance + 4.0 * np.log(100.0))
    assert criteria({"du": 1.0}, {"du": 100.0}, 5, priors=3.0).deviance == pytest.approx(103.0)


def test_experiments_are_folds() -> None:
    rows = Rows(np.array([0, 0, 1, 1, 2, -1]), np.arange(6.0), np.zeros((6, 2)), np.zeros(6, dtype=int))
    split = split_by_experiment(rows, ("du@first", "du@second", "dtheta@second"), ("second",))
    assert split.held_out[0].tolist() == [False, False, True, True, True, False] and not split.buffer[0].any()
    assert split.by == "experiments second"


def test_literature_compares_the_heat_capacity_at_constant_pressure() -> None:
    class Small:
        literature = {"c_p": (2.4, 2.5), "kappa": 130.0, "alpha_air": (10.0, 20.0)}  # noqa: RUF012

    def result(value: float, sigma: float | None = None) -> ParameterResult:
        return ParameterResult(value, sigma, "1", sigma is not None, False, value, 0.0, 1e9)

    values = {"E": 68000.0, "nu": 0.34, "alpha_exp": 2.02e-5, "theta_ref": 296.7}
    results = {name: result(v) for name, v in values.items()} | {"c0": result(2.35, 0.01), "kappa": result(133.0, 1.0)}
    results |= {"alpha_air@first": result(15.0, 1.0), "alpha_air@second": result(22.0, 1.0)}
    rows = {row["parameter"]: row for row in literature_rows(Small(), results)}  # type: ignore[arg-type]
    assert (
        rows["c_p"]["value"] == pytest.approx(2.35 + 9.0 * 68000.0 / (3.0 * 0.32) * 2.02e-5**2 * 296.7)
        and rows["c_p"]["compared"] == "within"
    )
    assert rows["kappa"]["compared"] == "above 130 by 2.3 %, 3 standard errors"
    assert rows["alpha_air@first"]["compared"] == "within" and rows["alpha_air@second"]["compared"].startswith("above 10 to 20 by 10 %")
