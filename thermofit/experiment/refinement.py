"""Solution verification: how far mesh and steps in time are from their limits, in every channel and every parameter.

On elements of size h a prediction is p_h = p_0 + C h^p + o(h^p). Three meshes tell the order p and the error of the middle one, which is
that of the study (Richardson); of the steps likewise with the study's own, halved and quartered, on the coarsest of these meshes. The grid
convergence index is the error times a factor of safety: 1.25 where the observed order is near the one of the method, else 3 (Roache 1994,
J. Fluids Eng. 116, 405-413; ASME V&V 20-2009). Sizes are rms over all compared values. A sheet is refined in its plane. Two and four layers
in place of its one tell the error of that, on the coarsest of the meshes too.

The error e of the residual draws fitted parameters off by -J^+ e: by that much all identified parameters, fitted together, would move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from thermofit.core.parameters import Parameters, param
from thermofit.experiment.discretisation import FINER
from thermofit.experiment.model import StageModel
from thermofit.experiment.protocol import Experiment
from thermofit.fit.linear_model import LinearModel
from thermofit.records.progress import progress
from thermofit.study.section import MeshSize, SheetSize

MESH_ORDER = 2.0
"""Order of the elements in displacements and temperatures."""
STEP_ORDER = 1.0
"""Order of the backward Euler steps of plasticity and heat."""
LAYERS = (2, 4)
"""Layers of elements over half the thickness that tell the error of a sheet."""
_NEAR = 0.5
"""An observed order within this part of the expected one is near it."""
_LOWEST = 0.5
"""An order below it is not used: it would make any difference an enormous error."""
_SAFE, _UNSAFE = 1.25, 3.0


@dataclass(frozen=True)
class Error:
    """Error (n,) of a residual by one kind of refinement, the orders by channel that it shows (nan: none), and factors of safety."""

    residual: np.ndarray
    order: Mapping[str, float]
    safety: Mapping[str, float]


@dataclass(frozen=True)
class Refinement:
    """Rows of the tables of channels and of parameters, each with what mesh and steps make, and the number of forward runs."""

    channels: list[dict[str, Any]]
    parameters: list[dict[str, Any]]
    forward: int


def coarser_mesh(size: MeshSize) -> MeshSize:
    """The mesh with 1/FINER as many elements along each axis, rounded down but at least one, along the load an even number."""
    counts = {axis: max(int(n / FINER), 1) for axis, n in size.counts.items()}
    return size.with_counts({**counts, "n_y": 2 * max(int(0.5 * size.n_y / FINER), 1)})


def spacing(size: MeshSize) -> float:
    """Representative size of an element, (n_x n_y n_z)^(-1/3), of a sheet (n_x n_y)^(-1/2)."""
    counts = list(size.counts.values())
    return float(np.prod(counts)) ** (-1.0 / len(counts))


def observed_order(coarse: float, fine: float, h: tuple[float, float, float]) -> float:
    """Order p of |p_h1 - p_h2| = `coarse` and |p_h2 - p_h3| = `fine` on sizes h1 > h2 > h3; nan where the differences do not fall so that
    any order from 0.05 to 10 explains them."""
    if not (coarse > 0.0 and fine > 0.0):
        return float("nan")

    def excess(p: float) -> float:
        return float((h[0] ** p - h[1] ** p) / (h[1] ** p - h[2] ** p) - coarse / fine)

    return float(brentq(excess, 0.05, 10.0)) if excess(0.05) * excess(10.0) < 0.0 else float("nan")


def error_of(difference: np.ndarray, h: float, finer: float, order: float) -> np.ndarray:
    """Error (n,) on elements or steps of size `h` from p_h - p_finer, for a given order."""
    return np.asarray(difference / (1.0 - (finer / h) ** order))


def refinement(experiment: Experiment, parameters: Parameters, size: MeshSize, sigmas: Mapping[str, float | None]) -> Refinement:
    """Errors of mesh, steps and layer at given parameters, on the mesh of the study; `sigmas`: standard errors of what was identified.

    NumericsError where a run fails.
    """
    settings = experiment.joint_settings()
    names = tuple(name for name in settings.free if name in parameters.values)

    def model(mesh: MeshSize, parts: int) -> StageModel:
        return experiment.with_steps(parts).joint(settings, parameters.with_free(names), mesh).model

    meshes = (coarser_mesh(size), size, experiment.finer(size)) if experiment.scalable else ()
    least = meshes[0] if meshes else size
    runs = [(least, 1), (least, 2), (least, 4), *((mesh, 1) for mesh in meshes[1:])]
    layered = len(runs)
    if isinstance(least, SheetSize):
        runs += [(MeshSize(n_x=least.n_x, n_y=least.n_y, n_z=n), 1) for n in LAYERS]
    own = model(least, 1)
    with progress("refinement", len(runs) + 1) as advance:
        found = []
        for mesh, parts in runs:
            found.append((own if (mesh, parts) == runs[0] else model(mesh, parts)).residual(parameters))
            advance()
        columns = own.linearised(parameters, names)[1] if names and own.linearise is not None else None
        advance()
    errors = {"steps": _error(own, [found[0], found[1], found[2]], (1.0, 0.5, 0.25), STEP_ORDER, of=0)}
    if meshes:
        h = (spacing(meshes[0]), spacing(meshes[1]), spacing(meshes[2]))
        errors["mesh"] = _error(own, [found[0], found[3], found[4]], h, MESH_ORDER, of=1)
    if layers := found[layered:]:
        errors["sheet"] = _error(own, [found[0], *layers], (1.0, 1.0 / LAYERS[0], 1.0 / LAYERS[1]), MESH_ORDER, of=0)
    shifts = {}
    if columns is not None:
        shifts = {kind: LinearModel(e.residual, columns).free_step * max(e.safety.values()) for kind, e in errors.items()}
    return Refinement(_channel_rows(own, errors), _parameter_rows(names, parameters, shifts, sigmas), len(runs) + 1)


def _error(model: StageModel, found: list[np.ndarray], h: tuple[float, float, float], expected: float, of: int) -> Error:
    """Error of the one at place `of` of three residuals on sizes h1 > h2 > h3, channel by channel."""
    out, orders, safeties = np.zeros_like(found[0]), {}, {}
    for channel, rows in model.places.items():
        first, second, third = (r[rows] for r in found)
        sizes = (float(np.linalg.norm(first - second)), float(np.linalg.norm(second - third)))
        order = observed_order(*sizes, h)
        near = bool(abs(order - expected) <= _NEAR * expected)
        used = float(np.clip(order, _LOWEST, expected)) if np.isfinite(order) else expected
        difference = (first - second, second - third)[of]
        out[rows] = error_of(difference, h[of], h[of + 1], used)
        orders[channel], safeties[channel] = order, _SAFE if near else _UNSAFE
    return Error(out, orders, safeties)


def _channel_rows(model: StageModel, errors: Mapping[str, Error]) -> list[dict[str, Any]]:
    rows = []
    for comparison in model.comparisons:
        channel, place = comparison.channel, model.places[comparison.channel]
        row: dict[str, Any] = {"channel": channel, "unit": comparison.unit}
        for kind, error in errors.items():
            whitened = error.residual[place]
            size = float(np.sqrt(np.mean(whitened**2 / comparison.weight)))
            row |= {
                f"{kind}_error": size,
                f"{kind}_order": error.order[channel],
                f"{kind}_index": error.safety[channel] * size,
                f"{kind}_over_noise": float(np.sqrt(np.mean((whitened / comparison.spread) ** 2))),
            }
        rows.append(row)
    return rows


def _parameter_rows(
    names: tuple[str, ...], parameters: Parameters, shifts: Mapping[str, np.ndarray], sigmas: Mapping[str, float | None]
) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for k, name in enumerate(names if shifts else ()):
        sigma = sigmas.get(name)
        row: dict[str, Any] = {"parameter": name, "unit": param(name).unit, "value": parameters[name], "sigma": sigma}
        row |= {f"{kind}_index": float(abs(shift[k])) for kind, shift in shifts.items()}
        total = float(np.linalg.norm([row[f"{kind}_index"] for kind in shifts]))
        rows.append({**row, "over_sigma": total / sigma if sigma else None})
    return rows
