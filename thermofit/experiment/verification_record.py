"""Record of a coupled run beside the data of one full-field experiment: tables, datasets, verdict; shared by verify and validate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thermofit.core.parameters import AT, Parameters
from thermofit.experiment.curves import moments, snapshots, stress_stretch, temperature_curves
from thermofit.experiment.energy import energy_curves, energy_totals
from thermofit.experiment.fields import Measured, field_datasets
from thermofit.experiment.literature import literature_remarks, literature_rows
from thermofit.experiment.residuals import Span, named_phases, node_rms, time_rms
from thermofit.experiment.several import free_in
from thermofit.experiment.verification import (
    IDENTIFY,
    INFORMATION,
    Verification,
    channel_table,
    coupling_error,
    judge,
    phase_table,
    verification,
)
from thermofit.records.artefact import Dataset, ParameterResult, Record, open_record
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study

Summary = dict[str, Any]


@dataclass(frozen=True)
class Checked:
    """A coupled run beside the data: the run, its summary and its datasets."""

    verified: Verification
    summary: Summary
    datasets: dict[str, Dataset]


def checked(study: Study, data: Measured, parameters: Parameters, thermal: Record | None, word: str = "verified") -> Checked:
    """One coupled run with given parameters beside all data of an experiment. NumericsError where the specimen cannot carry the force."""
    verified = verification(study, data, parameters)
    spans = named_phases(data.phases)
    return Checked(verified, _summary(verified, spans, thermal, word), _datasets(verified, data, spans))


def stages_remarks(study: Study, stages: Sequence[str], results: Mapping[str, ParameterResult]) -> Summary:
    """What a check says besides its channels: stages that are missing, published values."""
    published = literature_rows(study, results)
    missing = [f"{name} has not run: its parameters keep the start of the study" for name in IDENTIFY if name not in stages]
    return {"stages": list(stages), "literature": published, "remarks": [*missing, *literature_remarks(published)]}


def thermal_record(study: Study, stages: Sequence[str]) -> Record | None:
    """The record of the thermal stage, None where it has not run."""
    return open_record(artefact_path(study.run_dir, IDENTIFY[2])) if IDENTIFY[2] in stages else None


def with_remarks(summary: Summary, more: Summary) -> Summary:
    """A summary with further keys; remarks of both are kept."""
    return {**summary, **more, "remarks": [*more.get("remarks", ()), *summary.get("remarks", ())]}


def together(found: Mapping[str, Mapping[str, Any]], word: str) -> Summary:
    """The summaries of several experiments as one: channels are called du@first, phases and energies name their experiment."""
    bad = {name: s for name, s in found.items() if not s["trustworthy"]}
    lines = [f"{name}: {s['verdict'].partition(': ')[2]}" for name, s in (bad or found).items()]
    return {
        "verdict": f"{'not ' if bad else ''}{word}: " + "; ".join(lines),
        "trustworthy": not bad,
        "channels": {f"{c}{AT}{name}": row for name, s in found.items() for c, row in s["channels"].items()},
        "phases": [{"experiment": name, **row} for name, s in found.items() for row in s["phases"]],
        "energies": [{"experiment": name, **s["energy_mJ"]} for name, s in found.items()],
        "coupling_error": None,
        "remarks": [f"{name}: {text}" for name, s in found.items() for text in s["remarks"]],
    }


def results_in(results: Mapping[str, ParameterResult], name: str) -> dict[str, ParameterResult]:
    """The results of a joint fit as they read for one experiment."""
    return {bare: results[full] for full, bare in free_in(tuple(results), name).items()}


def _summary(verified: Verification, spans: tuple[Span, ...], thermal: Record | None, word: str) -> Summary:
    channels = channel_table(verified.residuals)
    rows = phase_table(verified.residuals, spans)
    found = judge(verified.residuals, rows, word)
    energy, coupling = energy_totals(verified.history), coupling_error(verified, thermal)
    remarks = []
    shown = " and ".join(name for name in INFORMATION if name in channels)
    remarks.append(f"{shown} as measured, for information: rigid-body motion, camera offset")
    if coupling is not None:
        remarks.append(f"one-way coupling: {1e3 * coupling['max_K']:.2g} mK at most, {1e3 * coupling['rms_K']:.2g} mK rms")
    if energy["smallest_dissipation"] < 0.0:
        remarks.append(f"dissipation falls to {energy['smallest_dissipation']:.2g} mJ/mm^3: against the second law, check beta")
    return {
        "verdict": found.line,
        "trustworthy": not found.outside,
        "channels": channels,
        "phases": rows,
        "coupling_error": coupling,
        "energy_mJ": {name: value for name, value in energy.items() if name != "smallest_dissipation"},
        "smallest_dissipation_mJ_mm3": energy["smallest_dissipation"],
        "solver": verified.history.counts,
        "remarks": remarks,
    }


def _datasets(verified: Verification, data: Measured, spans: tuple[Span, ...]) -> dict[str, Dataset]:
    dims = ("time", "point", "component")
    out: dict[str, Dataset] = {}
    for name, observation in verified.observed.items():
        out.update(field_datasets(observation))
        out[f"{name}/predicted"] = Dataset(verified.predicted[name], observation.unit, dims)
    for field in verified.residuals:
        channel = field.channel
        if channel in ("du", "dtheta"):
            out[f"residual/{channel}"] = Dataset(field.normalised, "1", dims)
            out[f"maps/{channel}"] = Dataset(node_rms(field), "1", dims[1:])
        if channel not in INFORMATION:
            out[f"over_time/{channel}"] = Dataset(time_rms(field), "1", dims[:1])
    out |= snapshots(verified.residuals, moments(spans, verified.steps))
    out |= stress_stretch(verified, data)
    out |= temperature_curves(verified)
    out |= energy_curves(verified.history)
    return out
