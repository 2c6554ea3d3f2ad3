"""Heat of an increment, and its rates, where effects change the local update itself (law.structure): all that comes to `heat.equation`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from thermofit.body.element.hex8 import ElementData
from thermofit.body.heat.equation import PointStates, at_points
from thermofit.body.sensitivity.lanes import add_lanes, copy_lanes
from thermofit.core.jit import kernel
from thermofit.law.backstress import recalled_energy
from thermofit.law.composition import asymmetry_factor, backstress_terms, modulus_factor, warm_moduli
from thermofit.law.page import Law, is_transformed, thermoelastic_heat
from thermofit.law.page_rates import FLOWED, LANES, STEP, generic
from thermofit.law.structure import asymmetry_heat, degradation_heat, energy_slope
from thermofit.point.state import ALPHA, BACK, LAMBDA, N_BACK, N_STATE, SENSE, TRACE
from thermofit.point.surface_norm import in_surface, surface_curved, surface_gradients, surface_number_slopes

Complex = Any
_LOG_J_N, _LOG_J, _ALPHA, _LAMBDA_N, _D_LAMBDA, _WARM, _WARM_N, _TRACE_N, _TRACE, _SENSE = range(10)
"""Arguments of the heat of an increment that are moved to differentiate it."""
_HILL_WEIGHTS = ((0, 1, 1.0), (2, 0, 1.0), (1, 2, 1.0), (3, 3, 2.0), (4, 4, 2.0), (5, 5, 2.0))
"""Of F, G, H, L, M, N: the components whose difference, or which alone, it weights in Y : G : Y, and how often."""
_TWICE = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""How often a component stands in a contraction."""


class PointChange(NamedTuple):
    """Change of all points over one increment, each (n_el, 8): ln J at both ends, alpha at the end, Lambda at the start, dLambda, tr C_el
    at both ends and the sense of flow at the end; of each backstress (N_BACK, n_el, 8) the squares Y_n : G : Y_n, Y_n : G : Y and
    Y : G : Y, of another surface what takes their place in `law.backstress.recalled_energy`."""

    log_j_n: np.ndarray
    log_j: np.ndarray
    alpha: np.ndarray
    accumulated_n: np.ndarray
    d_lambda: np.ndarray
    trace_n: np.ndarray
    trace: np.ndarray
    sense: np.ndarray
    before: np.ndarray
    across: np.ndarray
    after: np.ndarray


def change_between(start: PointStates, end: PointStates, theta: np.ndarray, law: Law) -> PointChange:
    """Change from one state of all points to another; both hold their structure. theta (n_el, 8) K is that of the middle."""
    at = TRACE - N_STATE, SENSE - N_STATE
    trace, sense = (np.ascontiguousarray(end.structure[:, :, k]) for k in at)
    trace_n = np.ascontiguousarray(start.structure[:, :, at[0]])
    change = PointChange(
        np.log(start.dilatation), np.log(end.dilatation), end.alpha, start.accumulated, end.accumulated - start.accumulated,
        trace_n, trace, sense, np.empty((0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0, 0)),
    )  # fmt: skip
    if not is_transformed(law):
        before, across, after = _hill_squares(start.structure, end.structure, BACK - N_STATE, law)
        return change._replace(before=before, across=across, after=after)
    y_n, y = _backs(start), _backs(end)
    # The work of X along N is C [Y_n : phi N (Y - kept Y_n) + dLambda^2 psi], since N is that of Y - kept Y_n; what is stored grows by
    # C (phi(Y)^2 - phi(Y_n)^2) / 2. `before` is chosen so that the derivative by kept is right as well.
    kept = _terms(change, theta, law)[1]
    w = y - kept[..., None] * y_n
    before = _contracted(y_n, _on_points(surface_curved, law, w, y_n))
    across = _contracted(y_n, _on_points(surface_gradients, law, w)) + kept * before
    return change._replace(before=before, across=across, after=_squared(y, law) - _squared(y_n, law) + before)


def _terms(change: PointChange, theta: np.ndarray, law: Law) -> np.ndarray:
    """C and exp(-gamma dLambda) of every backstress (2, N_BACK, n_el, 8)."""
    terms = np.empty((2, N_BACK, *theta.shape))
    _terms_of_points(change, theta, law, terms)
    return terms


def _on_points(function: Callable[..., np.ndarray], law: Law, *tensors: np.ndarray) -> np.ndarray:
    """A function of tensors (n, 8, 6) of those of all backstresses (N_BACK, n_el, 8, 6)."""
    found = function(*(np.ascontiguousarray(t).reshape(-1, 8, 6) for t in tensors), law)
    return found.reshape(*tensors[0].shape[:3], *found.shape[2:])


def _squared(y: np.ndarray, law: Law) -> np.ndarray:
    """phi^2 of all backstresses."""
    return _on_points(in_surface, law, y)


def _contracted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """x : y of tensors (..., 6)."""
    return np.asarray((x * _TWICE * y).sum(axis=-1))


def _backs(points: PointStates) -> np.ndarray:
    """Y of all backstresses (N_BACK, n_el, 8, 6)."""
    y = points.structure[:, :, BACK - N_STATE :]
    return np.ascontiguousarray(np.moveaxis(y.reshape(*y.shape[:2], N_BACK, 6), 2, 0))


def _hill_weights(law: Law) -> tuple[float, ...]:
    return (law.F, law.G, law.H, law.L, law.M, law.N)


def _part(y: np.ndarray, a: int, b: int) -> np.ndarray:
    """Difference of two components, or one alone where both are the same."""
    return np.asarray(y[..., a] - y[..., b] if a != b else y[..., a])


def _hill_squares(before: np.ndarray, after: np.ndarray, first: int, law: Law) -> np.ndarray:
    """Y_n : G : Y_n, Y_n : G : Y and Y : G : Y of all backstresses (3, N_BACK, n_el, 8); the numbers of a point (n_el, 8, n) hold Y from
    `first` on."""
    out = np.empty((3, N_BACK, *before.shape[:2]))
    _square_in_hill(np.ascontiguousarray(before), np.ascontiguousarray(after), first, law, out)
    return out


@kernel
def _square_in_hill(before: np.ndarray, after: np.ndarray, first: int, law: Law, out: np.ndarray) -> None:
    y_n, y = np.zeros(6), np.zeros(6)
    for e in range(before.shape[0]):
        for q in range(before.shape[1]):
            for i in range(N_BACK):
                for k in range(6):
                    y_n[k], y[k] = before[e, q, first + 6 * i + k], after[e, q, first + 6 * i + k]
                out[0, i, e, q] = _in_hill(y_n, y_n, law)
                out[1, i, e, q] = _in_hill(y_n, y, law)
                out[2, i, e, q] = _in_hill(y, y, law)


@kernel(forceinline=True)
def _in_hill(x: np.ndarray, y: np.ndarray, law: Law) -> float:
    """x : G : y of tensors (6,), `_HILL_WEIGHTS`."""
    normal = law.F * (x[0] - x[1]) * (y[0] - y[1]) + law.G * (x[2] - x[0]) * (y[2] - y[0]) + law.H * (x[1] - x[2]) * (y[1] - y[2])
    return float(normal + 2.0 * (law.L * x[3] * y[3] + law.M * x[4] * y[4] + law.N * x[5] * y[5]))


def _hill_of(y: np.ndarray, law: Law) -> np.ndarray:
    """Gradient of x : G : y by the components of x, (..., 6): an off-diagonal one stands for both of its entries."""
    out = np.zeros_like(y)
    for w, (a, b, n) in zip(_hill_weights(law), _HILL_WEIGHTS, strict=True):
        part = w * n * _part(y, a, b)
        out[..., a] += part
        if a != b:
            out[..., b] -= part
    return out


@kernel(forceinline=True)
def _heat_at(
    log_j_n: float,
    log_j: float,
    alpha: float,
    accumulated_n: float,
    d_lambda: float,
    theta: float,
    theta_n: float,
    trace_n: float,
    trace: float,
    sense: float,
    squares: tuple[np.ndarray, np.ndarray, np.ndarray],
    e: int,
    q: int,
    law: Law,
) -> tuple[float, float]:
    """Dissipated and thermoelastic heat of a point, mJ/mm^3, beside those of `heat.equation`; theta K is that of the middle."""
    accumulated = accumulated_n + d_lambda
    stiff_n, stiff = modulus_factor(accumulated_n, theta, law), modulus_factor(accumulated, theta, law)
    g_n, g = log_j_n / np.exp(log_j_n), log_j / np.exp(log_j)
    elastic = thermoelastic_heat(theta, (stiff_n - 1.0) * g_n, (stiff - 1.0) * g, law)
    if warm_moduli(law):
        slope_n = energy_slope(trace_n, log_j_n, accumulated_n, theta_n, law)
        slope = energy_slope(trace, log_j, accumulated, 2.0 * theta - theta_n, law)
        elastic = theta * (slope - slope_n) - thermoelastic_heat(theta, g_n, g, law)
    dissipated = 0.0 * elastic
    if d_lambda.real > 0.0:
        dissipated += degradation_heat(stiff_n - stiff, trace, log_j, g, theta, law)
        factor = asymmetry_factor(sense, law)
        if factor != 1.0:
            dissipated += asymmetry_heat(factor, alpha, accumulated, d_lambda, theta, law)
        terms = backstress_terms(accumulated, d_lambda * law.per_second, theta, law)
        for i in range(N_BACK):
            if terms[i][0] != 0.0:
                before, across, after = squares[0][i, e, q], squares[1][i, e, q], squares[2][i, e, q]
                dissipated += recalled_energy(before, across, after, d_lambda, terms[i][0], terms[i][1])
    return dissipated, elastic


@kernel
def _heats(change: PointChange, theta: np.ndarray, theta_n: np.ndarray, law: Law, dissipated: np.ndarray, elastic: np.ndarray) -> None:
    squares = (change.before, change.across, change.after)
    for e in range(theta.shape[0]):
        for q in range(8):
            dissipated[e, q], elastic[e, q] = _heat_at(
                change.log_j_n[e, q], change.log_j[e, q], change.alpha[e, q], change.accumulated_n[e, q], change.d_lambda[e, q],
                theta[e, q], theta_n[e, q], change.trace_n[e, q], change.trace[e, q], change.sense[e, q], squares, e, q, law,
            )  # fmt: skip


@kernel
def _differentiate(change: PointChange, theta: np.ndarray, theta_n: np.ndarray, argument: int, law: Law, out: np.ndarray) -> None:
    """Derivative of the heat of every point by one argument, or by the number of the law that is moved (argument < 0)."""
    h, squares = np.zeros(10), (change.before, change.across, change.after)
    if argument >= 0:
        h[argument] = STEP
    for e in range(theta.shape[0]):
        for q in range(8):
            log_j_n: Complex = complex(change.log_j_n[e, q], h[_LOG_J_N])
            log_j: Complex = complex(change.log_j[e, q], h[_LOG_J])
            alpha: Complex = complex(change.alpha[e, q], h[_ALPHA])
            lambda_n: Complex = complex(change.accumulated_n[e, q], h[_LAMBDA_N])
            d_lambda: Complex = complex(change.d_lambda[e, q], h[_D_LAMBDA])
            warm: Complex = complex(theta[e, q], h[_WARM])
            warm_n: Complex = complex(theta_n[e, q], h[_WARM_N])
            trace_n: Complex = complex(change.trace_n[e, q], h[_TRACE_N])
            trace: Complex = complex(change.trace[e, q], h[_TRACE])
            sense: Complex = complex(change.sense[e, q], h[_SENSE])
            dissipated, elastic = _heat_at(
                log_j_n, log_j, alpha, lambda_n, d_lambda, warm, warm_n, trace_n, trace, sense, squares, e, q, law
            )
            released: Complex = dissipated + elastic
            out[e, q] = released.imag / STEP


@kernel
def _terms_of_points(change: PointChange, theta: np.ndarray, law: Law, out: np.ndarray) -> None:
    """C and exp(-gamma dLambda) of every backstress into out (2, N_BACK, n_el, 8)."""
    for e in range(theta.shape[0]):
        for q in range(8):
            d_lambda = change.d_lambda[e, q]
            terms = backstress_terms(change.accumulated_n[e, q] + d_lambda, d_lambda * law.per_second, theta[e, q], law)
            for i in range(N_BACK):
                out[0, i, e, q], out[1, i, e, q] = terms[i][0], np.exp(-terms[i][1] * d_lambda)


def stored_squares(state: np.ndarray, law: Law) -> np.ndarray:
    """Twice the energy that each backstress stores over its modulus, (N_BACK, n_el, 8), at states (n_el, 8, N_FULL)."""
    if not is_transformed(law):
        return _hill_squares(state, state, BACK, law)[2]
    return _squared(np.ascontiguousarray(np.moveaxis(state[:, :, BACK:].reshape(*state.shape[:2], N_BACK, 6), 2, 0)), law)


def structure_heat(
    data: ElementData, start: PointStates, end: PointStates, theta: np.ndarray, theta_n: np.ndarray, law: Law, out: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Nodal heat of an increment beside `heat_of_increment`, added to out (n_np,), mJ; the same arguments, theta (n_np,) K, that of the
    middle of the increment, and theta_n (n_np,) at its start. At its end it is 2 theta - theta_n.

    Returns what is dissipated at every point (n_el, 8) in mJ/mm^3, and the totals (dissipated, thermoelastic) in mJ.
    """
    dissipated, elastic = np.empty(end.alpha.shape), np.empty(end.alpha.shape)
    warm, warm_n = at_points(data, theta), at_points(data, theta_n)
    _heats(change_between(start, end, warm, law), warm, warm_n, law, dissipated, elastic)
    nodal = (data.volume * (dissipated + elastic)) @ data.shape
    np.add.at(out, data.hexes, nodal)
    return dissipated, float((data.volume * dissipated).sum()), float((data.volume * elastic).sum())


class StructureSlopes(NamedTuple):
    """Derivatives of that heat at all points: by state numbers at start and end of the increment (n_state, n_el, 8), whose places are
    `start_places` and `end_places`; by J at both ends, by theta in the middle and at the start, each (n_el, 8), and by numbers of the law
    (n, n_el, 8)."""

    start: np.ndarray
    end: np.ndarray
    by_j: tuple[np.ndarray, np.ndarray]
    by_theta: tuple[np.ndarray, np.ndarray]
    by_numbers: np.ndarray


START_PLACES = np.array([LAMBDA, TRACE, *range(BACK, BACK + 6 * N_BACK)])
END_PLACES = np.array([LAMBDA, ALPHA, TRACE, SENSE, *range(BACK, BACK + 6 * N_BACK)])
"""Places in a state that the rows of `StructureSlopes.start` and `.end` stand for."""


class Felt(NamedTuple):
    """What the heat depends on: arguments of `_heat_at` by their places, and which (n,) of the numbers that are moved."""

    arguments: tuple[int, ...]
    numbers: np.ndarray


def felt_by_heat(moved: tuple[Law, ...]) -> Felt:
    """Felt of the law with no number moved by i h, then with each of several: what matters at any of several general points. Of what is
    not felt there no derivative has to be made, point by point and step by step."""
    points = FLOWED.reshape(-1, 8)
    square = tuple(np.stack([share * points**2] * N_BACK) for share in (0.31, 0.47, 0.83))
    change = PointChange(
        0.0011 + 0.0 * points, 0.0017 + 0.0 * points, 0.036 * points, 0.017 * points, 0.007 * points, 3.003 + 0.0 * points,
        3.005 + 0.0 * points, -0.3 + 0.0 * points, *square,
    )  # fmt: skip
    warm, warm_n, out = 297.3 + 0.0 * points, 296.1 + 0.0 * points, np.empty_like(points)

    def matters(law: Law, argument: int) -> bool:
        _differentiate(change, warm, warm_n, argument, generic(law, 297.3), out)
        return bool(np.any(out != 0.0))

    arguments = tuple(k for k in range(10) if matters(moved[0], k))
    return Felt(arguments, np.array([matters(law, -1) for law in moved[1:]], dtype=bool))


def structure_slopes(
    start: PointStates,
    end: PointStates,
    theta: np.ndarray,
    theta_n: np.ndarray,
    law: Law,
    moved: tuple[Law, ...],
    of_surface: tuple[int, ...],
    arguments: tuple[int, ...],
    moving: bool,
) -> StructureSlopes:
    """StructureSlopes of an increment, theta and theta_n (n_el, 8) K at the points in its middle and at its start.

    `moved` is the law with no number moved by i h, then with each of those that are differentiated beside those of the yield surface, which
    come first: those of Hill's tensor, or of a transformed one, by their places `of_surface`. `arguments`: those that the heat depends on
    (`Felt`), none where no effect is on but only asked for. Where the points are not `moving` states and J have no derivatives.
    """
    change, shape = change_between(start, end, theta, law), theta.shape
    by = np.zeros((10, *shape))
    for argument in arguments if moving else set(arguments) & {_WARM, _WARM_N}:
        _differentiate(change, theta, theta_n, argument, moved[0], by[argument])
    numbers = np.zeros((len(of_surface) + len(moved) - 1, *shape))
    for n, there in enumerate(moved[1:], start=len(of_surface)):
        _differentiate(change, theta, theta_n, -1, there, numbers[n])
    at_start, at_end = np.zeros((len(START_PLACES), *shape)), np.zeros((len(END_PLACES), *shape))
    if arguments and (moving or of_surface):
        terms = _terms(change, theta, law)
        recall = _Recall(_backs(start), _backs(end), np.where(change.d_lambda > 0.0, terms[0], 0.0), terms[1], law)
        transformed = is_transformed(law)
        for n, which in enumerate(of_surface):
            numbers[n] = recall.by_number(which) if transformed else recall.by_number_of_hill(which)
        if moving:
            by_old, by_new = recall.by_backs() if transformed else recall.by_backs_in_hill()
            at_start[2:] = np.moveaxis(by_old, 3, 1).reshape(-1, *shape)
            at_end[4:] = np.moveaxis(by_new, 3, 1).reshape(-1, *shape)
    at_start[0], at_start[1] = by[_LAMBDA_N] - by[_D_LAMBDA], by[_TRACE_N]
    at_end[0], at_end[1], at_end[2], at_end[3] = by[_D_LAMBDA], by[_ALPHA], by[_TRACE], by[_SENSE]
    by_j = (by[_LOG_J_N] / start.dilatation, by[_LOG_J] / end.dilatation)
    return StructureSlopes(at_start, at_end, by_j, (by[_WARM], by[_WARM_N]), numbers)


class _Recall(NamedTuple):
    """The heat of recall of all backstresses: Y_n and Y (N_BACK, n_el, 8, 6), their moduli C, zero where nothing flows, and
    kept = exp(-gamma dLambda), both (N_BACK, n_el, 8). It is

        C [Y_n : G : Y - kept Y_n : G : Y_n - (Y : G : Y - Y_n : G : Y_n) / 2],

    of another surface C [Y_n : phi N (W) - (phi(Y)^2 - phi(Y_n)^2) / 2] with W = Y - kept Y_n."""

    y_n: np.ndarray
    y: np.ndarray
    modulus: np.ndarray
    kept: np.ndarray
    law: Law

    def by_backs_in_hill(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (N_BACK, n_el, 8, 6) by the components of Y_n and of Y."""
        g_n, g = _hill_of(self.y_n, self.law), _hill_of(self.y, self.law)
        return self.modulus[..., None] * (g + (1.0 - 2.0 * self.kept)[..., None] * g_n), self.modulus[..., None] * (g_n - g)

    def by_number_of_hill(self, which: int) -> np.ndarray:
        """Derivative (n_el, 8) by one of F, G, H, L, M, N."""
        a, b, n = _HILL_WEIGHTS[which]
        x, z = _part(self.y_n, a, b), _part(self.y, a, b)
        return np.asarray((self.modulus * n * (x * z - self.kept * x * x - 0.5 * (z * z - x * x))).sum(axis=0))

    def by_backs(self) -> tuple[np.ndarray, np.ndarray]:
        """`by_backs_in_hill` of another surface."""
        w = self.y - self.kept[..., None] * self.y_n
        curved = _on_points(surface_curved, self.law, w, self.y_n)
        g_w, g_n, g = (_on_points(surface_gradients, self.law, x) for x in (w, self.y_n, self.y))
        weight = self.modulus[..., None] * _TWICE
        return weight * (g_w - self.kept[..., None] * curved + g_n), weight * (curved - g)

    def by_number(self, which: int) -> np.ndarray:
        """`by_number_of_hill` of another surface."""
        w = self.y - self.kept[..., None] * self.y_n
        _, by_w = _number_slopes(w, which, self.law)
        rest = _number_slopes(self.y_n, which, self.law)[0] - _number_slopes(self.y, which, self.law)[0]
        return np.asarray((self.modulus * (_contracted(self.y_n, by_w) + rest)).sum(axis=0))


def _number_slopes(y: np.ndarray, which: int, law: Law) -> tuple[np.ndarray, np.ndarray]:
    values, normals = surface_number_slopes(np.ascontiguousarray(y).reshape(-1, 8, 6), which, law)
    return values.reshape(y.shape[:3]), normals.reshape(y.shape)


def add_structure_rates(
    data: ElementData,
    slopes: StructureSlopes,
    ends: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] | None,
    theta_rates: tuple[np.ndarray, np.ndarray],
    number_rates: np.ndarray,
    out: np.ndarray,
) -> None:
    """Rates of that heat along directions added to out (n_np, m), mJ: ends = rates of J (n_el, 8, m) and states (n_el, 8, N_FULL, m) at
    start and end of the increment, None where they stay; theta_rates, of the middle and of the start, each (n_np, m); number_rates
    (n, m)."""
    parts = []
    if ends is not None:
        (j_n, state_n), (j, state) = ends
        only = np.zeros(1, dtype=np.int64)
        parts += [(slopes.start, START_PLACES, state_n), (slopes.end, END_PLACES, state)]
        parts += [(slopes.by_j[0][None], only, j_n), (slopes.by_j[1][None], only, j)]
    if len(number_rates):
        parts.append((slopes.by_numbers, np.arange(len(number_rates)), number_rates))
    for slope, rates in zip(slopes.by_theta, theta_rates, strict=True):
        if np.any(slope):
            parts.append((slope[None], np.zeros(1, dtype=np.int64), at_points(data, rates)))
    for coefficients, places, rates in parts:
        used = np.flatnonzero(np.any(coefficients != 0.0, axis=(1, 2)))
        if len(used):
            per_point = 0 if rates.ndim == 2 else rates.size // (coefficients[0].size * out.shape[1])
            flat = np.ascontiguousarray(rates).reshape(-1)
            _add_point_rates(data, np.ascontiguousarray(coefficients[used]), places[used], flat, per_point, out)


_NODAL, _HEAT, _END = 0, 8 * LANES, 9 * LANES


@kernel
def _add_point_rates(
    data: ElementData, coefficients: np.ndarray, places: np.ndarray, rates: np.ndarray, per_point: int, out: np.ndarray
) -> None:
    """Nodal heat' of sum_k coefficient_k x_k' at the points; x_k' of a point stands in row per_point * point + place_k of rates."""
    m, result = out.shape[1], out.reshape(-1)
    w, zero = np.zeros(_END), np.zeros(LANES)
    for e in range(data.hexes.shape[0]):
        for b in range(0, m, LANES):
            for a in range(8):
                copy_lanes(w, _NODAL + a * LANES, zero, 0)
            for q in range(8):
                copy_lanes(w, _HEAT, zero, 0)
                first = (e * 8 + q) * per_point
                for k in range(len(places)):
                    if coefficients[k, e, q] != 0.0:
                        add_lanes(w, _HEAT, data.volume[e, q] * coefficients[k, e, q], rates, (first + places[k]) * m + b)
                for a in range(8):
                    add_lanes(w, _NODAL + a * LANES, data.shape[q, a], w, _HEAT)
            for a in range(8):
                add_lanes(result, data.hexes[e, a] * m + b, 1.0, w, _NODAL + a * LANES)
