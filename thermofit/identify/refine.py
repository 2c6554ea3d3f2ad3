"""All parameters, all channels, one residual: the last fit of the chain, from where the stages ended.

A stage takes what earlier stages have told for exact, its thermocouples and the pose of its infrared camera too. Here nothing is: every
parameter is free, readings and landmarks are data with an error, the error of the smoothed force is noise that both fields share, and those
of mesh and steps are in the data (`experiment.discretisation`). From the optimum of the stages a few steps suffice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import AT, THERMOCOUPLES, Parameters, bare_name
from thermofit.experiment.channels import FIELDS
from thermofit.experiment.discretisation import SHEET, on_mesh
from thermofit.experiment.force_error import estimated_error
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.priors import improbable, off_declared
from thermofit.experiment.protocol import Experiment, JointProblem
from thermofit.experiment.trust import READING
from thermofit.experiment.verification import FORCE_TOLD, NUMERICAL, known_place
from thermofit.fit.linear_model import LinearModel
from thermofit.identify.combined import joint_budget
from thermofit.identify.outcome import MISFIT, channel_table, made
from thermofit.identify.solve import F_TOLERANCE, Solved, covariance_of, minimised, within
from thermofit.records.artefact import Dataset, ParameterResult, Record
from thermofit.records.staging import Job, Made, Note
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

EVALUATIONS = 16
"""Evaluations after which a joint fit that still moves is given up: the stages ended near its optimum, or the model lacks something. Few
suffice; a dozen where the error of the force leaves a bent valley, as of a sheet of 2 x 12 elements whose M_yinf is known to 8 %."""

STRAIGHT = 0.1
"""Relative change of a parameter up to which a joint step is taken at once."""
HEAT_EVALUATIONS = 60


def refined(study: Study, experiment: Experiment, base: Parameters, task: Job, records: Mapping[str, Record]) -> Made:
    """The record of the joint fit; `base`: what the stages, of which `records` are given, have identified.

    Where a channel was left far above its noise, the parameters stay as the stages left them: a joint fit would spread what is missing over
    all of them. The same where it does not come to an end. The record says so.
    """
    staged = {name: p for record in records.values() for name, p in record.parameters.items() if p.free}
    reason = _left_out(records)
    if not reason:
        try:
            problem = experiment.diagnosed(base, _freed(experiment, staged))
            bound = within(study, problem.base, problem.told)
            solved = _solved(bound, experiment, problem, task)
        except NumericsError as error:
            reason = f"the joint model cannot be run ({error})"
        else:
            reason = _doubtful(problem, solved)
            if not reason:
                return _made(bound, experiment, problem, solved, staged)
    return _as_staged(base, staged, records, reason)


def _freed(experiment: Experiment, staged: Mapping[str, ParameterResult]) -> tuple[str, ...]:
    """Bare names of what the stages have identified, and of the thermocouples where temperatures are compared."""
    compared = experiment.joint_settings(tuple(dict.fromkeys(map(bare_name, staged)))).channels
    warm = any(FIELDS[channel] == "theta" for channel in compared)
    return tuple(dict.fromkeys((*map(bare_name, staged), *(THERMOCOUPLES if warm else ()))))


def _left_out(records: Mapping[str, Record]) -> str:
    """Why there is nothing to be gained, empty where there is."""
    for stage, record in records.items():
        for name, c in record.summary.get("channels", {}).items():
            over = float(np.sqrt(c.get("chi2_reduced") or 0.0))
            if over > MISFIT:
                return f"{name} was left at {over:.3g} times its noise by {stage}: what is missing would be spread over all parameters"
        if not record.summary.get("converged", True):
            return f"{stage} has not converged"
    return ""


def _solved(study: Study, experiment: Experiment, problem: JointProblem, task: Job) -> Solved:
    """The joint fit with its budget. NumericsError where the model fails at its start."""
    settings = problem.settings.model_copy(update={"max_evaluations": EVALUATIONS})
    start = _warmed(study, settings, problem, task) if _far(problem) else problem.base
    model, fit = minimised(study, settings, start, (lambda *_: _begun(problem), problem.size, F_TOLERANCE), task)
    spread, remark = covariance_of(model, fit)
    parameters = problem.base.with_vector(fit.x)
    solved = Solved(parameters, model, fit, spread, (), (remark,) if remark else ())
    if spread is None or fit.jacobian is None or not fit.converged:
        return solved
    limits = {} if problem.errors is None else problem.errors.causes
    return replace(solved, budget=joint_budget(solved, experiment.prescribed_errors(parameters), limits))


def _far(problem: JointProblem) -> bool:
    """Whether the first joint step would go farther than a straight line leads: a reading that was taken for exact has drawn the parameters
    off."""
    errors, base = problem.errors, problem.base
    if errors is None or set(errors.known) != {""}:
        return False
    step = LinearModel(*problem.model.assembled(base, base.free, *errors.known[""])).free_step
    size = np.abs(base.vector())
    return bool(np.any(np.abs(step) > STRAIGHT * np.where(size > 0.0, size, np.inf)))


def _warmed(study: Study, settings: StageSettings, problem: JointProblem, task: Job) -> Parameters:
    """The start after a fit of what the temperatures alone feel, on the motion of the stages: conductivity against contact is a long bent
    valley, in which a run of heat costs a tenth of a coupled one."""
    base = problem.base
    thermal = acting_on_temperatures(base.free)
    model = None if problem.parts is None else problem.parts.heat(base)
    if model is None or not thermal:
        return base
    own = settings.model_copy(update={"free": thermal, "method": "trust-region", "max_evaluations": HEAT_EVALUATIONS})
    part = replace(task, config={**task.config, "start": "heat"})
    _, fit = minimised(study, own, base.with_free(thermal), (lambda *_: model, problem.size, F_TOLERANCE), part)
    return base.with_free(thermal).with_vector(fit.x).with_free(base.free)


def _begun(problem: JointProblem) -> StageModel:
    """The model, which knows its fields where the errors were told: there the fit begins."""
    model, errors = problem.model, problem.errors
    exact = model.linearise
    if errors is None or set(errors.known) != {""} or exact is None:
        return model

    def linearise(parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        if parameters.values == problem.base.values and names == problem.base.free:
            fields, slopes = errors.known[""]
            return fields, dict(slopes)
        return exact(parameters, names)

    return replace(model, linearise=linearise)


def _doubtful(problem: JointProblem, solved: Solved) -> str:
    """Why the answer of the joint fit is not taken, empty where it is."""
    fit = solved.fit
    if not fit.converged:
        return f"the joint fit does not come to an end ({fit.message})"
    channels = channel_table(solved.model, solved.model.errors(solved.parameters))
    worst = max(channels, key=lambda name: float(channels[name]["chi2_reduced"]))
    over = float(np.sqrt(channels[worst]["chi2_reduced"]))
    if over > MISFIT:
        return f"the joint fit leaves {worst} at {over:.3g} times its noise: what is missing would be spread over all parameters"
    return improbable(problem.model.priors, solved.parameters)


def _made(study: Study, experiment: Experiment, problem: JointProblem, solved: Solved, staged: Mapping[str, ParameterResult]) -> Made:
    """The record of a joint fit; the starts in it are those of the study, `staged` what the stages had."""
    model = solved.model
    remarks = [*off_declared(model.priors, solved.parameters, READING)]
    if problem.errors is not None and problem.errors.far:
        remarks.append("the force is taken as exact: the model misses more than its error could explain")
    remarks += _layer_in_words(problem)
    record = made(study, problem.base, solved, tuple(remarks))
    results = {
        name: replace(p, start=staged[name].start) if name in staged else p for name, p in record.parameters.items()
    }  # fmt: skip
    # What the joint fit sees are data with the errors of mesh and steps in them: fields are those of `verify`.
    fields = tuple(f"{name}/" for name in model.observations)
    datasets = {name: data for name, data in record.datasets.items() if not name.startswith(fields)}
    datasets |= _known(study, problem, solved.parameters)
    summary = {
        **record.summary,
        "verdict": str(record.summary["verdict"]).replace("identified", "refined", 1),
        "refined": True,
        "drive": experiment.drive,
        "staged": {name: {"value": p.value, "sigma": p.sigma} for name, p in staged.items()},
    }
    return replace(record, datasets=datasets, parameters=results, summary=summary)


def _layer_in_words(problem: JointProblem) -> list[str]:
    """What a fit on a sheet has taken into its data so that its optimum is that of the body, by test."""
    said: list[str] = []
    units = {name.partition(AT)[0]: o.unit for name, o in problem.model.observations.items()}
    for test, fields in ({} if problem.errors is None else problem.errors.fields).items():
        if SHEET in fields:
            sizes = [f"{np.sqrt(np.nanmean(error**2)):.2g} {units[name]} in {name}" for name, error in fields[SHEET].items()]
            where = f"{test}: " if test else ""
            size = problem.size
            said.append(Note(f"{where}the {size.words} is fitted with its difference from the body in the data, rms {', '.join(sizes)}"))
    return said


def _known(study: Study, problem: JointProblem, parameters: Parameters) -> dict[str, Dataset]:
    """What is known to be wrong with a prediction, by test: errors of mesh and steps in its fields as the mesh of `verify` has them, and
    what the data tell of the error of a prescribed force."""
    out, units = {}, {name.partition(AT)[0]: o.unit for name, o in problem.model.observations.items()}
    for test, fields in ({} if problem.errors is None else problem.errors.fields).items():
        assert problem.parts is not None
        force = estimated_error(problem.parts.each[test], problem.parts.seen_by(parameters, test))
        if force is not None:
            out[known_place(FORCE_TOLD, test)] = Dataset(force, "N", ("step",))
        for name, error in on_mesh(fields, problem.size, study.mesh_size.body).items():
            out[known_place(f"{NUMERICAL}/{name}", test)] = Dataset(error, units[name], ("time", "point", "component"))
    return out


def _as_staged(base: Parameters, staged: Mapping[str, ParameterResult], records: Mapping[str, Record], reason: str) -> Made:
    """The record where the parameters stay as the stages left them."""
    drives = [record.summary["drive"] for record in records.values() if "drive" in record.summary]
    summary = {
        "verdict": f"not refined, the parameters of the stages stay: {reason}",
        "trustworthy": True,
        "converged": all(record.summary.get("converged", True) for record in records.values()),
        "refined": False,
        "channels": {},
        "evaluations": {},
        "staged": {name: {"value": p.value, "sigma": p.sigma} for name, p in staged.items()},
        "remarks": [],
        **({"drive": drives[-1]} if drives else {}),
    }
    return Made({}, summary, dict(staged))
