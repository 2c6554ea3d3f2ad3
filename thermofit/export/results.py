"""What a finished run holds for exports, and all its results in one JSON file: every stage as `--json` prints it, with covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from thermofit.core.errors import StudyError, ThermofitError
from thermofit.core.jsonable import jsonable
from thermofit.core.parameters import Parameters
from thermofit.export.tables import covariances
from thermofit.records.artefact import Record, open_record
from thermofit.records.result import result_of
from thermofit.study.models import Sections, StudyFile
from thermofit.study.study import Study

VERIFY = "verify"
_STUDY_FILES = (".yaml", ".yml")


@dataclass(frozen=True)
class Finished:
    """A finished run: its artefacts by stage, and its study where a study file was named."""

    folder: Path
    records: dict[str, Record]
    given: Study | None

    @property
    def verified(self) -> Record:
        """The record of `verify`, which holds all parameters of the model. StudyError where it has not run."""
        if VERIFY not in self.records:
            raise StudyError(f"'{self.folder}' holds no verify.h5; `thermofit run STUDY.yaml --until verify` makes it")
        return self.records[VERIFY]

    @property
    def tests(self) -> tuple[Record, ...]:
        """The records of `verify` of several experiments; empty where there is one."""
        return tuple(open_record(path) for path in sorted(self.folder.glob(f"*/{VERIFY}.h5")))

    @property
    def parameters(self) -> Parameters:
        """All parameters of the verified model."""
        return Parameters.of({name: result.value for name, result in self.verified.parameters.items()})

    @property
    def study(self) -> Study:
        """The study, as it was named or as the record of `verify` holds it. StudyError where that does not suffice."""
        return self.given if self.given is not None else recorded_study(self.verified)


def finished(path: Path, load: Callable[[Path], Study]) -> Finished:
    """The run in a folder, or that of a study file, which `load` reads. StudyError where there is nothing to export."""
    study = load(path) if path.suffix in _STUDY_FILES else None
    folder = path if study is None else study.run_dir
    if not folder.is_dir():
        raise StudyError(f"'{folder}' is no folder; expected a run folder, such as runs/my-study, or a study file that has been run")
    records = {}
    for file in sorted(folder.glob("*.h5")):
        record = open_record(file)
        records[record.stage] = record
    if not records:
        raise StudyError(f"'{folder}' holds no artefact; expected the run folder of a study that has been run")
    return Finished(folder, records, study)


def recorded_study(record: Record) -> Study:
    """The study that the record of `verify` was made by: all that a run of its model reads. StudyError where it names files or effects
    that only the study file knows."""
    folder = record.path.absolute().parent
    tree: dict[str, Any] = {key: value for key, value in record.config.items() if key in Sections.model_fields}
    hint = f"name the study file instead of '{folder}'"
    if tree.get("coupon") is None:
        tree["experiment"] = str(folder / "raw")
    if tree.get("geometry", {}).get("file"):
        raise StudyError(f"the mesh of this run is that of a file ({tree['geometry']['file']}), which its study locates; {hint}")
    try:
        file = StudyFile.model_validate({"name": folder.name or "run", **tree})
    except (ValidationError, ThermofitError) as error:
        raise StudyError(f"{record.path}: the settings in it do not make a study ({' '.join(str(error).split())[:200]}); {hint}") from None
    sections = {name: getattr(file, name) for name in Sections.model_fields}
    return Study(**sections, source=folder / "study.yaml", experiment=folder / "raw", run_dir=folder, virtual=False)


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
