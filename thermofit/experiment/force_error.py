"""What the error of the smoothed force does to displacements and temperatures: noise of what is prescribed, no misfit of the model.

Where the material flows, a force that is wrong by dF moves the points by (du/dF) dF with the tangent du/dF of the flowing specimen, at that
moment alone: plastic strain follows the largest force so far. Near the largest force the tangent is so soft that half a newton makes more
than the noise of the cameras. The plastic strain dLambda that goes with it sets free q dLambda / c0 of temperature, q the heat per Lambda;
over the seconds for which the smoothed force errs that hardly flows away. Where the specimen rests the errors of the last moment of flow
stay, that of the temperature as long as the specimen stays warm. Tangents are those of one run, from step to step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.parameters import Parameters
from thermofit.experiment.channels import field_of
from thermofit.experiment.fields import LoadSteps, temperature_of
from thermofit.experiment.forward import Sampler
from thermofit.experiment.joint import ForceModes, Joint
from thermofit.observe.observation import FieldObservation

_LEAST = 1e-7
"""Part of the largest force by which it changes at least in a step that tells a tangent."""
_STRAINED = 0.02
"""Part of the largest force from which on the secant of the elastic range is told."""
_COLD = 1e-3
"""Excess temperature over the air, K, below which its decay says nothing."""
_DOUBT = 0.3
"""Relative error of what an error of the force makes of temperatures: heat of elasticity, and what flows away while the force errs, are
left out of it."""
_TELLS = 1e-3
"""Part of the largest mode's effect below which a mode is left out."""


@dataclass(frozen=True)
class Tangents:
    """What a unit of the force does at every step: `step` (n_steps,) the last step of flow, zero before the first; `of` (n_steps,) the
    increment from step `of` to `of` + 1 whose change over that of the force is the tangent at `step`, minus one where there is none."""

    step: np.ndarray
    of: np.ndarray


def tangents(history: History, force: np.ndarray) -> Tangents:
    """Tangents of a history that kept its points, under a force (n_steps,) N.

    The step in which flow begins is partly elastic: the one after it tells the tangent there.
    """
    flows = np.diff([float(np.mean(p.accumulated)) for p in history.points]) > 0.0
    change = np.diff(force)
    tells = flows & (np.abs(change) > _LEAST * float(np.abs(force).max()))
    step, of = np.zeros(len(force), dtype=int), np.full(len(force), -1)
    for n in range(len(change)):
        step[n + 1], of[n + 1] = step[n], of[n]
        if flows[n]:
            step[n + 1] = n + 1
            onwards = n + 1 < len(change) and tells[n + 1] and change[n + 1] * change[n] > 0.0
            of[n + 1] = n + 1 if onwards else n if tells[n] else of[n]
    return Tangents(step, of)


def displacement_modes(history: History, steps: LoadSteps, look: Sampler, seen: FieldObservation) -> ForceModes:
    """What the error of the force makes of the displacements as they are `seen`; `steps` are those of the history."""
    u, change = look.operator.displacement(history.u), np.diff(steps.force)
    tangent, at = np.zeros((len(look.index), *u.shape[1:])), np.zeros(len(look.index), dtype=int)
    found = tangents(history, steps.force)
    for i, n in enumerate(look.index):
        # Before flow the specimen is elastic: the secant is its tangent.
        if found.of[n] < 0 and abs(steps.force[n]) > _STRAINED * float(np.abs(steps.force).max()):
            tangent[i], at[i] = (u[n] - u[look.reference]) / steps.force[n], n
    for i, step, k in _observed(look, found):
        tangent[i], at[i] = (u[k + 1] - u[k]) / change[k], step
    return _telling(seen.averaged(tangent), at, steps)


def temperature_modes(joint: Joint, history: History, steps: LoadSteps, parameters: Parameters) -> ForceModes:
    """What the error of the force makes of the temperatures at the observed times; `steps` are those of the history."""
    look, change = joint.sampler_of("theta"), np.diff(steps.force)
    body, operator = joint.run.body, look.operator
    accumulated = np.array([p.accumulated for p in history.points])
    grown = np.einsum("neq,eq->n", np.diff(accumulated, axis=0), body.data.volume) * body.symmetry
    heat = np.array([b.dissipated for b in history.balance])
    plastic = operator.temperature(_at_nodes(accumulated, body.mesh.hexes, body.mesh.n_nodes))[:, :, 0]
    warm = operator.temperature(history.theta)[:, :, 0] - parameters["theta_air"]
    tangent, at = np.zeros((len(look.index), plastic.shape[1], 1)), np.zeros(len(look.index), dtype=int)
    for i, step, k in _observed(look, tangents(history, steps.force)):
        released = heat[k] / grown[k] / parameters["c0"] * (plastic[k + 1] - plastic[k]) / change[k]
        then, now = warm[step], warm[look.index[i]]
        left = np.clip(np.divide(now, then, out=np.ones_like(now), where=np.abs(then) > _COLD), 0.0, 1.0)
        tangent[i, :, 0], at[i] = released * (left if look.index[i] > step else 1.0), step
    return _telling(temperature_of(joint.data).averaged(tangent), at, steps, _DOUBT)


def told_error(joint: Joint, parameters: Parameters) -> np.ndarray | None:
    """Error of the prescribed force at all load steps, N (n_steps,), as all channels together tell it: the mean of its modes, given the
    residual. None where it is not known. NumericsError where the run fails."""
    whole = joint.data.steps["all"].error
    if joint.force_error is None or whole is None:
        return None
    model = joint.model
    errors = model.errors(parameters)
    parts = dict(enumerate(c.residual(errors[field_of(c)]) for c in model.comparisons))
    return np.asarray(sum(whole @ common.told(parts) for common in model.common))


def _telling(tangent: np.ndarray, at: np.ndarray, steps: LoadSteps, doubt: float = 0.0) -> ForceModes:
    """Modes of the errors at the steps `at` (n_t,), turned so that the first tell most, without those that tell next to nothing."""
    assert steps.error is not None
    modes = steps.error[at]
    size = np.sqrt(np.mean(tangent**2, axis=(1, 2)))
    _, s, turned = np.linalg.svd(size[:, None] * modes, full_matrices=False)
    kept = turned[s > _TELLS * max(float(s[0]), np.finfo(float).tiny)].T
    return ForceModes(tangent, modes @ kept, kept, doubt)


def _observed(look: Sampler, found: Tangents) -> Iterator[tuple[int, int, int]]:
    """Numbers of observed times after flow has begun, of their last step of flow and of the increment that tells the tangent there."""
    for i, n in enumerate(look.index):
        if found.of[n] >= 0:
            yield i, int(found.step[n]), int(found.of[n])


def _at_nodes(value: np.ndarray, hexes: np.ndarray, n_nodes: int) -> np.ndarray:
    """Nodal means (n_steps, n_nodes) of values (n_steps, n_el, 8) at points."""
    count = np.bincount(hexes.ravel(), minlength=n_nodes)
    of_element = np.repeat(value.mean(axis=2), 8, axis=1)
    return np.array([np.bincount(hexes.ravel(), one, n_nodes) for one in of_element]) / np.maximum(count, 1)


def with_force_error(joint: Joint, history: History, parameters: Parameters) -> Joint:
    """The joint problem that takes the error of its prescribed force for noise; unchanged where that is not known, or no force prescribed.

    `history` is that of the parameters, with its points kept.
    """
    steps = joint.steps.at(history.time)
    if steps.error is None or joint.study.force.drives != "force":
        return joint
    found = {"u": displacement_modes(history, steps, joint.sampler_of("u"), joint.data.displacement)}
    if joint.data.temperature is not None:
        found["theta"] = temperature_modes(joint, history, steps, parameters)
    return replace(joint, force_error=found)
