"""Section `experiments` of the study file: several tests that share the material, each with its own boundary and measurement."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, Field, StrictBool, ValidationError

from thermofit.core.parameters import AT
from thermofit.study.errors import content_error, sentence
from thermofit.study.section import ParameterName, ParameterSettings, Section, SpecimenOverride, no_repeats
from thermofit.study.stages import StageName, Window
from thermofit.study.virtual import Simulate


class OwnExperiment(Section):
    """One test of several. What is absent is that of the study."""

    experiment: str | None = None
    """Raw folder, relative to the study file; absent: a virtual experiment, in <run_dir>/<name>/raw."""
    held_out: StrictBool = False
    """True: predicted by `validate`, never fitted."""
    parameters: ParameterSettings = Field(default={})
    """Starts, or fixed values, of this test's own parameters, such as alpha_air."""
    fit_own: Annotated[tuple[ParameterName, ...], AfterValidator(no_repeats)] = ()
    """Of a held-out test: its own boundary and measurement parameters that are fitted on its own data before it is predicted."""
    specimen: SpecimenOverride | None = None
    windows: dict[StageName, Window] = Field(default={})
    """Windows of the stages on this test."""
    simulate: dict[str, Any] | None = None
    """Keys of the section `simulate` that differ in this test, where it is virtual."""


ExperimentName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
Experiments = dict[ExperimentName, OwnExperiment]


def virtual_of(common: Simulate | None, own: OwnExperiment, number: int, key: str) -> Simulate | None:
    """The virtual experiment of a test: the study's, with its own keys; another seed for each. None where there is no `simulate`.

    Raises the error of the section where the keys do not fit.
    """
    if common is None or own.experiment is not None:
        return None
    tree = merged({**common.model_dump(mode="json"), "seed": common.seed + number}, own.simulate or {})
    try:
        return Simulate.model_validate(tree)
    except ValidationError as error:
        guilty, text = sentence(error.errors()[0])
        raise content_error(f"does not fit: {text}", key=f"{key}.simulate.{guilty}") from None


def merged(tree: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A tree of keys with some of them changed, section by section."""
    out = dict(tree)
    for key, value in changes.items():
        inner = out.get(key)
        out[key] = merged(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return out


def check_experiments(experiments: Experiments, common: Simulate | None, named: dict[str, str]) -> None:
    """Every test has data, and every name <param>@<test> (by the key that holds it) means one of them that is fitted."""
    for number, (name, own) in enumerate(experiments.items()):
        key = f"experiments.{name}"
        if own.experiment is None and common is None:
            raise content_error("is missing: name its raw folder, or describe a virtual experiment under 'simulate'", f"{key}.experiment")
        if own.fit_own and not own.held_out:
            raise content_error("is given, but this test is fitted anyway; leave it out, or add held_out: true", f"{key}.fit_own")
        virtual_of(common, own, number, key)
    for where, text in named.items():
        name = text.partition(AT)[2]
        if name and name not in experiments:
            raise content_error(f"names {text}, but there is no experiment '{name}' under 'experiments'", where)
        if name and experiments[name].held_out:
            raise content_error(f"names {text}, but '{name}' is held out; expected a test that is fitted", where)
