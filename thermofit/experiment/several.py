"""Parameters and models of several experiments in one fit: which parameters each has for itself, called <param>@<test>, and the residual
of all, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.parameters import AT, Parameters, acting, bare_name
from thermofit.effects.catalogue import KINEMATICS, LOAD, MEASUREMENT, ON_FACETS, effects
from thermofit.experiment.channels import field_of
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.study.study import Study

BOUNDARY = acting("film", "reference")
"""Parameters of the base law that belong to a test and not to the material."""
_SLOTS = (*ON_FACETS, "initial_temperature", *LOAD, *KINEMATICS, *MEASUREMENT)


def own_names(study: Study) -> frozenset[str]:
    """Names of the parameters that every experiment has for itself: boundary and measurement, but for those that the study shares."""
    of_effects = {name for effect in effects(_SLOTS) for name in effect.names}
    return frozenset({*BOUNDARY, *of_effects} - set(study.shared))


def seen_by(parameters: Parameters, part: str) -> Parameters:
    """The parameters as they read for one experiment, without names of any."""
    plain = {name: value for name, value in parameters.values.items() if AT not in name}
    own = {bare_name(name): value for name, value in parameters.values.items() if name.endswith(f"{AT}{part}")}
    return Parameters.of({**plain, **own})


def free_in(names: Sequence[str], part: str) -> dict[str, str]:
    """Which of the names act in an experiment, by what they are called there; a bare name acts in all."""
    own = {bare_name(name) for name in names if name.endswith(f"{AT}{part}")}
    return {name: bare_name(name) for name in names if name.endswith(f"{AT}{part}") or (AT not in name and name not in own)}


def joined(models: dict[str, StageModel]) -> StageModel:
    """Models of several experiments as one, by name of the experiment."""
    exact = all(model.linearise is not None for model in models.values())
    remarks = [f"{name}: {model.remark}" for name, model in models.items() if model.remark]
    places = np.cumsum([0, *(len(model.comparisons) for model in models.values())])[:-1].tolist()
    return StageModel(
        errors=lambda parameters: _errors(models, parameters),
        comparisons=tuple(
            replace(c, channel=f"{c.channel}{AT}{name}", field=f"{field_of(c)}{AT}{name}")
            for name, model in models.items()
            for c in model.comparisons
        ),
        observations={
            f"{field}{AT}{name}": replace(o, name=f"{field}{AT}{name}")
            for name, model in models.items()
            for field, o in model.observations.items()
        },
        remark="; ".join(remarks),
        one_way=any(model.one_way for model in models.values()),
        linearise=(lambda parameters, names: _linearise(models, parameters, names)) if exact else None,
        priors=tuple(replace(p, name=f"{p.name}{AT}{name}") for name, model in models.items() for p in model.priors),
        cheap=all(model.cheap for model in models.values()),
        common=tuple(one.moved(before) for before, model in zip(places, models.values(), strict=True) for one in model.common),
    )


def _errors(models: dict[str, StageModel], parameters: Parameters) -> Errors:
    out: Errors = {}
    for name, model in models.items():
        out |= {f"{field}{AT}{name}": error for field, error in model.errors(seen_by(parameters, name)).items()}
    return out


def _linearise(models: dict[str, StageModel], parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
    """Error fields and derivatives; a parameter of another experiment has no influence."""
    errors: Errors = {}
    slopes: dict[str, np.ndarray] = {}
    for name, model in models.items():
        assert model.linearise is not None
        acting = free_in(names, name)
        column = [k for k, n in enumerate(names) if n in acting]
        found, rates = model.linearise(seen_by(parameters, name), tuple(acting[names[k]] for k in column))
        for field, error in found.items():
            errors[f"{field}{AT}{name}"] = error
            full = np.zeros((*error.shape, len(names)))
            full[..., column] = rates[field]
            slopes[f"{field}{AT}{name}"] = full
    return errors, slopes
