"""Material points in series: one force through all of them, their mean strain is prescribed.

At the end of a step, with P_i the nominal stress of section i at its strain e_i and A_i its cross-section over a common one,

    A_i P_i(e_i) = F  for every i,      sum w_i e_i = mean strain

are solved by Newton for all e_i and F. Every section takes its step under strain control, so that it may soften; what the others do holds
the row. The slope dP_i/de_i and the derivatives of the state by the strain are exact: the strain is counted from the stretch at rest, and a
shift of that is one more direction of `point.solve.differentiate`. With the same matrix the derivatives by parameters follow,

    A_i (dP_i/de_i de_i/dp + dP_i/dp) = dF/dp,      sum w_i de_i/dp = 0.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.jit import kernel
from thermofit.point.solve import CONVERGED, FAILED, N_ALL, START, Flags, Limits, advance, eliminate, work_for
from thermofit.point.step import (
    ACROSS,
    ALONG,
    AT_REST,
    BY_STRAIN,
    LAMBDA,
    LATERAL_X,
    LATERAL_Z,
    N_STATE,
    REST,
    SENSOR,
    STRAIN,
    STRESS,
    THETA,
    Input,
)

TOLERANCE = 1e-11
"""Difference of the forces, over the largest, at which a step has converged."""
ITERATIONS = 40
ATTEMPTS = 3
"""Guesses from which a step is sought."""
LARGEST = 0.05
"""Change of a strain in one iteration at most."""


@kernel
def sections_at(
    step: Input,
    strain: np.ndarray,
    states: np.ndarray,
    rates: np.ndarray,
    before: np.ndarray,
    numbers: np.ndarray,
    along: np.ndarray,
    flags: Flags,
    flows: np.ndarray,
    out: np.ndarray,
    rates_out: np.ndarray,
) -> int:
    """One step of every section to its own strain (n_s,), each on its own: new states (n_s, N_STATE) and their derivatives (n_s, N_STATE,
    n_q), of which the last is that by the strain itself. Status."""
    last = along.shape[2] - 1
    for i in range(len(strain)):
        w = work_for(numbers[i], along[i])
        w.s[:] = states[i]
        w.rates[:] = rates[i]
        w.rates[:, last] = 0.0
        w.rates[REST, last] = 1.0 if step.control == BY_STRAIN else 0.0
        guess = (w.s[ACROSS], w.s[ALONG], w.s[LAMBDA] - before[i, LAMBDA], w.s[THETA])
        status, flowing, _ = advance(Input(step.dt, strain[i], step.control, flows[i]), guess, flags, w)
        if status != CONVERGED:
            return status
        flows[i] = flowing
        out[i] = w.out
        rates_out[i] = w.rates_out
        if step.control == BY_STRAIN:
            rates_out[i, REST, last] = 0.0
            for k in (STRAIN, LATERAL_X, LATERAL_Z):
                rates_out[i, k, last] += 1.0
    return CONVERGED


@kernel
def bordered(slope: np.ndarray, weight: np.ndarray, right: np.ndarray) -> None:
    """right (n_s + 1, m) := solution of slope_i x_i - x_F = right_i, sum weight_i x_i = right_F."""
    n = len(slope)
    a = np.zeros((n + 1, n + 1))
    for i in range(n):
        a[i, i], a[i, n], a[n, i] = slope[i], -1.0, weight[i]
    eliminate(a, right)


@kernel
def guessed(attempt: int, mean: float, weight: np.ndarray, strain: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Strains (n_s,) from which a step to a mean strain is sought: as they grew in the step before, all by as much, or the one that grew
    most alone, as where the others begin to unload."""
    change, grown = mean - np.sum(weight * strain), strain - before
    last = np.sum(weight * grown)
    if attempt == 0 and last * change > 0.0:
        return strain + grown * (change / last)
    if attempt < 2:
        return strain + change
    out, k = strain.copy(), np.argmax(np.abs(grown))
    out[k] += change / weight[k]
    return out


@kernel
def row_step(
    step: Input,
    mean: float,
    weight: np.ndarray,
    area: np.ndarray,
    states: np.ndarray,
    rates: np.ndarray,
    before: np.ndarray,
    numbers: np.ndarray,
    along: np.ndarray,
    flags: Flags,
    flows: np.ndarray,
    out: np.ndarray,
    rates_out: np.ndarray,
) -> int:
    """One step of the row to a mean strain; arrays as `sections_at`, whose derivatives are those at a common mean strain here. Status.

    Iterations need the derivative by the strain alone; those by parameters are made once, where the step has converged.
    """
    n, last = len(weight), along.shape[2] - 1
    fixed, still, by_strain = np.zeros((n, N_ALL, 1)), np.zeros((n, N_STATE, 1)), np.zeros((n, N_STATE, 1))
    flowed = flows.copy()
    for attempt in range(ATTEMPTS):
        flows[:] = flowed
        strain = guessed(attempt, mean, weight, states[:, STRAIN], before[:, STRAIN])
        force = 0.0
        for iteration in range(ITERATIONS):
            if sections_at(step, strain, states, still, before, numbers, fixed, flags, flows, out, by_strain) != CONVERGED:
                break
            stress, slope = area * out[:, STRESS], area * by_strain[:, STRESS, 0]
            if iteration == 0:
                force = np.mean(stress)
            right = np.zeros((n + 1, 1))
            right[:n, 0] = force - stress
            right[n, 0] = mean - np.sum(weight * strain)
            if np.max(np.abs(right[:n, 0])) <= TOLERANCE * np.max(np.abs(stress)) and abs(right[n, 0]) < TOLERANCE:
                if last > 0:
                    if sections_at(step, strain, states, rates, before, numbers, along, flags, flows, out, rates_out) != CONVERGED:
                        break
                    turned = np.zeros((n + 1, last))
                    for p in range(last):
                        for i in range(n):
                            turned[i, p] = -area[i] * rates_out[i, STRESS, p]
                    bordered(slope, weight, turned)
                    for i in range(n):
                        for k in range(N_STATE):
                            for p in range(last):
                                rates_out[i, k, p] += rates_out[i, k, last] * turned[i, p]
                return CONVERGED
            bordered(slope, weight, right)
            change = np.max(np.abs(right[:n, 0]))
            if not np.isfinite(change):
                break
            share = min(1.0, LARGEST / change) if change > 0.0 else 1.0
            if iteration > ITERATIONS // 2:
                share *= 0.5  # a section on the edge of flow may turn back and forth
            strain = strain + share * right[:n, 0]
            force += share * right[n, 0]
    return FAILED


@kernel
def run_row(
    time: np.ndarray,
    mean: np.ndarray,
    weight: np.ndarray,
    area: np.ndarray,
    numbers: np.ndarray,
    along: np.ndarray,
    flags: Flags,
    limits: Limits,
    states: np.ndarray,
    rates: np.ndarray,
    counts: np.ndarray,
) -> int:
    """All steps of a row through its mean strains (n_t,) into states (n_t, n_s, N_STATE) and rates (n_t, n_s, N_STATE, n_q).

    `numbers` (n_s, N_ALL) and `along` (n_s, N_ALL, n_q) of every section; the last column of `along` is zero, and that of `rates` is no
    derivative. counts (2,): steps, halvings. Returns the index of the time that was not reached, -1 where all were.
    """
    n_s, n_q = len(weight), along.shape[2]
    now, slopes, before = np.zeros((n_s, N_STATE)), np.zeros((n_s, N_STATE, n_q)), np.zeros((n_s, N_STATE))
    out, slopes_out, flows = np.zeros((n_s, N_STATE)), np.zeros((n_s, N_STATE, n_q)), np.zeros(n_s, dtype=np.bool_)
    for i in range(n_s):
        now[i, THETA] = now[i, SENSOR] = numbers[i, START]
        now[i, REST] = 1.0
        slopes[i, THETA] = along[i, START]
        slopes[i, SENSOR] = along[i, START]
    rest = Input(1.0, 0.0, AT_REST, False)
    if sections_at(rest, np.zeros(n_s), now, slopes, now, numbers, along, flags, flows, out, slopes_out) != CONVERGED:
        return 0
    now[:], slopes[:], before[:] = out, slopes_out, out
    for n in range(len(time)):
        if n == 0 and mean[0] == 0.0:
            states[0], rates[0] = now, slopes
            continue
        length = time[n] - time[n - 1] if n > 0 else time[1] - time[0]
        begin = np.sum(weight * now[:, STRAIN])
        kept, slopes_kept, before_kept, flowed = now.copy(), slopes.copy(), before.copy(), flows.copy()
        parts, done = max(1, int(np.ceil(abs(mean[n] - begin) / limits.max_strain * (1.0 - 1e-12)))), False
        for cut in range(limits.max_cuts + 1):
            done = True
            for k in range(parts):
                to = begin + (mean[n] - begin) * ((k + 1) / parts) if k + 1 < parts else mean[n]
                step = Input(length / parts, to, BY_STRAIN, False)
                if row_step(step, to, weight, area, now, slopes, before, numbers, along, flags, flows, out, slopes_out) != CONVERGED:
                    done = False
                    break
                before[:], now[:], slopes[:] = now, out, slopes_out
            if done:
                counts[0] += parts
                counts[1] += cut
                break
            now[:], slopes[:], before[:], flows[:] = kept, slopes_kept, before_kept, flowed
            parts *= 2
        if not done:
            return n
        states[n], rates[n] = now, slopes
    return -1
