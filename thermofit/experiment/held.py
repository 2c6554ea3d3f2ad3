"""Runs that spare what does not change: mechanics that is held while heat is solved anew, and a run that nothing has touched.

Which parameters let the mechanics be held follows from where they act: those of the base law that the heat equation has, and all Params
of effects whose slot is one of the heat problem. They reach the mechanics through the thermal strain alone, of the order of 1e-5 per K.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from thermofit.body.body import Body
from thermofit.body.heat.one_way import HeatProblem, heat_problem, heat_run, heat_run_rates
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.history import NOBODY, History, MarchSettings, Watch
from thermofit.core.parameters import Parameters, acting
from thermofit.effects.catalogue import HEATING, effects

_IN_HEAT_EQUATION = acting("expansion", "heat", "conduction", "film")
"""Of the base law. alpha_exp is in both fields: its thermoelastic heat follows it here, its thermal strain stays that of the history."""


def thermal_names() -> frozenset[str]:
    """Parameters that a heat run depends on while the mechanics stays as it is."""
    return frozenset(_IN_HEAT_EQUATION).union(*(e.names for e in effects(HEATING)))


class AnyRun(Protocol):
    """From parameters to a history at the times `time` s (n_t,)."""

    @property
    def time(self) -> np.ndarray:
        """Step times."""

    def __call__(self, parameters: Parameters, watch: Watch = NOBODY) -> History:
        """History of the parameters; a watch that asks for sensitivities gets them."""


@dataclass(frozen=True)
class HeldRun:
    """A run whose mechanics stays that of `history`; derivatives are those of the heat run, zero for u and force."""

    problem: HeatProblem
    history: History

    @property
    def time(self) -> np.ndarray:
        """Step times s (n_t,)."""
        return self.history.time

    def __call__(self, parameters: Parameters, watch: Watch = NOBODY) -> History:
        """The history with the temperatures of the parameters."""
        asked = watch.sensitivities
        theta = heat_run(self.problem, parameters) if asked is None else self._with_rates(parameters, asked)
        return replace(self.history, theta=theta)

    def _with_rates(self, parameters: Parameters, asked: Sensitivities) -> np.ndarray:
        theta, n_p = np.empty_like(self.history.theta), len(asked.names)
        still, unloaded = np.zeros((*self.history.u.shape[1:], n_p)), np.zeros(n_p)

        def collect(n: int, temperature: np.ndarray, rates: np.ndarray) -> None:
            theta[n] = temperature
            asked.collect(n, StepRates(still, rates[:, :n_p], unloaded))

        heat_run_rates(self.problem, parameters, asked.names, collect)
        return theta


def held_run(body: Body, history: History, settings: MarchSettings) -> HeldRun:
    """HeldRun of a march with these settings that kept its points; StudyError where it did not."""
    return HeldRun(heat_problem(body, history, settings), replace(history, points=(), balance=()))


@dataclass(frozen=True)
class LastRun:
    """A run that keeps its last history and gives it again where only Params in `unfelt` differ, which nothing in a run depends on."""

    run: AnyRun
    unfelt: frozenset[str]
    _last: dict[frozenset[tuple[str, float]], History] = field(default_factory=dict)

    @property
    def time(self) -> np.ndarray:
        """Step times s (n_t,)."""
        return self.run.time

    def __call__(self, parameters: Parameters, watch: Watch = NOBODY) -> History:
        """The history of the parameters. Whoever watches sees a run of its own."""
        felt = frozenset((name, value) for name, value in parameters.values.items() if name not in self.unfelt)
        if felt not in self._last or watch.sensitivities is not None or watch.step is not None:
            history = self.run(parameters, watch)
            self._last.clear()
            self._last[felt] = history
        return self._last[felt]
