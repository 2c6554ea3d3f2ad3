"""A march driven by the elongation between two sections of the body: the displacement of its end and its force follow.

Beyond the load maximum no force is an equilibrium, and cameras seldom see the ends of a specimen; the motion of two sections inside is
measured. With the gauge g (n_np,), e = g . u_y the elongation between the sections and U the displacement of the end,

    e(U) - e(rest) = prescribed,

is one equation for U in every step, solved by secants around the equilibrium under U. Its derivative needs the answer of the step to U
alone: a direction of its own, q, whose history is zero at the start of every step. With the rates r of a parameter at the guess U' = c,

    U' = c - (g . u_y'|_c - e'(rest) - e') / (g . q_y),      rates = r + (U' - c) q,

e' that of the prescribed elongation itself, along the modes of its error.

The temperatures of q are none at the start of each step and cannot be foreseen, so that q alone would ask for a second sweep in every step.
It asks for none: U' of the step before is a good guess, and little of q is added. Where measured sections scatter by a micrometre, the
derivatives of all fields together, in units of the noise, are within 1e-3 of exact ones still. Those of a field that a parameter hardly
moves are less exact (the force by c0: 4 %).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.body import Body
from thermofit.body.heat.conduction import HeatConditions
from thermofit.body.heat.coupling import HeatOfStep
from thermofit.body.sensitivity.march import Differentiator
from thermofit.body.sensitivity.step_rates import LinearisedStep, Rates, Sensitivities, StepEnds, StepRates
from thermofit.body.solve.history import DEFAULTS, NOBODY, Balance, History, MarchSettings, State, Watch
from thermofit.body.solve.loading import Loading
from thermofit.body.solve.march import Run, beginning, marched
from thermofit.body.solve.predictor import Passed, predicted
from thermofit.core.errors import NumericsError
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import LOAD, effects
from thermofit.law.page import Law, law_in_step

_EXACT = 1e-9
"""Open elongation, as a share of the body's length, below which none is asked for: 0.15 nm of 150 mm."""
_OPEN = 3e-3
"""The same share per tolerance of equilibrium, at which the end of a step is found: 4.5 nm of 150 mm at the default. The end of the
reference specimen is off by 11 nm then and its force by 0.06 N, less than a fiftieth of the noise."""
_MAX_SECANTS = 20
_STEEPEST = 20.0
"""Most by which a secant may take the end farther than the one before would."""


@dataclass(frozen=True)
class GaugeLoading(Loading):
    """The elongation mm (n_t,) between two sections since the rest drives a body whose end displacement is prescribed (found, that is).

    `gauge` (n_np,): weights of the nodal u_y that make the elongation.
    """

    gauge: np.ndarray | None = None

    def elongation(self, u: np.ndarray) -> np.ndarray:
        """g . u_y of displacements (n_np, 3), or of their rates (n_np, 3, m)."""
        assert self.gauge is not None
        return np.asarray(self.gauge @ u[:, 1])


def march_between(
    body: Body,
    parameters: Parameters,
    loading: GaugeLoading,
    times: np.ndarray,
    settings: MarchSettings = DEFAULTS,
    watch: Watch = NOBODY,
) -> History:
    """`march` under the elongation between two sections; errors as there."""
    law, conditions = beginning(body, parameters, loading, times, settings)
    run = _Between(body, law, conditions, loading, settings)
    names = watch.sensitivities.names if watch.sensitivities is not None else ()
    return marched(run, parameters, loading.rates(parameters, names), times, watch)


class _BetweenRates(Differentiator):
    """Differentiates the steps of a march between two sections. The last direction asked for is that of the end alone."""

    _loading: GaugeLoading | None = None
    _rest = _end = np.empty(0)

    @property
    def _lane(self) -> int:
        return len(self.asked.names) - 1

    def begin(self, loading: GaugeLoading, rest: Rates) -> None:
        """From now on the elongation is prescribed, from a state with the rates `rest`."""
        self._loading, self._rest = loading, loading.elongation(rest.u)
        self._end = np.zeros(self.m)
        self._end[self._lane] = 1.0

    def between(self, start: Rates, mechanics: LinearisedStep, ends: StepEnds, wanted: np.ndarray) -> Rates:
        """Rates at the end of a step under an elongation of which `wanted` (m,) are the rates there. NumericsError as `step`, and where the
        elongation does not follow the end."""
        assert self._loading is not None
        for old in (start.u, start.theta, start.points, start.dilatation, *(theta for _, theta in start.past)):
            old[..., self._lane] = 0.0
        found = self.step(start, mechanics, ends, self._end)
        k, elongation = self._lane, self._loading.elongation(found.u)
        if elongation[k] == 0.0:
            raise NumericsError("sections: the elongation does not follow the end of the body; use smaller steps")
        change = -(elongation - self._rest - wanted) / elongation[k]
        change[k:] = 0.0
        self._end = self._end + change
        for new in (found.u, found.theta, found.points, found.dilatation):
            _add_column(new.reshape(-1, new.shape[-1]), k, change)
        return replace(found, top_force=found.top_force + found.top_force[k] * change)

    def _change(self, found: np.ndarray, theta: np.ndarray) -> np.ndarray:
        size = super()._change(found, theta)
        size[self._lane] = 0.0
        return size


class _Between(Run):
    """One march between two sections."""

    differentiator = _BetweenRates

    def __init__(self, body: Body, law: Law, conditions: HeatConditions, loading: GaugeLoading, settings: MarchSettings) -> None:
        super().__init__(body, law, conditions, loading, settings)
        self.between = loading
        self.rest = 0.0
        self.ratio = 1.0

    def differentiate(self, parameters: Parameters, asked: Sensitivities, load_rates: np.ndarray) -> None:
        """As in any march; the last direction is that of the end alone, under the name of a Param of the machine: no such one acts."""
        wanted, count = asked.collect, len(asked.names)

        def collect(n: int, at: StepRates) -> None:
            wanted(n, StepRates(at.u[:, :, :count], at.theta[:, :count], at.force[:count]))

        names = (*asked.names, _of_machine(asked.names))
        unit = np.ones((len(load_rates), 1))
        super().differentiate(parameters, replace(asked, names=names, collect=collect), np.concatenate([load_rates, unit], axis=1))

    def load(self, t: float) -> float:
        """Displacement of the end where the specimen rests, whatever the noise of the elongation is then."""
        return self.rest_displacement

    def initial(self, t: float) -> State:
        """The state at rest, from which the elongation counts."""
        start = super().initial(t)
        self.rest = float(self.between.elongation(start.u))
        if start.rates is not None:
            assert isinstance(self.rates, _BetweenRates)
            self.rates.begin(self.between, start.rates)
        return start

    def _step(self, start: State, past: tuple[Passed, ...], t: float) -> tuple[State, Balance]:
        """One step: the end by secants, then its derivatives."""
        wanted = self.loading.at(t) + self.rest
        before = float(self.between.elongation(start.u))
        end = start.load + self.ratio * (wanted - before)
        self.solver.law = law_in_step(self.law, t - start.time)
        u, theta, fresh = predicted(self.body, start, past, t, end)
        one_way = self.settings.coupling == "one-way"
        heat = HeatOfStep(self.body, self.law, self.conditions, start, (t, self.settings.heat_scheme))
        tried, open_before, there = start.load, wanted - before, start.u
        exact = self.length * max(_OPEN * self.settings.newton.tolerance, _EXACT)
        for _ in range(_MAX_SECANTS):
            theta = self.resting_temperature if one_way else theta
            found = self._mechanics(u, theta, start, past, end, fresh, None if one_way else heat)
            left = wanted - float(self.between.elongation(found.u))
            if abs(left) <= exact:
                break
            moved, closed = end - tried, open_before - left
            ratio = moved / closed if closed * moved > 0.0 else self.ratio
            if tried != start.load:
                ratio = float(np.clip(ratio, self.ratio / _STEEPEST, self.ratio * _STEEPEST))
            onwards = ratio * left / moved if moved != 0.0 else 0.0
            u, fresh = found.u + onwards * (found.u - there), False
            tried, open_before, there, end = end, left, found.u, end + ratio * left
            if not one_way:
                theta = heat.solve(found.u, found.state, found.dilatation, theta)
        else:
            raise NumericsError(
                f"sections: no displacement of the end gives the prescribed elongation within {_MAX_SECANTS} trials ({left:.1e} mm left); "
                "the strain may have left the part between them: use smaller steps, or sections that are farther apart"
            )
        if one_way:
            heat.solve(found.u, found.state, found.dilatation, start.theta)
        grown = float(self.between.elongation(found.u)) - before
        if abs(grown) > 1e3 * _EXACT * self.length and (end - start.load) / grown > 0.0:
            self.ratio = (end - start.load) / grown
        state, balance = heat.finish(found, end)
        if self.rates is None or start.rates is None:
            return state, balance
        mechanics = self._linearised(found, self.resting_temperature if one_way else state.theta, start.points)
        assert isinstance(self.rates, _BetweenRates)
        load_rates = self.loading.between(self.load_rates, t)
        return replace(state, rates=self.rates.between(start.rates, mechanics, heat.ends(found), load_rates)), balance


@kernel
def _add_column(rates: np.ndarray, k: int, change: np.ndarray) -> None:
    """rates (n, m) += rates_k change: every direction with as much of direction k as its `change` (m,) says."""
    for i in range(rates.shape[0]):
        by_k = rates[i, k]
        if by_k != 0.0:
            for p in range(rates.shape[1]):
                rates[i, p] += by_k * change[p]


def _of_machine(names: Sequence[str]) -> str:
    """Name of a Param of the machine that is not among `names`."""
    every = [name for e in effects(LOAD) for name in e.names]
    return next((name for name in every if name not in names), every[0])
