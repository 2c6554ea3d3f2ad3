"""Solve one stage: coarse mesh first, every evaluation kept on disk, standard errors with the noise of the comparison."""

from __future__ import annotations

import dataclasses
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.core.digest import path_digest, source_digest
from thermofit.core.errors import NumericsError, UntrustworthyError
from thermofit.core.jsonable import json_text
from thermofit.core.parameters import Parameters
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.protocol import Experiment
from thermofit.fit.budget import Budget
from thermofit.fit.covariance import Covariance, NoiseOperator
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import memories, noise_operator
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Hooks, Settings
from thermofit.identify.variables import FitVariables, fit_variables
from thermofit.records.checkpoint import Checkpoint
from thermofit.records.progress import Advance, progress
from thermofit.records.staging import Job
from thermofit.study.section import MeshSize, ParameterStart
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

_MOVED = 1e-3
"""Relative change from which a parameter is worth a word; those of finite differences are smaller."""
_SHOWN = 4


class Follower:
    """Tells `advance` of every evaluation of a fit of parameters `names`; the optimiser's variables become parameters by `change`."""

    def __init__(self, advance: Advance, names: Sequence[str], change: FitVariables) -> None:
        self.advance, self.names, self.change = advance, tuple(names), change
        self.before: np.ndarray | None = None

    def __call__(self, evaluation: Any, residual: np.ndarray | None) -> None:
        """One evaluation, with its residual (n,) in units of the noise; None where it failed."""
        values = np.asarray(self.change.parameters(np.asarray(evaluation.x, dtype=float)), dtype=float)
        parameters = {name: float(value) for name, value in zip(self.names, values, strict=True)}
        if residual is None:
            self.advance(1, "failed", {"parameters": parameters, "failed": True})
            return
        over_noise = float(np.sqrt(evaluation.f / max(len(residual), 1)))
        note = f"{over_noise:.4g} times the noise"
        if moved := self._moved(values):
            note += "; " + ", ".join(f"{name} {parameters[name]:.5g}" for name in moved)
        self.before = values
        self.advance(1, note, {"objective_over_noise": over_noise, "parameters": parameters})

    def _moved(self, values: np.ndarray) -> list[str]:
        """Names of the parameters that have moved most since the last evaluation."""
        if self.before is None:
            return list(self.names[:_SHOWN])
        change = np.abs(values - self.before) / np.maximum(np.maximum(np.abs(self.before), np.abs(values)), np.finfo(float).tiny)
        return [self.names[k] for k in np.argsort(-change)[:_SHOWN] if change[k] > _MOVED]


DIFFERENCE_STEP = 5e-6
"""Finite differences in units of the scale: well above the accuracy of equilibrium, below one standard error of a parameter."""
F_TOLERANCE = 0.01
"""Remaining drop of the objective in units of its variance at which a fit has converged: a tenth of a standard error."""
COMPARED = 1e-4
"""The same where optima are compared with one another: a hundredth of a standard error, so that starts on both sides of one optimum are
told from two optima. Steps of Gauss and Newton contract so fast at the end that this is one more of them."""

TURNS = 4
"""Most often that a one-way stage solves its mechanics."""
ROUNDING = 1e-9
"""Part of a bound by which a value may lie beyond it that a bounded step has left there."""
SETTLED = 0.1
"""Change of every parameter, in standard errors, below which the mechanics of a one-way stage need not be solved anew."""

ModelOn = Callable[[MeshSize, Parameters], StageModel]
Target = tuple[ModelOn, MeshSize, float]
"""Model maker, mesh, and tolerance of the objective of one fit."""
Again = Callable[[Parameters], Iterable[tuple[str, Parameters]]]
"""Starts in turn that replace one at which the forward model fails, each with what it is in words."""
DRIVE = "drive"
"""Key of a job's config whose model is driven otherwise than its study says."""


class NotCarriedError(NumericsError):
    """A fit was kept from its minimum by parameters for which the forward model fails."""


def model_on(experiment: Experiment, settings: StageSettings) -> ModelOn:
    """StageModel of a stage on any mesh."""
    return lambda size, base: experiment.model(settings, base, size)


@dataclass(frozen=True)
class Solved:
    """A stage that is solved: parameters, the model on the final mesh, the fit, and the covariance with correlated noise.

    `earlier`: the fits before the last one, on the coarse mesh or with the mechanics of earlier parameters.
    """

    parameters: Parameters
    model: StageModel
    fit: FitResult
    covariance: Covariance | None
    earlier: tuple[FitResult, ...]
    remarks: tuple[str, ...]
    budget: Budget | None = None
    """Combined uncertainty of the free parameters by cause; None: only the noise is known."""


def solve(
    study: Study,
    settings: StageSettings,
    base: Parameters,
    model_on: ModelOn,
    job: Job,
    *,
    scalable: bool,
    f_tolerance: float = F_TOLERANCE,
    again: Again | None = None,
    to_the_end: bool = True,
) -> Solved:
    """Minimise a stage's objective from `base` to `f_tolerance`; on a fine mesh, if `scalable`, the optimum of the coarse one is the start.

    A one-way stage takes its mechanics from a coupled run with the parameters that it starts from; thermal strain in that run takes
    part in the heat balance (9 K alpha_exp^2 theta beside c0). So the mechanics is solved anew at the optimum until that settles.

    A mesh carries a little more or less than another: where the forward model fails at a start, `again` gives others in turn. A killed run
    resumes: finished evaluations are read from `<run_dir>/<stage>.evaluations/`, which goes when the artefact is written. NumericsError
    where the forward model fails at every start; unless `to_the_end`, NotCarriedError where it keeps a fit from its minimum.
    """
    base = base.with_free(settings.free)
    size, coarse_size = study.mesh_size, study.mesh_size.coarse
    fits: list[FitResult] = []
    said: list[str] = []
    if scalable and size.elements > 2 * coarse_size.elements and study.numerics.coarse_start:
        _, coarse, remark = _begun(study, settings, base, (model_on, coarse_size, F_TOLERANCE), job, None, again)
        _refuse_edge(coarse[-1], to_the_end)
        fits, said = coarse, [remark]
        base = base.with_vector(coarse[-1].x)
    near = fits[-1] if fits else None
    model, fine, remark = _begun(study, settings, base, (model_on, size, f_tolerance), job, near, again)
    _refuse_edge(fine[-1], to_the_end)
    said.append(remark)
    fit, fits = fine[-1], fits + fine
    spread, remark = covariance_of(model, fit)
    restless = "" if _close(*fine[-2:]) else "the mechanics of the one-way stage has not settled: the optimum still moves with it"
    return Solved(base.with_vector(fit.x), model, fit, spread, tuple(fits[:-1]), tuple(r for r in (remark, restless, *said) if r))


def _refuse_edge(fit: FitResult, to_the_end: bool) -> None:
    if fit.at_edge and not to_the_end:
        raise NotCarriedError(fit.message)


def _begun(
    study: Study, settings: StageSettings, base: Parameters, on: Target, job: Job, near: FitResult | None, again: Again | None
) -> tuple[StageModel, list[FitResult], str]:
    """Model and fits on one mesh from the first start at which the model runs, and a remark where that is another than `base`."""
    try:
        return *_settled(study, settings, base, on, job, near), ""
    except NumericsError as error:
        failed = error
    for number, (words, start) in enumerate(() if again is None else again(base), start=1):
        here = dataclasses.replace(job, config={**job.config, "start": number})
        try:
            model, fits = _settled(study, settings, start, on, here)
        except NumericsError:
            continue
        return model, fits, f"the mesh {on[1].words} fails at its first start; started again {words}"
    raise failed


def _settled(
    study: Study, settings: StageSettings, base: Parameters, on: Target, job: Job, near: FitResult | None = None
) -> tuple[StageModel, list[FitResult]]:
    """Model and fits on one mesh; the last fit is the result. Several only where the model is one-way. `near`: a fit that ended at `base`,
    on another mesh or with other mechanics."""
    fits: list[FitResult] = []
    for turn in range(TURNS):
        model, fit = minimised(study, settings, base, on, job, (near, turn))
        fits.append(fit)
        if not model.one_way or not fit.converged or (turn and _close(*fits[-2:])):
            break
        base, near = base.with_vector(fit.x), fit
    return model, fits


def _close(before: FitResult, after: FitResult | None = None) -> bool:
    """True where the second fit has not moved against its standard errors; a single fit is close to itself."""
    if after is None:
        return True
    scale = np.abs(after.x) * 1e-3 if after.sigma is None else SETTLED * np.where(np.isfinite(after.sigma), after.sigma, np.inf)
    return bool(np.all(np.abs(after.x - before.x) <= scale))


def checkpoint_folder(job: Job, label: str) -> str:
    """Name of the folder of evaluations of a job on one mesh."""
    return f".{job.stage}.{label}.evaluations"


def evaluation_key(job: Job, base: Parameters) -> str:
    """All that an evaluation depends on besides the free parameters; of the inputs it is their content that counts."""
    inputs = {name: path_digest(path) for name, path in job.inputs.items()}
    return json_text({"config": job.config, "inputs": inputs, "base": dict(base.values), "source": source_digest()})


def discard_checkpoints(job: Job) -> None:
    """Remove the evaluations and trials of a job whose artefact is safely written."""
    import shutil

    for folder in job.path.parent.glob(f".{job.stage}.*.evaluations"):
        shutil.rmtree(folder, ignore_errors=True)
    for trial in job.path.parent.glob(f".{job.stage}.*.h5"):
        trial.unlink(missing_ok=True)


def method_of(model: StageModel, settings: StageSettings) -> str:
    """Method of a fit. Hardening terms that nearly do each other's work make valleys in which the box of the Gauss-Newton method ends on a
    wall: where a run costs next to nothing least squares go by the trust region."""
    return "trust-region" if model.cheap and settings.method == "least-squares" else settings.method


def minimised(
    study: Study, settings: StageSettings, base: Parameters, on: Target, job: Job, start: tuple[FitResult | None, int] = (None, 0)
) -> tuple[StageModel, FitResult]:
    """Model and fit on one mesh, every evaluation kept on disk; `start` = (a fit that ended at `base` where there is one, number of the
    turn)."""
    (model_on, size, f_tolerance), (near, turn) = on, start
    model = remembering(model_on(size, base))
    label = ("point" if model.cheap else f"{size.n_x}x{size.n_y}x{size.n_z}") + (f".{turn}" if turn else "")
    label += "".join(f".{job.config[key]}" for key in (DRIVE, "start") if key in job.config)
    store = Checkpoint(job.path.parent / checkpoint_folder(job, label), evaluation_key(job, base))
    problem, change = stage_problem(study, settings, base, model, near)
    options = Settings(
        x_tolerance=settings.tolerance, f_tolerance=f_tolerance, max_evaluations=settings.max_evaluations, difference_step=DIFFERENCE_STEP
    )
    with progress(f"{job.stage} {label}", None) as advance:
        hooks = Hooks(store=store, on_evaluation=Follower(advance, settings.free, change))
        fit = minimise(problem, method_of(model, settings), options, hooks)
    return model, change.converted(fit)


def at_rounding(y: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Values y (n,) with those at their bounds that lie beyond them by a rounding error, where a bounded step has left them."""
    inside = np.where((y < lower) & (y >= lower - ROUNDING * np.abs(lower)), lower, y)
    return np.where((inside > upper) & (inside <= upper + ROUNDING * np.abs(upper)), upper, inside)


def stage_problem(
    study: Study, settings: StageSettings, base: Parameters, model: StageModel, near: FitResult | None = None
) -> tuple[Problem, FitVariables]:
    """What the optimiser sees of a stage that starts at `base`, and the map from its variables to the parameters.

    `near`: a fit that ended at `base`, with whose derivatives a search begins.
    """
    names, change = settings.free, fit_variables(settings.free, base)
    bounds = np.array([study.bounds(name) for name in names])
    lower, upper = change.bounds(bounds[:, 0], bounds[:, 1])

    def linearise(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = change.parameters(y)
        residual, slope = model.linearised(base.with_vector(x), names)
        return residual, change.by_variables(slope, x)

    jacobian, curvature = (None, None) if near is None else (near.jacobian, near.curvature)
    problem = Problem(
        residual=lambda y: model.residual(base.with_vector(change.parameters(y))),
        start=at_rounding(change.variables(base.vector()), lower, upper),
        lower=lower,
        upper=upper,
        scale=change.scales(np.array([study.scale(name) for name in names])),
        names=names,
        linearise=None if model.linearise is None else linearise,
        first_jacobian=None if jacobian is None else change.by_variables(jacobian, base.vector()),
        first_curvature=None if curvature is None else change.curvature_by_variables(curvature, base.vector()),
    )
    return problem, change


def within(study: Study, base: Parameters, told: Mapping[str, tuple[float, float]]) -> Study:
    """The study with the bounds within which an earlier stage has told parameters."""
    starts = {name: ParameterStart(start=base[name], bounds=ends, scale=study.scale(name)) for name, ends in told.items()}
    return study.model_copy(update={"parameters": {**study.parameters, **starts}}) if told else study


def remembering(model: StageModel, count: int = 3) -> StageModel:
    """The same model, which knows the error fields of its last parameters: the record of a stage asks again for those at the optimum."""
    kept: OrderedDict[tuple[tuple[str, float], ...], Errors] = OrderedDict()
    exact = model.linearise

    def keep(parameters: Parameters, fields: Errors) -> None:
        kept[tuple(parameters.values.items())] = fields
        if len(kept) > count:
            kept.popitem(last=False)

    def errors(parameters: Parameters) -> Errors:
        known = kept.get(tuple(parameters.values.items()))
        if known is not None:
            return known
        fields = model.errors(parameters)
        keep(parameters, fields)
        return fields

    def linearise(parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        assert exact is not None
        fields, slopes = exact(parameters, names)
        keep(parameters, fields)
        return fields, slopes

    return dataclasses.replace(model, errors=errors, linearise=None if exact is None else linearise)


def covariance_of(model: StageModel, fit: FitResult) -> tuple[Covariance | None, str]:
    """Covariance at an optimum with the correlation of the noise, or None and why not."""
    if fit.jacobian is None:
        return None, "no standard errors: the Jacobian at the optimum could not be formed"
    try:
        return LinearModel(fit.residual, fit.jacobian, noise_of(model, fit.residual)).covariance(fit.names, fit.at_bound), ""
    except UntrustworthyError as error:
        return None, f"no standard errors: {error}"


def noise_of(model: StageModel, residual: np.ndarray) -> NoiseOperator | None:
    """Correlation of the residual at an optimum: as it is over time for records, else as the comparisons put it in; None where white."""
    if model.segments is not None:
        return noise_operator(memories(residual, model.segments))
    return None if model.white else model.noise


def merged_counts(*fits: FitResult | None) -> Mapping[str, float]:
    """Forward runs, of these with exact derivatives, failed and replayed ones and wall time of several fits together."""
    total: dict[str, float] = {"forward": 0, "linearised": 0, "failed": 0, "replayed": 0, "wall_s": 0.0}
    for fit in fits:
        if fit is not None:
            counts = dataclasses.asdict(fit.counts)
            for name in total:
                total[name] += counts[name]
    return total
