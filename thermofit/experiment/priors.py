"""What was declared before a test, and how well: readings of thermocouples, and that an effect of them is off.

A reading is a datum with an error (errata 13). So is what is declared with it: that one temperature is that of both jaws. An effect that
says otherwise stands for an error of the declaration, and pays for it in the joint objective: one row (value - declared) / sigma. What
happens to the specimen or to a camera (drifts, lamps, films) was not declared, and has none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from thermofit.core.parameters import THERMOCOUPLE as THERMOCOUPLE
from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.effects.catalogue import effects
from thermofit.experiment.model import Prior
from thermofit.study.study import Study

UNLIKELY = 5.0
"""Standard errors off what was declared from which it is no error of that: one in two million readings."""

LANDMARKS = "landmarks of the infrared camera"
"""Cause in a budget: where the camera lies beside the specimen."""
_POSE = "ir_registration."


def prior_sigma(study: Study, name: str) -> float | None:
    """Standard error of the declared value of a parameter: the study's, else that of the Param; None: none."""
    bare = bare_name(name)
    if bare in study.diagnosis.priors:
        return study.diagnosis.priors[bare]
    return param(bare).prior


def priors_of(study: Study, declared: Mapping[str, float]) -> tuple[Prior, ...]:
    """Priors of declared values by parameter, those with a standard error."""
    sigmas = {name: prior_sigma(study, name) for name in declared}
    return tuple(Prior(name, declared[name], sigma) for name, sigma in sigmas.items() if sigma is not None)


def effect_priors(study: Study, registration: Mapping[str, float] | None = None) -> tuple[Prior, ...]:
    """Priors of the amplitudes of effects that a diagnosis may free, about neutral.

    `registration`: standard errors of the pose of the infrared camera by what they are called in `ir_registration`. An error of picked
    landmarks is then one of the measurement that the data have to outweigh. The study's `diagnosis.priors` comes first.
    """
    told = {p.name: p.neutral for e in effects() for p in e.amplitudes if "." in p.name}
    posed = tuple(Prior(n, told[n], s, firm=False) for n, s in (registration or {}).items() if n not in study.diagnosis.priors)
    return (*priors_of(study, told), *posed)


def is_of_pose(name: str) -> bool:
    """Whether a parameter is a number of the pose of an infrared camera."""
    return name.startswith(_POSE)


def pose_bounds(study: Study, registration: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Bounds of the pose of the infrared camera by Param, within which it is fitted with everything else: UNLIKELY standard errors of its
    calibration. Landmarks are picked by hand, so that a camera lies beside the specimen in any test, by their error.

    Empty where a number of the pose has no standard error, or where the study gives one: then it is as given.
    """
    known = {p.name: p for p in effect_priors(study, registration)}
    pose = [p.name for e in effects() for p in e.amplitudes if any(n in e.names for n in registration)]
    if not all(n in known and study.setting(n) is None for n in pose):
        return {}
    return {n: (known[n].value - UNLIKELY * known[n].sigma, known[n].value + UNLIKELY * known[n].sigma) for n in pose}


def contradicted(priors: Sequence[Prior], parameters: Parameters, before: Parameters | None = None) -> tuple[Prior, ...]:
    """Declared values from which parameters lie so far off that no error of the reading explains it.

    `before`: parameters that are taken as they are; what is no worse than there is not held against the new ones.
    """
    return tuple(
        prior
        for prior in priors
        if prior.firm
        and abs(parameters[prior.name] - prior.value)
        > max(UNLIKELY * prior.sigma, prior.sigma + (0.0 if before is None else abs(before[prior.name] - prior.value)))
    )


def improbable(priors: Sequence[Prior], parameters: Parameters, before: Parameters | None = None) -> str:
    """Why parameters cannot be, where one is contradicted by what was declared (`contradicted`); else empty."""
    return next((in_words(prior, parameters[prior.name]) for prior in contradicted(priors, parameters, before)), "")


def in_words(prior: Prior, value: float) -> str:
    """That a value is no error of what was declared."""
    return f"{prior.name} would be {_off(prior, value)}: that is no error of a reading (a larger one is given under diagnosis.priors)"


def off_declared(priors: Sequence[Prior], parameters: Parameters, times: float) -> list[str]:
    """A sentence for every declared value that lies more than so many of its standard errors off."""
    return [
        f"{prior.name} ends at {_off(prior, parameters[prior.name])}: usually an effect of heat or of the measurement is missing, for "
        "which it stands in; the other parameters are then as doubtful"
        for prior in priors
        if prior.firm and abs(parameters[prior.name] - prior.value) > times * prior.sigma
    ]


def _off(prior: Prior, value: float) -> str:
    unit, times = param(prior.name).unit, abs(value - prior.value) / prior.sigma
    return f"{value:.5g} {unit}, {times:.0f} times the standard error of {prior.sigma:.2g} {unit} off the declared {prior.value:.5g} {unit}"
