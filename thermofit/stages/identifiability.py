"""`identifiability`: do the data determine the parameters, before a test and at the optimum, and within which intervals?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters, param, units_of
from thermofit.experiment.forms import experiment_of
from thermofit.experiment.programmes import OWN
from thermofit.identify.chains import chain_intervals
from thermofit.identify.identifiability import Analysis, analysed
from thermofit.identify.intervals import Interval, KeptEvaluations, bootstrap, full_bootstrap, half_width, laplace, profiles, wider
from thermofit.identify.linear import Linear
from thermofit.identify.solve import discard_checkpoints, evaluation_key
from thermofit.identify.subject import Subject, linear_subject, optimum_of, prepared
from thermofit.records.artefact import Dataset, ParameterResult, of_parameters
from thermofit.records.executor import SERIAL, Executor, Task, run_all
from thermofit.records.key import read_of
from thermofit.records.progress import progress
from thermofit.records.staging import Job, Made, Outcome, job, produce
from thermofit.report.figures import STYLE, save_figures
from thermofit.report.identifiability import (
    Row,
    correlation_rows,
    correlations_figure,
    determined_rows,
    flat_rows,
    interval_rows,
    intervals_json,
    move_remarks,
    profile_figure,
    programme_rows,
    programmes_figure,
    sensitive,
    shift_rows,
    spectrum_figure,
    spectrum_rows,
)
from thermofit.study.study import Study

NAME = "identifiability"
_SECTIONS = (
    *(
        "model",
        "hardening",
        "yield_surface",
        "material_axes",
        "mesh",
        "geometry",
        "specimen",
        "static",
        "parameters",
        "evaluation",
        "force",
        "noise",
    ),
    *("numerics", "simulate", "coupon", "diagnosis.priors"),
)
WIDER = 1.5
"""Bootstrap intervals wider than Laplace's by this factor: the residual is correlated beyond what the noise model knows."""


@dataclass(frozen=True)
class IdentifiabilityOptions:
    """What is asked: `stage` (None: thermal, of coupons plastic); `before` a test, under `programme`; `compare` these programmes
    (empty: all; None: no comparison); `repeats` of a bootstrap (0: none), `refit` each in full; profile; mcmc, on the `full_model`
    itself; `seed`."""

    stage: str | None = None
    before: bool = False
    programme: str = OWN
    compare: tuple[str, ...] | None = None
    repeats: int = 0
    refit: bool = False
    profile: bool = False
    mcmc: bool = False
    full_model: bool = False
    seed: int = 1


def run(study: Study, options: IdentifiabilityOptions | None = None, *, force: bool = False, where: Executor = SERIAL) -> Outcome:
    """Record of an analysis: `identifiability`, `identifiability-a-priori`, or `identifiability-compare`.

    A killed analysis resumes. StudyError where an artefact is missing (names its command), the study plans no test, or an option does not
    fit; UntrustworthyError where there are too few data; NumericsError where the model fails.
    """
    options = _checked(options or IdentifiabilityOptions())
    key = options.stage or experiment_of(study).last_stage
    study.stage(key)
    task = _job(study, options, key)

    def make() -> Made:
        set_threads(study.numerics.threads)
        if options.compare is not None:
            return _compared(study, key, options, task, where)
        return _analysis(study, key, options, task, where)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome


def _checked(options: IdentifiabilityOptions) -> IdentifiabilityOptions:
    """StudyError for options that contradict each other."""
    if options.before and options.repeats:
        raise StudyError("--bootstrap resamples a measured residual, and --a-priori has none: leave out one of them")
    if options.refit and not options.repeats:
        raise StudyError("--refit fits every repeat of a bootstrap anew: give --bootstrap N too")
    if options.full_model and not options.mcmc:
        raise StudyError("--full-model is about the chain of --mcmc: give both")
    if options.programme != OWN and not options.before:
        raise StudyError(f"--programme {options.programme} is a planned test: give --a-priori too")
    if options.compare is not None and (options.repeats or options.profile or options.mcmc):
        raise StudyError("--compare ranks planned tests by their linearised intervals: leave out --bootstrap, --profile and --mcmc")
    return options


def _job(study: Study, options: IdentifiabilityOptions, key: str) -> Job:
    planned = options.before or options.compare is not None
    name = f"{NAME}-compare" if options.compare is not None else f"{NAME}-a-priori" if options.before else NAME
    inputs: dict[str, Path] = {}
    if not planned:
        inputs = {**optimum_of(study, key)[1]}
    else:
        inputs = experiment_of(study).plan_inputs
    several = ("experiments", "shared") if study.fitted else ()
    config = {**read_of(study, *_SECTIONS, *several, f"stages.{key}"), "options": {**asdict(options), "stage": key}}
    return job(study.run_dir, name, config, inputs)


def _analysis(study: Study, key: str, options: IdentifiabilityOptions, task: Job, where: Executor) -> Made:
    subject = Subject(study, key, options.programme if options.before else None)
    ready = prepared(subject)
    kept = KeptEvaluations(task.path.parent / f".{task.stage}.parts.evaluations", evaluation_key(task, ready.base))
    linear = linear_subject(subject, kept.store("linear"))
    analysis = analysed(linear)
    found: dict[str, Mapping[str, Interval]] = {"laplace": laplace(linear, analysis)}
    datasets, remarks = _matrices(linear, analysis), [ready.remark] if ready.remark else []
    curves: Mapping[str, np.ndarray] = {}
    if options.repeats:
        found["bootstrap"], draws, said = _bootstrapped(subject, linear, options, kept, where)
        datasets["bootstrap/x"] = of_parameters(draws, ("repeat", "parameter"), units_of(linear.names))
        ratio = wider(dict(found["bootstrap"]), dict(found["laplace"]), linear.names)
        remarks += [said, *_wider_remark(ratio)]
    if options.profile:
        found["profile"], curves = profiles(subject, linear, analysis, kept, where)
        datasets |= {f"profile/{n}": Dataset(v, "1", ("point", "value_and_rise")) for n, v in curves.items()}
    if options.mcmc:
        found["mcmc"], chain = chain_intervals(subject, linear, analysis, options.seed, options.full_model)
        datasets["mcmc/x"] = of_parameters(chain.x, ("draw", "parameter"), units_of(_inside(linear)))
        remarks.append(f"chain: {chain.steps} steps, correlation time {chain.correlation_time:.3g}, acceptance {chain.acceptance:.2f}")
    pictures = {"correlation": correlations_figure, "spectrum": spectrum_figure}
    with matplotlib.rc_context(STYLE):
        figures: dict[str, Figure | None] = {name: draw(analysis) for name, draw in pictures.items()}
        figures["profile"] = profile_figure(linear, curves, found)
        paths = _saved(study, task.stage, figures)
    summary = {
        **_summary(linear, analysis, half_width(linear, analysis)),
        "stage_analysed": key,
        "before": options.before,
        "intervals": intervals_json(found),
        "interval_table": interval_rows(found),
        "remarks": [*remarks, *move_remarks(linear, analysis), *_interval_remarks(found)],
        "figures": paths,
    }
    return Made(datasets, summary, _parameters(study, linear, analysis), options.seed if options.repeats or options.mcmc else None)


def _bootstrapped(
    subject: Subject, linear: Linear, options: IdentifiabilityOptions, kept: KeptEvaluations, where: Executor
) -> tuple[Mapping[str, Interval], np.ndarray, str]:
    if options.refit:
        found, draws, blocks = full_bootstrap(subject, linear, options.repeats, options.seed, kept, where)
        how = "every repeat fitted anew"
    else:
        found, draws, blocks = bootstrap(linear, options.repeats, options.seed)
        how = "with the Jacobian of the optimum"
    return found, draws, f"bootstrap: {options.repeats} repeats, {how}; {blocks.remark}"


def _wider_remark(ratio: float) -> list[str]:
    if ratio < WIDER:
        return []
    return [
        f"bootstrap intervals are up to {ratio:.2g} times those of Laplace: the residual holds more than the noise, correlated over time "
        "and space; trust the bootstrap"
    ]


def _interval_remarks(found: Mapping[str, Mapping[str, Interval]]) -> list[str]:
    return [f"{way} of {name}: {i.remark}" for way, ways in found.items() for name, i in ways.items() if i.remark]


def _summary(linear: Linear, analysis: Analysis, half: float) -> dict[str, Any]:
    moves = shift_rows(linear, analysis)
    strong = {linear.shifts[name].words: list(sensitive(linear, change)) for name, change in analysis.shifts.items()}
    return {
        "verdict": analysis.verdict,
        "trustworthy": analysis.kind == "unique",
        "kind": analysis.kind,
        "determined": determined_rows(linear, analysis, half),
        "correlation_sensitivity": correlation_rows(analysis, "C^S"),
        "correlation_parameters": correlation_rows(analysis, "C^P"),
        "spectrum": spectrum_rows(analysis),
        "condition": analysis.spectrum.condition,
        "flat_directions": flat_rows(analysis.spectrum.flat),
        "to_fix": [list(names) for names in analysis.fixing],
        "criteria": asdict(analysis.criteria),
        "moved_by": moves,
        "sensitive_to": strong,
        "data": {"n": len(linear.residual), "s2": analysis.s2},
    }


def _matrices(linear: Linear, analysis: Analysis) -> dict[str, Dataset]:
    dims, spread = ("parameter", "parameter"), analysis.covariance
    return {
        "names": Dataset(np.array(linear.names), "1", ("parameter",)),
        "covariance": of_parameters(analysis.s2 * spread.matrix_unit, dims, units_of(linear.names)),
        "correlation": Dataset(spread.correlation_parameters, "1", dims),
        "correlation_sensitivity": Dataset(spread.correlation_sensitivity, "1", dims),
        "eigenvalues": Dataset(analysis.spectrum.values, "1", ("direction",)),
        "eigenvectors": Dataset(analysis.spectrum.vectors, "1", ("parameter", "direction")),
    }


def _inside(linear: Linear) -> tuple[str, ...]:
    """Names of the parameters that are not at a bound."""
    return tuple(name for name, at in zip(linear.names, linear.at_bound, strict=True) if not at)


def _parameters(study: Study, linear: Linear, analysis: Analysis) -> dict[str, ParameterResult]:
    out = {}
    for i, name in enumerate(linear.names):
        sigma = float(analysis.sigma[i])
        value, low, high = float(linear.x[i]), float(linear.lower[i]), float(linear.upper[i])
        at = bool(linear.at_bound[i])
        out[name] = ParameterResult(value, sigma if np.isfinite(sigma) else None, param(name).unit, True, at, value, low, high)
    return out


def _saved(study: Study, stage: str, figures: Mapping[str, Figure | None]) -> list[str]:
    """Paths of the figures; StudyError where the folder cannot be written."""
    made = {f"{stage}-{name}": figure for name, figure in figures.items() if figure is not None}
    folder = study.run_dir / "figures"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [str(path) for path in save_figures(folder, made)]
    except OSError as error:
        raise StudyError(f"'{folder}' cannot be written ({error}): expected a writable folder with free space") from error


def _compared(study: Study, key: str, options: IdentifiabilityOptions, task: Job, where: Executor) -> Made:
    """Programmes ranked by the intervals that they would give."""
    assert options.compare is not None
    names = options.compare or experiment_of(study).programmes
    kept = KeptEvaluations(task.path.parent / f".{task.stage}.parts.evaluations", evaluation_key(task, Parameters.of({})))
    tasks = [Task(f"programme {name}", programme_task, (study, key, name, kept)) for name in names]
    with progress("compare", len(tasks)) as advance:
        found = run_all(tasks, where, lambda index, row: advance(1, names[index]))
    rows = programme_rows(found)
    free = study.stage(key).free
    with matplotlib.rc_context(STYLE):
        paths = _saved(study, task.stage, {"programmes": programmes_figure(rows, free)})
    best = rows[0]
    summary = {
        "verdict": compare_verdict(rows, free),
        "trustworthy": best["kind"] == "unique",
        "stage_analysed": key,
        "programmes": rows,
        "figures": paths,
        "remarks": [f"{row['programme']}: {row['said']}" for row in rows if row["kind"] != "unique"],
    }
    return Made({}, summary)


def programme_task(study: Study, key: str, name: str, kept: KeptEvaluations) -> Row:
    """A row of the comparison: one programme as planned, or why it cannot be carried out."""
    free = study.stage(key).free
    try:
        analysis = analysed(linear_subject(Subject(study, key, name), kept.store(f"linear-{name}")))
    except NumericsError as error:
        return {
            "programme": name,
            "kind": "failed",
            "said": str(error),
            "D": np.nan,
            "A": np.nan,
            "E": np.nan,
            **dict.fromkeys(free, np.nan),
        }
    relative = dict(zip(analysis.names, analysis.relative.tolist(), strict=True))
    c = analysis.criteria
    return {"programme": name, "kind": analysis.kind, "said": analysis.verdict, "D": c.d, "A": c.a, "E": c.e, **relative}


def compare_verdict(rows: Sequence[Row], free: Sequence[str]) -> str:
    """Which programme tells most, and which leave something open."""
    good = [row for row in rows if row["kind"] == "unique"]
    weak = [str(row["programme"]) for row in rows if row["kind"] == "weak"]
    worse = [str(row["programme"]) for row in rows if row["kind"] not in ("unique", "weak", "failed")]
    left = f"; {', '.join(weak)} tell{'s' if len(weak) == 1 else ''} too little of a direction" if weak else ""
    left += f"; {', '.join(worse)} leave{'s' if len(worse) == 1 else ''} something open" if worse else ""
    if not good:
        return f"no programme determines {', '.join(free)}{left}"
    best = good[0]
    worst = max(free, key=lambda name: float(best[name]))
    text = f"{best['programme']} tells most: {', '.join(free)} to {100 * float(best['A']):.2g} % (rms), {worst} least"
    return f"{text} (+- {100 * float(best[worst]):.2g} %){left}"
