"""From the records of a study to a case: the joint model of its driver at the joint optimum, and the error of its discretisation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.artefact import open_record
from thermofit.core.errors import UntrustworthyError
from thermofit.core.staging import Job, artefact_path, job
from thermofit.core.study import Study
from thermofit.core.study_section import PRESETS, MeshSize, mesh_size
from thermofit.core.study_stages import StageSettings
from thermofit.diagnose.case import Case, slots_of
from thermofit.diagnose.refit import JointFit, require_converged
from thermofit.diagnose.structure import named_phases
from thermofit.diagnose.verification import identified_stages
from thermofit.fit.result import FitResult
from thermofit.identify.inputs import INTERPOLATE, Measured, measured, start_parameters, with_identified
from thermofit.identify.joint import NUISANCES, joint_free, joint_model, joint_settings, station_names
from thermofit.measure.stations import INFRARED

SECTIONS = ("model", "material_axes", "mesh", "parameters", "evaluation", "force", "numerics", "stages", "diagnosis")
FINER = 1.5
"""Refinement of the mesh by which the error of the discretisation is measured."""


@dataclass(frozen=True)
class Prepared:
    """A case at the optimum of the joint fit, how to fit again, and the error (n,) of the discretisation in its residual."""

    case: Case
    fit: FitResult
    refit: JointFit
    numerical: np.ndarray
    size: MeshSize


def diagnosis_job(study: Study, name: str) -> tuple[Job, tuple[str, ...]]:
    """Job of a diagnosing stage, and the identification stages it rests on.

    StudyError where a record is missing (names its command); UntrustworthyError where a fit has not converged.
    """
    stages = identified_stages(study)
    inputs: dict[str, Path] = {name: artefact_path(study.run_dir, name) for name in (INTERPOLATE, *stages)}
    for stage in stages:
        record = open_record(artefact_path(study.run_dir, stage))
        if not record.summary.get("converged", True):
            raise UntrustworthyError(f"{stage} has not converged ({record.summary['verdict']}); mend it before tracing its residual")
    return job(study.run_dir, name, study.config_of(*SECTIONS), inputs), stages


def diagnosis_mesh(study: Study) -> MeshSize:
    """Mesh of the joint model: the one of section `diagnosis`, else that of the study, but not finer than the coarse preset."""
    if study.diagnosis.mesh is not None:
        return mesh_size(study.diagnosis.mesh)
    own, coarse = study.mesh_size, PRESETS["coarse"]
    return own if own.n_x * own.n_y * own.n_z <= coarse.n_x * coarse.n_y * coarse.n_z else coarse


def prepared(study: Study, task: Job, stages: tuple[str, ...]) -> Prepared:
    """Joint fit of everything that the stages identified, from where they ended. UntrustworthyError where it does not converge."""
    data = measured(study)
    base, _ = with_identified(study, start_parameters(study, data), stages)
    free = tuple(dict.fromkeys((*joint_free(study), *NUISANCES)))
    settings, size = joint_settings(study, free, data), diagnosis_mesh(study)
    model = joint_model(study, data, settings, size)
    refit = JointFit(study, settings, model, task)
    parameters, fit = refit(base.with_free(free), "joint")
    require_converged(fit)
    known = slots_of("body", INFRARED if data.temperature is not None else ())
    case = Case(model, parameters, known, named_phases(data.phases), station_names())
    return Prepared(case, fit, refit, _numerical_error(study, data, settings, size, case), size)


def _numerical_error(study: Study, data: Measured, settings: StageSettings, size: MeshSize, case: Case) -> np.ndarray:
    """Error (n,) of the mesh in the residual: of second order, so that a mesh finer by r differs by 1 - 1/r^2 of it."""
    finer = MeshSize(**{name: int(np.ceil(FINER * getattr(size, name))) for name in ("n_x", "n_y", "n_z")})
    there = joint_model(study, data, settings, finer).residual(case.parameters)
    return np.asarray((case.model.residual(case.parameters) - there) / (1.0 - FINER**-2))
