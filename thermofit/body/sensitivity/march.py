"""Sensitivities of a march by direct differentiation: du/dp, dtheta/dp and dF/dp of every step, exact for the discrete equations.

After each converged step the equations of both fields are differentiated along all asked-for parameters at once, through the
history variables (M. Kleiber et al., Parameter Sensitivity in Nonlinear Mechanics, 1997):

    K u' = f_ext'(p) - f_int'|_u (theta', s_n', p),      s' = s'(u', s_n', p),
    [c0 M + gamma dt E] theta' = ... (u', u_n', theta_n', h'(s', s_n', theta'), p).

Mechanics and heat alternate as in the march until theta' stands still; the factors are those of the step. A sweep over both ends with
the answer of u' to the change of theta' that it found, and the answer of theta' to that change of volume: of what a sweep leaves, this
is nearly all. Memory holds the rates of two states, whatever the number of steps; what is wanted of a step is taken by the caller's
`collect`.
"""

from __future__ import annotations

import numpy as np

from thermofit.body.body import LOADED, Body, ThermalGeometry
from thermofit.body.element.responses import responses
from thermofit.body.heat.conduction import HeatConditions, expansion_capacity
from thermofit.body.heat.fixed_stress import STRONG, left_of
from thermofit.body.sensitivity.conduction_rates import (
    ConditionRates,
    add_effect_sources,
    heat_answer,
    heat_step_rates,
    steady_rates,
    usual_change,
)
from thermofit.body.sensitivity.heat_rates import (
    WARM,
    PointStateRates,
    SourceSlopes,
    add_dilatation_heat,
    heat_source_rates,
    source_law,
    source_slopes,
)
from thermofit.body.sensitivity.mechanical_rates import add_answer, dilatation_rates, load_rates, thermal_load_rates, update_rates
from thermofit.body.sensitivity.step_rates import LinearisedStep as LinearisedStep
from thermofit.body.sensitivity.step_rates import Rates as Rates
from thermofit.body.sensitivity.step_rates import Sensitivities as Sensitivities
from thermofit.body.sensitivity.step_rates import StepEnds as StepEnds
from thermofit.body.sensitivity.step_rates import StepRates as StepRates
from thermofit.body.solve.extrapolation import lagrange
from thermofit.body.solve.linear import multiply_symmetric
from thermofit.core.errors import NumericsError
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters
from thermofit.law.page import Law, law_in_step, relative
from thermofit.law.page_rates import ALPHA_EXP, ELASTIC, THETA_REF, WARMING, directions, padded
from thermofit.point.lanes_memory import lane_zeros
from thermofit.point.rates import BY_THETA, SHEAR
from thermofit.point.relative_rates import rows_of_response, stiffness_slopes
from thermofit.point.state import LAMBDA, N_FULL, N_STATE

MAX_SWEEPS = 20
MENDINGS = 100
"""Answers after which the rates of the internal forces of a step have to balance. With a factor kept from a step in which other points
flowed each of them leaves up to 0.8 of what was there."""
_RESOLVED = 2e-3
"""Last relative change of theta' that is not worth another solve for u'."""
_FORCE_SHARE = 4e-3
"""Share of the force rates of a direction, per tolerance of theta', that may stay out of balance when its states are differentiated."""
_ELASTIC_SHARE = 2.0
"""So much more where no point flows: u' and J' alone take part in it, and the answer at the end of a sweep mends both."""
_WEAK = 0.05
"""Ratio 9 K alpha^2 theta_0 / c0, about that of metals, at which a sweep lessens what is left some thousand times. Of a larger one less may
be left, by its fourth power: a sweep lessens it by the square at best."""
_STRONG_SHARE = 0.02
"""Share of the tolerance where the ratio is `STRONG`, and both fields agree within each sweep but for what flow makes of it."""
_UNFELT = 1250.0
"""Square of the tolerance, times this, that theta' may be off its guess after a sweep where no history and no source feels it. A body that
expands freely turns no point and shifts none on its yield surface, and the answers of a sweep know of its change of volume. They do so
with the factor at hand: not where a sweep had to be mended more than once with it."""
_LEFT = 1e-3
"""Relative disagreement of both fields, per tolerance, at which the answers of a sweep end there."""
_BORROWED = 0.2
"""Share of the tolerance where the factor is that of an earlier elastic step: its answers are less exact."""
_NEGLIGIBLE = 1e-3
"""K; a parameter whose usual change moves no temperature by more has no temperature to agree on."""
_DIVERGES = 1e4
"""Growth of the rates of forces out of balance, over the least so far, from which mending leads nowhere."""
_ROUND_OFF = 1e-11
"""Forces of round-off, in units of elastic modulus times facet area."""


@kernel
def assemble(equation: np.ndarray, force: np.ndarray, out: np.ndarray) -> None:
    """out (n_eq, m) -= element loads (n_el, 24, m) by equation numbers (n_el, 24); negative numbers are prescribed dofs."""
    for e in range(equation.shape[0]):
        for i in range(equation.shape[1]):
            k = equation[e, i]
            if k >= 0:
                for m in range(out.shape[1]):
                    out[k, m] -= force[e, i, m]


def volume_mean(body: Body, field: np.ndarray) -> np.ndarray:
    """Volume mean of nodal fields (n_np, ...)."""
    p = body.thermal
    weight = multiply_symmetric(p.row, p.column, body.capacity, np.ones(body.mesh.n_nodes))
    return np.asarray(weight @ field / weight.sum())


class Differentiator:
    """Differentiates the steps of one march; holds the buffers of two states."""

    def __init__(
        self, body: Body, law: Law, parameters: Parameters, conditions: ConditionRates, asked: Sensitivities, *, one_way: bool
    ) -> None:
        self.body, self.law, self.conditions, self.asked, self.one_way = body, law, conditions, asked, one_way
        self.along = directions(parameters, asked.names, law)
        self.m = padded(len(asked.names))
        self._sources = source_law(law, self.along)
        n_el = body.mesh.n_elements
        n_state = N_FULL if self.along.structured else N_STATE
        self._states = (lane_zeros((n_el, 8, n_state, self.m)), lane_zeros((n_el, 8, n_state, self.m)))
        self._dilatations = (lane_zeros((n_el, 8, self.m)), lane_zeros((n_el, 8, self.m)))
        self._points, self._dilatation = self._states[0], self._dilatations[0]
        self._clean = True
        self._response = lane_zeros((n_el, rows_of_response(self.along, law), 8))
        self._stiff = np.ones((n_el, 8))
        self._skewed = relative(law)
        self._loads = lane_zeros((n_el, 24, self.m))
        self._warming = lane_zeros((n_el, 24, self.m))
        self._swelling = lane_zeros((n_el, 8, self.m))
        # A body without stress feels a change of its moduli by round-off alone.
        self._facets = float(np.linalg.norm(body.data.volume.sum(axis=1) ** (2.0 / 3.0)))
        self._round_off = _ROUND_OFF * self._facets * np.abs(self.along.numbers[list(ELASTIC)]).sum(axis=0)
        self._softened = np.zeros(self.m)
        top = np.isin(body.mesh.hexes, body.loaded)
        self._top_elements = np.flatnonzero(top.any(axis=1))
        self._top_dofs = top[self._top_elements]
        self.resting = np.zeros((body.mesh.n_nodes, self.m))
        self._pulled = np.argwhere(body.element_equation == body.top)[0] if body.top >= 0 else None
        self._rest_shift = self._load = np.zeros(self.m)
        self.sweeps = 0
        self.mended = False
        self._mendings = 0
        self._exact_forces = False
        self._scale = self._held = self._top_rate = np.zeros(self.m)
        self._parameter_scale = np.ones(self.m)
        self._parameter_scale[: len(asked.names)] = [usual_change(parameters, name) for name in asked.names]
        self._more = expansion_capacity(law)
        self._coupling = self._more / law.c0
        self._strong = self._coupling > STRONG and not one_way
        self._tolerance = asked.tolerance * (_STRONG_SHARE if self._strong else (_WEAK / max(self._coupling, _WEAK)) ** 4)

    def collect(self, n: int, rates: Rates) -> None:
        """Hand the derivatives of recorded time n to the caller."""
        k = len(self.asked.names)
        self.asked.collect(n, StepRates(rates.u[:, :, :k], rates.theta[:, :k], rates.top_force[:k] * self.body.symmetry))

    def rest(self, theta: np.ndarray, geometry: ThermalGeometry, conditions: HeatConditions, length: float, from_rest: bool) -> None:
        """Rates of the steady temperature theta (n_np,) of the resting specimen and of the displacement that it causes."""
        self.resting = np.ascontiguousarray(steady_rates(self.body, geometry, conditions, theta, self.conditions))
        if from_rest:
            law, rates = self.law, self.along.numbers
            warmer = volume_mean(self.body, theta - law.theta_ref)
            warming = volume_mean(self.body, self.resting) - rates[THETA_REF]
            self._rest_shift = length * (rates[ALPHA_EXP] * warmer + law.alpha_exp * warming)

    def initial(self, mechanics: LinearisedStep, load: np.ndarray) -> Rates:
        """Rates of the state at rest under a load with the rates (m,): N on the end of the model, or mm from its resting place."""
        self._load = self._rest_shift + load
        start = self._states[1]
        start[:] = 0.0
        self._respond(mechanics)
        u = self._mechanics(mechanics, start, self.resting)
        points, dilatation = self._update(mechanics, start, self.resting, u)
        return Rates(u, self.resting, points, dilatation, self._top_rate)

    def step(self, start: Rates, mechanics: LinearisedStep, ends: StepEnds, load: np.ndarray) -> Rates:
        """Rates at the end of a step from those at its start, its load with the rates (m,). NumericsError where mechanics and heat do not
        come to agree.

        `mended` tells afterwards whether the factor at hand was so far from that of the step that an answer of it had to be mended.
        """
        self.mended = False
        self._load = self._rest_shift + load
        self.law, self._sources = law_in_step(self.law, ends.step.length), self._sources.in_step(ends.step.length)
        self._respond(mechanics)
        self._take_buffer(start)
        theta = self.resting if self.one_way else self._guess(start, ends.step.length)
        borrowed = mechanics.kept and mechanics.largest_increment == 0.0
        tolerance = self._tolerance * (_BORROWED if borrowed else 1.0)
        u, felt = self._mechanics(mechanics, start.points, theta), theta
        softens = self.along.warms or (mechanics.largest_increment > 0.0 and bool(np.any(self._response[:, BY_THETA])))
        slopes = source_slopes(self.body.data, (ends.before, ends.after), ends.theta, self._sources)
        felt_inside = softens or self._feels(ends, slopes)
        for sweep in range(MAX_SWEEPS):
            self.sweeps += 1
            if sweep > 0 and softens:  # the answer below knows of expansion alone
                u, felt = self._mechanics(mechanics, start.points, theta), theta
            points, dilatation = self._update(mechanics, start.points, theta, u)
            found = self.heat_rates(start, (u, PointStateRates(dilatation, points)), theta, ends, slopes)
            size = self._change(found, theta)
            if self._exact_forces or np.any(size > min(_RESOLVED, tolerance)):
                found, felt = self._agreed(mechanics, ends, (u, dilatation), found, felt)
                size = self._change(found, theta)
            theta = found
            enough = tolerance if felt_inside or self._mendings > 1 else max(tolerance, _UNFELT * self.asked.tolerance**2)
            if np.all(size <= enough):
                self._clean = True
                past = ((ends.step.length, start.theta), *start.past[:1])
                return Rates(u, found, points, dilatation, self._top_rate, past)
        worst = self.asked.names[int(np.argmax(size[: len(self.asked.names)]))]
        raise NumericsError(
            f"sensitivities: temperature and displacement still disagree after {MAX_SWEEPS} sweeps, most for {worst}; use smaller steps"
        )

    def _feels(self, ends: StepEnds, slopes: SourceSlopes) -> bool:
        """Whether the sources of a step feel theta' beside weak expansion."""
        effects = ends.step.conditions.effects
        heated = effects is not None and bool(effects.of("heat_source"))
        return self._coupling > _WEAK or heated or bool(np.any(slopes.dissipation[WARM]))

    def _change(self, found: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Relative change (m,) of theta' (n_np, m); none where theta does not act on the mechanics."""
        if self.one_way:
            return np.zeros(self.m)
        scale = np.maximum(np.abs(found).max(axis=0), _NEGLIGIBLE / self._parameter_scale)
        return np.asarray(np.abs(found - theta).max(axis=0) / scale)

    def _agreed(
        self, mechanics: LinearisedStep, ends: StepEnds, end: tuple[np.ndarray, np.ndarray], found: np.ndarray, felt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """theta' (n_np, m) by the heat equation and that which u' and J' of the end of a step (= end) have followed, after these followed;
        the histories of the points do not. NumericsError where a strong coupling does not come to agree.
        """
        if not self._strong:
            change = np.zeros_like(found) if self.one_way else found - felt
            answer, followed = self._answer(mechanics, ends, end, change)
            return found + answer, felt + followed
        for _ in range(MAX_SWEEPS):
            change = left_of(self.body, ends.step, self._more, found - felt)
            answer, followed = self._answer(mechanics, ends, end, change)
            found, felt = found + answer, felt + followed
            self._loads[:] = 0.0  # what the first answer has balanced
            if np.all(self._change(found, felt) <= _LEFT * self.asked.tolerance):
                return found, felt
        raise NumericsError(
            f"sensitivities: expansion takes {self._coupling:.3g} times the heat that warms the body, and both fields still disagree after "
            f"{MAX_SWEEPS} answers; check alpha_exp and c0"
        )

    def _answer(
        self, mechanics: LinearisedStep, ends: StepEnds, end: tuple[np.ndarray, np.ndarray], change: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """u' and J' of the end of a step (= end) follow a change of theta' (n_np, m); the answer (n_np, m) of theta' to that, and the
        change that they have followed.

        The body swells with theta' and takes heat for it: c0 / (c0 + 9 K alpha^2 theta_0) is left of a change that is even over the body
        and free to expand. The part of the answer that is in proportion to the change goes on as a geometric series; where it is large it
        is left of the change already (`fixed_stress`).
        """
        (u, dilatation), swelling = end, self._swelling
        moved, warming = self._warm(mechanics, change)
        dilatation_rates(self.body.data, mechanics.u, moved, swelling)
        answer = np.zeros_like(change)
        if not self.one_way:
            heat = np.zeros_like(change)
            add_dilatation_heat(self.body.data, ends.after.dilatation, self._stiff, ends.theta[0], self.law, swelling, heat)
            answer = heat_answer(self.body, ends.step, heat)
        back = (answer * change).sum(axis=0) / np.maximum((change * change).sum(axis=0), 1e-300)
        series = np.ones(self.m) if self._strong else 1.0 / (1.0 + np.clip(-back, 0.0, self._coupling))
        u += series * moved
        dilatation += series * swelling
        self._held = self._held + series * warming
        self._top_rate = self._top_rate + series * (warming + self._by_stiffness(mechanics, moved))
        return np.asarray(series * answer), np.asarray(series * change)

    def _take_buffer(self, start: Rates) -> None:
        """The buffers of the new state: those that do not hold its start. Points that never yielded are not written, so that their zeros
        must be true: cleared where a step failed that had begun to fill them."""
        self._points = self._states[1 if start.points is self._states[0] else 0]
        self._dilatation = self._dilatations[1 if start.dilatation is self._dilatations[0] else 0]
        if not self._clean:
            self._points[:] = 0.0
        self._clean = False

    def _guess(self, start: Rates, dt: float) -> np.ndarray:
        """theta' at the end of the step, extrapolated from the last three states at most."""
        times, values = [0.0], [start.theta]
        for length, theta in start.past:
            times.append(times[-1] - length)
            values.append(theta)
        return np.asarray(sum(w * v for w, v in zip(lagrange(times, dt), values, strict=True)))

    def _respond(self, mechanics: LinearisedStep) -> None:
        states = (mechanics.before, mechanics.after)
        responses(self.body.data, (mechanics.u, mechanics.theta), states, self.law, self.along, self._response)
        if self._skewed:
            self._stiff[:] = self._response[:, SHEAR] / self.law.mu
        if np.isin(self.along.in_structure, WARMING).any():
            moduli = _ROUND_OFF * self._facets * (self.law.lame + self.law.mu + self.law.bulk)
            largest = np.abs(stiffness_slopes(self._response, self.along)).max(axis=(0, 2))
            self._softened = moduli * (largest @ np.abs(self.along.numbers[self.along.in_structure]))

    def _mechanics(self, mechanics: LinearisedStep, points_n: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """u' (n_np, 3, m) for given theta' and rates of the old state."""
        body, states = self.body, (mechanics.before, mechanics.after)
        load_rates(body.data, mechanics.u, states, self.law, self.along, self._response, points_n, theta, self._loads)
        u = np.zeros((body.mesh.n_nodes, 3, self.m))
        u[body.equation == LOADED] = self._load
        self._held = self._on_top(self._loads) if body.top < 0 else self._load
        self._pull()
        if body.top < 0 and np.any(self._load):
            e = self._top_elements
            self._loads[e] += np.einsum("eij,ejm->eim", mechanics.elements(e), u[body.mesh.hexes[e]].reshape(len(e), 24, self.m))
        self._scale = self._add_answer(mechanics, self._loads, u)
        return u

    def _update(self, mechanics: LinearisedStep, points_n: np.ndarray, theta: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates of points and J for u', which is mended where it leaves the rates of the internal forces out of balance.

        Where points flow the stiffness at hand is the symmetric neighbour of the exact one, off by some 4e-4 dLambda, or one
        of another state. Little as that is, the body answers softly along its axis: left alone it grows to 5 % of a rate in 60 steps.
        NumericsError where mending does not help.
        """
        body, states = self.body, (mechanics.before, mechanics.after)
        elastic = mechanics.largest_increment == 0.0
        keeps = elastic and not self.along.warms  # then the states keep their rates, but for that of tr C_el
        points, dilatation = points_n if keeps else self._points, self._dilatation
        allowed = _FORCE_SHARE * self._tolerance
        forces = self._exact_forces = mechanics.kept or mechanics.largest_increment > 0.0
        if elastic:
            allowed *= _ELASTIC_SHARE
        least = np.inf
        for self._mendings in range(MENDINGS):
            rates = (u, points_n, theta)
            update_rates(
                body.data, mechanics.u, states, self.law, self.along, self._response, rates, points, dilatation, forces, self._loads
            )
            if not forces:
                self._top_rate = self._held + self._by_stiffness(mechanics, u)
                return points, dilatation
            top = self._on_top(self._loads) if body.top < 0 else self._load
            self._pull()
            within = allowed * self._scale + self._round_off + self._softened
            over = self._unbalanced() / np.maximum(within, np.finfo(float).tiny)
            if np.all(over <= 1.0):
                self._top_rate = top
                return points, dilatation
            if over.max() > _DIVERGES * least:
                break
            least = min(least, float(over.max()))
            self._add_answer(mechanics, self._loads, u)
            self.mended = True
        raise NumericsError("sensitivities: the tangent of the converged step is too far from the exact one; use smaller steps")

    def _pull(self) -> None:
        """Take the rates of a prescribed force off the element loads, at one place of the loaded end."""
        if self._pulled is not None:
            element, row = self._pulled
            self._loads[element, row] -= self._load

    def _unbalanced(self) -> np.ndarray:
        """Norm (m,) of the rates of the internal forces at free dofs, which equilibrium wants to vanish."""
        right = np.zeros((self.body.n_equations, self.m))
        assemble(self.body.element_equation, self._loads, right)
        return np.asarray(np.sqrt(np.einsum("em,em->m", right, right)))

    def _add_answer(self, mechanics: LinearisedStep, loads: np.ndarray, u: np.ndarray) -> np.ndarray:
        """u (n_np, 3, m) += K^-1 of minus the element loads (n_el, 24, m); returns the norm (m,) of the nodal loads."""
        body = self.body
        right = np.zeros((body.n_equations, self.m))
        assemble(body.element_equation, loads, right)
        x = mechanics.solve(right)
        add_answer(body.equation, x, u)
        return np.asarray(np.sqrt(np.einsum("em,em->m", right, right)))

    def _warm(self, mechanics: LinearisedStep, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change of u' (n_np, 3, m) by one of theta' (n_np, m) and by what `_update` has left of the force rates, states held; and what the
        change of theta' adds to the rate of the force on the end at fixed u', (m,)."""
        thermal_load_rates(self.body.data, mechanics.u, self._response, change, self._warming)
        warming = self._on_top(self._warming)
        if self._exact_forces:
            self._loads += self._warming
        else:
            self._loads[:] = self._warming
        moved = np.zeros((self.body.mesh.n_nodes, 3, self.m))
        self._scale = np.maximum(self._scale, self._add_answer(mechanics, self._loads, moved))
        return moved, warming

    def _on_top(self, loads: np.ndarray) -> np.ndarray:
        """Part (m,) of element loads (n_el, 24, m) that pulls on the loaded end along y; zero where a force is prescribed."""
        if self.body.top >= 0:
            return np.zeros(self.m)
        e = self._top_elements
        return np.asarray(loads[e].reshape(len(e), 8, 3, self.m)[self._top_dofs][:, 1].sum(axis=0))

    def _by_stiffness(self, mechanics: LinearisedStep, u: np.ndarray) -> np.ndarray:
        """The same part of K u' (n_np, 3, m)."""
        if self.body.top >= 0:
            return np.zeros(self.m)
        e = self._top_elements
        nodal = np.einsum("eij,ejm->eim", mechanics.elements(e), u[self.body.mesh.hexes[e]].reshape(len(e), 24, self.m))
        return np.asarray(nodal.reshape(len(e), 8, 3, self.m)[self._top_dofs][:, 1].sum(axis=0))

    def heat_rates(
        self, start: Rates, moved: tuple[np.ndarray, PointStateRates], theta: np.ndarray, ends: StepEnds, slopes: SourceSlopes
    ) -> np.ndarray:
        """theta' (n_np, m) at the end of the step by the differentiated heat equation; `moved` are u' and the rates of the points there,
        theta is the estimate so far."""
        u, end = moved
        middle_rates = start.theta if self.one_way else 0.5 * (start.theta + theta)
        heat, rates = np.zeros((self.body.mesh.n_nodes, self.m)), (PointStateRates(start.dilatation, start.points), end)
        temperatures = ((ends.theta[0], middle_rates), (ends.theta[1], start.theta))
        heat_source_rates(self.body.data, slopes, rates, temperatures, self._sources, heat)
        motion, conditions = ((ends.u[0], start.u), (ends.u[1], u)), self.conditions.about(middle_rates)
        accumulated = ((ends.before.accumulated, ends.after.accumulated), (start.points[:, :, LAMBDA], end.state[:, :, LAMBDA]))
        add_effect_sources(self.body, ends.step, conditions, *accumulated, heat)
        return np.ascontiguousarray(heat_step_rates(self.body, ends.step, start.theta, heat, conditions, motion))
