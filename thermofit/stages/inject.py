"""`inject`: plant an effect into the measured data, run the loop on them, and count how often it is found; predict that beforehand."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import matplotlib

from thermofit.core.digest import path_digest, source_digest
from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.core.jsonable import json_text
from thermofit.diagnose.expected import expected
from thermofit.diagnose.injected import Injection, answered
from thermofit.diagnose.known_fit import known_fit
from thermofit.diagnose.planting import asked, plantable, plantings
from thermofit.diagnose.prepared import DIAGNOSE, Prepared, diagnosis_job, prepared
from thermofit.diagnose.trace import traced
from thermofit.effects.catalogue import Effect
from thermofit.experiment.drive import SECTIONS
from thermofit.identify.solve import discard_checkpoints, merged_counts
from thermofit.records.artefact import fresh, open_record
from thermofit.records.executor import SERIAL, Executor, Task, run_all
from thermofit.records.progress import progress
from thermofit.records.staging import Job, Made, Outcome, produce
from thermofit.records.stopping import keeps, kept
from thermofit.report.figures import STYLE, save_figures
from thermofit.report.findings import diagnosis_parameters
from thermofit.report.injections import Injected, injection_datasets, injection_map, injection_summary, local_params
from thermofit.study.study import Study

NAME = "inject"
KEPT = f"{NAME}.jsonl"
"""Finished runs of the loop in the run folder, one JSON object a line: what was planted and what was said of it."""
FIGURE = "injection-map"
LOOP = "close-loop"


@dataclass(frozen=True)
class InjectOptions:
    """What is planted: an effect by name, its amplitude in its unit, how many draws, values of its other Params that are not drawn, the
    seed of the draws; whether the answer is only predicted."""

    effect: str
    amplitude: float
    count: int = 1
    secondary: Mapping[str, float] = field(default_factory=dict)
    seed: int = 1
    predict_only: bool = False


def run(study: Study, options: InjectOptions, *, force: bool = False, where: Executor = SERIAL) -> Outcome:
    """Record `<run_dir>/inject-<effect>.h5` of how often the effect is found, what else is named, and what was predicted.

    Needs `interpolate` and the identification stages. A killed command resumes: each finished run of the loop is kept in
    `<run_dir>/inject.jsonl` and not made again. StudyError for an effect that is not known or cannot be planted; UntrustworthyError where a
    fit of the stages has not converged; NumericsError where a run with the effect fails.
    """
    if options.count < 1:
        raise StudyError(f"--count is {options.count}; expected how often the effect is planted, 1 or more")
    one, given = asked(options.effect, options.amplitude, options.secondary)
    plain, stages = diagnosis_job(study, NAME)
    wanted = {"effect": one.name, "values": given, "count": options.count, "seed": options.seed, "predict_only": options.predict_only}
    path = study.run_dir / f"{NAME}-{one.name}.h5"
    task = replace(plain, path=path, config={**plain.config, NAME: wanted})

    def make() -> Made:
        set_threads(study.numerics.threads)
        return _made(study, stages, plain, one, given, options, where)

    outcome = produce(task, make, force=force)
    discard_checkpoints(task)
    return outcome


def _made(
    study: Study, stages: tuple[str, ...], plain: Job, one: Effect, given: dict[str, float], options: InjectOptions, where: Executor
) -> Made:
    """The prediction, the runs of the loop, and both side by side."""
    found = prepared(study, plain, stages, known_fit(diagnosis_job(study, DIAGNOSE)[0]))
    plantable(found.case, one)
    here = traced(found.case, found.numerical, study.diagnosis.held_out, fit=found.fit)
    drawn = plantings(found.case, one, given, options.count, options.seed)
    there = tuple(expected(here, one, drawn))
    base: dict[str, Any] | None = None
    rows: tuple[dict[str, Any], ...] = ()
    if not options.predict_only:
        turned = found.drive == SECTIONS
        at = [found.case.parameters.replace(**how.values) for how in drawn]
        ones = [_injection(study, stages, turned, found, after, one, plain) for after in (found.case.parameters, *at)]
        base, *others = _run(study, ones, where)
        rows = tuple(others)
    names, reach = local_params(one), None
    if names is not None:
        seen = here.rows.channel >= 0
        y, t = here.rows.xy[seen, 1], here.rows.time[seen]
        reach = (float(y.min()), float(y.max())), (float(t.min()), float(t.max()))
    of = Injected(one, drawn, there, base, rows, reach)
    summary = injection_summary(of)
    if reach is not None:
        with matplotlib.rc_context(STYLE):
            pictures = save_figures(study.run_dir / "figures", {FIGURE: injection_map(of, found.case.spans)})
        summary["figures"] = {FIGURE: str(pictures[0])}
    fewer = [f"{len(drawn)} of {options.count} injections are different: nothing else of {one.name} can be drawn"]
    points = ", ".join(s.effect for s in here.promising())
    holding = [f"the data as they are point to {points} already; that counts as neither expected nor found"] if points else []
    settled = [] if found.fit.converged else ["the joint fit has not settled: planted at the optimum of the stages"]
    summary["remarks"] = [*summary["remarks"], *holding, *settled, *found.remarks, *(fewer if len(drawn) < options.count else [])]
    summary["trustworthy"] = found.fit.converged and not any("failed" in row for row in rows)
    summary["evaluations"] = merged_counts(found.fit)
    summary |= {"amplitude": options.amplitude, "count": len(drawn), "seed": options.seed, "kept": str(study.run_dir / KEPT)}
    return Made(injection_datasets(of), summary, diagnosis_parameters(study, found.case, found.fit), options.seed)


def _injection(study: Study, stages: tuple[str, ...], turned: bool, found: Prepared, after: Any, one: Effect, plain: Job) -> Injection:
    """One run of the loop; a folder of evaluations of its own."""
    before = found.case.parameters
    changed = {name: value for name, value in after.values.items() if value != before[name]}
    config = {**plain.config, "planted": changed, "at": dict(before.values) if changed else {}}
    inputs = {name: path_digest(path) for name, path in plain.inputs.items()}
    digest = hashlib.sha256(json_text({"config": config, "inputs": inputs, "source": source_digest()}).encode()).hexdigest()[:16]
    return Injection(study, stages, turned, before, after, one.name, replace(plain, stage=f"{NAME}.{digest}", config=config))


def _run(study: Study, ones: list[Injection], where: Executor) -> list[dict[str, Any]]:
    """What the loop says of each; what an earlier command has found is taken from the run folder, and that of the data as they are from a
    fresh record of `close-loop`."""
    kept_rows = _Kept(study.run_dir / KEPT)
    first = _known_answer(study)
    if first is not None:
        kept_rows.rows.setdefault(ones[0].job.stage, first)
    missing = [one for one in ones if one.job.stage not in kept_rows.rows]
    tasks = [Task(f"injection {number}", answered, (one,)) for number, one in enumerate(missing, start=1)]
    with progress(NAME, len(ones)) as advance:
        advance(len(ones) - len(missing))

        def done(index: int, row: dict[str, Any]) -> None:
            one = missing[index]
            kept_rows.add(one, row)
            discard_checkpoints(one.job)
            advance(1, row.get("failed") or ", ".join(row["accepted"]) or "nothing named")
            kept()

        run_all(tasks, where, done)
    return [kept_rows.rows[one.job.stage] for one in ones]


def _known_answer(study: Study) -> dict[str, Any] | None:
    """What a fresh record of `close-loop` says of the data as they are."""
    task, _ = diagnosis_job(study, LOOP)
    if not fresh(task.path, task.stage, task.config, task.inputs):
        return None
    said = open_record(task.path).summary
    unlisted = said.get("unlisted")
    return {
        "accepted": said["accepted"],
        "like": said["stand_ins"],
        "unlisted": None if unlisted is None else {"channel": unlisted["channel"]},
        "estimate": {},
    }


class _Kept:
    """Rows by the digest of all that they depend on, in a file that grows by whole lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, dict[str, Any]] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        for line in lines:
            try:
                row = json.loads(line)
                self.rows[row["key"]] = row
            except (json.JSONDecodeError, KeyError, TypeError):
                continue  # a line that a kill has cut off
        keeps(self)

    def add(self, one: Injection, row: dict[str, Any]) -> None:
        """Keep a finished run."""
        planted = {n: v for n, v in one.after.values.items() if v != one.before[n]}
        self.rows[one.job.stage] = row
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as stream:
            if stream.tell() and not self.path.read_bytes().endswith(b"\n"):
                stream.write("\n")
            line = json_text({"key": one.job.stage, "effect": one.effect, "planted": planted, **row})
            stream.write(line.replace("\n", " ") + "\n")
