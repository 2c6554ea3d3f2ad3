"""What checks of given parameters share: the stages they rest on, tables per channel and phase, the verdict, several tests as one;
what others published beside what was identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from thermofit.core.parameters import AT, Parameters, bare_name, param, physical_bounds
from thermofit.experiment.fields import INTERPOLATE
from thermofit.experiment.residuals import ResidualField, Span, Statistics, span_of, statistics
from thermofit.experiment.several import free_in
from thermofit.experiment.trust import above_floor, level
from thermofit.records.artefact import Dataset, ParameterResult, Record, open_record, other_sources
from thermofit.records.key import drifted
from thermofit.records.staging import artefact_path
from thermofit.study.literature import PRESSURE, published
from thermofit.study.study import Study

IDENTIFY = ("identify-elastic", "identify-plastic", "identify-thermal")
"""The identification stages in their order."""
REFINE = "refine"
"""The joint fit that comes after them."""
INFORMATION = ("u", "theta")
"""Channels that hold what no parameter of the law can explain (rigid-body motion, the camera's offset): shown, not judged."""
Summary = dict[str, Any]


@dataclass(frozen=True)
class Checked:
    """A prediction beside all data of one test: the summary (verdict, channels, phases, remarks, evaluations) and the datasets of its
    record."""

    summary: Summary
    datasets: dict[str, Dataset]


def identified_stages(study: Study) -> tuple[str, ...]:
    """The identification stages whose result is there, and the joint fit after them; the elastic one always, so that its absence names its
    command."""
    return tuple(name for name in (*IDENTIFY, REFINE) if name == IDENTIFY[0] or artefact_path(study.run_dir, name).exists())


def made_otherwise(study: Study, stages: Sequence[str]) -> list[str]:
    """Which artefacts of `interpolate` and the given stages were made with other settings than the study's now, or by other sources."""
    ones = [study.one_of(name) for name in study.fitted] or [study]
    out = []
    for one, stage in [*((one, INTERPOLATE) for one in ones), *((study, stage) for stage in stages)]:
        record = open_record(artefact_path(one.run_dir, stage))
        sources = other_sources(record)
        out += [*drifted(one, {stage: record}), *([f"{record.path.name}: {sources}"] if sources else [])]
    return out


def fitted_parameters(study: Study, parameters: Parameters, stages: Sequence[str]) -> dict[str, ParameterResult]:
    """All parameters of the verified model: those that a stage identified as it left them, the others as prescribed."""
    results = {}
    for name in parameters.given():
        value = parameters[name]
        results[name] = ParameterResult(value, None, param(name).unit, False, False, value, *physical_bounds(name))
    for stage in stages:
        record = open_record(artefact_path(study.run_dir, stage))
        results |= {name: result for name, result in record.parameters.items() if result.free}
    return results


def channel_table(residuals: Sequence[ResidualField]) -> dict[str, dict[str, Any]]:
    """Per channel its statistics; `judged` False where it is shown for information."""
    table = {}
    for field in residuals:
        numbers = statistics(field)
        if numbers is not None:
            table[field.channel] = {**asdict(numbers), "judged": field.channel not in INFORMATION}
    return table


def phase_table(residuals: Sequence[ResidualField], spans: Sequence[Span]) -> list[dict[str, Any]]:
    """One row per judged channel and phase in which it is compared: its statistics without the mean."""
    rows = []
    for field in residuals:
        if field.channel in INFORMATION:
            continue
        index = span_of(field.time, spans)
        for number, span in enumerate(spans):
            found = statistics(field.at(index == number))
            if found is not None:
                place = {"channel": field.channel, "phase": span.name, "t0_s": round(span.t0, 3), "t1_s": round(span.t1, 3)}
                rows.append({**place, **{key: value for key, value in asdict(found).items() if key != "mean"}})
    return rows


@dataclass(frozen=True)
class Judgement:
    """The verdict in one line, and the judged channels that are at their floor and those that are not."""

    line: str
    within: tuple[str, ...]
    outside: tuple[str, ...]


def judge(residuals: Sequence[ResidualField], rows: Sequence[dict[str, Any]], word: str = "verified") -> Judgement:
    """Which channels are explained by their noise, as a whole and in every phase (`rows` of `phase_table`), by the rule of `trust`.

    `word` is the verdict: "verified" on data that were fitted, "valid" on others.
    """
    found = [(f.channel, statistics(f)) for f in residuals if f.channel not in INFORMATION]
    sizes = {channel: s for channel, s in found if s is not None}
    levels = [level(channel, s.chi2_reduced, 0.0, s.n) for channel, s in sizes.items()]
    levels += [level(row["channel"], row["chi2_reduced"], 0.0, row["n"], row["phase"]) for row in rows]
    above = above_floor(levels)
    outside = tuple(channel for channel in sizes if channel in {one.channel for one in above})
    if not outside:
        line = f"{word}: " + ", ".join(f"{channel} {s.over_floor:.2f}" for channel, s in sizes.items()) + " times the noise"
    else:
        line = f"not {word}: " + "; ".join(_outlier(channel, sizes[channel], rows) for channel in outside)
    return Judgement(line, tuple(channel for channel in sizes if channel not in outside), outside)


def _outlier(channel: str, found: Statistics, rows: Sequence[dict[str, Any]]) -> str:
    worst = max((row for row in rows if row["channel"] == channel), key=lambda row: float(row["chi2_reduced"]))
    return (
        f"{channel} is {found.over_floor:.2g} times its noise (rms {found.rms:.3g} {found.unit}, noise {found.floor_rms:.3g}), "
        f"most in {worst['phase']} ({np.sqrt(worst['chi2_reduced']):.2g} times)"
    )


def stages_remarks(study: Study, stages: Sequence[str], results: Mapping[str, ParameterResult]) -> Summary:
    """What a check says besides its channels: stages that are missing, published values."""
    published = literature_rows(study, results)
    missing = [f"{name} has not run: its parameters keep the start of the study" for name in IDENTIFY if name not in stages]
    return {"stages": list(stages), "literature": published, "remarks": [*missing, *literature_remarks(published)]}


def thermal_record(study: Study, stages: Sequence[str]) -> Record | None:
    """The record of the thermal stage, None where it has not run, or its parameters are not the last ones."""
    if IDENTIFY[2] not in stages or refined_record(study, stages) is not None:
        return None
    return open_record(artefact_path(study.run_dir, IDENTIFY[2]))


def refined_record(study: Study, stages: Sequence[str]) -> Record | None:
    """The record of the joint fit, None where that has not run, or has left the parameters of the stages."""
    if REFINE not in stages:
        return None
    record = open_record(artefact_path(study.run_dir, REFINE))
    return record if record.summary.get("refined") else None


@dataclass(frozen=True)
class KnownErrors:
    """What the joint fit knows to be wrong with a prediction: errors of mesh and steps in its fields, (n_t, n_s, n_c) each, and the error
    of the smoothed force at the load steps, N (n_steps,), as all channels together tell it; None where it is not told."""

    fields: Mapping[str, np.ndarray]
    force: np.ndarray | None = None


def known_place(cause: str, test: str) -> str:
    """Where the record of the joint fit keeps something that it knows of a test: "force_error", or "numerical/u" of a field."""
    return f"{cause}{AT}{test}" if test else cause


FORCE_TOLD, NUMERICAL = "force_error", "numerical"


def known_errors(record: Record | None, test: str) -> KnownErrors | None:
    """What the record of the joint fit knows to be wrong with the prediction of a test; None without a record."""
    if record is None:
        return None
    places = {field: known_place(f"{NUMERICAL}/{field}", test) for field in ("u", "theta", "force")}
    force = known_place(FORCE_TOLD, test)
    fields = {field: record[place].value for field, place in places.items() if record.has(place)}
    return KnownErrors(fields, record[force].value if record.has(force) else None)


def with_remarks(summary: Summary, more: Summary) -> Summary:
    """A summary with further keys; remarks and notes of both are kept."""
    both = {key: [*more.get(key, ()), *summary.get(key, ())] for key in ("remarks", "notes")}
    return {**summary, **more, **both}


def together(found: Mapping[str, Checked], word: str) -> Checked:
    """The checks of several experiments as one: channels are called du@first, phases and energies name their experiment, and datasets stay
    in their own records. That of a test which is alone (it has no name) is as it is."""
    if set(found) == {""}:
        return found[""]
    summaries = {name: one.summary for name, one in found.items()}
    bad = {name: s for name, s in summaries.items() if not s["trustworthy"]}
    lines = [f"{name}: {s['verdict'].partition(': ')[2]}" for name, s in (bad or summaries).items()]
    summary = {
        "verdict": f"{'not ' if bad else ''}{word}: " + "; ".join(lines),
        "trustworthy": not bad,
        "channels": {f"{c}{AT}{name}": row for name, s in summaries.items() for c, row in s["channels"].items()},
        "phases": [{"experiment": name, **row} for name, s in summaries.items() for row in s["phases"]],
        "energies": [{"experiment": name, **s["energy_mJ"]} for name, s in summaries.items()],
        "coupling_error": None,
        **{key: [f"{name}: {text}" for name, s in summaries.items() for text in s.get(key, ())] for key in ("remarks", "notes")},
        "evaluations": {key: sum(s["evaluations"][key] for s in summaries.values()) for key in ("forward", "failed")},
    }
    return Checked(summary, {})


def results_in(results: Mapping[str, ParameterResult], name: str) -> dict[str, ParameterResult]:
    """The results of a joint fit as they read for one experiment."""
    return {bare: results[full] for full, bare in free_in(tuple(results), name).items()}


Row = dict[str, Any]


def literature_rows(study: Study, results: Mapping[str, ParameterResult]) -> list[Row]:
    """One row for every published value: what was found, with its standard error, and whether it lies in the published range.

    A parameter of several experiments has a row for each. c_p is c0 + 9 K alpha_exp^2 theta_ref (errata 6).
    """
    rows = []
    for name, given in study.literature.items():
        value = published(given)
        low, high = value.limits
        for found_name in _found(name, results):
            found = _pressure(results) if name == PRESSURE else results[found_name]
            where = _where(found.value, found.sigma, (low, high))
            row = {"parameter": found_name, "found": "" if found.free else "prescribed", "source": value.source, "compared": where}
            unit = param("c0").unit if name == PRESSURE else found.unit
            rows.append({**row, "unit": unit, "value": found.value, "sigma": found.sigma, "low": low, "high": high})
    return rows


def literature_remarks(rows: list[Row]) -> list[str]:
    """One remark for each identified parameter that lies outside what others found."""
    return [f"literature: {r['parameter']} = {r['value']:.4g} {r['unit']} is {r['compared']}" for r in rows if r["compared"] != "within"]


def _found(name: str, results: Mapping[str, ParameterResult]) -> list[str]:
    """The parameters that a published one is compared with: those of every experiment where there are any."""
    own = [other for other in results if bare_name(other) == name and AT in other]
    return own or [name]


def _pressure(results: Mapping[str, ParameterResult]) -> ParameterResult:
    v = {name: results[name].value for name in ("E", "nu", "c0", "alpha_exp", "theta_ref")}
    more = 9.0 * v["E"] / (3.0 * (1.0 - 2.0 * v["nu"])) * v["alpha_exp"] ** 2 * v["theta_ref"]
    c0 = results["c0"]
    return ParameterResult(c0.value + more, c0.sigma, c0.unit, c0.free, c0.at_bound, c0.start, c0.lower, c0.upper)


def _where(value: float, sigma: float | None, limits: tuple[float, float]) -> str:
    """In words how a value lies to a range: within, or how far off in its standard errors and per cent."""
    low, high = limits
    if low <= value <= high:
        return "within"
    edge, side = (low, "below") if value < low else (high, "above")
    far = f"{side} {low:g} to {high:g}" if low < high else f"{side} {low:g}"
    part = f" by {100.0 * abs(value - edge) / abs(edge):.2g} %" if edge else ""
    return far + part + (f", {abs(value - edge) / sigma:.2g} standard errors" if sigma else "")
