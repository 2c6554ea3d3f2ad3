"""The motion of a specimen that only an infrared camera saw: computed under the measured force with prescribed mechanical parameters.

A camera shows fixed pixels, the model material points. Without DIC nobody has measured which material a pixel sees; a run of the model says
it. Its parameters are those of the study and are not fitted: what a wrong yield stress does to temperatures alone, a wrong dissipation or
film does as well. So a study that asks for them is refused. What the run does not know is rigid motion: slip in the jaws, a machine that
gives way.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from thermofit.body.mesh.mesh import Mesh
from thermofit.body.solve.history import Watch
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.experiment import DicField
from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.experiment.fields import LoadSteps, Measured
from thermofit.experiment.forward import march_settings, run_of, sampler
from thermofit.experiment.joint import coarse_mesh
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.protocol import Kept
from thermofit.observe.observation import FieldObservation
from thermofit.observe.observation_points import observation_points
from thermofit.records.progress import progress
from thermofit.study.models import FROM_EXPERIMENT, is_prescribed
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

MECHANICAL_STAGES = ("elastic", "plastic")
"""Stages that compare displacements, by their keys under `stages`."""


def mechanical(names: Iterable[str]) -> tuple[str, ...]:
    """Those of the named parameters that temperatures on a known motion do not tell: of the material's mechanics, the load and DIC."""
    every = tuple(names)
    warm = {*acting_on_temperatures(every), *(n for n in every if bare_name(n) in FROM_EXPERIMENT)}
    return tuple(dict.fromkeys(n for n in every if n not in warm))


def refuse_identified(study: Study, free: Iterable[str], key: str) -> None:
    """StudyError where a study without displacements frees mechanical parameters under that key."""
    if asked := mechanical(free):
        raise StudyError(
            f"{study.source.name}: key '{key}' holds {', '.join(asked)}, but the experiment has no displacements, and temperatures "
            "alone do not tell them: leave them out and give their values as numbers under 'parameters', or add the dic section to "
            "experiment.yaml"
        )


def refuse_unknown_mechanics(study: Study) -> None:
    """StudyError where a study without displacements leaves open what its motion is computed with: a mechanical parameter that has a start,
    which stands for one to be identified, or none; another drive than the force."""
    name = study.source.name
    if study.force.drives != "force":
        raise StudyError(
            f"{name}: key 'force.drives' is {study.force.drives}, but the experiment has no displacements: its motion is computed under "
            "the measured force; leave the key out"
        )
    used = tuple(dict.fromkeys(n for key in MECHANICAL_STAGES for n in mechanical(getattr(study.stages, key).free)))
    if missing := [n for n in used if n not in study.parameters]:
        raise StudyError(
            f"{name}: key 'parameters.{missing[0]}' is missing: the experiment has no displacements, and its motion is computed with "
            f"{', '.join(missing)}; give what is known as numbers, or add the dic section to experiment.yaml"
        )
    if asked := [n for n in mechanical(study.parameters) if not is_prescribed(study.parameters, n)]:
        start = getattr(study.parameters[asked[0]], "start", 0.0)
        raise StudyError(
            f"{name}: parameters {', '.join(asked)} have a start, to be identified, but the experiment has no displacements, and "
            f"temperatures alone do not tell them: give what is known as numbers ({asked[0]}: {start:g}), or add the dic section to "
            "experiment.yaml"
        )
    refuse_identified(study, study.stages.thermal.free, "stages.thermal.free")
    refuse_identified(study, study.diagnosis.free or (), "diagnosis.free")


def refuse_some_without_displacements(study: Study) -> None:
    """StudyError where some tests of a study have displacements and others have none: the motion of these would have to be computed before
    those have told the mechanics."""
    names = [n for n in (*study.fitted, *study.held_out) if study.one_of(n).coupon is None]
    tests = {n: study.one_of(n) for n in names} | ({} if study.fitted else {study.source.name: study.alone})
    without = [n for n, test in tests.items() if not test.has_displacements]
    if without and len(without) < len(tests):
        raise StudyError(
            f"{study.source.name}: {without[0]} has no displacements, but {next(n for n in tests if n not in without)} has: identify the "
            f"mechanical parameters in a study without {without[0]}, and give them as numbers in another one for it"
        )


def told_by_temperatures(study: Study, settings: StageSettings, key: str) -> tuple[StageSettings, Kept]:
    """Settings of a stage of a test without displacements: a mechanical stage has nothing to identify, and keeps what the study gives.
    StudyError where another stage frees mechanical parameters."""
    if key not in MECHANICAL_STAGES:
        refuse_identified(study, settings.free, f"stages.{key}.free")
        return settings, Kept()
    why = "the experiment has no displacements"
    return settings.model_copy(update={"free": ()}), Kept(settings.free, why, "uncertainty.parameters may state their errors")


def computed_motion(study: Study, data: Measured, mesh: Mesh, parameters: Parameters) -> DicField:
    """Displacements of all nodes of the face of `mesh`, on both sides of its symmetry plane, at the load steps of `data`, from one coupled
    run with given parameters on a mesh not finer than coarse. NumericsError where they cannot carry the measured force."""
    steps, points = data.steps["all"], observation_points(mesh.nodes, mesh.node_sets["face"], np.inf, np.inf)
    run = run_of(study, data, coarse_mesh(study), steps, march_settings(study, "full"))
    with progress("motion", len(steps.time) - 1) as advance:
        try:
            history = run(parameters, Watch(step=lambda _: advance()))
        except NumericsError as error:
            raise NumericsError(
                f"{study.source.name}: the motion cannot be computed with {in_words(study, parameters)}: the model finds no equilibrium "
                f"under the measured force ({error}); correct these parameters, or the force and the lengths of the specimen"
            ) from error
    everywhere = _unseen(steps, points.xy)
    u = sampler(run.body, everywhere, steps).displacement(history)
    flat = np.zeros((*u.shape[:2], 1))
    reference = np.concatenate([points.xy, np.zeros((len(points.xy), 1))], axis=1)
    return DicField(steps.time, np.arange(len(points.xy)), reference, np.concatenate([u, flat], axis=2))


def _unseen(steps: LoadSteps, xy: np.ndarray) -> FieldObservation:
    """Points xy (n_s, 2) mm at all load steps, of which nothing is measured."""
    shape = (len(steps.time), len(xy), 2)
    return FieldObservation("u", steps.time, xy, np.zeros(shape), np.ones(shape), np.ones(shape[:2], dtype=bool), "mm")


def used_parameters(study: Study, parameters: Parameters) -> dict[str, float]:
    """Mechanical parameters that the study gives, by name: the motion is computed with them."""
    return {name: parameters[name] for name in mechanical(study.parameters)}


def in_words(study: Study, parameters: Parameters) -> str:
    """These parameters with their values and units."""
    return ", ".join(f"{name} = {valued(name, value)}" for name, value in used_parameters(study, parameters).items())


def valued(name: str, value: float) -> str:
    """A value with the unit of its parameter, none where it is a pure number."""
    unit = param(bare_name(name)).unit
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def taken_as_exact(study: Study) -> tuple[str, ...]:
    """Mechanical parameters of a test without displacements for which the study states no error."""
    return tuple(name for name in mechanical(study.parameters) if name not in study.uncertainty.parameters)
