"""Prediction of the next state of a march by extrapolation in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.body.body import Body
from thermofit.body.solve.extrapolation import lagrange
from thermofit.body.solve.history import State


@dataclass(frozen=True)
class Passed:
    """What extrapolation needs of a state before the current one: time s, load, u mm, theta K."""

    time: float
    load: float
    u: np.ndarray
    theta: np.ndarray


def passed(state: State) -> Passed:
    """Passed of a state."""
    return Passed(state.time, state.load, state.u, state.theta)


def predicted(body: Body, start: State, past: tuple[Passed, ...], t: float, load: float) -> tuple[np.ndarray, np.ndarray, bool]:
    """Extrapolated u and theta at time t, and whether a fresh tangent is needed.

    Quadratic in time through the last three states where the load went on in the same sense over all of them, linear through two. After a
    change of the programme the state itself (and a fresh tangent). Where the end is displaced, u is extrapolated over its displacement, and
    after a change of the programme the whole body is stretched evenly: the end is where it has to be, and no jump of it is left to the last
    layer of elements, which could not take it alone.
    """
    points = [passed(start)]
    rate = (load - start.load) / (t - start.time)
    for before in past:
        last = points[-1]
        if not _goes_on((last.load - before.load) / (last.time - before.time), rate):
            break
        points.append(before)
    if len(points) == 1:
        return start.u if body.top >= 0 else _stretched(body, start.u, load - start.load), start.theta, True
    in_time = lagrange([p.time for p in points], t)
    moved = body.top < 0 and load != start.load
    weights = lagrange([p.load for p in points], load) if moved else in_time
    u = sum((w * p.u for w, p in zip(weights, points, strict=True)), np.zeros_like(start.u))
    theta = sum((w * p.theta for w, p in zip(in_time, points, strict=True)), np.zeros_like(start.theta))
    return u, theta, False


def onwards(start: State, before: Passed, load: float) -> np.ndarray:
    """u (n_np, 3) where the whole body goes on as in the step before, as far as a displacement of the end by `load` asks for."""
    return start.u + (load - start.load) / (start.load - before.load) * (start.u - before.u)


def _stretched(body: Body, u: np.ndarray, elongation: float) -> np.ndarray:
    """u after an even stretch along y that moves the end by `elongation` mm."""
    y = body.mesh.nodes[:, 1]
    out = u.copy()
    out[:, 1] += elongation * (y - y.min()) / np.ptp(y)
    return out


def _goes_on(before: float, now: float) -> bool:
    """True where a load rate is that of the same phase of the programme: same sign, less than three times apart (or both zero)."""
    if before == 0.0 or now == 0.0:
        return before == now
    return 1.0 / 3.0 < now / before < 3.0
