"""What a stage takes for exact, and what one standard error of it makes of the residual of that stage: earlier parameters, what is
prescribed, the smoothed force, mesh and steps.

All of it is asked on the coarse mesh, whose rows are those of the stage: an uncertainty need not be known better than to a tenth. The error
of the force is asked on one layer of elements over half the thickness, for it has fifty modes or more, each of them a direction of the run.
What it does to parameters of a small test is that on two layers within 0.2 %, of 6 x 40 elements in the plane
(tests/experiment/test_prescribed.py, slow).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters, load_modes
from thermofit.experiment.channels import field_of
from thermofit.experiment.discretisation import MESH, ORDER, SHEET, STEPS, left_by, sheet_on_mesh, telling_mesh
from thermofit.experiment.fields import Measured
from thermofit.experiment.force_error import along_modes, on_one_layer
from thermofit.experiment.held import thermal_names
from thermofit.experiment.joint import FORCE_NOISE, Joint, coarse_mesh
from thermofit.experiment.model import StageModel, steps_for
from thermofit.experiment.prescribed import SCALE, Moved, acting, columns, not_told
from thermofit.study.section import MeshSize, SheetSize
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

ModelOf = Callable[[Measured, StageSettings, Parameters, MeshSize], StageModel]
"""StageModel of data, settings and parameters on a mesh."""


@dataclass(frozen=True)
class StageErrors:
    """Columns (n, m) of the residual by cause, and its derivatives (n, n_b) by parameters that earlier stages told."""

    causes: Mapping[str, np.ndarray]
    slopes: np.ndarray


def stage_errors(
    study: Study,
    data: Measured,
    settings: StageSettings,
    parameters: Parameters,
    earlier: tuple[str, ...],
    prescribed: Mapping[str, Moved],
    model_of: ModelOf,
) -> StageErrors:
    """StageErrors of a stage on one specimen at its optimum. NumericsError where a run fails."""
    size = coarse_mesh(study)
    warm = any(field_of(c) == "theta" for c in settings.channels)
    causes = _numerical(study, data, settings, parameters, size, model_of, warm)
    prescribed = not_told(prescribed, earlier)
    # Displacements hardly feel what acts in the heat balance alone.
    felt = {c: moved for c, moved in prescribed.items() if warm or not set(moved) <= thermal_names() | {"theta_air", "theta_clamp"}}
    scale = felt.pop(SCALE, None)
    if not warm:
        felt = {c: {n: by for n, by in moved.items() if n not in thermal_names()} for c, moved in felt.items()}
    names = tuple(dict.fromkeys((*earlier, *acting(felt))))
    asked = settings.model_copy(update={"free": (*settings.free, *(n for n in names if n not in settings.free))})
    model = model_of(data, asked, parameters, size)
    if names:
        _, slopes = model.linearised(parameters, names)
    else:
        slopes = np.zeros((sum(c.n for c in model.comparisons), 0))
    causes |= columns(felt, names, slopes)
    if scale is not None and "u" in model.observations:
        causes[SCALE] = sum(scale.values()) * _of_displacements(model, parameters)
    noise = _force_noise(study, data, settings, parameters, size, model, model_of)
    if noise.size:
        causes[FORCE_NOISE] = noise
    return StageErrors(causes, slopes[:, [names.index(n) for n in earlier]])


def _numerical(
    study: Study, data: Measured, settings: StageSettings, parameters: Parameters, size: MeshSize, model_of: ModelOf, warm: bool
) -> dict[str, np.ndarray]:
    """Errors of the study's mesh, of the one layer of a sheet and of the steps, (n, 1) each: wholly in the residual, for a stage does not
    correct them. Steps tell of heat: where no temperatures are compared they are not asked."""
    here = model_of(data, settings, parameters, size).residual(parameters)
    finer = telling_mesh(study, data.specimen, size)
    fine = model_of(data, settings, parameters, finer).residual(parameters)
    found = {MESH: left_by(size, study.mesh_size) * (here - fine)[:, None] / (1.0 - left_by(size, finer))}
    if isinstance(size, SheetSize):
        body = model_of(data, settings, parameters, size.body).residual(parameters)
        found[SHEET] = (here - body)[:, None] / (1.0 - sheet_on_mesh(size.body))
    if warm:
        halved = replace(data, steps={name: steps.divided(2) for name, steps in data.steps.items()})
        slow = model_of(halved, settings, parameters, size).residual(parameters)
        found[STEPS] = (here - slow)[:, None] / (1.0 - 0.5 ** ORDER[study.numerics.heat_integration])
    return found


def _of_displacements(model: StageModel, parameters: Parameters) -> np.ndarray:
    """What all displacements larger by themselves make of the residual (n, 1)."""
    errors = model.errors(parameters)
    shown = {name: errors[name] + o.value if name == "u" else np.zeros_like(o.value) for name, o in model.observations.items()}
    return model.assemble_jacobian(errors, {name: field[..., None] for name, field in shown.items()})


def _force_noise(
    study: Study, data: Measured, settings: StageSettings, parameters: Parameters, size: MeshSize, model: StageModel, model_of: ModelOf
) -> np.ndarray:
    """What the error of the smoothed force makes of the residual (n, k) of a `model`, one column for each of its modes; none where
    it drives nothing. On one layer of elements; on those of the mesh, which tell it as well, where one layer does not carry the force.
    NumericsError where these do not either."""
    steps = steps_for(data, set(model.observations))
    if steps.error is None or study.force.drives != "force" or model.linearise is None:
        return np.zeros((0, 0))

    if "theta" in model.observations:  # a stage may hold its motion, and the error of the force moves it
        joint = Joint(study, data, settings, size)
        found = along_modes(joint, parameters)
        times = {name: o.time for name, o in joint.prediction.instruments.observations.items()}
        slopes = {name: found[name][np.searchsorted(times[name], o.time - 1e-9)] for name, o in model.observations.items()}
    else:
        names = load_modes(steps.error.shape[1])

        def of_motion(mesh: MeshSize) -> Mapping[str, np.ndarray]:
            here = model if mesh == size else model_of(data, settings, parameters, mesh)
            assert here.linearise is not None
            return here.linearise(parameters, names)[1]

        slopes = dict(on_one_layer(size, of_motion))
    return model.assemble_jacobian({name: np.zeros_like(o.value) for name, o in model.observations.items()}, slopes)
