"""What lies in a run folder: every artefact that can be read, of the run and of each of its experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from thermofit.core.errors import StudyError, ThermofitError
from thermofit.records.artefact import Record, open_record, stale

FIRST = ("simulate", "calibrate-ir", "interpolate")
IDENTIFY = ("identify-elastic", "identify-plastic", "identify-thermal")
REFINE = "refine"
ORDER = (
    *(*FIRST, *IDENTIFY, REFINE, "verify", "diagnose", "close-loop"),
    *("gridsearch", "sensitivity", "identifiability", "validate", "compare"),
)
"""Order in which stages are listed."""
NEEDED = ("interpolate", "identify-elastic", "identify-plastic", "verify", "close-loop")
"""Stages without which something of the report is missing."""
Records = Mapping[str, Record]
"""Artefacts by stage."""


@dataclass(frozen=True)
class RunFolder:
    """A run: its own artefacts, those of each experiment by name ("" for a run of one), and why artefacts could not be read, by stage."""

    path: Path
    records: Records
    tests: Mapping[str, Records]
    unreadable: Mapping[str, str]
    stale: Mapping[str, tuple[str, ...]]
    """Why artefacts of the run itself no longer follow from their inputs, by stage."""

    def has(self, stage: str) -> bool:
        """Whether the run itself holds a readable artefact of a stage."""
        return stage in self.records

    def reached(self) -> list[str]:
        """Stages of the run itself in their order."""
        known = [stage for stage in ORDER if stage in self.records]
        return known + sorted(stage for stage in self.records if stage not in (*ORDER, "report"))


def read_run(path: Path) -> RunFolder:
    """Everything that can be read in a run folder. StudyError where it is no folder or holds no artefact."""
    if not path.is_dir():
        raise StudyError(f"report: '{path}' is no folder: expected a run folder, which holds artefacts <stage>.h5, or a study file")
    records, unreadable = _records(path)
    tests = {one.name: _records(one)[0] for one in sorted(path.iterdir()) if one.is_dir() and (one / "interpolate.h5").is_file()}
    if not records and not tests and not unreadable:
        raise StudyError(f"report: '{path}' holds no artefact <stage>.h5: run `thermofit run STUDY.yaml --run-dir {path}` first")
    reasons = {stage: stale(record) for stage, record in records.items()}
    return RunFolder(path, records, tests or {"": records}, unreadable, reasons)


def _records(folder: Path) -> tuple[dict[str, Record], dict[str, str]]:
    found: dict[str, Record] = {}
    failed: dict[str, str] = {}
    for path in sorted(folder.glob("*.h5")):
        try:
            record = open_record(path)
        except ThermofitError as error:
            failed[path.stem] = str(error)
        else:
            found[record.stage] = record
    return found, failed
