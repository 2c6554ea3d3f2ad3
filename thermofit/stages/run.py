"""`run`: the chain of stages. It knows their order and when one does not apply, never what they do: the command line hands them in."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from thermofit.core.errors import StudyError
from thermofit.core.parameters import bare_name
from thermofit.experiment.forms import experiment_of
from thermofit.records.artefact import ParameterResult, Record, open_record
from thermofit.records.lock import locked
from thermofit.records.result import is_trustworthy, result_of
from thermofit.records.staging import Outcome, artefact_path
from thermofit.study.errors import near_miss
from thermofit.study.study import Study

NAME = "run"
OPTIONAL = ("gridsearch", "sensitivity")
"""Stages that cost many identifications: run on demand."""
ALONE = "necking"
"""The only link of the chain of a necking test."""
IDENTIFY = ("identify-elastic", "identify-plastic", "identify-thermal")
REFINE = "refine"
_SOLVES = {"simulate", *IDENTIFY, REFINE, "verify"}
"""Stages that run a model."""


@dataclass(frozen=True)
class Link:
    """One stage of the chain: its name, and its function `run(study, *, force) -> Outcome`."""

    name: str
    run: Callable[..., Outcome]


@dataclass(frozen=True)
class Selection:
    """First and last stage (None: from the beginning, to the end), and whether the optional ones are wanted."""

    first: str | None = None
    last: str | None = None
    everything: bool = False


@dataclass(frozen=True)
class ChainStep:
    """What became of one stage: its outcome and wall time in s, or why it was left out."""

    name: str
    outcome: Outcome | None
    seconds: float
    skipped: str = ""


@dataclass(frozen=True)
class Row:
    """One identified parameter of the final table; `true` and `deviation` (value/true - 1) are None where the truth is not known."""

    name: str
    unit: str
    true: float | None
    start: float
    value: float
    sigma: float | None
    deviation: float | None
    at_bound: bool
    stage: str
    sigma_noise: float | None = None
    """The part of sigma that the noise of the data makes."""
    staged: float | None = None
    """What the stage that identified it alone had, where all were refined together."""


def selected(names: Sequence[str], selection: Selection) -> tuple[str, ...]:
    """The chosen stages in their order; optional ones where all are wanted or where they are named.

    StudyError for an unknown name and where the last stage comes before the first.
    """
    for option, name in (("--from", selection.first), ("--until", selection.last)):
        if name is not None and name not in names:
            raise StudyError(f"{option} {name}: there is no such stage{near_miss(name, names)}; the chain is {', '.join(names)}")
    begin = 0 if selection.first is None else names.index(selection.first)
    end = len(names) - 1 if selection.last is None else names.index(selection.last)
    if end < begin:
        raise StudyError(
            f"--from {selection.first} --until {selection.last}: the last stage comes before the first; the chain is {', '.join(names)}"
        )
    wanted = (selection.first, selection.last)
    return tuple(n for n in names[begin : end + 1] if n not in OPTIONAL or selection.everything or n in wanted)


def chain(
    study: Study, links: Sequence[Link], selection: Selection, force: bool = False, report: Callable[[dict[str, Any]], None] | None = None
) -> tuple[ChainStep, ...]:
    """Run the chosen stages one after another; `report` is told of each as soon as it is done.

    A stage whose answer is not trustworthy does not end the chain, so that verify and report can say why; an error does. StudyError where
    another process works in the run folder.
    """
    names = selected([link.name for link in links], selection)
    functions = {link.name: link.run for link in links}
    with locked(study.run_dir):
        return _steps(study, names, functions, force, report)


def _steps(
    study: Study,
    names: Sequence[str],
    functions: Mapping[str, Callable[..., Outcome]],
    force: bool,
    report: Callable[[dict[str, Any]], None] | None,
) -> tuple[ChainStep, ...]:
    if _SOLVES & set(names):
        experiment_of(study).compile()
    steps = []
    for name in names:
        reason = _does_not_apply(study, name)
        begin = time.perf_counter()
        outcome = None if reason else functions[name](study, force=force)
        steps.append(ChainStep(name, outcome, time.perf_counter() - begin, reason))
        if report is not None:
            report(step_result(steps[-1]))
    return tuple(steps)


def _does_not_apply(study: Study, name: str) -> str:
    """Why a stage is left out, empty where it applies. Asked when its turn comes: `simulate` may have made the raw folder."""
    unseen = [test.experiment for test in experiment_of(study).unseen] if name in ("simulate", "calibrate-ir") else []
    reasons = [one.no_use(name) for one in (experiment_of(study), *unseen)]
    if all(reasons):
        return reasons[0]
    if name in OPTIONAL and getattr(study, name) is None:
        return f"the study has no section '{name}'"
    return ""


def step_result(step: ChainStep) -> dict[str, Any]:
    """A step as plain types: the JSON of its stage with `fresh` and `wall_s`, or the reason why it was left out."""
    if step.outcome is None:
        return {"stage": step.name, "skipped": step.skipped, "wall_s": 0.0}
    return {**result_of(step.outcome.record), "fresh": step.outcome.fresh, "wall_s": step.seconds}


def table(study: Study, records: Sequence[Record]) -> tuple[Row, ...]:
    """Every identified parameter, beside its start and, where the study tells it, the truth."""
    found: dict[str, Row] = {}
    for record in records:
        staged = record.summary.get("staged", {})
        for name, result in record.parameters.items():
            if result.free:
                found[name] = _row(name, result, study.truth_of(name), record, staged.get(name, {}).get("value"))
    rows = found.values()
    order = {name: index for index, name in enumerate(_free_names(study))}
    return tuple(sorted(rows, key=lambda row: order.get(bare_name(row.name), len(order))))


def _free_names(study: Study) -> tuple[str, ...]:
    return (*study.stages.elastic.free, *study.stages.plastic.free, *study.stages.thermal.free)


def _row(name: str, result: ParameterResult, true: float | None, record: Record, staged: float | None) -> Row:
    deviation = result.value / true - 1.0 if true else None
    return Row(
        name=name,
        unit=result.unit,
        true=true,
        start=result.start,
        value=result.value,
        sigma=result.sigma,
        deviation=deviation,
        at_bound=result.at_bound,
        stage=record.stage,
        sigma_noise=result.sigma_noise,
        staged=staged,
    )


def _records(study: Study, steps: Sequence[ChainStep]) -> list[Record]:
    """Records of the identification and of the joint fit up to the last stage of this run; those before its first stage are on disk."""
    reached = [step.name for step in steps]
    made = {step.name: step.outcome.record for step in steps if step.outcome is not None}
    if ALONE in made:
        return [made[ALONE]]
    order = (*IDENTIFY, REFINE)
    last = max((order.index(name) for name in reached if name in order), default=-1)
    if any(name in reached for name in (*OPTIONAL, "verify", "report")):
        last = len(order) - 1
    left_out = {step.name for step in steps if step.outcome is None}
    records = []
    for name in order[: last + 1]:
        path = artefact_path(study.run_dir, name)
        if name in made:
            records.append(made[name])
        elif name not in left_out and path.exists():
            records.append(open_record(path))
    return records


def summary_of(study: Study, steps: Sequence[ChainStep]) -> dict[str, Any]:
    """The result of the chain in the form of a stage's JSON, with the steps, the final table and the figures."""
    done = {step.name: step.outcome.record for step in steps if step.outcome is not None}
    records = _records(study, steps)
    line, trustworthy = verdict(steps)
    parameters: dict[str, Any] = {}
    for record in records:
        parameters |= {name: value for name, value in result_of(record)["parameters"].items() if value["free"]}
    last = done.get("verify", records[-1] if records else None)
    return {
        "stage": NAME,
        "verdict": line,
        "trustworthy": trustworthy,
        "parameters": parameters,
        "channels": {} if last is None else result_of(last)["channels"],
        "evaluations": _evaluations(records),
        "table": [asdict(row) for row in table(study, records)],
        "steps": [step_result(step) for step in steps],
        "figures": _figures(done),
        "page": done["report"].summary.get("pages", {}).get("html") if "report" in done else None,
        "run_dir": str(study.run_dir),
        "wall_s": sum(step.seconds for step in steps),
    }


def _evaluations(records: Sequence[Record]) -> dict[str, float]:
    """Forward runs, failed ones and wall time of all identification stages together."""
    total = {"forward": 0, "failed": 0, "wall_s": 0.0}
    for record in records:
        counts: Mapping[str, Any] = record.summary.get("evaluations", {})
        total = {key: value + (counts.get(key) or 0) for key, value in total.items()}
    return total


def _figures(done: Mapping[str, Record]) -> list[str]:
    """Paths of the pictures that the stages made."""
    pictures: list[str] = []
    for record in done.values():
        picture, figures = record.summary.get("picture"), record.summary.get("figures", ())
        pictures += [] if picture is None else [str(picture)]
        pictures += [str(path) for path in (figures.values() if isinstance(figures, Mapping) else figures)]
    return pictures


def verdict(steps: Sequence[ChainStep]) -> tuple[str, bool]:
    """One line on the whole chain, and whether every stage of it trusts its answer."""
    done = [step for step in steps if step.outcome is not None]
    doubtful = [step for step in done if step.outcome is not None and not is_trustworthy(step.outcome.record)]
    if doubtful:
        return "; ".join(f"{step.name}: {_line(step)}" for step in doubtful), False
    if not done:
        return "nothing to do", True
    work = "all fresh" if all(step.outcome is not None and step.outcome.fresh for step in done) else f"{sum(s.seconds for s in done):.0f} s"
    last = next((step for step in done if step.name == "verify"), done[-1])
    return f"{len(done)} stages done ({work}); {last.name}: {_line(last)}", True


def _line(step: ChainStep) -> str:
    return "" if step.outcome is None else str(step.outcome.record.summary.get("verdict", ""))
