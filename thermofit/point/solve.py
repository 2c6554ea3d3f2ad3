"""Steps of a material point solved by Newton, cut where they fail, and differentiated after they have converged.

Every derivative comes from the equations of `point.step` by complex step: those of Newton, and those of direct differentiation,
dx/dp = -(dr/dx)^-1 (dr/ds ds/dp + dr/dp), where ds/dp are the derivatives of the state at the start of the step.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from thermofit.core.jit import by_type, kernel
from thermofit.law.composition import EFFECT_NUMBERS, effect_numbers, hardening_numbers, no_effects
from thermofit.law.hardening.catalogue import SHARED
from thermofit.law.page import AnyLaw, AnySurfaceLaw, Law, SurfaceLaw
from thermofit.law.page_rates import N_NUMBERS, STEP, SURFACE, Complex
from thermofit.law.surface.catalogue import NUMBERS as OF_SURFACE
from thermofit.point.state import YIELD_TOLERANCE
from thermofit.point.step import (
    ACROSS,
    ALONG,
    AT_REST,
    BY_STRAIN,
    LAMBDA,
    N_STATE,
    N_UNKNOWNS,
    REST,
    SENSOR,
    STRAIN,
    STRESS,
    THETA,
    Exchange,
    Input,
    Surroundings,
    end_of_iteration,
    end_of_step,
    equations,
    exchange_of,
    new_state,
    residual,
)

_as_tuple: Any = to_fixed_tuple
_new_law: Any = Law
_new_any_law: Any = AnyLaw
_new_surface_law: Any = SurfaceLaw
_new_any_surface_law: Any = AnySurfaceLaw
N_OF_EFFECTS = len(EFFECT_NUMBERS)
OF_EFFECTS = N_NUMBERS - N_OF_EFFECTS
"""Place of the first number of an effect."""
N_OF_SURFACE = len(OF_SURFACE)
N_BASE = SURFACE - len(SHARED)
N_ALL = N_NUMBERS + 4
"""Numbers that a run depends on: those of the law, then tau, lag, theta_air and the temperature at the start."""
TAU, LAG, AIR, START = range(N_NUMBERS, N_ALL)
TOLERANCE = 2e-14
"""Residual, in units of mu or as a strain, at which a step has converged."""
ACCEPTED = 1e-12
"""Residual that round-off may leave."""
MAX_ITERATIONS = 30
FARTHEST = 5.0
"""Logarithmic stretch and plastic increment beyond which an iteration is lost."""
MAX_RETREATS = 6
"""How often an iteration may come back from a negative plastic increment, where effects are on."""
CONVERGED, FAILED = 0, -1


class Limits(NamedTuple):
    """Largest change of the stretch in one step, and how often a step may be halved."""

    max_strain: float
    max_cuts: int


class Flags(NamedTuple):
    """What a law of the thesis is: model 1 or 2, alpha in closed form, plasticity at all, any effect on (as in `law.page.BaseLaw`)."""

    model: int
    closed_form: int
    plastic: int
    effective: int


class AnyFlags(NamedTuple):
    """The same of a law with any hardening: the type says which kernels run, `model` is the number of the hardening law."""

    model: int
    closed_form: int
    plastic: int
    effective: int


class SurfaceFlags(NamedTuple):
    """Flags of a law of the thesis with a transformed yield surface."""

    model: int
    closed_form: int
    plastic: int
    effective: int


class AnySurfaceFlags(NamedTuple):
    """Flags of a law with any hardening and a transformed yield surface."""

    model: int
    closed_form: int
    plastic: int
    effective: int


FLAGS_OF: dict[type, Any] = {Law: Flags, AnyLaw: AnyFlags, SurfaceLaw: SurfaceFlags, AnySurfaceLaw: AnySurfaceFlags}
"""Flags of every kind of law."""
_IN_KERNELS = -1
"""Number of the surface of a law that a kernel makes: none asks for it."""


class Work(NamedTuple):
    """Scratch of a run: Jacobian (4, 4), residual (4,), states (`s` and `out` of a step, `before` the one before it, `kept` that of the
    interval), complex ones, and derivatives of states (N_STATE, n_p). `numbers` (n_p + 1, N_ALL): those of the run moved along each
    parameter by i h, last as they are; `asked` (n_p + 1,): whether one of an effect moves; `air` (3, n_p + 1): the air of
    the run, and by how much it is warmer at begin and end of an interval, moved likewise."""

    jacobian: np.ndarray
    right: np.ndarray
    s: np.ndarray
    z: np.ndarray
    z_out: np.ndarray
    out: np.ndarray
    kept: np.ndarray
    rates: np.ndarray
    rates_out: np.ndarray
    rates_kept: np.ndarray
    rhs: np.ndarray
    before: np.ndarray
    numbers: np.ndarray
    asked: np.ndarray
    air: np.ndarray


@kernel(forceinline=True)
def work_for(numbers: np.ndarray, along: np.ndarray) -> Work:
    """Work for numbers (N_ALL,) of a run and their derivatives (N_ALL, n_p) along parameters."""
    n_p = along.shape[1]
    moved, asked = np.empty((n_p + 1, N_ALL), dtype=np.complex128), np.zeros(n_p + 1, dtype=np.bool_)
    for p in range(n_p + 1):
        for i in range(N_ALL):
            moved[p, i] = complex(numbers[i], STEP * along[i, p] if p < n_p else 0.0)
        if p < n_p:
            asked[p] = np.any(along[OF_EFFECTS:N_NUMBERS, p] != 0.0)
    z = np.zeros((2, N_STATE), dtype=np.complex128)
    s, r = np.zeros((4, N_STATE)), np.zeros((3, N_STATE, n_p))
    return Work(
        np.zeros((N_UNKNOWNS, N_UNKNOWNS)), np.zeros(N_UNKNOWNS), s[0], z[0], z[1], s[1], s[2], r[0], r[1], r[2],
        np.zeros((N_UNKNOWNS, n_p)), s[3], moved, asked, np.zeros((3, n_p + 1), dtype=np.complex128),
    )  # fmt: skip


@kernel(forceinline=True)
def _law(flags: Flags, numbers: np.ndarray, rest: tuple[Any, ...], of_effects: tuple[Any, ...]) -> Law:
    return _new_law(*_as_tuple(numbers, N_BASE), *rest, *of_effects)


@kernel(forceinline=True)
def _any_law(flags: AnyFlags, numbers: np.ndarray, rest: tuple[Any, ...], of_effects: tuple[Any, ...]) -> Law:
    return _new_any_law(*_as_tuple(numbers, N_BASE), *hardening_numbers(numbers[N_BASE:]), *rest, *of_effects)


@kernel(forceinline=True)
def _surface_law(flags: SurfaceFlags, numbers: np.ndarray, rest: tuple[Any, ...], of_effects: tuple[Any, ...]) -> Law:
    surface = _as_tuple(numbers[SURFACE:], N_OF_SURFACE)
    return _new_surface_law(*_as_tuple(numbers, N_BASE), *surface, *rest, _IN_KERNELS, *of_effects)


@kernel(forceinline=True)
def _any_surface_law(flags: AnySurfaceFlags, numbers: np.ndarray, rest: tuple[Any, ...], of_effects: tuple[Any, ...]) -> Law:
    own, surface = hardening_numbers(numbers[N_BASE:]), _as_tuple(numbers[SURFACE:], N_OF_SURFACE)
    return _new_any_surface_law(*_as_tuple(numbers, N_BASE), *own, *surface, *rest, _IN_KERNELS, *of_effects)


_MAKERS: dict[type, Any] = {Flags: _law, AnyFlags: _any_law, SurfaceFlags: _surface_law, AnySurfaceFlags: _any_surface_law}


def law_for(flags: Flags, numbers: np.ndarray, rest: tuple[Any, ...], of_effects: tuple[Any, ...]) -> Law:
    """In kernels: the law of numbers (N_ALL,), of the kind that the type of `flags` says."""
    raise NotImplementedError


@by_type(law_for)
def _law_for(flags: Any, numbers: Any, rest: Any, of_effects: Any) -> Any:
    make = _MAKERS[flags.instance_class]
    return lambda flags, numbers, rest, of_effects: make(flags, numbers, rest, of_effects)


def switched(flags: Flags, effective: int) -> Flags:
    """In kernels: flags of the same type, with effects on (1) or off (0)."""
    raise NotImplementedError


@by_type(switched)
def _switched(flags: Any, effective: Any) -> Any:
    kind: Any = flags.instance_class
    return lambda flags, effective: kind(flags.model, flags.closed_form, flags.plastic, effective)


@kernel(forceinline=True)
def law_and_surroundings(numbers: np.ndarray, flags: Flags, dt: float) -> tuple[Law, Surroundings]:
    """Law in a step of dt s and Surroundings of complex numbers (N_ALL,)."""
    rest, of_effects = (flags.model, flags.closed_form, flags.plastic, flags.effective, 1.0 / dt), effect_numbers(numbers[OF_EFFECTS:])
    return law_for(flags, numbers, rest, of_effects), Surroundings(numbers[TAU], numbers[LAG], numbers[AIR])


@kernel(forceinline=True)
def plain_law_and_surroundings(numbers: np.ndarray, flags: Flags, dt: float) -> tuple[Law, Surroundings]:
    """The same without any effect, whatever their numbers are."""
    rest = (flags.model, flags.closed_form, flags.plastic, 0, 1.0 / dt)
    return law_for(flags, numbers, rest, no_effects()), Surroundings(numbers[TAU], numbers[LAG], numbers[AIR])


@kernel(forceinline=True)
def _moved(x: tuple[float, float, float, float], k: int) -> Complex:
    """x with entry k moved by i h (none for a negative k)."""
    return (
        complex(x[0], STEP if k == 0 else 0.0),
        complex(x[1], STEP if k == 1 else 0.0),
        complex(x[2], STEP if k == 2 else 0.0),
        complex(x[3], STEP if k == 3 else 0.0),
    )


@kernel(inline="always")
def linearised(x: tuple[float, float, float, float], z: np.ndarray, step: Input, law: Law, exchange: Exchange, w: Work) -> float:
    """Residual and Jacobian of a step at x into w; returns the largest residual."""
    for k in range(N_UNKNOWNS):
        there = _moved(x, k)
        r0, r1, r2, r3 = equations(there, z, step, law, exchange, end_of_iteration(there, z, step, law))
        w.jacobian[0, k], w.jacobian[1, k] = r0.imag / STEP, r1.imag / STEP
        w.jacobian[2, k], w.jacobian[3, k] = r2.imag / STEP, r3.imag / STEP
        if k == 0:
            w.right[0], w.right[1], w.right[2], w.right[3] = r0.real, r1.real, r2.real, r3.real
    return max(abs(w.right[0]), abs(w.right[1]), abs(w.right[2]), abs(w.right[3]))


@kernel(forceinline=True)
def eliminate(a: np.ndarray, b: np.ndarray) -> None:
    """b := a^-1 b with pivoting; a (n, n), b (n, m); both are overwritten."""
    n, m = a.shape[0], b.shape[1]
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[p, k]):
                p = i
        if p != k:
            for j in range(n):
                a[k, j], a[p, j] = a[p, j], a[k, j]
            for j in range(m):
                b[k, j], b[p, j] = b[p, j], b[k, j]
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k + 1, n):
                a[i, j] -= factor * a[k, j]
            for j in range(m):
                b[i, j] -= factor * b[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(m):
            value = b[k, j]
            for i in range(k + 1, n):
                value -= a[k, i] * b[i, j]
            b[k, j] = value / a[k, k]


@kernel
def newton(
    x: tuple[float, float, float, float], z: np.ndarray, step: Input, law: Law, exchange: Exchange, w: Work
) -> tuple[int, tuple[float, float, float, float], int]:
    """Solve a step from the guess x: status, solution, iterations; w holds the Jacobian there. law, exchange and state z are complex."""
    before, retreats = np.inf, 0
    for iteration in range(MAX_ITERATIONS):
        worst = linearised(x, z, step, law, exchange, w)
        if worst < TOLERANCE or (worst < ACCEPTED and worst >= 0.25 * before):
            return CONVERGED, x, iteration
        if not np.isfinite(worst):
            return FAILED, x, iteration
        before = worst
        right = w.right.reshape(N_UNKNOWNS, 1)
        eliminate(w.jacobian, right)
        gamma = x[2] - w.right[2]
        if law.effective == 1 and step.flows and gamma < 0.0:
            # The rate of flow enters laws that are defined for flow only; the excess is convex there, so that Newton may overshoot.
            retreats += 1
            if retreats > MAX_RETREATS:
                return FAILED, x, iteration
            gamma = 0.25 * x[2]
        x = (x[0] - w.right[0], x[1] - w.right[1], gamma, x[3] - w.right[3])
        if not (abs(x[0]) < FARTHEST and abs(x[1]) < FARTHEST and abs(gamma) < FARTHEST):
            return FAILED, x, iteration  # before a stretch underflows: a complex division by zero is an exception in numba
    return FAILED, x, MAX_ITERATIONS


@kernel
def _beyond_yield(x: tuple[float, float, float, float], z: np.ndarray, step: Input, law: Law) -> bool:
    """True where an elastic solution leaves the yield surface."""
    there = end_of_step(_moved((x[0], x[1], 0.0, x[3]), -1), z, Input(step.dt, step.target, step.control, True), law)
    return there.excess.real * law.mu.real > YIELD_TOLERANCE * there.yield_stress.real


@kernel(inline="always")
def solve_step(
    z: np.ndarray, step: Input, law: Law, exchange: Exchange, guess: tuple[float, float, float, float], w: Work
) -> tuple[int, tuple[float, float, float, float], bool, int]:
    """Solve a step elastically or plastically, whichever holds; `step.flows` says which is tried first and `guess` where.

    Returns status, solution, whether it flows, and Newton iterations; w holds the Jacobian of the solution.
    """
    total = 0
    if step.flows:
        status, x, n = newton(guess, z, step, law, exchange, w)
        total += n
        if status == CONVERGED and x[2] > 0.0:
            return CONVERGED, x, True, total
    elastic = Input(step.dt, step.target, step.control, False)
    start = (z[ACROSS].real, z[ALONG].real, 0.0, z[THETA].real)
    status, x, n = newton(start, z, elastic, law, exchange, w)
    total += n
    if status != CONVERGED:
        return status, x, False, total
    if law.plastic == 0 or step.control == AT_REST or not _beyond_yield(x, z, step, law):
        return CONVERGED, x, False, total
    status, x, n = newton(x, z, Input(step.dt, step.target, step.control, True), law, exchange, w)
    total += n
    if status == CONVERGED and not x[2] > 0.0:
        status = FAILED
    return status, x, True, total


@kernel(forceinline=True)
def _complex_state(s: np.ndarray, rates: np.ndarray, p: int, z: np.ndarray) -> None:
    """z = s + i h ds/dp, or s alone for a negative p."""
    for i in range(N_STATE):
        z[i] = complex(s[i], STEP * rates[i, p] if p >= 0 else 0.0)


@kernel(forceinline=True)
def _residual_of(x: Complex, z: np.ndarray, step: Input, numbers: np.ndarray, flags: Flags) -> Complex:
    """Residual of the numbers (N_ALL,) of a run without effects."""
    law, around = plain_law_and_surroundings(numbers, flags, step.dt)
    return residual(x, z, step, law, exchange_of(step.dt, around))


@kernel(forceinline=True)
def _set_new_state(x: Complex, z: np.ndarray, step: Input, numbers: np.ndarray, flags: Flags, out: np.ndarray) -> None:
    """New state of the numbers (N_ALL,) of a run without effects."""
    law, around = plain_law_and_surroundings(numbers, flags, step.dt)
    new_state(x, z, step, law, exchange_of(step.dt, around), out)


@kernel
def _set_state(x: Complex, z: np.ndarray, step: Input, law: Law, exchange: Exchange, out: np.ndarray) -> None:
    """New state of a solved step; not inlined, for it is asked once per step."""
    new_state(x, z, step, law, exchange, out)


@kernel
def _residual_with_effects(x: Complex, z: np.ndarray, step: Input, numbers: np.ndarray, flags: Flags) -> Complex:
    law, around = law_and_surroundings(numbers, flags, step.dt)
    return residual(x, z, step, law, exchange_of(step.dt, around))


@kernel
def _set_new_state_with_effects(x: Complex, z: np.ndarray, step: Input, numbers: np.ndarray, flags: Flags, out: np.ndarray) -> None:
    law, around = law_and_surroundings(numbers, flags, step.dt)
    new_state(x, z, step, law, exchange_of(step.dt, around), out)


@kernel(inline="always")
def differentiate(x: tuple[float, float, float, float], step: Input, flags: Flags, w: Work) -> None:
    """Derivatives of the state at the end of a solved step into w.rates_out, from those at its start, w.rates; w holds the Jacobian.

    Without effects all is inlined, and nothing of the effects is left in it.
    """
    plain, full = switched(flags, 0), switched(flags, 1)
    n_p = w.rates.shape[1]
    for p in range(n_p):
        _complex_state(w.s, w.rates, p, w.z)
        if flags.effective == 1 or w.asked[p]:
            r0, r1, r2, r3 = _residual_with_effects(_moved(x, -1), w.z, step, w.numbers[p], full)
        else:
            r0, r1, r2, r3 = _residual_of(_moved(x, -1), w.z, step, w.numbers[p], plain)
        w.rhs[0, p], w.rhs[1, p], w.rhs[2, p], w.rhs[3, p] = -r0.imag, -r1.imag, -r2.imag, -r3.imag
    eliminate(w.jacobian, w.rhs)
    for p in range(n_p):
        _complex_state(w.s, w.rates, p, w.z)
        end: Complex = (complex(x[0], w.rhs[0, p]), complex(x[1], w.rhs[1, p]), complex(x[2], w.rhs[2, p]), complex(x[3], w.rhs[3, p]))
        if flags.effective == 1 or w.asked[p]:
            _set_new_state_with_effects(end, w.z, step, w.numbers[p], full, w.z_out)
        else:
            _set_new_state(end, w.z, step, w.numbers[p], plain, w.z_out)
        for i in range(N_STATE):
            w.rates_out[i, p] = w.z_out[i].imag / STEP


@kernel(inline="always")
def advance(step: Input, guess: tuple[float, float, float, float], flags: Flags, w: Work) -> tuple[int, bool, int]:
    """One step from w.s to w.out, and its derivatives by the parameters that w follows: status, whether it flows, iterations."""
    law, around = law_and_surroundings(w.numbers[-1], flags, step.dt)
    exchange = exchange_of(step.dt, around)
    _complex_state(w.s, w.rates, -1, w.z)
    status, x, flows, n = solve_step(w.z, step, law, exchange, guess, w)
    if status != CONVERGED:
        return status, flows, n
    taken = Input(step.dt, step.target, step.control, flows)
    _set_state(_moved(x, -1), w.z, taken, law, exchange, w.z_out)
    for i in range(N_STATE):
        w.out[i] = w.z_out[i].real
    if w.rates.shape[1] > 0:
        differentiate(x, taken, flags, w)
    return CONVERGED, flows, n


@kernel(forceinline=True)
def _guess(s: np.ndarray, before: np.ndarray) -> tuple[float, float, float, float]:
    """Elastic stretches and temperature as they are, dLambda as in the step before."""
    return (s[ACROSS], s[ALONG], s[LAMBDA] - before[LAMBDA], s[THETA])


@kernel(forceinline=True)
def _copy(state: np.ndarray, rates: np.ndarray, to: np.ndarray, rates_to: np.ndarray) -> None:
    """A state (N_STATE,) and its derivatives (N_STATE, n_p); written out, because an assignment of arrays compiles its error message."""
    for i in range(N_STATE):
        to[i] = state[i]
        for p in range(rates.shape[1]):
            rates_to[i, p] = rates[i, p]


@kernel(inline="always")
def cross(interval: tuple[float, float, int, bool], flags: Flags, limits: Limits, w: Work) -> tuple[int, bool, int, int, int]:
    """One interval (length s, target, control, did the step before flow) in equal steps, twice as many where one fails or strains too much.

    w.s and w.rates are the state and its derivatives before and, on success, after. Returns status, whether the last step flows, steps,
    halvings, iterations.
    """
    length, target, control, flowed = interval
    begin = w.s[STRAIN] if control == BY_STRAIN else w.s[STRESS]
    parts = 1
    if control == BY_STRAIN:
        parts = max(1, int(np.ceil(abs(target - begin) / limits.max_strain * (1.0 - 1e-12))))
    _copy(w.s, w.rates, w.kept, w.rates_kept)
    iterations = 0
    for cut in range(limits.max_cuts + 1):
        flows, done = flowed and cut == 0, True
        for n in range(parts):
            to = begin + (target - begin) * ((n + 1) / parts) if n + 1 < parts else target
            share = (n + 0.5) / parts
            for p in range(w.air.shape[1]):
                w.numbers[p, AIR] = w.air[0, p] + (1.0 - share) * w.air[1, p] + share * w.air[2, p]
            step = Input(length / parts, to, control, flows)
            status, flows, used = advance(step, _guess(w.s, w.before), flags, w)
            iterations += used
            if status != CONVERGED or abs(w.out[STRAIN] - w.s[STRAIN]) > 1.001 * limits.max_strain:
                done = False
                break
            for i in range(N_STATE):
                w.before[i] = w.s[i]
            _copy(w.out, w.rates_out, w.s, w.rates)
        if done:
            return CONVERGED, flows, parts, cut, iterations
        _copy(w.kept, w.rates_kept, w.s, w.rates)
        parts *= 2
    return FAILED, False, parts, limits.max_cuts, iterations


@kernel
def run(
    time: np.ndarray,
    target: np.ndarray,
    by_stress: np.ndarray,
    numbers: np.ndarray,
    along: np.ndarray,
    warmer: np.ndarray,
    warmer_along: np.ndarray,
    flags: Flags,
    limits: Limits,
    states: np.ndarray,
    rates: np.ndarray,
    counts: np.ndarray,
) -> int:
    """All steps of a history into states (n_t, N_STATE) and, where `along` has columns, rates (n_t, N_STATE, n_p).

    `warmer` (n_t,) K: by how much the air is warmer at the times than `numbers` say, and `warmer_along` (n_t, n_p) its derivatives.
    counts (3,): steps, halvings, Newton iterations. Returns the index of the time that was not reached, -1 where all were.
    """
    w = work_for(numbers, along)
    n_p = along.shape[1]
    for p in range(n_p + 1):
        w.air[0, p] = w.numbers[p, AIR]
    w.s[THETA] = w.s[SENSOR] = numbers[START]
    w.s[REST] = 1.0
    for p in range(along.shape[1]):
        w.rates[THETA, p] = w.rates[SENSOR, p] = along[START, p]
    flows = False
    for n in range(-1, len(time)):
        # The first interval finds the specimen at rest. One call of `cross`, and of `advance` in it: every further one is compiled anew.
        if n != 0 or target[0] != 0.0:
            length, to, control = 1.0, 0.0, AT_REST
            if n >= 0:
                length = time[n] - time[n - 1] if n > 0 else time[1] - time[0]
                to, control = target[n], int(by_stress[n])
                for p in range(n_p + 1):
                    for k in range(2):
                        at = max(n - 1 + k, 0)
                        w.air[1 + k, p] = complex(warmer[at], STEP * warmer_along[at, p] if p < n_p else 0.0)
            status, flows, steps, cuts, used = cross((length, to, control, flows), flags, limits, w)
            if status != CONVERGED:
                return max(n, 0)
            if n >= 0:
                counts[0] += steps
                counts[1] += cuts
                counts[2] += used
        if n >= 0:
            for i in range(N_STATE):
                states[n, i] = w.s[i]
                for p in range(n_p):
                    rates[n, i, p] = w.rates[i, p]
    return -1
