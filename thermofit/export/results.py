"""All results of a run in one JSON file: every stage as `--json` prints it, with the covariance of what it fitted."""

from __future__ import annotations

from typing import Any

from thermofit.core.jsonable import jsonable
from thermofit.export.finished import Finished
from thermofit.export.tables import covariances
from thermofit.records.result import result_of


def results_of(run: Finished) -> dict[str, Any]:
    """`stages` by name; `covariance` of a stage: names, units and the matrix, whose entries have the product of the units."""
    matrices = {c.stage: c for c in covariances(run.records)}
    stages: dict[str, Any] = {}
    for name, record in run.records.items():
        stages[name] = result_of(record)
        attributes = record.attributes
        made = {key: attributes[key] for key in ("created", "thermofit_version", "source_digest", "packages")}
        stages[name]["made"] = {**made, "inputs": record.inputs}
        if name in matrices:
            c = matrices[name]
            stages[name]["covariance"] = {"parameters": c.names, "units": c.units, "matrix": c.matrix}
    found: dict[str, Any] = jsonable({"run": run.folder.name, "stages": stages})
    return found
