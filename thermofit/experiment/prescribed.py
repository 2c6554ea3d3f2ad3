"""What a test prescribes and somebody has measured: by how much its error moves parameters of the model that stand for it.

An error of the load cell is the gain of the effect `force_scale`, one of the displacements' scale that of `dic_scale`, one of temperature
differences in the image that of `ir_gain`. A specimen that is thicker by a part e than was measured feels F / (1 + e): its thickness acts
as a gain -e of the force, and its surface, 2 (w + t) / (w t) per volume, gives off less heat by e w / (w + t). The width likewise.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from thermofit.core.experiment import Specimen
from thermofit.core.parameters import AT, THERMOCOUPLES, Parameters, bare_name, param
from thermofit.experiment.channels import field_of
from thermofit.experiment.priors import prior_sigma
from thermofit.study.study import Study

CALIBRATION, AREA_THICKNESS, AREA_WIDTH, SCALE, INFRARED = "force calibration", "thickness", "width", "camera scale", "infrared gain"
_GAIN, _SCALE, _INFRARED = "force_scale.gain", "dic_scale.error", "ir_gain.gain"
_OF_FORCE = ("MPa", "mW/(mm K)", "mJ/(mm^3 K)", "W/(m^2 K)", "mJ/mm^3", "mW/mm^2")
"""Units that hold a force: a law in which all parameters of these units are larger by a part e needs a force larger by e, for the same
strains and temperatures."""

Moved = Mapping[str, float]
"""By how much parameters move for one standard error of a cause."""


def calibration(study: Study) -> float:
    """Relative standard uncertainty of the force by the class of the machine, whose limits are those of a uniform distribution (JCGM 100,
    4.3.7); 0 where none is stated."""
    return 0.0 if study.uncertainty.force_class is None else 0.01 * study.uncertainty.force_class / float(np.sqrt(3.0))


def of_specimen(study: Study, specimen: Specimen, parameters: Parameters) -> dict[str, Moved]:
    """Causes for a specimen under cameras; what is free in the fit is no cause."""
    told, w, t = study.uncertainty, specimen.gauge_width, specimen.thickness
    found: dict[str, Moved] = {}
    if told.force_class is not None:
        found[CALIBRATION] = {_GAIN: calibration(study)}
    if told.thickness is not None:
        e = told.thickness / t
        found[AREA_THICKNESS] = {_GAIN: -e, "alpha_air": -e * w / (w + t) * parameters["alpha_air"]}
    if told.width is not None:
        e = told.width / w
        found[AREA_WIDTH] = {_GAIN: -e, "alpha_air": -e * t / (w + t) * parameters["alpha_air"]}
    if told.camera_scale is not None:
        found[SCALE] = {_SCALE: told.camera_scale}
    if told.infrared_gain is not None:
        found[INFRARED] = {_INFRARED: told.infrared_gain}
    found |= stated(study, parameters)
    for name in THERMOCOUPLES:
        sigma = prior_sigma(study, name)
        if sigma is not None:
            found[name] = {name: sigma}
    free = {bare_name(name) for name in parameters.free}
    return {cause: moved for cause, moved in found.items() if not {cause, *moved} & (free & {*THERMOCOUPLES, _GAIN, _SCALE, _INFRARED})}


def counted_as_exact(study: Study, channels: Collection[str], free: Collection[str], *, records: bool) -> tuple[str, ...]:
    """Keys of `uncertainty` that a study does not state although they act in what is compared, and although what stands for them is not
    among the `free` parameters; `records`: of coupons, which have no cameras and no area."""
    seen, fitted = {field_of(bare_name(channel)) for channel in channels}, {bare_name(name) for name in free}
    stands = {"force_class": _GAIN} if records else {"force_class": _GAIN, "thickness": _GAIN, "width": _GAIN}
    if not records:
        stands |= {"camera_scale": _SCALE} if "u" in seen else {}
        stands |= {"infrared_gain": _INFRARED} if "theta" in seen else {}
    return tuple(key for key, name in stands.items() if name not in fitted and getattr(study.uncertainty, key) is None)


def stated(study: Study, parameters: Parameters) -> dict[str, Moved]:
    """Stated errors of parameters that the study prescribes, each a cause of its own; what is free is not prescribed."""
    free = {bare_name(name) for name in parameters.free}
    return {name: {name: sigma} for name, sigma in study.uncertainty.parameters.items() if name not in free}


def not_told(found: Mapping[str, Moved], earlier: Collection[str]) -> dict[str, Moved]:
    """The causes without those of parameters that `earlier` stages have told: these come with the noise of their stage."""
    return {cause: moved for cause, moved in found.items() if not set(moved) <= set(earlier)}


def of_records(study: Study, parameters: Parameters) -> dict[str, Moved]:
    """Causes for records of coupons: a force larger by e asks for all parameters of a unit of force to be so."""
    e, found = calibration(study), stated(study, parameters)
    if not e:
        return found
    values = {name: value for name, value in parameters.values.items() if param(name).unit in _OF_FORCE and value != 0.0}
    return found | {CALIBRATION: {name: -e * value for name, value in values.items()}}


def of_test(found: Mapping[str, Moved], test: str, own: frozenset[str]) -> dict[str, Moved]:
    """The causes of one of several tests by the names of their fit: `own` parameters are those of that test alone. The error of a parameter
    that all share is one cause."""
    return {
        cause if set(moved) == {cause} and cause not in own else f"{cause}{AT}{test}": {
            f"{name}{AT}{test}" if name in own else name: by for name, by in moved.items()
        }
        for cause, moved in found.items()
    }


def columns(found: Mapping[str, Moved], names: tuple[str, ...], slopes: np.ndarray) -> dict[str, np.ndarray]:
    """What one standard error of every cause makes of the residual (n, 1), from its derivatives (n, n_names) by named parameters."""
    return {cause: np.sum([by * slopes[:, [names.index(name)]] for name, by in moved.items()], axis=0) for cause, moved in found.items()}


def acting(found: Mapping[str, Moved]) -> tuple[str, ...]:
    """Names of the parameters that the causes move."""
    return tuple(dict.fromkeys(name for moved in found.values() for name in moved))
