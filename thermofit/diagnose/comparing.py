"""Models side by side on the same data: fitted to the same channels, judged by error, held-out error and information criteria.

How many independent values a residual is worth, and what information criteria make of that.

The correlation of the whitened residual is measured in time (pooled over the points) and over distance (pooled over the times), each
up to where it first dies away; n values are worth n / (tau_time tau_space). Misfit and interpolated noise hang together alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist, squareform

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.diagnose.case import Case, rows_of_tests, stacked
from thermofit.diagnose.held_out import Proof, Rows, Split, compared
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.trace import room_of, split_of
from thermofit.effects.catalogue import effect
from thermofit.experiment.channels import field_of
from thermofit.experiment.fields import with_identified
from thermofit.experiment.forms import experiment_after
from thermofit.experiment.model import StageModel
from thermofit.experiment.protocol import Experiment, JointProblem
from thermofit.experiment.trust import WHOLE
from thermofit.experiment.verification import identified_stages
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import memories
from thermofit.fit.result import FitResult
from thermofit.law.hardening.catalogue import LINEAR, hardening
from thermofit.law.hardening.curves import taken_over
from thermofit.law.surface.catalogue import surface
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation
from thermofit.records.staging import Job
from thermofit.study.literature import Candidate
from thermofit.study.models import start_of as start_value
from thermofit.study.section import law_named, surface_error
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

_GONE = 0.02
"""Correlation below which values count as independent."""
_BINS = 24
_LEAST_TIMES = 8
"""Fewer times of a point tell nothing of the memory; then every time counts as independent."""


def independent(model: StageModel, residual: np.ndarray) -> dict[str, float]:
    """Number of independent values by channel at a residual (n,) whitened by the noise."""
    if model.segments is not None:
        found, out, at = memories(residual[: sum(model.segments)], model.segments), {}, 0
        for c in model.comparisons:
            out[c.channel] = sum(m.independent for m in found if at <= m.part.start < at + c.n)
            at += c.n
        return out
    out, at = {}, 0
    for c in model.comparisons:
        out[c.channel] = _of_field(c, residual[at : at + c.n], model.observations[field_of(c)])
        at += c.n
    return out


def _of_field(c: Comparison, r: np.ndarray, observation: FieldObservation) -> float:
    z = np.zeros((len(observation.time), len(observation.xy), int(c.rows[:, 2].max(initial=0)) + 1))
    np.add.at(z, tuple(c.rows.T), r)
    return max(c.n / (time_scale(z) * length_scale(z, observation.xy)), 1.0)


def time_scale(z: np.ndarray) -> float:
    """1 + 2 sum of the correlation over time of z (n_t, n_s, n_c), zero where nothing is compared; at least 1."""
    n_t = len(z)
    total = float(np.sum(z**2))
    if n_t < _LEAST_TIMES or total == 0.0:
        return 1.0
    rho = np.array([np.sum(z[:-k] * z[k:]) / total for k in range(1, n_t)])
    below = np.flatnonzero(rho <= _GONE)
    return float(1.0 + 2.0 * np.sum(rho[: below[0]] if below.size else rho))


def length_scale(z: np.ndarray, xy: np.ndarray) -> float:
    """Number of points that err as one: mean over points of the sum of the correlation over distance of z (n_t, n_s, n_c); at least 1."""
    if len(xy) < 3:
        return 1.0
    flat = z.transpose(1, 0, 2).reshape(len(xy), -1)
    size = np.sqrt(np.sum(flat**2, axis=1))
    used = np.flatnonzero(size > 0.0)
    if len(used) < 3:
        return 1.0
    product, mean = flat[used] @ flat[used].T, float(np.mean(size[used] ** 2))
    distance = squareform(pdist(xy[used]))
    edges = np.linspace(0.0, 0.5 * float(distance.max()), _BINS + 1)
    number = np.digitize(distance, edges[1:])
    off = ~np.eye(len(used), dtype=bool)
    total = 0.0
    for k in range(_BINS):
        here = off & (number == k)
        if not here.any():
            continue
        rho = float(product[here].mean()) / mean
        if rho <= _GONE:
            break
        total += rho * float(here.sum()) / len(used)
    return 1.0 + total


@dataclass(frozen=True)
class Criteria:
    """Information criteria of a fit: deviance, AIC, BIC, number of fitted parameters and of independent values."""

    deviance: float
    aic: float
    bic: float
    parameters: int
    independent: float


def criteria(mean_square: Mapping[str, float], worth: Mapping[str, float], parameters: int, priors: float = 0.0) -> Criteria:
    """AIC and BIC from the mean square of every channel's whitened residual and the number of independent values in it.

    The variance of a channel is the noise's, or larger where the model misfits: -2 ln L = sum n (ln s^2 + q / s^2) with s^2 = max(q, 1)
    the most likely one, q the mean square; so a misfit counts as one, not as thousands of sure contradictions. `priors` is the square
    sum of departures from what is known of parameters.
    """
    deviance = priors
    for channel, q in mean_square.items():
        variance = max(q, 1.0)
        deviance += worth[channel] * (np.log(variance) + q / variance)
    count = float(sum(worth.values()))
    return Criteria(float(deviance), float(deviance + 2.0 * parameters), float(deviance + parameters * np.log(count)), parameters, count)


def mean_squares(model: StageModel, residual: np.ndarray) -> dict[str, float]:
    """Mean square of the residual by channel."""
    out, at = {}, 0
    for c in model.comparisons:
        out[c.channel] = float(np.mean(residual[at : at + c.n] ** 2))
        at += c.n
    return out


def least(values: Sequence[float]) -> int:
    """Place of the smallest value."""
    return int(np.argmin(np.array(values)))


_FIRST = 0.1
"""Share of its probe at which an effect starts that a candidate adds."""
_SURE = 2.0
"""Standard errors by which a held-out error differs."""
_PLAIN, _STRONG = 2.0, 10.0
"""Differences of BIC that mean something, and that mean much (Kass and Raftery 1995)."""


@dataclass(frozen=True)
class Contender:
    """A model fitted to the joint data: name, study, experiment, joint problem at the optimum, fit, residual (n,) and columns (n, p)."""

    name: str
    study: Study
    experiment: Experiment
    problem: JointProblem
    fit: FitResult
    residual: np.ndarray
    columns: np.ndarray
    failures: tuple[str, ...] = ()
    """Starts that failed on the way, in words."""

    @property
    def parameters(self) -> Parameters:
        """Parameters at the optimum."""
        return self.problem.base

    @property
    def model(self) -> StageModel:
        """Model of all channels."""
        return self.problem.model


def candidate_study(study: Study, candidate: Candidate) -> Study:
    """The study with the hardening law, the yield surface and the parameters of a candidate. A hardening law other than the study's starts
    on the curve of the study's start, but for what the candidate gives; Params of the study's yield surface go with it."""
    own = hardening(law_named(candidate.model, candidate.hardening) or study.hardening_law)
    other = hardening(study.hardening_law)
    taken: dict[str, float] = {}
    if not set(own.fitted) <= set(other.fitted):
        starts = {name: start_value(setting) for name, setting in study.parameters.items()}
        taken = taken_over(own, other, {name: starts.get(name, param(name).neutral) for name in (*other.names, LINEAR)})
        taken = {name: value for name, value in taken.items() if name not in other.fitted}
    yields = surface(candidate.yield_surface or study.yield_surface)
    gone = set(surface(study.yield_surface).names) - set(yields.names)
    kept = {name: setting for name, setting in study.parameters.items() if bare_name(name) not in gone}
    starts = {name: value for name, value in getattr(yields.file, "LITERATURE", {}).items() if name in yields.fitted and name not in kept}
    changes: dict[str, Any] = {
        "parameters": {**kept, **taken, **starts, **candidate.parameters},
        "hardening": own.name,
        "yield_surface": yields.name,
    }
    if wrong := surface_error(candidate.parameters, yields.name):
        raise StudyError(f"{study.source.name}: key 'compare': {wrong[0]} {wrong[1]}")
    return study.model_copy(update=changes)


def wanted_of(candidate: Candidate, settings: StageSettings, own: Study, study: Study) -> tuple[str, ...]:
    """What a candidate fits: its own choice, else all of the joint fit, and what it adds. What the hardening law of its study `own` frees
    takes the place of what that of the `study` frees with which it competes."""
    names = candidate.free or hardening(own.hardening_law).exchanged(settings.free, hardening(study.hardening_law))
    names = names if candidate.free else surface(own.yield_surface).exchanged(names, surface(study.yield_surface))
    added: list[str] = []
    for name in candidate.add:
        added += [name] if "." in name or not _is_effect(name) else [p.name for p in effect(name).amplitudes]
    for name in added:
        param(name)
    return tuple(dict.fromkeys((*names, *added)))


def _is_effect(name: str) -> bool:
    try:
        effect(name)
    except StudyError:
        return False
    return True


def fitted(study: Study, name: str, candidate: Candidate, task: Job) -> Contender:
    """A candidate fitted from where the stages ended. NumericsError where its model fails at the start."""
    own = candidate_study(study, candidate)
    experiment = experiment_after(own, identified_stages(study))
    settings = experiment.joint_settings(wanted_of(candidate, experiment.joint_settings(), own, study))
    free = settings.free
    base, _ = with_identified(study, experiment.start(), identified_stages(study))
    base = base.replace(**_on_the_curve(study, own, base))
    base = _started(base, candidate, free).with_free(free)
    problem = experiment.joint(settings, base)
    model = problem.model
    keyed = replace(task, config={**task.config, "candidate": {"name": name, **candidate.model_dump(mode="json")}})
    joint = JointFit(own, settings, model, keyed, settings.max_evaluations, problem.parts)
    try:
        parameters, fit = joint(base, name)
    except NumericsError as error:
        raise NumericsError(f"candidate '{name}': {error}") from error
    residual, columns = model.linearised(parameters, free)
    return Contender(name, own, experiment, replace(problem, base=parameters), fit, residual, columns, tuple(joint.failures))


def _on_the_curve(study: Study, own: Study, base: Parameters) -> dict[str, float]:
    """What another hardening law frees, on the curve that the study's has at `base`, inside its bounds; nothing where it frees the same."""
    law, other = hardening(own.hardening_law), hardening(study.hardening_law)
    if set(law.fitted) == set(other.fitted):
        return {}
    found = taken_over(law, other, base)
    return {name: float(np.clip(value, *own.bounds(name))) for name, value in found.items()}


def _started(base: Parameters, candidate: Candidate, free: Sequence[str]) -> Parameters:
    """Values of a candidate's own parameters; what it adds starts where it can be felt."""
    values = {name: s if isinstance(s, float | int) else s.start for name, s in candidate.parameters.items()}
    for name in free:
        p = param(name)
        if p.probe is not None and name not in values and base[name] == p.neutral:
            values[name] = p.neutral + _FIRST * (p.probe - p.neutral)
    return base.replace(**values)


@dataclass(frozen=True)
class Judged:
    """Contenders with what judges them: criteria, mean squares by channel, held-out residual (n,) of each, its rows, how it was made."""

    contenders: tuple[Contender, ...]
    criteria: tuple[Criteria, ...]
    errors: tuple[Mapping[str, float], ...]
    held_out: tuple[np.ndarray, ...]
    rows: Rows
    by: str

    def proof(self, before: int, after: int) -> Proof:
        """How much better one contender predicts held-out data than another."""
        return compared(self.held_out[before], self.held_out[after], self.rows, 1)


def judged(study: Study, contenders: Sequence[Contender]) -> Judged:
    """The same data, the same number of independent values (that of the best fit), the same held-out data for all contenders."""
    errors = [mean_squares(c.model, c.residual) for c in contenders]
    best = contenders[least([float(np.mean(c.residual**2)) for c in contenders])]
    worth = independent(best.model, best.residual)
    scores = []
    for c, q in zip(contenders, errors, strict=True):
        known = len(c.model.departures(c.parameters))
        scores.append(criteria(q, worth, len(c.parameters.free) - known, float(np.sum(c.model.departures(c.parameters) ** 2))))
    found, rows, by = _held_out(study, contenders)
    return Judged(tuple(contenders), tuple(scores), tuple(errors), found, rows, by)


def _held_out(study: Study, contenders: Sequence[Contender]) -> tuple[tuple[np.ndarray, ...], Rows, str]:
    """Held-out residuals: predictions of declared experiments or records, else of folds by the linearised models."""
    first = contenders[0]
    if first.experiment.unseen:
        return _unseen(contenders)
    problem = first.problem
    rows = rows_of_tests(problem.each, problem.spans)
    case = Case(
        first.model, first.parameters, (), problem.spans, frozenset(), first.model.cheap, correlation_length=problem.correlation_length
    )
    split = split_of(case, rows, first.columns, study.diagnosis.held_out)
    return tuple(_predicted(c, split) for c in contenders), rows, split.by


def _predicted(contender: Contender, split: Split) -> np.ndarray:
    room = room_of(contender.parameters, contender.parameters.free)
    return LinearModel(contender.residual, contender.columns, bounds=room).predicted(split.folds)


def _unseen(contenders: Sequence[Contender]) -> tuple[tuple[np.ndarray, ...], Rows, str]:
    out, rows = [], []
    for c in contenders:
        free = c.problem.settings.free
        there = [(test, test.predicted(c.parameters, free)) for test in c.experiment.unseen]
        problems = [test.problem(c.problem.settings, parameters, ()) for test, parameters in there]
        out.append(np.concatenate([p.model.residual(at) for p, (_, at) in zip(problems, there, strict=True)]))
        rows = [rows_of_tests(p.each, p.spans) for p in problems]
    names = ", ".join(test.label for test in contenders[0].experiment.unseen)
    return tuple(out), stacked(rows), f"{names}, which no fit has seen"


def verdict(found: Judged) -> tuple[str, bool]:
    """In words which model the data prefer, and whether criteria and held-out data say so alike."""
    names = [c.name for c in found.contenders]
    order = np.argsort([c.bic for c in found.criteria])
    best, rest = int(order[0]), [int(k) for k in order[1:]]
    parts, sure = [], True
    for k in rest:
        more = found.criteria[k].bic - found.criteria[best].bic
        proof = found.proof(k, best)
        gain = f"held-out error {_changed(proof)}"
        if more < _PLAIN:
            parts.append(f"{names[k]} is as good (BIC {more:+.1f}; {gain})")
        elif proof.gain < -_SURE * proof.sigma:
            sure = False
            parts.append(f"{names[k]} predicts held-out data better though its BIC is {more:.0f} higher ({gain})")
        else:
            word = "far worse" if more > _STRONG else "worse"
            confirmed = "" if proof.gain > _SURE * proof.sigma else ", which held-out data do not confirm"
            parts.append(f"{names[k]} is {word} (BIC {more:+.0f}; {gain}{confirmed})")
    left = max(float(np.sqrt(q)) for q in found.errors[best].values())
    fits = f"explains the data ({left:.2f} times the noise at most)" if left <= WHOLE else f"leaves up to {left:.2g} times the noise"
    if not all(c.fit.converged for c in found.contenders):
        unsettled = [c.name for c in found.contenders if not c.fit.converged]
        parts.append(f"not converged: {', '.join(unsettled)}")
        sure = False
    return f"{names[best]} is preferred and {fits}" + "".join(f"; {part}" for part in parts), sure


def _changed(proof: Proof) -> str:
    word = "lower" if proof.gain >= 0.0 else "higher"
    return f"{abs(100.0 * proof.gain):.1f} +- {100.0 * proof.sigma:.1f} % {word}"


def table(found: Judged) -> list[dict[str, Any]]:
    """One row for each contender: number of fitted parameters, error and held-out error over the noise, criteria, the best BIC as zero."""
    best = min(c.bic for c in found.criteria)
    rows = []
    for c, score, q, unseen_r in zip(found.contenders, found.criteria, found.errors, found.held_out, strict=True):
        row: dict[str, Any] = {"model": c.name, "fitted": score.parameters, "n_independent": score.independent}
        row |= {f"{channel} over noise": float(np.sqrt(value)) for channel, value in q.items()}
        row["held out over noise"] = float(np.sqrt(np.nanmean(unseen_r**2)))
        rows.append({**row, "AIC": score.aic, "BIC": score.bic, "BIC - best": score.bic - best})
    return rows


def parameter_table(found: Judged) -> list[dict[str, Any]]:
    """One row for each parameter that any contender fits: value and standard error in each."""
    names = dict.fromkeys(name for c in found.contenders for name in c.parameters.free)
    rows = []
    for name in names:
        row: dict[str, Any] = {"parameter": name, "unit": param(name).unit}
        for c in found.contenders:
            row[c.name] = c.parameters[name] if name in c.parameters.free else None
            sigma = None if c.fit.sigma is None or name not in c.fit.names else float(c.fit.sigma[c.fit.names.index(name)])
            row[f"{c.name} +-"] = sigma if sigma is not None and np.isfinite(sigma) else None
        rows.append(row)
    return rows
