"""What a stage takes for exact joins its own noise: cause by cause, with the correlation that earlier stages hand on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.experiment.model import StageModel
from thermofit.experiment.stage_errors import StageErrors
from thermofit.fit.budget import MISFIT, Budget, moves
from thermofit.fit.linear_model import LinearModel
from thermofit.identify.budget import budget_datasets
from thermofit.identify.combined import ABOVE_NOISE, with_budget
from thermofit.identify.solve import Solved
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation
from thermofit.records.artefact import Dataset

TIMES, POINTS = 40, 30
RNG = np.random.default_rng(4)
COLUMNS = RNG.normal(size=(TIMES * POINTS, 2))
WEIGHED = COLUMNS / np.sqrt(TIMES * POINTS)
"""The residual of a channel has its number of values as its weight."""
SLOPES = RNG.normal(size=(TIMES * POINTS, 1))
FORCE = RNG.normal(size=(TIMES * POINTS, 1))
SETTINGS: Any = None


def solved(over: float = 1.0) -> Solved:
    """A fit of M_y0 and M_yinf to temperatures whose error is `over` times their noise."""
    xy = np.stack([np.linspace(-5.0, 5.0, POINTS), np.linspace(-20.0, 20.0, POINTS)], axis=1)
    error = over * np.random.default_rng(5).normal(size=(TIMES, POINTS, 1))
    seen = FieldObservation(
        "theta", np.arange(TIMES, dtype=float), xy, error, np.ones_like(error), np.ones((TIMES, POINTS), dtype=bool), "K"
    )
    model = StageModel(lambda p: {"theta": error}, (plain(seen),), {"theta": seen}, "")
    parameters = Parameters.of({"E": 7e4, "M_y0": 130.0, "M_yinf": 290.0}, ("M_y0", "M_yinf"))
    residual = model.residual(parameters)
    spread = LinearModel(residual, WEIGHED).covariance(parameters.free)
    fit: Any = SimpleNamespace(names=parameters.free, residual=residual, jacobian=WEIGHED)
    return Solved(parameters, model, fit, spread, (), ())


class Stored(dict[str, Dataset]):
    """Record of the elastic stage: it has told E, and M_y0 before it was fitted here."""

    def __init__(self, **parts: list[list[float]]) -> None:
        budget = Budget(("E", "M_y0"), {cause.replace("_", " "): np.array(m) for cause, m in parts.items()}, np.zeros(2, dtype=bool))
        super().__init__({**budget_datasets(budget), "evaluations/names": Dataset(np.array(budget.names), "1", ("parameter",))})
        self.parameters = {name: SimpleNamespace(free=True) for name in budget.names}
        self.names = tuple(self)


def found(one: Solved, record: Stored, asked: list[tuple[str, ...]] | None = None, **causes: np.ndarray) -> Solved:
    """The answer with its budget; the experiment tells these causes and its derivative by E."""

    def stage_errors(settings: Any, parameters: Parameters, earlier: tuple[str, ...]) -> StageErrors:
        if asked is not None:
            asked.append(earlier)
        return StageErrors({cause.replace("_", " "): columns for cause, columns in causes.items()}, SLOPES[:, : len(earlier)])

    experiment: Any = SimpleNamespace(stage_errors=stage_errors)
    return with_budget(SETTINGS, experiment, one, {"identify-elastic": record})  # type: ignore[dict-item]


def moved(one: Solved, columns: np.ndarray) -> np.ndarray:
    return moves(LinearModel(one.fit.residual, WEIGHED), columns, np.zeros(2, dtype=bool))


def test_earlier_parameters_move_those_of_this_stage_by_what_they_are_uncertain() -> None:
    """2 MPa of E by noise; what this stage fits itself is taken from nobody."""
    one, asked = solved(), []  # type: ignore[var-annotated]
    budget = found(one, Stored(noise=[[2.0], [9.0]]), asked, mesh=FORCE).budget
    assert asked == [("E",)] and budget is not None
    assert np.allclose(budget.parts["noise of identify-elastic"], moved(one, 2.0 * SLOPES))
    assert np.allclose(budget.parts["mesh"], moved(one, FORCE)) and MISFIT not in budget.parts
    assert one.covariance is not None and np.allclose(budget.of("noise"), one.covariance.sigma_unit, rtol=0.05)


def test_a_cause_that_both_stages_feel_moves_the_parameters_by_the_sum_of_both_ways() -> None:
    """One error of the force, and a second one that only the earlier stage felt."""
    one = solved()
    budget = found(one, Stored(force_noise=[[3.0, 1.0], [0.0, 0.0]]), force_noise=FORCE).budget
    assert budget is not None
    assert np.allclose(budget.parts["force noise"], moved(one, np.column_stack([FORCE + 3.0 * SLOPES, SLOPES])))


@pytest.mark.parametrize(("over", "told"), [(0.9 * ABOVE_NOISE, False), (1.3, True)])
def test_a_misfit_is_told_where_a_channel_is_above_its_noise(over: float, told: bool) -> None:
    budget = found(solved(over), Stored(noise=[[2.0], [9.0]])).budget
    assert budget is not None and (MISFIT in budget.parts) is told


def test_where_a_run_fails_the_answer_keeps_its_noise_and_says_so() -> None:
    def fails(*_: Any) -> StageErrors:
        raise NumericsError("no equilibrium")

    experiment: Any = SimpleNamespace(stage_errors=fails)
    one = with_budget(SETTINGS, experiment, solved(), {})
    assert one.budget is None and one.remarks == (
        "the uncertainty holds the noise of the data alone: a run that tells the rest failed (no equilibrium)",
    )
