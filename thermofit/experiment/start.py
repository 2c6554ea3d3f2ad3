"""A start that can carry the measured force: plastic parameters read off the mean stress-stretch curve.

Under a prescribed force a set of parameters whose largest force lies below the measured one has no equilibrium at all. Such a
start is replaced by the uniaxial closed form (loading along 2, r = sqrt(F + H)): M_22 = P_22 lambda_y, plastic stretches
exp(r Lambda) along y and exp(-F Lambda / r) along x, M_22 = (M_y0 + (M_yinf - M_y0)(1 - exp(-H_exp Lambda))) / r.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured
from thermofit.law.page import in_model_axes
from thermofit.observe.observation import FieldObservation
from thermofit.study.study import Study
from thermofit.virtual.machine import bar_of, uniaxial_law

HARDENING = ("M_y0", "M_yinf", "H_exp")
_MARGIN = 1.005
_RAISE = 1.005
_LEAST_STAGES = 5
_POINTS = 2001
"""Of the law's table: the largest force is compared with a margin of half a per cent."""


def mean_strain(observation: FieldObservation, component: int) -> np.ndarray:
    """Mean du_i/dx_i over the window (n_t,): least squares of the displacement over its own coordinate."""
    out = np.full(len(observation.time), np.nan)
    for n in range(len(observation.time)):
        used = observation.mask[n]
        if used.sum() >= 3:
            x = observation.xy[used, component]
            x = x - x.mean()
            out[n] = x @ observation.value[n, used, component] / (x @ x)
    return out


def carries(study: Study, data: Measured, parameters: Parameters) -> bool:
    """True where the largest force of the specimen with these parameters lies above the measured one."""
    law = uniaxial_law(in_model_axes(parameters, study.material_axes.angle), study.model, _POINTS)
    capacity = bar_of(data.specimen, law).capacity
    return bool(capacity > _MARGIN * float(np.max(data.steps["displacement"].force)))


def feasible_start(study: Study, data: Measured, parameters: Parameters) -> tuple[Parameters, str]:
    """The given start where it can carry the measured force; else its free plastic parameters read off the mean curve, and a remark.

    NumericsError where the curve gives no usable start either.
    """
    plastic = [name for name in (*HARDENING, "F") if name in parameters.free]
    if not plastic or study.force.drives != "force" or carries(study, data, parameters):
        return parameters, ""
    found = _read_off(study, data, parameters)
    while not carries(study, data, found) and "M_yinf" in plastic and found["M_yinf"] < study.bounds("M_yinf")[1]:
        # A mean curve that the law does not fit to its end may fall short of the largest force.
        found = found.replace(M_yinf=min(_RAISE * found["M_yinf"], study.bounds("M_yinf")[1]))
    if not carries(study, data, found):
        raise NumericsError(
            f"start of {', '.join(plastic)}: it cannot carry the measured {np.max(data.steps['displacement'].force):.0f} N, nor can "
            "what the mean stress-stretch curve suggests; raise parameters.M_yinf or widen its bounds"
        )
    values = ", ".join(f"{name} = {found[name]:.4g}" for name in plastic)
    return found, f"the start cannot carry the measured force; replaced by {values} from the mean stress-stretch curve"


def _read_off(study: Study, data: Measured, parameters: Parameters) -> Parameters:
    observation, steps = data.displacement, data.steps["displacement"]
    force = np.interp(observation.time, steps.time, steps.force)
    stretch = [1.0 + mean_strain(observation, c) for c in (0, 1)]
    mandel = force / (data.specimen.gauge_width * data.specimen.thickness) * stretch[1]
    plastic = [np.log(stretch[1]) - mandel / parameters["E"], np.log(stretch[0]) + parameters["nu"] * mandel / parameters["E"]]
    use = (force >= np.maximum.accumulate(force) * 0.999) & (plastic[0] > 2e-3) & np.isfinite(plastic[0] + plastic[1])
    if use.sum() < _LEAST_STAGES:
        raise NumericsError(
            f"start: only {int(use.sum())} stages lie on the plastic loading curve, {_LEAST_STAGES} are needed; raise parameters.M_yinf"
        )
    along, across, mandel = plastic[0][use], plastic[1][use], mandel[use]
    across_thickness = in_model_axes(parameters, study.material_axes.angle)["H"]
    if "F" in parameters.free:
        share = float(np.clip(-(across @ along) / (along @ along), 0.05, 0.95))  # F/(F + H)
        parameters = parameters.replace(F=float(np.clip(across_thickness * share / (1.0 - share), *study.bounds("F"))))
    r = float(np.sqrt(parameters["F"] + across_thickness))
    multiplier = along / r
    names = [name for name in HARDENING if name in parameters.free]
    if not names:
        return parameters
    bounds = np.array([study.bounds(name) for name in names])
    scale = np.array([study.scale(name) for name in names])

    def error(x: np.ndarray) -> np.ndarray:
        p = parameters.replace(**dict(zip(names, x * scale, strict=True)))
        model = p["M_yinf"] - (p["M_yinf"] - p["M_y0"]) * np.exp(-p["H_exp"] * multiplier) + p["H_lin"] * multiplier
        return model / r - mandel

    start = np.array([np.clip(parameters[name], *study.bounds(name)) for name in names]) / scale
    fit = least_squares(
        error, np.clip(start, bounds[:, 0] / scale * (1 + 1e-9), bounds[:, 1] / scale * (1 - 1e-9)), bounds=(bounds / scale[:, None]).T
    )
    return parameters.replace(**dict(zip(names, (fit.x * scale).tolist(), strict=True)))
