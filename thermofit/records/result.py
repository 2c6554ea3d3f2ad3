"""The JSON of a result: what `--json` prints and what scripts read; design contract, keys may be added, never renamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from thermofit.core.errors import DataError, StudyError
from thermofit.core.jsonable import jsonable
from thermofit.records.artefact import Record, layout, open_record, other_sources, stale


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


def budget_of(record: Record) -> dict[str, Any]:
    """What the uncertainties of a result are made of: `budget` per parameter, causes largest first, which measurement would help most, and
    `exact`, keys of `uncertainty` that the study does not state. DataError where it has none."""
    if not record.summary.get("budget"):
        raise DataError(
            f"{record.path}: '{record.stage}' tells no causes of uncertainty; expected refine.h5 or the record of an identification"
        )
    told: dict[str, Any] = jsonable(
        {
            "stage": record.stage,
            "verdict": str(record.summary.get("helps_most", "")),
            "parameters": {name: asdict(p) for name, p in record.parameters.items() if p.free},
            "budget": record.summary["budget"],
            "exact": record.summary.get("exact", []),
        }
    )
    return told


def exact_words(keys: Sequence[str]) -> str:
    """What a budget does not hold, because the study does not state it."""
    return f"not stated under 'uncertainty', and counted as exact: {', '.join(keys)}"


def dataset_of(record: Record, name: str) -> dict[str, Any]:
    """One dataset with its values. DataError where there is none of that name."""
    data = record[name]
    values = {"dataset": name, "unit": data.unit, "units": data.units, "dims": data.dims, "values": data.value}
    found: dict[str, Any] = jsonable({"stage": record.stage, **values})
    return found


def listing_of(folder: Path) -> dict[str, Any]:
    """The artefacts of a run folder, each with its verdict, in the order in which they were made. StudyError where there is none."""
    records = [open_record(path) for path in folder.glob("*.h5")]
    if not records:
        raise StudyError(f"'{folder}' is a folder without artefacts: expected RUN_DIR/<stage>.h5, or a run folder that holds some")
    told = [(r.attributes["created"], str(r.path), r) for r in records]
    rows = [
        {
            "stage": r.stage,
            "created": made,
            "verdict": str(r.summary.get("verdict", "")),
            "trustworthy": is_trustworthy(r),
            "artefact": path,
        }
        for made, path, r in sorted(told, key=lambda row: row[:2])
    ]
    return {"stage": "show", "folder": str(folder), "artefacts": rows}
