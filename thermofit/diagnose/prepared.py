"""From the records of a study to a case: the joint model of its driver at the joint optimum, and the error of its discretisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import NumericsError, UntrustworthyError
from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.diagnose.case import Case, RefinedProblem, Sharper, not_identifiable, rows_of_tests
from thermofit.diagnose.known_fit import KnownFit
from thermofit.diagnose.other_tests import other_test_of
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.score import ALIKE, indistinguishable
from thermofit.effects.catalogue import BASE, effect_of_param, effects, is_of_effect
from thermofit.experiment.computed_motion import mechanical
from thermofit.experiment.drive import FORCE, carried
from thermofit.experiment.drive import SECTIONS as BY_SECTIONS
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_after, experiment_of
from thermofit.experiment.instruments import station_names
from thermofit.experiment.joint import JointParts
from thermofit.experiment.joint_errors import JointWithErrors, told, too_far
from thermofit.experiment.missing import MissingTerm
from thermofit.experiment.protocol import Experiment, JointProblem
from thermofit.experiment.verification import identified_stages
from thermofit.fit.memory import memories
from thermofit.fit.result import FitResult
from thermofit.identify.solve import DRIVE, within
from thermofit.records.artefact import read_record
from thermofit.records.key import read_of
from thermofit.records.staging import Job, artefact_path, job
from thermofit.study.section import MeshSize
from thermofit.study.stages import Stages
from thermofit.study.study import Study

SECTIONS = (
    *("model", "hardening", "yield_surface", "material_axes", "mesh", "geometry", "parameters", "evaluation", "force", "numerics"),
    *("stages", "coupon", "diagnosis", "uncertainty"),
)
DIAGNOSE = "diagnose"
USUAL = frozenset(name for stage in ("elastic", "plastic", "thermal") for name in getattr(Stages(), stage).free)
"""Parameters that the stages identify where a study does not say."""
JOINT_EVALUATIONS = 10
"""Evaluations after which a joint fit that still moves is given up."""


@dataclass(frozen=True)
class Prepared:
    """A case at the optimum of the joint fit, how to fit again, and the error (n,) of the discretisation that is left in its
    residual."""

    case: Case
    fit: FitResult
    refit: JointFit
    numerical: np.ndarray
    size: MeshSize
    remarks: tuple[str, ...] = ()
    drive: str = FORCE
    """What drives the test."""


def inputs_of(study: Study) -> dict[str, Path]:
    """Artefacts of `interpolate` of all that is fitted and all that is held out."""
    experiment = experiment_of(study)
    return {**experiment.inputs, **{name: path for test in experiment.unseen for name, path in test.experiment.inputs.items()}}


def diagnosis_job(study: Study, name: str) -> tuple[Job, tuple[str, ...]]:
    """Job of a diagnosing stage, and the identification stages it rests on.

    StudyError where a record is missing (names its command); UntrustworthyError where a fit has not converged.
    """
    stages = identified_stages(study)
    inputs = inputs_of(study)
    inputs |= {stage: artefact_path(study.run_dir, stage) for stage in stages}
    for stage in stages:
        record = read_record(artefact_path(study.run_dir, stage), stage, f"thermofit run {study.source.name} --until {stage}")
        if not record.summary.get("converged", True):
            raise UntrustworthyError(f"{stage} has not converged ({record.summary['verdict']}); make it converge first")
    sections = (*SECTIONS, *(("experiments", "shared") if study.fitted or study.held_out else ()))
    config = read_of(study, *sections)
    if name == DIAGNOSE:  # which adds no effect
        config["diagnosis"] = {key: value for key, value in config["diagnosis"].items() if key != "max_effects"}
    return job(study.run_dir, name, config, inputs), stages


def prepared(study: Study, task: Job, stages: tuple[str, ...], known: KnownFit | None = None, of: Experiment | None = None) -> Prepared:
    """Joint fit of everything that the stages identified, from where they ended; `known`: that fit, where it has been made. `of`: the
    experiment, where it is not that of the artefacts.

    A model that lacks something large drives its parameters far off before it settles; then the optimum of the stages is traced instead:
    scores are those after a joint step of all fitted parameters in any case. Where the model cannot carry the measured force, the motion of
    sections drives it.
    """
    experiment = experiment_after(study, stages if known is None else (*stages, DIAGNOSE)) if of is None else of
    _, found, turned = carried(experiment, lambda driven: _prepared(study, task, stages, known, driven))
    return replace(found, remarks=(*found.remarks, turned)) if turned else found


def _prepared(study: Study, task: Job, stages: tuple[str, ...], known: KnownFit | None, experiment: Experiment) -> Prepared:
    """The same in the drive that the experiment has. NumericsError where its model fails."""
    base, _ = with_identified(study, experiment.start(), stages)
    joint = experiment.diagnosed(base)
    shown, said = (joint.known, ()) if joint.flow is None else not_identifiable(joint.known, joint.base, joint.flow)
    pose = frozenset(n for n in joint.told if is_of_effect(n))
    # A camera stands where it stands in its own test alone.
    settings = joint.settings
    shared = settings.model_copy(update={"free": tuple(n for n in settings.free if n not in pose)}) if pose else settings
    elsewhere = tuple(other_test_of(test, shared, joint.base, shown) for test in experiment.unseen)
    fitting = within(study, joint.base, joint.told)
    task = replace(task, config={**task.config, DRIVE: experiment.drive}) if experiment.drive == BY_SECTIONS else task
    refit = JointFit(fitting, joint.settings, joint.model, task, parts=joint.parts)
    if known is None:
        _refuse_one_family(study, joint)
        _refuse_few(joint.model.residual(joint.base), joint)
        parameters, fit = replace(refit, at_most=JOINT_EVALUATIONS, both_starts=True)(joint.base, "joint")
    else:
        parameters, fit = known.parameters, known.fit
        refit.failures.extend(known.failures)
        refit.ends.update(known.ends)
    if not fit.converged:
        parameters = joint.base
    case = Case(
        model=joint.model,
        parameters=parameters,
        known=shown,
        spans=joint.spans,
        instruments=frozenset(n for n in (*parameters.free, *(n for e in shown for n in e.names)) if bare_name(n) in station_names()),
        cheap=joint.model.cheap,
        scored=None if joint.parts is None else joint.parts.scored,
        other_tests=elsewhere,
        placed=rows_of_tests(joint.each, joint.spans),
        largest_strain=joint.largest_strain,
        refined_at=_refinement(joint, refit),
        heated=refit.heated,
        moved=None if joint.parts is None else refit.moved,
        mechanics=None if joint.parts is None or joint.parts.mechanics is None else refit.mechanically,
        flowing=None if joint.parts is None else refit.flowing,
        correlation_length=joint.correlation_length,
        bounds=fitting.bounds,
        pose=pose,
        doubts={} if joint.errors is None else joint.errors.causes,
        prescribed=experiment.prescribed_errors,
    )
    assert joint.numerical is not None
    remarks = (*said, *_unknown_force(experiment, joint), *_computed_motion(experiment))
    return Prepared(case, fit, refit, joint.numerical(parameters), joint.size, remarks, experiment.drive)


def _unknown_force(experiment: Experiment, joint: JointProblem) -> tuple[str, ...]:
    """A remark where the error of a prescribed force is not known."""
    if joint.errors is None or joint.errors.whole.knows_force_error or experiment.drive != FORCE:
        return ()
    again = f"thermofit interpolate {experiment.study.source.name} --force"
    return (f"the force is taken as exact: interpolate.h5 holds no error of it ({again} adds that to a record of an earlier version)",)


def _computed_motion(experiment: Experiment) -> tuple[str, ...]:
    """A remark where a motion is computed: what it is computed with is not judged."""
    used = dict.fromkeys(n for test in experiment.fields if test.data.displacement is None for n in mechanical(test.study.parameters))
    if not used:
        return ()
    return (
        f"{', '.join(used)} are taken as exact: temperatures alone do not show an error of them, which beta and the other parameters of "
        "heat take up",
    )


def _refinement(joint: JointProblem, refit: JointFit) -> Sharper | None:
    """The problem that knows its errors at the parameters at hand; None where there are none to tell."""
    if joint.plain is None or joint.errors is None:
        return None
    return told_again(joint.plain, joint.errors, refit, _effects_of(joint.base.free))


def told_again(plain: JointParts, before: JointWithErrors, refit: JointFit, added: frozenset[str]) -> Sharper:
    """Tells the errors of a problem anew, which were told `before` with the effects `added` fitted.

    A force that was taken as exact is known by its error from where that could explain what the residual shows of it. Errors of mesh and
    steps are told anew with every effect that is added, while the force stays exact too. What was missing had driven the parameters off,
    and these errors were those of a contact that conducts nothing; an effect that was added brings gradients of its own.
    """

    def sharp(parameters: Parameters, beside: MissingTerm | None = None) -> RefinedProblem | None:
        """The problem told at parameters; None where it is told already, or nothing was added while the model misses more there than the
        error of the force could explain."""
        found, news = before, beside is not None or not _effects_of(parameters.free) <= added
        if not news and not before.far:
            return None
        exact = before.far and too_far(before.whole, parameters)
        if exact and not news:
            return None
        try:
            found = told(plain, parameters) if beside is None else told(plain, parameters, beside)
        except NumericsError as error:
            refit.failures.append(f"errors of mesh and force: a run that tells them failed, those told before are kept ({error})")
            if exact:
                return None
        else:
            # An effect that was added may be what hid the error of the force, which is known from then on. Where it is known by the errors
            # told before it stays so: beside a force that is exact a fit may end far from where it belongs.
            exact = exact and found.far
        parts, left, doubts = (found.whole, found.left_whole, found.causes_whole)
        if exact:
            parts, left, doubts = found.parts, found.left, found.causes
        fitting = replace(refit, model=parts.model, parts=parts, ends={})
        nearby = replace(fitting, parts=None)
        again = told_again(plain, replace(found, far=exact), refit, added | _effects_of(parameters.free))
        by_motion = (fitting.moved, fitting.mechanically)
        return RefinedProblem(parts.model, parts.scored, fitting, nearby, left, fitting.heated, *by_motion, doubts, again)

    return sharp


def _effects_of(free: Sequence[str]) -> frozenset[str]:
    """Names of the effects of which something is fitted."""
    return frozenset(effect_of_param(bare_name(n)).name for n in free if is_of_effect(n))


def _refuse_few(residual: np.ndarray, joint: JointProblem) -> None:
    """UntrustworthyError where there are fewer independent data than fitted parameters."""
    n, p = sum(c.n for c in joint.model.comparisons), len(joint.base.free)
    if n <= p:
        raise UntrustworthyError(
            f"diagnosis: {n} data for {p} fitted parameters leave nothing to judge; free fewer, or use more of the record"
        )
    if joint.model.segments is not None:
        worth = sum(m.independent for m in memories(residual, joint.model.segments))
        if worth < p:
            raise UntrustworthyError(
                f"diagnosis: {n} data are worth {worth:.2g} independent ones, because their misfit is correlated in time, and {p} "
                "parameters are fitted; free fewer (diagnosis.free), or use more records"
            )


def _refuse_one_family(study: Study, joint: JointProblem) -> None:
    """UntrustworthyError where the study frees two effects that the test cannot tell apart."""
    own = freed_effects([n for n in joint.base.free if n not in joint.told])
    if len(own) < 2:
        return
    _, fitted = joint.model.linearised(joint.base, joint.base.free)
    found = indistinguishable(fitted, own)
    if found is not None:
        raise UntrustworthyError(
            f"{study.source.name}: the study frees {found[0]} and {found[1]}, whose influence this test cannot tell apart (|cos| "
            f"{found[2]:.3f}, expected below {ALIKE}); free one of them, and give the other a value or leave it out"
        )


def freed_effects(free: Sequence[str]) -> dict[str, list[int]]:
    """Places among the names `free` of the amplitudes of every effect that is freed. A mechanism of the base law counts (H_lin, G, L),
    unless a stage identifies it as a rule: conductivity, films and expansion are fitted together, correlated as they are."""
    of_base = {name: e.name for e in effects(BASE) for name in e.names if name not in USUAL}
    own: dict[str, list[int]] = {}
    for k, n in enumerate(free):
        if bare_name(n) in of_base:
            own.setdefault(of_base[bare_name(n)], []).append(k)
        elif is_of_effect(n) and not param(n).scan:
            own.setdefault(effect_of_param(n).name, []).append(k)
    return own
