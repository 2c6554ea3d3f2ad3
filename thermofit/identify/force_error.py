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

from thermofit.core.parameters import Parameters
from thermofit.fem.history import History
from thermofit.identify.forward import Sampler
from thermofit.identify.joint import Joint

_LEAST = 1e-7
"""Part of the largest force by which it changes at least in a step that tells a tangent."""


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


def displacement_modes(history: History, force: np.ndarray, modes: np.ndarray, look: Sampler) -> np.ndarray:
    """Displacements (n_t, n_s, 2, k) mm at the observed times that modes (n_steps, k) N of the error of the force (n_steps,) N make."""
    u, change = look.operator.displacement(history.u), np.diff(force)
    out = np.zeros((len(look.index), *u.shape[1:], modes.shape[1]))
    for i, step, k in _observed(look, tangents(history, force)):
        out[i] = ((u[k + 1] - u[k]) / change[k])[:, :, None] * modes[step]
    return out


def temperature_modes(joint: Joint, history: History, modes: np.ndarray, parameters: Parameters) -> np.ndarray:
    """Temperatures (n_t, n_s, 1, k) K at the observed times that modes (n_steps, k) N of the error of the force make."""
    look, force = joint.sampler_of("theta"), joint.steps.at(history.time).force
    mesh, operator = joint.run.body.mesh, look.operator
    volume = joint.run.body.data.volume
    found, change = tangents(history, force), np.diff(force)
    accumulated = np.array([p.accumulated for p in history.points])
    grown = np.einsum("neq,eq->n", np.diff(accumulated, axis=0), volume) * joint.run.body.symmetry
    heat = np.array([b.dissipated for b in history.balance])
    plastic = operator.temperature(_at_nodes(accumulated, mesh.hexes, mesh.n_nodes))[:, :, 0]
    warm = operator.temperature(history.theta)[:, :, 0] - parameters["theta_air"]
    out = np.zeros((len(look.index), plastic.shape[1], 1, modes.shape[1]))
    for i, step, k in _observed(look, found):
        released = heat[k] / grown[k] / parameters["c0"] * (plastic[k + 1] - plastic[k]) / change[k]
        then, now = warm[step], warm[look.index[i]]
        left = np.clip(np.divide(now, then, out=np.ones_like(now), where=np.abs(then) > 1e-3), 0.0, 1.0) if look.index[i] > step else 1.0
        out[i, :, 0] = (released * left)[:, None] * modes[step]
    return out


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
    found = {"u": displacement_modes(history, steps.force, steps.error, joint.sampler_of("u"))}
    if joint.data.temperature is not None:
        found["theta"] = temperature_modes(joint, history, steps.error, parameters)
    return replace(joint, force_error=found)
