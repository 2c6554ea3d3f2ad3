"""March in time: mechanics and heat, step by step; the only place where state is committed.

`coupling` "full" lets both fields of a step converge together; "one-way" solves the mechanics at the initial temperature and the
heat equation, with the heat capacity of constant stress, on the deformation and dissipation that follow from it. With
`sensitivities` every step is differentiated after it has converged (body.sensitivity.march), in either coupling.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import reduce

import numpy as np

from thermofit.body.body import Body, check_axes, thermal_geometry
from thermofit.body.element.energy import internal_energy_of
from thermofit.body.heat.conduction import HeatConditions, at_constant_stress, steady_temperature
from thermofit.body.heat.coupling import HeatOfStep
from thermofit.body.heat.films import conditions_of
from thermofit.body.sensitivity.conduction_rates import condition_rates
from thermofit.body.sensitivity.march import Differentiator, LinearisedStep, Sensitivities, volume_mean
from thermofit.body.solve.arc import PathFollower, PathPoint
from thermofit.body.solve.history import DEFAULTS, NOBODY, State, added, history, recorded
from thermofit.body.solve.history import Balance as Balance
from thermofit.body.solve.history import History as History
from thermofit.body.solve.history import MarchSettings as MarchSettings
from thermofit.body.solve.history import Watch as Watch
from thermofit.body.solve.linear import Factor
from thermofit.body.solve.loading import Loading as Loading
from thermofit.body.solve.loading import moving, solution_times
from thermofit.body.solve.newton import Equilibrator, Equilibrium, axes_about_z, virgin_state
from thermofit.body.solve.predictor import Passed, onwards, passed, predicted
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.law.bounds import check_beta
from thermofit.law.page import Law, law_in_step, law_of
from thermofit.law.page_rates import is_structured
from thermofit.point.state import LAMBDA


def march(
    body: Body,
    parameters: Parameters,
    loading: Loading,
    times: np.ndarray,
    settings: MarchSettings = DEFAULTS,
    watch: Watch = NOBODY,
) -> History:
    """Solve the coupled boundary value problem at the increasing `times` s (n_t,); the first is the state at rest.

    Only these are recorded; solution steps between them (`max_step`) add up to one Balance. `watch` follows the run and may have it
    differentiated. Effects of the machine (slot load) stand between the loading and the specimen. NumericsError where a step fails even
    after `max_cuts` bisections, or all steps together need more than one each and `all_cuts` besides; the message names the time.
    StudyError where times, loading, body and parameters do not fit together.
    """
    law, conditions = beginning(body, parameters, loading, times, settings)
    run = Run(body, law, conditions, loading.acting(parameters), settings)
    load_rates = np.empty((0, 0)) if watch.sensitivities is None else loading.rates(parameters, watch.sensitivities.names)
    return marched(run, parameters, load_rates, times, watch)


def beginning(
    body: Body, parameters: Parameters, loading: Loading, times: np.ndarray, settings: MarchSettings
) -> tuple[Law, HeatConditions]:
    """Law and conditions at the first time of a march. StudyError where times, loading, body and parameters do not fit together."""
    if len(times) < 2 or np.any(np.diff(times) <= 0.0):
        raise StudyError("march: at least two increasing times are needed; check the evaluation times of the study")
    loading.check(body, times)
    check_axes(body, settings.material_angle)
    check_beta(parameters)
    law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
    conditions = conditions_of(body, parameters, settings.films)
    if settings.coupling == "one-way":
        conditions = at_constant_stress(conditions, law)
    return law, conditions.at(float(times[0]), float(times[0]), np.empty(0))


def marched(run: Run, parameters: Parameters, load_rates: np.ndarray, times: np.ndarray, watch: Watch) -> History:
    """The history of a run through its times; `load_rates` (n, n_p) are the derivatives of the loading by what `watch` asks for."""
    body, settings = run.body, run.settings
    run.structured = is_structured(parameters, run.law, watch.sensitivities.names if watch.sensitivities is not None else ())
    if watch.sensitivities is not None:
        run.differentiate(parameters, watch.sensitivities, load_rates)
    start = run.initial(float(times[0]))
    past: tuple[Passed, ...] = ()
    records, balances, energy = [recorded(body, start, settings)], [], run.energy(start)
    run.collect(0, start)
    if watch.state is not None:
        watch.state(0, start)
    for n, t in enumerate(times[1:], start=1):
        parts = []
        for middle in solution_times(start.time, float(t), settings.max_step):
            run.steps += 1
            state, balance = run.advance(start, past, middle, 0)
            past, start = (passed(start), *past[:1]), state
            parts.append(balance)
        records.append(recorded(body, start, settings))
        before, energy = energy, run.energy(start)
        balances.append(replace(reduce(added, parts), internal=energy - before))
        run.collect(n, start)
        if watch.state is not None:
            watch.state(n, start)
        if watch.step is not None:
            watch.step(n)
    return history(body, records, tuple(balances), run.counts(len(times) - 1))


class Run:
    """One march: body, law, conditions and the solver with its buffers."""

    differentiator = Differentiator
    """What differentiates its steps."""

    def __init__(self, body: Body, law: Law, conditions: HeatConditions, loading: Loading, settings: MarchSettings) -> None:
        self.body, self.law, self.conditions, self.loading, self.settings = body, law, conditions, loading, settings
        self.follower = PathFollower(body, law, settings.newton) if loading.control == "arc" else None
        self.solver = self.follower or Equilibrator(body, law, settings.newton)
        self.factor = body.symmetry if loading.control == "force" else 1.0
        self.length = float(np.ptp(body.mesh.nodes[:, 1]))
        self.iterations = 0
        self.fallbacks = body.mechanical.fallbacks.total() + body.thermal.fallbacks.total()
        self.cuts = 0
        self.steps = 0
        self.resting_temperature = np.empty(0)
        self.rest_displacement = 0.0
        self.rates: Differentiator | None = None
        self.load_rates = np.empty((0, 0))
        self.elastic: Factor | None = None
        self.structured = False

    def differentiate(self, parameters: Parameters, asked: Sensitivities, load_rates: np.ndarray) -> None:
        """Differentiate every step from now on; load_rates (n, n_p) are those of the loading at its times. What moves nothing (slip of jaws
        where a force is prescribed) takes no part.

        StudyError under arc control, where no load is given that could be held.
        """
        if self.follower is not None:
            raise StudyError("sensitivities: under arc control the load is an unknown; prescribe the displacement of the end instead")
        one_way, places = self.settings.coupling == "one-way", moving(asked.names, load_rates)
        if 0 < len(places) < len(asked.names):
            asked, load_rates = asked.of(places), load_rates[:, places]
        rates = condition_rates(parameters, asked.names, self.law if one_way else None)
        rates = rates.on_sets(tuple(self.body.films), tuple(self.settings.films))
        self.rates = self.differentiator(self.body, self.law, parameters, rates, asked, one_way=one_way)
        self.load_rates = np.zeros((len(load_rates), self.rates.m))
        self.load_rates[:, : load_rates.shape[1]] = load_rates / self.factor

    def load(self, t: float) -> float:
        """Load of the model at time t: its share of the force, the displacement, or the arc length."""
        return self.loading.at(t) / self.factor + self.rest_displacement

    def initial(self, t: float) -> State:
        """Equilibrium at the steady temperature of the resting specimen (5.2.2)."""
        body = self.body
        u = np.zeros((body.mesh.n_nodes, 3))
        geometry = thermal_geometry(body, u)
        theta = steady_temperature(body, geometry, self.conditions)
        self.resting_temperature = theta
        from_rest = self.loading.control == "displacement" and self.loading.from_rest
        if from_rest:
            self.rest_displacement = self.law.alpha_exp * float(volume_mean(body, theta - self.law.theta_ref)) * self.length
        load = self.load(t)
        virgin = virgin_state(body.mesh.n_elements, axes_about_z(self.settings.material_angle), structure=self.structured)
        found = self.solver.solve(u, theta, virgin, load if self.follower is None else 0.0)
        state = State(t, load, found.u, theta, found.state, found.dilatation, thermal_geometry(body, found.u), found.top_force)
        if self.rates is None:
            return state
        self.rates.rest(theta, geometry, self.conditions, self.length, from_rest)
        load_rates = self.loading.between(self.load_rates, t)
        return replace(state, rates=self.rates.initial(self._linearised(found, theta, virgin), load_rates))

    def advance(self, start: State, past: tuple[Passed, ...], t: float, depth: int) -> tuple[State, Balance]:
        """One step to time t; bisected where it fails."""
        try:
            return self._step(start, past, t)
        except NumericsError as err:
            self.solver.forget()
            if depth >= self.settings.max_cuts:
                advice = self._advice(start, t)
                raise NumericsError(f"time step to t = {t:.4g} s failed after {depth} bisections ({err}); {advice}") from err
        self.cuts += 1
        if self.cuts > self.steps + self.settings.all_cuts:
            raise NumericsError(
                f"{self.cuts} bisections in {self.steps} steps to t = {t:.4g} s, expected one for every step and {self.settings.all_cuts} "
                "besides at most: with these parameters there is hardly a solution; check them, the loads and the starts"
            )
        middle, first = self.advance(start, past, 0.5 * (start.time + t), depth + 1)
        end, second = self.advance(middle, (passed(start), *past[:1]), t, depth + 1)
        return end, added(first, second)

    def _advice(self, start: State, t: float) -> str:
        """What to do about a step from `start` to t that fails however short it is."""
        if self.loading.control != "force" or abs(self.load(t)) <= abs(start.top_force) or not np.any(start.points[:, :, LAMBDA]):
            return "check loads and starts, or allow smaller steps"
        return (
            f"the maximum force reached is {start.top_force * self.body.symmetry:.5g} N: if that is the load maximum of the specimen, no "
            "larger force is in equilibrium; prescribe the displacement of the end (or the arc length) instead"
        )

    def energy(self, state: State) -> float:
        """Internal energy of the specimen, mJ, nan where it is not kept; the heat capacity is that of the heat equation."""
        if not self.settings.keep_energy:
            return float("nan")
        law = self.law._replace(c0=self.conditions.c0)
        return self.body.symmetry * internal_energy_of(self.body.data, state.u, state.theta, state.points, state.dilatation, law)

    def collect(self, n: int, state: State) -> None:
        """Hand the derivatives of recorded time n to whoever asked for them."""
        if self.rates is not None and state.rates is not None:
            self.rates.collect(n, state.rates)

    def counts(self, steps: int) -> dict[str, int]:
        """What the run cost."""
        return {
            "steps": steps,
            "newton_iterations": self.iterations,
            "factorisations": self.solver.factorisations,
            "element_passes": self.solver.passes,
            "bisections": self.cuts,
            "solver_changes": self.body.mechanical.fallbacks.total() + self.body.thermal.fallbacks.total() - self.fallbacks,
            **({} if self.rates is None else {"sensitivity_sweeps": self.rates.sweeps}),
        }

    def _step(self, start: State, past: tuple[Passed, ...], t: float) -> tuple[State, Balance]:
        load = self.load(t)
        self.solver.law = law_in_step(self.law, t - start.time)
        u, theta, fresh = predicted(self.body, start, past, t, load)
        heat = HeatOfStep(self.body, self.law, self.conditions, start, (t, self.settings.heat_scheme))
        if self.follower is not None:
            found = self._along_path(self.follower, theta, start, load, heat)
        elif self.settings.coupling == "one-way":
            theta = self.resting_temperature
            found = self._mechanics(u, theta, start, past, load, fresh)
            heat.solve(found.u, found.state, found.dilatation, start.theta)
        else:
            found = self._mechanics(u, theta, start, past, load, fresh, heat)
        state, balance = heat.finish(found, load)
        if self.rates is None or start.rates is None:
            return state, balance
        theta = self.resting_temperature if self.settings.coupling == "one-way" else state.theta
        load_rates = self.loading.between(self.load_rates, t)
        here, ends = self._linearised(found, theta, start.points), heat.ends(found)
        try:
            rates = self.rates.step(start.rates, here, ends, load_rates)
        except NumericsError:
            # A specimen that has stopped to flow, or barely flows, may be far from where the factor at hand was formed. A smaller step
            # would be as far.
            if not here.kept:
                raise
            rates = self.rates.step(start.rates, self._linearised(found, theta, start.points, kept=False), ends, load_rates)
        return replace(state, rates=rates), balance

    def _mechanics(
        self,
        u: np.ndarray,
        theta: np.ndarray,
        start: State,
        past: tuple[Passed, ...],
        load: float,
        fresh: bool,
        heat: HeatOfStep | None = None,
    ) -> Equilibrium:
        """Equilibrium from the guess u, where that leads nowhere from those of `_guesses`. Coupled if `heat` is given."""
        thermal = None if heat is None else (heat, self.settings.coupling_tolerance)
        before = start.theta if heat is not None else theta
        tried = [(guess, before, True) for guess in self._guesses(start, past, before, load)]
        if not (fresh and u is start.u):
            tried.insert(0, (lambda: u, theta, fresh))
        for number, (guess, warm, anew) in enumerate(tried, start=1):
            try:
                found = self.solver.solve(guess(), warm, start.points, load, fresh=anew, thermal=thermal)
                break
            except NumericsError:
                if number == len(tried):
                    raise
        self.iterations += found.iterations
        return found

    def _guesses(self, start: State, past: tuple[Passed, ...], theta: np.ndarray, load: float) -> list[Callable[[], np.ndarray]]:
        """Where equilibrium under a load is sought if an extrapolation leads nowhere: at the start of the step, or from the elastic answer
        to the load. The last helps where overstress relaxes as the load turns: the tangent is then that of flow, the answer elastic.

        A body whose end is displaced would leave the whole jump to its last layer of elements. It goes on as in the step before, where it
        has moved in the same sense, or begins with the answer of the tangent."""

        def answer() -> np.ndarray:
            return self.solver.answer(start.u, theta, start.points, load - start.load)

        def elastic() -> np.ndarray:
            law = self.solver.law
            self.solver.law = law._replace(plastic=0)
            try:
                return self.solver.solve(begin(), theta, start.points, load, fresh=True).u
            finally:
                self.solver.law = law
                self.solver.forget()

        begin = answer if self.body.top < 0 else lambda: start.u
        goes_on = self.body.top < 0 and bool(past) and (start.load - past[0].load) * (load - start.load) > 0.0
        along: list[Callable[[], np.ndarray]] = [lambda: onwards(start, past[0], load)] if goes_on else []
        return [*along, begin, *([elastic] if self.law.effective == 1 else [])]

    def _along_path(self, follower: PathFollower, theta: np.ndarray, start: State, load: float, heat: HeatOfStep) -> Equilibrium:
        """Equilibrium at an arc length from the start of the step; both fields in turn until the temperature stands still."""
        here = PathPoint(start.u, start.top_force, start.direction)
        one_way = self.settings.coupling == "one-way"
        theta = self.resting_temperature if one_way else theta
        for _ in range(self.settings.max_coupling):
            found = follower.follow(here, theta, start.points, load - start.load)
            self.iterations += found.iterations
            after = heat.solve(found.u, found.state, found.dilatation, start.theta if one_way else theta)
            change = float(np.max(np.abs(after - theta)))
            if one_way or change <= self.settings.coupling_tolerance:
                return found
            theta = after
        raise NumericsError(f"coupling: temperature still changes by {change:.1e} K after {self.settings.max_coupling} sweeps")

    def _linearised(self, found: Equilibrium, theta: np.ndarray, before: np.ndarray, kept: bool = True) -> LinearisedStep:
        """The tangent of a converged step under force control: elastic steps in a row share one factor, since their stiffness hardly
        changes, until one of them had to mend its answers; a factor with which equilibrium was just found at once is good enough;
        otherwise, and where none may be `kept`, a fresh one.
        """
        flows = bool(np.any(found.state[:, :, LAMBDA] > before[:, :, LAMBDA]))
        here = LinearisedStep(found.u, theta, before, found.state)
        if self.body.top >= 0 and kept:
            worn = self.rates is not None and self.rates.mended
            at_hand = self.solver.good_factor() if flows else None if worn else self.elastic
            if at_hand is not None:
                return replace(here, factor=at_hand, kept=True)
        factor, stiffness = self.solver.linearise(found.u, theta, before)
        self.elastic = None if flows else factor
        return replace(here, factor=factor, stiffness=stiffness)
