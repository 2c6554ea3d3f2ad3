"""Several experiments in one fit: shared material parameters, every test with its own boundary and measurement parameters.

The own parameters of a test are called <param>@<test>. The residual of the joint fit is that of all tests, one after the other; every
test is modelled as if it were alone, with the parameters as they read for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thermofit.core.parameters import AT, Parameters, acting, bare_name
from thermofit.effects.catalogue import KINEMATICS, LOAD, MEASUREMENT, ON_FACETS, effects
from thermofit.experiment.channels import field_of
from thermofit.experiment.coupon_records import CouponData
from thermofit.experiment.fields import INTERPOLATE, Measured, measured_of, start_parameters
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.start import feasible_start
from thermofit.records.staging import artefact_path
from thermofit.records.stale import read_current
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

BOUNDARY = acting("film", "reference")
"""Parameters of the base law that belong to a test and not to the material."""
_SLOTS = (*ON_FACETS, "initial_temperature", *LOAD, *KINEMATICS, *MEASUREMENT)


@dataclass(frozen=True)
class Part:
    """One experiment: its name, the study as it reads for it, what was measured."""

    name: str
    study: Study
    data: Measured


@dataclass(frozen=True)
class Several:
    """All fitted experiments of a study, and the names of the parameters that each has for itself."""

    parts: tuple[Part, ...]
    own: frozenset[str]

    @property
    def theta_air(self) -> float:
        """Air of the first experiment, K; every other has its own."""
        return self.parts[0].data.theta_air

    @property
    def theta_clamp(self) -> float:
        """Jaws of the first experiment, K; every other has its own."""
        return self.parts[0].data.theta_clamp

    @property
    def correlation_length(self) -> float:
        """The largest one of all experiments, mm."""
        return max(part.data.correlation_length for part in self.parts)


def own_names(study: Study) -> frozenset[str]:
    """Names of the parameters that every experiment has for itself: boundary and measurement, but for those that the study shares."""
    of_effects = {name for effect in effects(_SLOTS) for name in effect.names}
    return frozenset({*BOUNDARY, *of_effects} - set(study.shared))


def interpolate_paths(study: Study, names: Sequence[str]) -> dict[str, Path]:
    """Artefacts of `interpolate` of the named experiments, by <stage>@<experiment>."""
    return {f"{INTERPOLATE}{AT}{name}": artefact_path(study.run_dir / name, INTERPOLATE) for name in names}


def part_of(study: Study, name: str) -> Part:
    """One experiment, fitted or held out. StudyError that names the command where it has not been interpolated."""
    path = interpolate_paths(study, [name])[f"{INTERPOLATE}{AT}{name}"]
    return Part(name, study.one_of(name), measured_of(read_current(path, INTERPOLATE, study.source.name)))


def several(study: Study) -> Several:
    """All fitted experiments of a study; StudyError as `part_of`."""
    return Several(tuple(part_of(study, name) for name in study.fitted), own_names(study))


def several_start(study: Study, data: Several) -> Parameters:
    """Start values: the common ones, and for every experiment its own where they differ."""
    values = dict(start_parameters(study, data).values)
    for part in data.parts:
        here = start_parameters(part.study, part.data)
        values |= {f"{name}{AT}{part.name}": here[name] for name in data.own if here[name] != values.get(name, here[name])}
    return Parameters.of(values)


def expanded(free: Sequence[str], data: Several) -> tuple[str, ...]:
    """Free parameters of the joint fit: one for every experiment of those that each has for itself."""
    out: list[str] = []
    for name in free:
        out += [f"{name}{AT}{part.name}" for part in data.parts] if name in data.own else [name]
    return tuple(dict.fromkeys(out))


def spread(values: Mapping[str, float], data: object) -> dict[str, float]:
    """Given values by the names of the joint fit: what each experiment has for itself gets the value in each."""
    if not isinstance(data, Several):
        return dict(values)
    return {full: value for name, value in values.items() for full in expanded([name], data)}


def seen_by(parameters: Parameters, part: str) -> Parameters:
    """The parameters as they read for one experiment, without names of any."""
    plain = {name: value for name, value in parameters.values.items() if AT not in name}
    own = {bare_name(name): value for name, value in parameters.values.items() if name.endswith(f"{AT}{part}")}
    return Parameters.of({**plain, **own})


def free_in(names: Sequence[str], part: str) -> dict[str, str]:
    """Which of the names act in an experiment, by what they are called there; a bare name acts in all."""
    own = {bare_name(name) for name in names if name.endswith(f"{AT}{part}")}
    return {name: bare_name(name) for name in names if name.endswith(f"{AT}{part}") or (AT not in name and name not in own)}


Maker = Callable[[Part, StageSettings, Parameters], StageModel]
"""The model of one experiment: its part, the settings with the names that are free there, its parameters."""


def several_model(data: Several, settings: StageSettings, base: Parameters, make: Maker) -> StageModel:
    """The joint StageModel of all experiments; channels and fields are called du@first, u@first."""
    models = {}
    for part in data.parts:
        here = settings.model_copy(update={"free": tuple(free_in(settings.free, part.name).values())})
        models[part.name] = make(part, here, seen_by(base, part.name).with_free(here.free))
    return joined(models)


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


def feasible(study: Study, data: Measured | CouponData | Several, base: Parameters) -> tuple[Parameters, str]:
    """A start that can carry the measured force of every experiment, and a remark where it is not the study's."""
    if not isinstance(data, Several):
        return feasible_start(study, data, base)
    said = []
    for part in data.parts:
        here = seen_by(base, part.name).with_free(n for n in base.free if AT not in n)
        found, remark = feasible_start(part.study, part.data, here)
        base = base.replace(**{name: found[name] for name in here.free})
        said += [f"{part.name}: {remark}"] if remark else []
    return base, "; ".join(said)
