"""A test that is only planned, as if it had been measured: fields of the assumed material with the declared noise, nothing drawn.

From the section `simulate` of a study: specimen, machine, programme, instruments and the material that is assumed. One run of the study's
own mesh gives the values at the points, stages and frames at which the instruments would look; sigma is what a laboratory declares, taken
through the interpolation. No random number enters: the residual at the assumed material is zero, and only its slopes are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.mesh.mesh import Mesh
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, displacement_of, force_observation, temperature_of
from thermofit.experiment.forward import march_settings, run_of, sampler
from thermofit.law.page import in_model_axes
from thermofit.observe.observation import FieldObservation
from thermofit.observe.observation_points import ObservationPoints, observation_points, observed_window
from thermofit.observe.projection import face_patches
from thermofit.study.geometry import STRAIGHT
from thermofit.study.section import mesh_size
from thermofit.study.study import Study
from thermofit.study.virtual import Simulate, VirtualInstruments
from thermofit.virtual.machine import CrossheadStep, LoadHistory, bar_of, load_history, uniaxial_law
from thermofit.virtual.setup import instrument_times, rigid_motion, solution_times

INTERPOLATED = 0.5**0.5
"""Noise of a value that is linear in a triangle of measured ones, in units of theirs: root of the mean of the squared weights."""


def _kept_noise(study: Study, mesh: Mesh, points: ObservationPoints, spacing: float) -> np.ndarray:
    """Noise (n_s,) of a nodal value over that of one of the measured values, which lie `spacing` mm apart."""
    if study.evaluation.interpolation == "three-point":
        return np.full(len(points.xy), INTERPOLATED)
    return 1.0 / np.sqrt(np.maximum(face_patches(mesh, points).areas() / spacing**2, 1.0))


@dataclass(frozen=True)
class Planned:
    """A planned test: `data` as the identification sees it, `motion` (n_t, n_s, 2) mm what rigid-body motion adds to the displacements,
    `duration` s, and the largest force in N."""

    data: Measured
    motion: np.ndarray
    duration: float
    force: float


def simulated(study: Study) -> Simulate:
    """The section `simulate` of a study; StudyError where it has none."""
    if study.simulate is None:
        raise StudyError(
            f"{study.source.name}: key 'simulate' is missing: an analysis before the test needs its programme, instruments and an assumed "
            "material; add it, see `thermofit new`"
        )
    return study.simulate


def planned(study: Study, steps: tuple[CrossheadStep, ...], assumed: Parameters) -> Planned:
    """Planned of a programme with the assumed material.

    StudyError where the section `simulate` is missing or the programme cannot be carried out; NumericsError where the run fails.
    """
    settings = simulated(study)
    specimen = study.specimen_of(settings.specimen.lengths())
    bar = bar_of(specimen, uniaxial_law(in_model_axes(assumed, study.material_axes.angle, study.slots), study.slots))
    load = load_history(steps, bar, settings.machine, settings.force.rate)
    dic_time, ir_time = instrument_times(load, settings, settings.seed)
    dic_time, ir_time = _wanted(study.evaluation.displacement_times, dic_time), _wanted(study.evaluation.temperature_times, ir_time)
    mesh = specimen_mesh(study.geometry, specimen, mesh_size(study.evaluation.nodes), study.mesh_file)
    reach = (settings.dic.half_width, settings.dic.half_height)
    window = observed_window(study.evaluation.window, specimen, study.geometry.shape in STRAIGHT, reach)
    points = observation_points(mesh.nodes, mesh.node_sets["face"], *window)
    every = study.numerics.max_time_step
    load_steps = {
        "displacement": _steps(load, settings, solution_times(load, dic_time, dic_time, every)),
        "temperature": _steps(load, settings, solution_times(load, ir_time, ir_time, every)),
        "all": _steps(load, settings, solution_times(load, dic_time, ir_time, every)),
    }
    noise = (study.noise.displacement or settings.dic.noise_in_plane, study.noise.temperature or settings.ir.netd)
    kept = [_kept_noise(study, mesh, points, spacing) for spacing in (settings.dic.spacing, settings.ir.pixel_size)]
    u = _blank("u", dic_time, points.xy, 2, kept[0] * noise[0], "mm")
    theta = _blank("theta", ir_time, points.xy, 1, kept[1] * noise[1], "K")
    force = force_observation(dic_time, load_steps["displacement"], settings.force.noise)
    begin = float(load.time[np.flatnonzero(load.force > 0.0)[0] - 1])
    phases = (TestPhase(float(load.time[0]), float(load.time[-1]), "loading"),)
    data = Measured(specimen, assumed["theta_air"], assumed["theta_clamp"], u, theta, force, load_steps, begin, phases)
    data = _filled(study, data, assumed)
    return Planned(data, _motion(data, load, settings, settings.seed), float(load.time[-1]), float(load.force.max()))


def _wanted(choice: str | tuple[float, ...], times: np.ndarray) -> np.ndarray:
    """The times of the instrument, or those of the study's list that lie within the test."""
    if isinstance(choice, str):
        return times
    asked = np.asarray(choice, dtype=float)
    return np.asarray(asked[(asked >= times[0]) & (asked <= times[-1])])


def _steps(load: LoadHistory, instruments: VirtualInstruments, time: np.ndarray) -> LoadSteps:
    """Load steps at given times; the crosshead as a machine without slip would show it, the elongation as DIC sees it."""
    force, slip = np.interp(time, load.time, load.force), np.interp(time, load.time, load.slip)
    crosshead = np.interp(time, load.time, load.crosshead) - slip
    return LoadSteps(time, force, crosshead, crosshead - instruments.machine.compliance * force)


def _blank(name: str, time: np.ndarray, xy: np.ndarray, components: int, sigma: np.ndarray, unit: str) -> FieldObservation:
    """A field with `sigma` (n_s,) of every point, whose values are still zero."""
    shape = (len(time), len(xy), components)
    of_all = np.broadcast_to(np.maximum(sigma, 1e-6)[None, :, None], shape).copy()
    return FieldObservation(name, time, xy, np.zeros(shape), of_all, np.ones(shape[:2], dtype=bool), unit)


def _filled(study: Study, data: Measured, assumed: Parameters) -> Measured:
    """The same with the values that the model predicts, from one run through all times."""
    seen, warm = displacement_of(data), temperature_of(data)
    run = run_of(study, data, study.mesh_size, data.steps["all"], march_settings(study, "full"))
    history = run(assumed)
    u = sampler(run.body, seen, data.steps["all"]).displacement(history)
    theta = sampler(run.body, warm, data.steps["all"]).temperature(history.theta)
    return replace(data, displacement=replace(seen, value=u), temperature=replace(warm, value=theta))


def _motion(data: Measured, load: LoadHistory, instruments: VirtualInstruments, seed: int) -> np.ndarray:
    """What the machine's rigid-body motion adds to the displacements (n_t, n_s, 2) mm."""
    u = displacement_of(data)
    motion = rigid_motion(load, instruments.machine, seed, u.time)
    half = np.full((*u.value.shape[:2], 1), 0.5 * data.specimen.thickness)
    place = np.concatenate([u.xy + u.value, half], axis=2)
    moved = np.einsum("tij,tsj->tsi", motion.rotation, place) + motion.shift[:, None, :]
    added = (moved - place)[:, :, :2]
    return np.asarray(added - added[:1])
