"""The JSON of a result: what `--json` prints and what scripts read; design contract, keys may be added, never renamed."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from thermofit.core.jsonable import jsonable
from thermofit.records.artefact import Record, layout
from thermofit.records.stale import other_sources, stale


def result_of(record: Record) -> dict[str, Any]:
    """stage, verdict, trustworthy, parameters, channels, evaluations and the rest of the summary; nan and inf are null."""
    summary = dict(record.summary)
    fixed = {
        "stage": record.stage,
        "verdict": str(summary.pop("verdict", "")),
        "trustworthy": is_trustworthy(record),
        "parameters": {name: asdict(parameter) for name, parameter in record.parameters.items()},
        "channels": summary.pop("channels", {}),
        "evaluations": summary.pop("evaluations", {}),
    }
    rest = {key: value for key, value in summary.items() if key not in fixed}
    result: dict[str, Any] = jsonable({**fixed, **rest, "artefact": record.path})
    return result


def description_of(record: Record) -> dict[str, Any]:
    """The result with its provenance (attributes, config, hashes of the inputs), why it is stale, and the datasets without their values."""
    sources = other_sources(record)
    extra = {
        "stale": [*stale(record), *([sources] if sources else [])],
        "attributes": record.attributes,
        "inputs": record.inputs,
        "config": record.config,
        "datasets": {name: {k: v for k, v in asdict(data).items() if v or k != "units"} for name, data in layout(record).items()},
    }
    description: dict[str, Any] = {**result_of(record), **jsonable(extra)}
    return description


def is_trustworthy(record: Record) -> bool:
    """False where the stage itself says that its answer is not to be trusted (exit code 5)."""
    return record.summary.get("trustworthy") is not False
