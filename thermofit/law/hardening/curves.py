"""A hardening law fitted to a curve of yield stress over plastic strain: starts of an identification, also of one law from another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from thermofit.core.parameters import param
from thermofit.law.hardening.catalogue import LINEAR, Hardening

Bounds = Mapping[str, tuple[float, float]]
_INSIDE = 1e-9
_SAMPLES = 60
_FROM, _TO = 1e-4, 0.2
"""Plastic strains between which one law takes over the curve of another, as many samples in each decade."""


def fitted_to_curve(
    law: Hardening,
    accumulated: np.ndarray,
    stress: np.ndarray,
    values: Any,
    bounds: Bounds,
    scale: Mapping[str, float],
    *,
    over: float = 1.0,
) -> dict[str, float]:
    """Values by name, those of `bounds` fitted to stresses (n,) MPa at Lambda (n,) by least squares; a stress is sigma_y / `over`.

    `values[name]` gives the start, and the value of what is not fitted; `scale` the usual size of a fitted one.
    """
    names = list(bounds)
    limits, size = np.array([bounds[name] for name in names]), np.array([scale[name] for name in names])

    def error(x: np.ndarray) -> np.ndarray:
        return law.curve({**_all(law, values), **dict(zip(names, x * size, strict=True))}, accumulated) / over - stress

    start = np.array([np.clip(values[name], *bounds[name]) for name in names]) / size
    inside = np.clip(start, limits[:, 0] / size * (1 + _INSIDE), limits[:, 1] / size * (1 - _INSIDE))
    found = least_squares(error, inside, bounds=(limits / size[:, None]).T)
    return dict(zip(names, (found.x * size).tolist(), strict=True))


def _all(law: Hardening, values: Any) -> dict[str, float]:
    return {name: values[name] for name in dict.fromkeys((*law.names, *law.fitted, LINEAR))}


def first_guess(law: Hardening, accumulated: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    """Values by name of what the law frees, and of its own Params, from a rising curve: yield stress (n,) MPa at Lambda (n,)."""
    guess = law.file.first_guess(accumulated, stress)
    values = {name: guess.get(name, param(name).neutral) for name in (*law.names, *law.fitted, LINEAR)}
    bounds = {name: (param(name).lower, param(name).upper) for name in law.fitted}
    fitted = fitted_to_curve(law, accumulated, stress, values, bounds, {name: param(name).scale for name in law.fitted})
    found = {**guess, **fitted}
    return guess if law.error({**values, **found}) else found


def taken_over(law: Hardening, other: Hardening, values: Any) -> dict[str, float]:
    """Values by name of a law that follows the curve that another one has by `values[name]`. Linear hardening beside them stays as it is,
    unless it is what the law frees."""
    accumulated = np.concatenate([[0.0], np.geomspace(_FROM, _TO, _SAMPLES)])
    stress = other.curve(values, accumulated)
    if LINEAR not in law.fitted:
        stress = stress - values[LINEAR] * accumulated
    return first_guess(law, accumulated, stress)
