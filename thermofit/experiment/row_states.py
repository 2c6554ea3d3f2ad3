"""State of the material where each value of a residual was measured: time, place, plastic strain, rate of flow, temperature.

Plastic strain and rate are those of the last flow before the value: a strain under load remembers the flow that made it, not the rest
that followed. Of a body they come from the point driver along the predicted strain of its sections, of coupons from their own run.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermofit.core.parameters import AT, Parameters
from thermofit.experiment.channels import field_of
from thermofit.experiment.joint import JointParts
from thermofit.experiment.local_balance import JointErrors, shown
from thermofit.experiment.missing_coupon import CouponMissing
from thermofit.experiment.model import StageModel
from thermofit.experiment.residuals import named_phases
from thermofit.experiment.section_force import last_rate, predicted_states

VARIABLES: Mapping[str, str] = {"plastic strain": "1", "rate": "e-fold", "temperature": "K", "time": "s", "place y": "mm"}
"""Unit of every variable, the plainest cause first; the rate counts by its natural logarithm."""
States = dict[str, np.ndarray]
"""By variable its value at every row (n,), nan where it has none."""


def row_states(model: StageModel, parameters: Parameters, parts: JointParts | None) -> States:
    """States at the rows of a model at parameters: of bodies by their joint problems `parts`, of coupons by their records; nan in the rows
    of priors. NumericsError where a run fails."""
    n = sum(c.n for c in model.comparisons) + len(model.priors)
    out = {name: np.full(n, np.nan) for name in VARIABLES}
    of_tests: dict[str, JointErrors] = {}
    at = 0
    for c in model.comparisons:
        own = slice(at, at + c.n)
        at += c.n
        channel, _, test = c.channel.partition(AT)
        if parts is not None:
            if test not in of_tests:
                of_tests[test] = shown(parts.each[test], parts.seen_by(parameters, test))
            found = _of_body(of_tests[test], field_of(channel), c.rows)
        elif isinstance(model.missing, CouponMissing):
            found = _of_coupons(model.missing, parameters, c.rows)
        else:
            found = {}
        for name, value in found.items():
            out[name][own] = value
    return out


def _of_coupons(missing: CouponMissing, parameters: Parameters, rows: np.ndarray) -> States:
    """States at rows (n, 3) of records that follow one another."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name in ("time", "plastic strain", "rate", "temperature")}
    for test in missing.records:
        history = missing.run(parameters, test)
        parts["time"].append(history.time - history.time[0])
        parts["plastic strain"].append(history.accumulated)
        parts["rate"].append(np.log(last_rate(history.time, history.accumulated)))
        parts["temperature"].append(history.theta)
    return {name: np.concatenate(value)[rows[:, 0]] for name, value in parts.items()}


def _of_body(seen: JointErrors, field: str, rows: np.ndarray) -> States:
    """States at rows (n, 3) of a field of a body."""
    observation = seen.joint.model.observations[field]
    time, y = observation.time[rows[:, 0]], observation.xy[rows[:, 1], 1]
    out = {"time": time, "place y": y}
    flow = predicted_states(seen, named_phases(seen.joint.data.phases))
    if flow is not None:
        with np.errstate(divide="ignore"):
            out["plastic strain"] = _at(flow.time, flow.y, flow.accumulated, time, y)
            out["rate"] = np.log(_at(flow.time, flow.y, flow.rate, time, y, held=True))
    if "theta" in seen.errors:
        warm = seen.joint.model.observations["theta"]
        theta = (warm.value + seen.errors["theta"])[:, :, 0]
        rows_y, label = np.unique(np.round(warm.xy[:, 1], 3), return_inverse=True)
        known = np.where(warm.mask, theta, 0.0)
        total = np.stack([np.bincount(label, one, len(rows_y)) for one in known])
        count = np.stack([np.bincount(label, one, len(rows_y)) for one in warm.mask.astype(float)])
        there = count.min(axis=0) > 0
        if there.any():
            out["temperature"] = _at(warm.time, rows_y[there], (total / np.maximum(count, 1.0))[:, there], time, y)
    return out


def _at(knots_t: np.ndarray, knots_y: np.ndarray, value: np.ndarray, time: np.ndarray, y: np.ndarray, *, held: bool = False) -> np.ndarray:
    """A history (n_t, n_y) at times and places (n,): straight between times, or `held` as it was last; of the nearest place."""
    nearest = np.abs(y[:, None] - knots_y[None, :]).argmin(axis=1)
    out = np.full(len(time), np.nan)
    for i in np.unique(nearest):
        own = nearest == i
        if held:
            out[own] = value[np.clip(np.searchsorted(knots_t, time[own], side="right") - 1, 0, len(knots_t) - 1), i]
        else:
            out[own] = np.interp(time[own], knots_t, value[:, i])
    return out
