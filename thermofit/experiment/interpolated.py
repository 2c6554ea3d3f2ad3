"""Algorithms 2 and 3, from the instruments' points and pixels to material points of the mesh, with their noise.

Also the force: smoothed to its noise level, and the times through which the solver must step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, Experiment, InfraredSequence, Specimen
from thermofit.experiment.fields import TestPhase, field_datasets, specimen_dict
from thermofit.experiment.static import static_record
from thermofit.observe.camera import CameraPose
from thermofit.observe.end_motion import end_motion, sections_inside
from thermofit.observe.force import SmoothForce, smooth_force, step_times
from thermofit.observe.interpolation import (
    NodalDisplacement,
    displacements_at,
    edge_distance,
    interpolate_displacements,
    interpolate_temperatures,
    pixel_map,
)
from thermofit.observe.noise import LEAST_AT_REST, LEAST_VALUES, NoiseEstimate, displacement_noise, temperature_noise
from thermofit.observe.observation import FieldObservation
from thermofit.observe.observation_points import ObservationPoints, observation_points
from thermofit.observe.selection import masked
from thermofit.read.raw import read_experiment
from thermofit.records.artefact import Dataset, Record, read_record
from thermofit.records.staging import Made, artefact_path
from thermofit.records.stale import read_current
from thermofit.study.section import mesh_size
from thermofit.study.study import Study

CALIBRATE = "calibrate-ir"
_LEAST_NOISE = {"mm": 1e-6, "K": 1e-4}
"""Noise of data without noise: sigma must not vanish, because it divides the residual."""


@dataclass(frozen=True)
class RawData:
    """What the artefact of `interpolate` is made of: `inputs` are its files by name, `made` reads them. DataError, StudyError for what is
    wrong in them."""

    inputs: Mapping[str, Path]
    made: Callable[[], Made]


def raw_fields(study: Study) -> RawData:
    """Raw folder and calibration of a full-field experiment, and how they become displacements, temperatures, their sigma and masks, load
    steps and phases of the test.

    Temperatures need the artefact of `calibrate-ir` where the experiment has infrared frames (StudyError names the command).
    """
    if not study.experiment.is_dir():
        mend = f"run `thermofit simulate {study.source.name}` first" if study.virtual else "correct the key 'experiment' of the study"
        raise DataError(f"{study.experiment}: the raw folder does not exist; {mend}")
    inputs: dict[str, Path] = {"experiment": study.experiment}
    if study.mesh_file is not None:
        inputs["mesh"] = study.mesh_file
    if study.static is not None:
        return RawData(inputs, lambda: static_record(study))
    if (study.experiment / "ir").is_dir():
        inputs[CALIBRATE] = artefact_path(study.run_dir, CALIBRATE)
        read_record(inputs[CALIBRATE], CALIBRATE, f"thermofit {CALIBRATE} {study.source.name}")
    return RawData(inputs, lambda: _make(study, inputs.get(CALIBRATE)))


def _make(study: Study, calibrated: Path | None) -> Made:
    experiment = read_experiment(study.experiment, ("force", "dic"))
    if experiment.dic is None:
        raise DataError(f"{study.experiment}: experiment.yaml declares no displacements; add its dic section")
    specimen, size = study.specimen_of(experiment.specimen), mesh_size(study.evaluation.nodes)
    mesh = specimen_mesh(study.geometry, specimen, size, study.mesh_file)
    window = study.evaluation.window
    points = observation_points(mesh.nodes, mesh.node_sets["face"], window.abs_x_max, window.abs_y_max)
    nodal = interpolate_displacements(experiment.dic, points.xy)
    smooth = smooth_force(experiment.force, study.force.noise, study.force.smoothing)
    phases = label_phases(smooth)
    load_start = next((p.t0 for p in phases if p.label in ("elastic", "loading")), float(smooth.time[0]))
    summary: dict[str, Any] = {"load_start_s": load_start, "remarks": []}
    mask = study.evaluation.mask
    displacement = masked(_displacement(study, experiment.dic, nodal, points, summary), mask, "evaluation.mask")
    fields, temperature = [displacement], None
    if calibrated is not None:
        record = read_current(calibrated, CALIBRATE, study.source.name)
        temperature = masked(_temperature(study, record, nodal, (points, specimen), summary), mask, "evaluation.mask")
        fields.append(temperature)
    datasets = _force_datasets(study, experiment, smooth, displacement, temperature)
    ends = (float(mesh.nodes[:, 1].min()), float(mesh.nodes[:, 1].max()))
    datasets |= _elongation(study, experiment.dic, ends, smooth, datasets, summary)
    for field in fields:
        datasets.update(field_datasets(field))
    datasets["points/node"] = Dataset(points.node, "1", ("point",))
    datasets["points/mirror"] = Dataset(points.mirror, "1", ("point",))
    summary |= {
        "specimen": specimen_dict(specimen),
        "temperatures": {"theta_air": experiment.theta_air, "theta_clamp": experiment.theta_clamp},
        "phases": [{"t0": p.t0, "t1": p.t1, "label": p.label} for p in phases],
        "force": _force_summary(smooth),
        "repairs": list(experiment.repairs),
    }
    summary["verdict"] = _verdict(summary, fields)
    return Made(datasets, summary)


def _displacement(
    study: Study, dic: DicField, nodal: NodalDisplacement, points: ObservationPoints, summary: dict[str, Any]
) -> FieldObservation:
    """Displacements at the evaluation times with sigma from the raw noise through the interpolation weights.

    The summary holds the time in s at which loading starts; what is found is added to it.
    """
    wanted = study.evaluation.displacement_times
    at = nodal if wanted == "stages" else displacements_at(nodal, np.asarray(wanted, dtype=float))
    raw = displacement_noise(dic, summary["load_start_s"])
    if study.noise.displacement is None:
        summary["remarks"] += _floor_remark("displacement", "stages", raw[0].temporal, summary["load_start_s"])
    noise = np.array([raw[0].sigma, raw[1].sigma]) if study.noise.displacement is None else np.full(2, study.noise.displacement)
    noise = np.maximum(noise, _LEAST_NOISE["mm"])
    summary["displacement"] = {
        "noise_mm": noise.tolist(),
        "noise_method": raw[0].temporal.method,
        "noise_spatial_mm": [raw[0].spatial.sigma, raw[1].spatial.sigma],
        "correlation_length_mm": max(raw[0].correlation_length, raw[1].correlation_length),
        "points_lost": int(at.counts.points_lost.sum()),
        "nodes": len(points.xy),
        "nodes_outside": at.counts.nodes_outside,
        "retriangulated": at.counts.retriangulated,
        "times_outside": at.counts.times_outside,
        "masked": at.counts.masked,
    }
    sigma = at.sigma_factor[:, :, None] * noise
    return FieldObservation("u", at.time, points.xy, at.value[:, :, :2], sigma, at.mask, "mm")


def _temperature(
    study: Study, record: Record, nodal: NodalDisplacement, where: tuple[ObservationPoints, Specimen], summary: dict[str, Any]
) -> FieldObservation:
    """Temperatures at the evaluation times at the current positions of the material points; the summary as for `_displacement`."""
    points, specimen = where
    distance = edge_distance(specimen, points.xy)
    infrared = InfraredSequence(record["time"].value, record["frames"].value)
    pose = record.summary["pose"]
    camera = CameraPose(
        pose["scale_mm_per_px"], np.array(pose["origin_px"]), np.array(pose["axis_x"]), np.array(pose["axis_y"]), str(pose["side"])
    )
    wanted = study.evaluation.temperature_times
    times = infrared.time if wanted == "frames" else np.asarray(wanted, dtype=float)
    times = times[(times >= nodal.time[0]) & (times <= nodal.time[-1])] if wanted == "frames" else times
    at = interpolate_temperatures(infrared, pixel_map(camera), points.xy, displacements_at(nodal, times), distance >= study.ir.edge_margin)
    raw = temperature_noise(infrared, _on_specimen(record, specimen, study.ir.edge_margin), summary["load_start_s"])
    if study.noise.temperature is None:
        summary["remarks"] += _floor_remark("temperature", "frames", raw.temporal, summary["load_start_s"])
    noise = max(raw.sigma if study.noise.temperature is None else study.noise.temperature, _LEAST_NOISE["K"])
    summary["temperature"] = {
        "noise_K": noise,
        "noise_method": raw.temporal.method,
        "noise_spatial_K": raw.spatial.sigma,
        "correlation_length_px": raw.correlation_length,
        "correlation_length_mm": raw.correlation_length * camera.scale,
        "frames_beyond_dic": int(len(infrared.time) - len(times)) if wanted == "frames" else 0,
        "nodes_at_edge": at.counts.nodes_at_edge,
        "times_outside": at.counts.times_outside,
        "no_position": at.counts.no_position,
        "outside_image": at.counts.outside_image,
        "dead_pixel": at.counts.dead_pixel,
        "masked": at.counts.masked,
    }
    return FieldObservation("theta", at.time, points.xy, at.value[:, :, None], (noise * at.sigma_factor)[:, :, None], at.mask, "K")


def _floor_remark(channel: str, fields: str, found: NoiseEstimate, load_start: float) -> list[str]:
    """What the user is told where the noise of a channel does not come from the rest before loading."""
    if found.at_rest >= LEAST_AT_REST:
        return []
    return [
        f"{channel} noise by {found.method}: only {found.at_rest} {fields} before loading at {load_start:.1f} s hold {LEAST_VALUES} values "
        f"or more that scatter, {LEAST_AT_REST} are needed"
    ]


def _on_specimen(record: Record, specimen: Specimen, margin: float) -> np.ndarray:
    """True (n_row, n_col) for pixels on the resting specimen, away from its blurred edge."""
    place = record["coordinates"].value
    flat = place.reshape(-1, 2)
    inside = (edge_distance(specimen, flat) > margin) & (np.abs(flat[:, 1]) < 0.5 * specimen.total_length)
    return np.asarray(inside.reshape(place.shape[:2]))


def _force_datasets(
    study: Study, experiment: Experiment, smooth: SmoothForce, displacement: FieldObservation, temperature: FieldObservation | None
) -> dict[str, Dataset]:
    """Raw and smoothed force, and the load steps for each set of observation times."""
    theta_time = displacement.time if temperature is None else temperature.time
    required = {"displacement": displacement.time, "temperature": theta_time, "all": np.union1d(displacement.time, theta_time)}
    datasets = {
        "force/time": Dataset(experiment.force.time, "s", ("sample",)),
        "force/raw": Dataset(experiment.force.force, "N", ("sample",)),
        "force/smooth": Dataset(smooth.evaluate(experiment.force.time), "N", ("sample",)),
        "force/sigma": Dataset(smooth.sigma(experiment.force.time), "N", ("sample",)),
    }
    numerics = study.numerics
    for name, times in required.items():
        steps = step_times(smooth, times, numerics.force_tolerance, numerics.max_time_step)
        steps = _refined(_merged(steps, times), numerics.steps_per_interval)
        datasets[f"steps/{name}/time"] = Dataset(steps, "s", ("step",))
        datasets[f"steps/{name}/force"] = Dataset(smooth.evaluate(steps), "N", ("step",))
        datasets[f"steps/{name}/force_error"] = Dataset(smooth.error_modes(steps), "N", ("step", "mode"))
        if experiment.force.crosshead is not None:
            crosshead = np.interp(steps, experiment.force.time, experiment.force.crosshead)
            datasets[f"steps/{name}/crosshead"] = Dataset(crosshead, "mm", ("step",))
    return datasets


def _elongation(
    study: Study, dic: DicField, ends: tuple[float, float], smooth: SmoothForce, datasets: dict[str, Dataset], summary: dict[str, Any]
) -> dict[str, Dataset]:
    """What the DIC points say of the elongation of the model, or of the part of it that the field covers, at the load steps; nothing where
    they cannot say it and another drive is asked for.

    DataError where DIC is to drive and does not tell the elongation.
    """
    names = ("displacement", "temperature", "all")
    try:
        sections = sections_inside(dic, ends, study.force.band)
        motion = end_motion(dic, sections, study.force.band, summary["load_start_s"])
        steps = {name: motion.at(datasets[f"steps/{name}/time"].value, summary["load_start_s"], smooth) for name in names}
    except DataError as error:
        if study.force.drives == "dic":
            raise
        summary["elongation"] = {"missing": str(error)}
        return {}
    summary["elongation"] = {"noise_mm": motion.noise, "points": motion.points, "sections_mm": list(sections)}
    out = {
        "elongation/time": Dataset(motion.time, "s", ("stage",)),
        "elongation/value": Dataset(motion.elongation, "mm", ("stage",)),
        "elongation/force_error": Dataset(motion.force_error(smooth), "N", ("stage",)),
    }
    if sections != ends:
        out["elongation/xy"] = Dataset(motion.gauge.xy, "mm", ("gauge_point", "axis"))
        out["elongation/weight"] = Dataset(motion.gauge.weight, "1", ("gauge_point",))
    return out | {f"steps/{name}/elongation": Dataset(value, "mm", ("step",)) for name, value in steps.items()}


_CLOSEST = 1e-3
"""s; two step times that are nearer than this are one: the observation's where one of them is an observation."""


def _merged(steps: np.ndarray, required: np.ndarray) -> np.ndarray:
    """Step times without near-coincident ones; every required time is kept exactly."""
    distance = np.min(np.abs(steps[:, None] - required[None, :]), axis=1)
    others = steps[distance > _CLOSEST]
    return np.union1d(others[np.concatenate([[True], np.diff(others) > _CLOSEST])], required)


def _refined(steps: np.ndarray, parts: int) -> np.ndarray:
    """Every interval cut into `parts` equal ones."""
    share = np.arange(parts) / parts
    return np.append((steps[:-1, None] + np.diff(steps)[:, None] * share).ravel(), steps[-1])


_UNLOADED = 0.02
"""Share of the largest force below which a hold after loading counts as cooling."""


_BEND = 0.5
"""Share of its rate before that the force keeps after the onset of yield, at most."""


def _onset(smooth: SmoothForce, t0: float, t1: float) -> float:
    """Time in s of the first knee or kink in (t0, t1) at which the force rate falls by half within half a second; t1 where none does."""
    bends = np.sort(np.concatenate([smooth.phases.knees, smooth.phases.kinks]))
    for bend in bends[(bends > t0) & (bends < t1)]:
        reach = min(0.5, 0.5 * (bend - t0), 0.5 * (t1 - bend))
        if float(smooth.rate(bend + reach)) < _BEND * float(smooth.rate(bend - reach)):
            return float(bend)
    return t1


def label_phases(smooth: SmoothForce) -> tuple[TestPhase, ...]:
    """Phases of the test in the words of the thesis: rest, elastic, loading, unloading, hold, cooling."""
    items = smooth.phases.items
    largest = float(np.max(np.abs(smooth.force)))
    first = next((n for n, item in enumerate(items) if item.kind == "loading"), len(items))
    after = next((n for n in range(first, len(items)) if items[n].kind != "loading"), len(items))
    phases = [TestPhase(item.t0, item.t1, "rest" if item.kind == "hold" else item.kind) for item in items[:first]]
    if first < len(items):
        t0, t1 = items[first].t0, items[after - 1].t1
        onset = _onset(smooth, t0, t1)
        phases += [TestPhase(t0, onset, "elastic"), *([TestPhase(onset, t1, "loading")] if onset < t1 else [])]
    for item in items[after:]:
        unloaded = abs(float(smooth.evaluate(0.5 * (item.t0 + item.t1)))) < _UNLOADED * largest
        label = item.kind if item.kind != "hold" else ("cooling" if unloaded else "hold")
        phases.append(TestPhase(item.t0, item.t1, label))
    return tuple(phases)


def _force_summary(smooth: SmoothForce) -> dict[str, Any]:
    return {
        "noise_N": smooth.noise,
        "residual_rms_N": smooth.residual_rms,
        "residual_autocorrelation": smooth.residual_autocorrelation,
        "residual_max_in_noise": smooth.residual_max,
        "samples": smooth.n,
        "knots": len(smooth.knots),
        "spurious_reversals": smooth.spurious_reversals,
    }


def _verdict(summary: dict[str, Any], fields: list[FieldObservation]) -> str:
    u = summary["displacement"]
    parts = [f"{fields[0].mask.shape[1]} points; u at {len(fields[0].time)} times, noise {1e3 * float(np.mean(u['noise_mm'])):.2f} um"]
    if len(fields) > 1:
        parts.append(f"theta at {len(fields[1].time)} times, noise {1e3 * summary['temperature']['noise_K']:.1f} mK")
    force = summary["force"]
    parts.append(f"force smoothed to {force['residual_rms_N']:.2f} N (noise {force['noise_N']:.2f} N)")
    lost = [f"{sum(int((~f.mask).sum()) for f in fields)} point-times left out"]
    return "; ".join(parts + lost)
