"""From the records of a study to a case: the joint model of its driver at the joint optimum, and the error of its discretisation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import NumericsError, UntrustworthyError
from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.diagnose.case import Case, Sharper, slots_of, untold
from thermofit.diagnose.elsewhere import Elsewhere
from thermofit.diagnose.experiments import joined_rows, spans_of
from thermofit.diagnose.held_out import Rows
from thermofit.diagnose.known_fit import KnownFit
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.score import ALIKE, indistinguishable
from thermofit.diagnose.unseen import bodies_elsewhere, records_elsewhere
from thermofit.effects.catalogue import BASE, Effect, effect_of_param, effects, is_of_effect
from thermofit.experiment.coupon_model import answerable, coupon_model, coupon_run, offsets
from thermofit.experiment.coupon_records import CouponData, coupon_data
from thermofit.experiment.coupon_sensor import SENSOR
from thermofit.experiment.errors_told import Told, told, too_far
from thermofit.experiment.fields import measured, start_parameters, with_identified
from thermofit.experiment.flow_conditions import flow_conditions
from thermofit.experiment.joint import NUISANCES, Joint, joint_free, joint_settings, station_names
from thermofit.experiment.joint_several import JointSeveral, joint_several, known_in
from thermofit.experiment.model import Prior, StageModel, needs_drive
from thermofit.experiment.priors import effect_priors
from thermofit.experiment.residuals import Span, named_phases
from thermofit.experiment.several import Several, expanded, interpolate_paths, several, several_start
from thermofit.experiment.verification import identified_stages
from thermofit.fit.memory import memories
from thermofit.fit.result import FitResult
from thermofit.identify.stage import data_paths
from thermofit.observe.stations import INFRARED
from thermofit.records.artefact import open_record
from thermofit.records.key import read_of
from thermofit.records.staging import Job, artefact_path, job
from thermofit.study.section import PRESETS, MeshSize, mesh_size
from thermofit.study.stages import ChannelSettings, Stages, StageSettings
from thermofit.study.study import Study

SECTIONS = (
    *("model", "hardening", "material_axes", "mesh", "geometry", "parameters", "evaluation", "force", "numerics"),
    *("stages", "coupon", "diagnosis"),
)
DIAGNOSE = "diagnose"
USUAL = frozenset(name for stage in ("elastic", "plastic", "thermal") for name in getattr(Stages(), stage).free)
"""Parameters that the stages identify where a study does not say."""
KNOWN = 0.05
"""Standard error of an elastic constant over its value from which the joint fit of coupons leaves it as it is."""
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


def diagnosis_job(study: Study, name: str) -> tuple[Job, tuple[str, ...]]:
    """Job of a diagnosing stage, and the identification stages it rests on.

    StudyError where a record is missing (names its command); UntrustworthyError where a fit has not converged.
    """
    stages = identified_stages(study)
    inputs: dict[str, Path] = {**data_paths(study), **interpolate_paths(study, study.held_out)}
    inputs |= {stage: artefact_path(study.run_dir, stage) for stage in stages}
    for stage in stages:
        record = open_record(artefact_path(study.run_dir, stage))
        if not record.summary.get("converged", True):
            raise UntrustworthyError(f"{stage} has not converged ({record.summary['verdict']}); mend it before tracing its residual")
    sections = (*SECTIONS, *(("experiments", "shared") if study.experiments else ()))
    config = read_of(study, *sections)
    if name == DIAGNOSE:  # which adds no effect
        config["diagnosis"] = {key: value for key, value in config["diagnosis"].items() if key != "max_effects"}
    return job(study.run_dir, name, config, inputs), stages


def diagnosis_mesh(study: Study) -> MeshSize:
    """Mesh of the joint model: the one of section `diagnosis`, else that of the study, but not finer than the coarse preset."""
    if study.diagnosis.mesh is not None:
        return mesh_size(study.diagnosis.mesh)
    own, coarse = study.mesh_size, PRESETS["coarse"]
    return own if own.n_x * own.n_y * own.n_z <= coarse.n_x * coarse.n_y * coarse.n_z else coarse


@dataclass(frozen=True)
class _Joint:
    """A joint problem before its fit: settings, start, model, the same model with finer numerics, and what its driver knows."""

    settings: StageSettings
    base: Parameters
    model: StageModel
    numerical: Callable[[Parameters], np.ndarray]
    """Error (n,) of the discretisation that is left in the residual at given parameters."""
    largest_strain: float
    known: tuple[Effect, ...]
    spans: tuple[Span, ...]
    size: MeshSize
    parts: Joint | JointSeveral | None = None
    plain: Joint | JointSeveral | None = None
    """The problem of a body before its errors were told."""
    errors: Told | None = None
    """Its errors, told at the optimum of the stages."""
    rows: Rows | None = None
    elsewhere: tuple[Elsewhere, ...] = ()
    correlation_length: float = 0.0
    """Distance in mm over which the noise of neighbouring points hangs together."""
    remarks: tuple[str, ...] = ()


def prepared(study: Study, task: Job, stages: tuple[str, ...], known: KnownFit | None = None) -> Prepared:
    """Joint fit of everything that the stages identified, from where they ended; `known`: that fit, where it has been made.

    A model that lacks something large drives its parameters far off before it settles; then the optimum of the stages is traced instead:
    scores are those after a joint step of all fitted parameters in any case.
    """
    joint = _coupon(study, stages) if study.coupon is not None else _several(study, stages) if study.fitted else _body(study, stages)
    refit = JointFit(study, joint.settings, joint.model, task, parts=joint.parts)
    if known is None:
        _refuse_one_family(study, joint)
        _refuse_few(joint.model.residual(joint.base), joint)
        parameters, fit = replace(refit, at_most=JOINT_EVALUATIONS)(joint.base, "joint")
    else:
        parameters, fit = known.parameters, known.fit
        refit.failures.extend(known.failures)
        refit.ends.update(known.ends)
    if not fit.converged:
        parameters = joint.base
    scored = None if joint.parts is None else joint.parts.scored
    instruments = frozenset(n for n in (*parameters.free, *(n for e in joint.known for n in e.names)) if bare_name(n) in station_names())
    how = (study.coupon is not None, scored, joint.elsewhere, joint.rows, joint.largest_strain, _sharper(joint, refit), refit.heated)
    case = Case(joint.model, parameters, joint.known, joint.spans, instruments, *how, joint.correlation_length)
    return Prepared(case, fit, refit, joint.numerical(parameters), joint.size, (*joint.remarks, *_unknown_force(study, joint)))


def _unknown_force(study: Study, joint: _Joint) -> tuple[str, ...]:
    """A remark where the error of a prescribed force is not known."""
    if joint.errors is None or joint.errors.whole.knows_force_error or study.force.drives != "force":
        return ()
    again = f"thermofit interpolate {study.source.name} --force"
    return (f"the force is taken as exact: interpolate.h5 holds no error of it ({again} adds that to a record of an earlier version)",)


def _sharper(joint: _Joint, refit: JointFit) -> Callable[[Parameters], Sharper | None] | None:
    """The problem that knows the error of the force, which was taken as exact, where that could explain what the residual shows of it. The
    errors are told again at the parameters at hand: an effect that was added brings gradients of its own."""
    plain, first = joint.plain, joint.errors
    if plain is None or first is None or not first.far:
        return None

    def sharp(parameters: Parameters) -> Sharper | None:
        found = first
        if too_far(first.whole, parameters):
            return None
        try:
            found = told(plain, parameters)
        except NumericsError as error:
            refit.failures.append(
                f"errors of mesh and force: a run that tells them failed, those of the stages' optimum are kept ({error})"
            )
        fitting = replace(refit, model=found.whole.model, parts=found.whole, ends={})
        return Sharper(found.whole.model, found.whole.scored, fitting, replace(fitting, parts=None), found.left_whole, fitting.heated)

    return sharp


def _refuse_few(residual: np.ndarray, joint: _Joint) -> None:
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


def _refuse_one_family(study: Study, joint: _Joint) -> None:
    """UntrustworthyError where the study frees two effects that the test cannot tell apart."""
    own = freed_effects(joint.base.free)
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


def _body(study: Study, stages: tuple[str, ...]) -> _Joint:
    """Fields on a body, with the error of the mesh at the optimum of the stages taken into the data."""
    data = measured(study)
    base, _ = with_identified(study, start_parameters(study, data), stages)
    free = study.diagnosis.free or tuple(dict.fromkeys((*joint_free(study), *NUISANCES)))
    settings, size = joint_settings(study, free, data), diagnosis_mesh(study)
    plain = Joint(study, data, settings, size, beside=effect_priors(study))
    found = told(plain, base.with_free(free))
    return _Joint(
        settings,
        base.with_free(free),
        found.parts.model,
        lambda _: found.left,
        found.largest_strain,
        slots_of("body", INFRARED if data.temperature is not None else ()),
        named_phases(data.phases),
        size,
        found.parts,
        plain,
        found,
        elsewhere=bodies_elsewhere(study, size, free, base),
        correlation_length=data.correlation_length,
    )


def _several(study: Study, stages: tuple[str, ...]) -> _Joint:
    """Fields on several bodies that share their material."""
    data = several(study)
    base, _ = with_identified(study, several_start(study, data), stages)
    free = expanded(study.diagnosis.free or (*joint_free(study), *NUISANCES), data)
    size = diagnosis_mesh(study)
    plain, spans = joint_several(study, data, free, size), spans_of(data)
    first = next(iter(plain.parts.values()))
    needs_drive(study, first.settings.channels)
    priors = _priors_of_each(study, data)
    plain = JointSeveral({name: replace(part, beside=priors[name]) for name, part in plain.parts.items()})
    found = told(plain, base.with_free(free))
    return _Joint(
        first.settings.model_copy(update={"free": free}),
        base.with_free(free),
        found.parts.model,
        lambda _: found.left,
        found.largest_strain,
        known_in(data, lambda hot: slots_of("body", INFRARED if hot else ())),
        spans,
        size,
        found.parts,
        plain,
        found,
        joined_rows({name: part.model for name, part in plain.parts.items()}, spans),
        bodies_elsewhere(study, size, free, base),
        data.correlation_length,
    )


def _priors_of_each(study: Study, data: Several) -> dict[str, tuple[Prior, ...]]:
    """Priors of effects by experiment: each has those of its own readings, the first also those of the material, which count once."""
    every, names = effect_priors(study), [part.name for part in data.parts]
    own = tuple(p for p in every if p.name in data.own or p.name in study.shared)
    return {name: every if name == names[0] else own for name in names}


def _coupon(study: Study, stages: tuple[str, ...]) -> _Joint:
    """Records of coupons. The error of the steps is of first order: half the steps differ by half of it."""
    data = coupon_data(study)
    base, _ = with_identified(study, start_parameters(study, data), stages)
    settings = with_elastic(study, data, base)
    fine = study.model_copy(update={"numerics": study.numerics.model_copy(update={"steps_per_interval": 2})})
    model, finer = (coupon_model(of, data, settings, base, effect_priors(study)) for of in (study, fine))
    run = coupon_run(study, data, settings.free)
    hot = any(test.theta is not None for test in data.tests) and "dtheta" in settings.channels
    there = flow_conditions(data.tests, lambda test: run.history(base, test))
    known, untold_words = untold(slots_of("point", SENSOR if hot else ()), base.with_free(settings.free), there)
    return _Joint(
        settings,
        base.with_free(settings.free),
        model,
        lambda parameters: 2.0 * (model.residual(parameters) - finer.residual(parameters)),
        max(float(run.history(base, test).accumulated.max()) for test in data.tests),
        known,
        coupon_spans(data),
        MeshSize(n_x=1, n_y=1, n_z=1),
        elsewhere=_unseen_records(study, settings, base, known),
        remarks=untold_words,
    )


def _unseen_records(study: Study, settings: StageSettings, base: Parameters, known: tuple[Effect, ...]) -> tuple[Elsewhere, ...]:
    """Held-out records of coupons."""
    data = coupon_data(study, held_out=True)
    if not data.tests:
        return ()
    model = unseen_coupons(study, data, settings, base)
    return (records_elsewhere([t.name for t in data.tests], model, known, coupon_spans(data)),)


def unseen_coupons(study: Study, data: CouponData, settings: StageSettings, base: Parameters) -> StageModel:
    """Model of held-out records, each with the air that was measured beside it."""
    own = settings.model_copy(update={"free": tuple(n for n in settings.free if n != "theta_air")})
    return coupon_model(study, data, own, base)


def coupon_joint_settings(study: Study, data: CouponData) -> StageSettings:
    """All that the stages of a coupon study identify, on all that they compare; with temperatures, the air's too, held by a prior."""
    hot = any(test.theta is not None for test in data.tests)
    own = [answerable(study.stage(key), data)[0] for key in ("elastic", "plastic", *(("thermal",) if hot else ()))]
    wanted = study.diagnosis.channels or tuple(dict.fromkeys(c for s in own for c in s.channels))
    nuisances = tuple(name for name in ("theta_air",) if {"theta", "dtheta"} & set(wanted) and name not in study.parameters)
    free = study.diagnosis.free or tuple(dict.fromkeys((*(name for s in own for name in s.free), *nuisances)))
    channels = {c: ChannelSettings() for c in wanted}
    return StageSettings.model_construct(
        **{**own[1].__dict__, "free": tuple(free), "channels": channels, "window": "all", "coupling": "full"}
    )


def with_elastic(study: Study, data: CouponData, base: Parameters) -> StageSettings:
    """Settings of the joint fit of coupons, with the elastic constants that no elastic range told the first stage free where all of the
    data together do: unloadings and reverse flow tell E as well. A start is no prescription."""
    settings = coupon_joint_settings(study, data)
    kept = tuple(n for n in answerable(study.stage("elastic"), data)[1] if n not in settings.free)
    if not kept or study.diagnosis.free is not None:
        return settings
    wider = settings.model_copy(update={"free": (*kept, *settings.free)})
    residual, columns = coupon_model(study, data, wider, base).linearised(base, wider.free)
    basis, _ = np.linalg.qr(columns)
    size = max(float(np.mean((residual - basis @ (basis.T @ residual)) ** 2)), 1.0) ** 0.5  # what a joint step leaves
    told = []
    for k, name in enumerate(kept):
        others, _ = np.linalg.qr(np.delete(columns, k, axis=1))
        own = columns[:, k] - others @ (others.T @ columns[:, k])
        if size < KNOWN * base[name] * float(np.linalg.norm(own)):
            told.append(name)
    return settings.model_copy(update={"free": (*told, *settings.free)})


def coupon_spans(data: CouponData) -> tuple[Span, ...]:
    """Phases of all records on their common time axis."""
    out = []
    for test, offset in zip(data.tests, offsets(data.tests), strict=True):
        spans = named_phases(test.phases)
        prefix = f"{test.name} " if len(data.tests) > 1 else ""
        out += [Span(f"{prefix}{s.name}", s.t0 + offset, s.t1 + offset, record=test.name) for s in spans]
    return tuple(out)
