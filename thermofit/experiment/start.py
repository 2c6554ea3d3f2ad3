"""A start that can carry the measured force: plastic parameters read off the mean stress-stretch curve.

Under a prescribed force a set of parameters whose largest force lies below the measured one has no equilibrium at all. Such a
start is replaced by the uniaxial closed form (loading along 2, r = sqrt(F + H)): M_22 = P_22 lambda_y, plastic stretches
exp(r Lambda) along y and exp(-F Lambda / r) along x, M_22 = sigma_y(Lambda) / r with the curve of the hardening law.

A displacement drives any law. From one that is far off the mean curve a fit may end in a valley of its own: such a start is replaced as
well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured, displacement_of
from thermofit.experiment.window import elastic_slope
from thermofit.law.hardening.catalogue import hardening
from thermofit.law.hardening.curves import fitted_to_curve
from thermofit.law.page import along_tension, in_model_axes
from thermofit.observe.observation import FieldObservation
from thermofit.records.staging import Note
from thermofit.study.geometry import STRAIGHT
from thermofit.study.study import Study
from thermofit.virtual.machine import bar_of, uniaxial_law

_MARGIN = 1.005
STRONGER = (1.002, 1.01, 1.04)
"""Factors of the yield stress that are tried in turn where a mesh carries a little less than another."""
_RAISE = 1.005
_OFF = 0.02
"""Part of the stress by which a start may miss the mean curve (rms) where a displacement drives; by judgement. `softening-squared` of steel
was in view (docs/other-causes.md)."""
_BEYOND, _SURE = 1.25, 3.0
"""Factor, and standard errors, by which the elastic slope must lie beyond a bound of E before that is refused."""
_LEAST_STAGES = 5
_POINTS = 2001
"""Of the law's table: the largest force is compared with a margin of half a per cent."""


def mean_strain(observation: FieldObservation, component: int) -> np.ndarray:
    """Mean du_i/dx_i over the window (n_t,): least squares of the displacement over its own coordinate."""
    out, place = np.full(len(observation.time), np.nan), observation.place
    for n in range(len(observation.time)):
        used = observation.mask[n]
        if used.sum() >= 3:
            x = place[n, used, component]
            x = x - x.mean()
            out[n] = x @ observation.value[n, used, component] / (x @ x)
    return out


def carries(study: Study, data: Measured, parameters: Parameters) -> bool:
    """True where the largest force of the specimen with these parameters lies above the measured one."""
    law = uniaxial_law(in_model_axes(parameters, study.material_axes.angle, study.slots), study.slots, _POINTS)
    capacity = bar_of(data.specimen, law).capacity
    return bool(capacity > _MARGIN * float(np.max(data.steps["displacement"].force)))


def feasible_start(study: Study, data: Measured, parameters: Parameters) -> tuple[Parameters, str]:
    """The given start where it can carry the measured force; else its free plastic parameters read off the mean curve, and a remark. Where
    a displacement drives, the given start where it is near the mean curve, or that does not tell another one.

    NumericsError where the curve gives no usable start either, StudyError where E could only end at its bound.
    """
    _check_modulus(study, data, parameters)
    own = hardening(study.hardening_law)
    plastic = [name for name in (*own.fitted, "F") if name in parameters.free]
    if not plastic:
        return parameters, ""
    if study.force.drives != "force":
        return _near_curve(study, data, parameters, plastic)
    if carries(study, data, parameters):
        return parameters, ""
    found = _carrying(study, data, _read_off(study, data, parameters), [name for name in own.raises if name in plastic])
    if not carries(study, data, found):
        raise NumericsError(
            f"start values of {', '.join(plastic)} are too weak for the measured {np.max(data.steps['displacement'].force):.0f} N, and so "
            f"are those of the mean stress-stretch curve; raise parameters.{own.raises[0]} or widen its bounds"
        )
    values = ", ".join(f"{name} = {found[name]:.4g}" for name in plastic)
    return found, Note(f"start values are too weak for the measured force; used are {values} from the mean stress-stretch curve")


def _near_curve(study: Study, data: Measured, parameters: Parameters, plastic: Sequence[str]) -> tuple[Parameters, str]:
    """The given start where it is near the mean curve, or the law does not come nearer; else what that says, and a remark."""
    try:
        found = _read_off(study, data, parameters)
    except NumericsError:  # too little flow to tell a curve: any start is as good
        return parameters, ""
    off, left = (_miss(study, data, p) for p in (parameters, found))
    if off <= max(_OFF, left):
        return parameters, ""
    values = ", ".join(f"{name} = {found[name]:.4g}" for name in plastic)
    return found, Note(f"start values are {100.0 * off:.2g} % off the mean stress-stretch curve; used are {values} from that curve")


def _miss(study: Study, data: Measured, parameters: Parameters) -> float:
    """Part of the stress by which the law misses the mean curve, rms."""
    along, _, mandel = _mean_curve(study, data, parameters)
    r, _ = along_tension(in_model_axes(parameters, study.material_axes.angle, study.slots), study.slots)
    said = hardening(study.hardening_law).curve(parameters, along / r) / r
    return float(np.linalg.norm(said - mandel) / np.linalg.norm(mandel))


def _check_modulus(study: Study, data: Measured, parameters: Parameters) -> None:
    """The elastic slope of a straight specimen beside the bounds of a free E, before an identification is spent on finding the bound."""
    if "E" not in parameters.free or study.geometry.shape not in STRAIGHT or (found := elastic_slope(data)) is None:
        return
    slope, sigma = found
    low, high = study.bounds("E")
    if low / _BEYOND - _SURE * sigma < slope < high * _BEYOND + _SURE * sigma:
        return
    raise StudyError(
        f"{study.source.name}: key 'parameters.E': the elastic slope of the data is {slope:.3g} MPa, the bounds are {low:g} to {high:g}: "
        "E would end at its bound; widen the bounds, or check thickness, width and the unit of the force"
    )


def other_starts(study: Study, data: Measured, parameters: Parameters) -> Iterator[tuple[str, Parameters]]:
    """Starts in turn for a mesh on which the given one cannot carry the measured force: a little stronger ones, then what the mean curve
    says; none where the force does not drive or nothing plastic is free."""
    own = hardening(study.hardening_law)
    raised = [name for name in own.raises if name in parameters.free]
    if not raised or study.force.drives != "force":
        return
    for factor in STRONGER:
        stronger = {name: min(factor * parameters[name], study.bounds(name)[1]) for name in raised}
        yield f"with {', '.join(raised)} {100.0 * (factor - 1.0):.3g} % higher", parameters.replace(**stronger)
    try:
        yield "from the mean stress-stretch curve", _carrying(study, data, _read_off(study, data, parameters), raised)
    except NumericsError:
        return


def _carrying(study: Study, data: Measured, found: Parameters, raised: Sequence[str]) -> Parameters:
    """The parameters with the named ones raised until the largest force is carried, or a bound reached: a mean curve that the law does not
    fit to its end may fall short of it."""
    while not carries(study, data, found) and any(found[name] < study.bounds(name)[1] for name in raised):
        found = found.replace(**{name: min(_RAISE * found[name], study.bounds(name)[1]) for name in raised})
    return found


def _mean_curve(study: Study, data: Measured, parameters: Parameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logarithmic plastic strain along and across the load, and Mandel stress MPa, (n,) each, of the stages in which the force grows.
    NumericsError where there are too few."""
    observation, steps = displacement_of(data), data.steps["displacement"]
    force = np.interp(observation.time, steps.time, steps.force)
    stretch = [1.0 + mean_strain(observation, c) for c in (0, 1)]
    mandel = force / (data.specimen.gauge_width * data.specimen.thickness) * stretch[1]
    plastic = [np.log(stretch[1]) - mandel / parameters["E"], np.log(stretch[0]) + parameters["nu"] * mandel / parameters["E"]]
    use = (force >= np.maximum.accumulate(force) * 0.999) & (plastic[0] > 2e-3) & np.isfinite(plastic[0] + plastic[1])
    if use.sum() < _LEAST_STAGES:
        raise NumericsError(
            f"start: only {int(use.sum())} stages lie on the plastic loading curve, {_LEAST_STAGES} are needed; raise "
            f"parameters.{hardening(study.hardening_law).raises[0]}"
        )
    return plastic[0][use], plastic[1][use], mandel[use]


def _read_off(study: Study, data: Measured, parameters: Parameters) -> Parameters:
    """The parameters with the free ones of the hardening law, and F, as the mean curve says. NumericsError where that is too short."""
    own = hardening(study.hardening_law)
    along, across, mandel = _mean_curve(study, data, parameters)
    if "F" in parameters.free:
        across_thickness = in_model_axes(parameters, study.material_axes.angle)["H"]
        share = float(np.clip(-(across @ along) / (along @ along), 0.05, 0.95))  # F/(F + H)
        parameters = parameters.replace(F=float(np.clip(across_thickness * share / (1.0 - share), *study.bounds("F"))))
    r, _ = along_tension(in_model_axes(parameters, study.material_axes.angle, study.slots), study.slots)
    multiplier = along / r
    names = [name for name in own.fitted if name in parameters.free]
    if not names:
        return parameters
    bounds, scale = {name: study.bounds(name) for name in names}, {name: study.scale(name) for name in names}
    return parameters.replace(**fitted_to_curve(own, multiplier, mandel, parameters, bounds, scale, over=r))
