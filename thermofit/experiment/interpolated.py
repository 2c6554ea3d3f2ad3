"""From the instruments' points and pixels to nodal values of the mesh, with their noise: by projection, or by algorithms 2 and 3.

Also the force: smoothed to its noise level, and the times through which the solver must step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.body.mesh.mesh import Mesh
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence, MeasuredTest, Specimen
from thermofit.experiment.computed_motion import computed_motion, in_words, refuse_unknown_mechanics, used_parameters
from thermofit.experiment.fields import (
    LoadSteps,
    Measured,
    TestPhase,
    field_datasets,
    force_observation,
    refined,
    specimen_dict,
    start_parameters,
)
from thermofit.experiment.static import static_record
from thermofit.observe.camera import CameraPose
from thermofit.observe.cut_knees import cut_knees, off_chords
from thermofit.observe.end_motion import end_motion, sections_inside
from thermofit.observe.face_quads import distance_to_edge, face_quads
from thermofit.observe.fixed_pattern import FixedPattern, fixed_pattern
from thermofit.observe.force import SmoothForce, programme_times, smooth_force, step_times
from thermofit.observe.interpolation import (
    NodalDisplacement,
    displacements_at,
    edge_distance,
    interpolate_displacements,
    interpolate_temperatures,
    pixel_map,
)
from thermofit.observe.noise import (
    LEAST_AT_REST,
    LEAST_VALUES,
    FieldNoise,
    NoiseEstimate,
    displacement_noise,
    temperature_noise,
    temporal_noise,
)
from thermofit.observe.observation import FieldObservation
from thermofit.observe.observation_points import ObservationPoints, observation_points, observed_window, reach_of
from thermofit.observe.projection import (
    Patches,
    Projected,
    face_patches,
    in_line,
    project_displacements,
    project_temperatures,
    rests,
    sight_of,
)
from thermofit.observe.selection import masked
from thermofit.observe.triangles import point_spacing
from thermofit.read.plausible import asked
from thermofit.read.raw import read_experiment
from thermofit.records.artefact import Dataset, Record, read_current, read_record
from thermofit.records.staging import Made, artefact_path
from thermofit.study.geometry import STRAIGHT
from thermofit.study.section import mesh_size
from thermofit.study.study import Study

CALIBRATE = "calibrate-ir"
_LEAST_NOISE = {"mm": 1e-6, "K": 1e-4}
"""Noise of data without noise: sigma must not vanish, because it divides the residual."""


Frames = Callable[[], Record]
"""Reads the artefact of `calibrate-ir`."""


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
    if experiment.dic is None and calibrated is None:
        raise DataError(
            f"{study.experiment}: experiment.yaml declares neither displacements nor infrared frames; add its dic or ir section"
        )
    if experiment.dic is None:
        refuse_unknown_mechanics(study)
    specimen, size = study.specimen_of(experiment.specimen), mesh_size(study.evaluation.nodes)
    frames = None if calibrated is None else lambda: read_current(calibrated, CALIBRATE, study.source.name)
    remarks = _asked(replace(experiment, specimen=specimen), frames)
    mesh = specimen_mesh(study.geometry, specimen, size, study.mesh_file)
    reach = _image_reach(frames) if experiment.dic is None else reach_of(experiment.dic)
    window = observed_window(study.evaluation.window, specimen, study.geometry.shape in STRAIGHT, reach)
    points = observation_points(mesh.nodes, mesh.node_sets["face"], *window)
    smooth = smooth_force(experiment.force, study.force.noise, study.force.smoothing)
    phases = label_phases(smooth)
    load_start = next((p.t0 for p in phases if p.label in ("elastic", "loading")), float(smooth.time[0]))
    summary: dict[str, Any] = {"load_start_s": load_start, "window_mm": list(window), "remarks": list(remarks), "notes": []}
    face, three_point = Face(mesh, specimen, points), study.evaluation.interpolation == "three-point"
    if experiment.dic is None:
        fields = _on_computed_motion(study, experiment, frames, face, smooth, phases, summary)
    else:
        fields = (_three_point if three_point else _projected)(study, experiment.dic, frames, face, summary)
    fields = [masked(field, study.evaluation.mask, "evaluation.mask") for field in fields]
    fields = _off_chords(fields, smooth, summary)
    datasets = _force_datasets(study, experiment, smooth, {field.name: field.time for field in fields})
    ends = (float(mesh.nodes[:, 1].min()), float(mesh.nodes[:, 1].max()))
    if experiment.dic is not None:
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


def _asked(experiment: MeasuredTest, frames: Frames | None) -> tuple[str, ...]:
    """Remarks on the plausibility of force and displacements, then of all data together; the frames are let go again."""
    remarks = asked(experiment)
    if frames is None:
        return remarks
    infrared, camera = _infrared(frames())
    return asked(replace(experiment, ir=infrared), camera)


def _image_reach(frames: Frames | None) -> tuple[float, float]:
    """Largest |x| and |y| in mm of the resting specimen's frame that the camera sees."""
    assert frames is not None
    x, y = np.abs(frames()["coordinates"].value).reshape(-1, 2).max(axis=0)
    return float(x), float(y)


@dataclass(frozen=True)
class Face:
    """The face that the cameras see: mesh of the comparison, specimen, and the points that are compared."""

    mesh: Mesh
    specimen: Specimen
    points: ObservationPoints

    def near_edge(self, xy: np.ndarray, margin: float, shape: str) -> np.ndarray:
        """True (n,) for places (n, 2) mm nearer than `margin` mm to the free edges of the face, or beyond them."""
        inside = edge_distance(self.specimen, xy) if shape in STRAIGHT else distance_to_edge(face_quads(self.mesh), xy)
        return np.asarray(inside < margin)


Fields = list[FieldObservation]


def _projected(study: Study, dic: DicField, frames: Frames | None, face: Face, summary: dict[str, Any]) -> Fields:
    """Displacements and, where the cameras saw them, temperatures as means over the patches of the nodes; the summary says what of the data
    was used."""
    noise, patches = _displacement_noise(study, dic, summary), face_patches(face.mesh, face.points)
    wanted = study.evaluation.displacement_times
    good = in_line(dic, noise)
    at = project_displacements(dic, patches, good, None if wanted == "stages" else np.asarray(wanted, dtype=float))
    u = _means("u", at, face, noise, "mm")
    scatter = _scatter(u, study.noise.displacement is None, summary)
    fields = [replace(u, sigma=scatter * u.sigma)]
    summary["displacement"] |= {"nodes": len(patches.xy), **at.counts}
    summary["remarks"] += _sparse_remark(at.points, "u", "DIC points", _distances(dic, face))
    summary["nodal_values"] = [_used(at, "points", fields[0], scatter * float(noise.mean()))]
    if frames is not None:
        fields.append(_projected_temperature(study, frames(), dic, good, face, patches, summary))
    return fields


def _on_computed_motion(
    study: Study,
    experiment: MeasuredTest,
    frames: Frames | None,
    face: Face,
    smooth: SmoothForce,
    phases: tuple[TestPhase, ...],
    summary: dict[str, Any],
) -> Fields:
    """Temperatures of a test without displacements: the material moves past the pixels as a run with the study's parameters says. Nothing
    of that motion is kept but its size."""
    assert frames is not None
    record, parameters = frames(), start_parameters(study, experiment)
    infrared, camera = _infrared(record)
    times = infrared.time[(infrared.time >= smooth.time[0]) & (infrared.time <= smooth.time[-1])]
    steps = _step_times(study, smooth, np.union1d(times, _frame_times(study, infrared, smooth.time)))
    loading = LoadSteps(steps, smooth.evaluate(steps))
    rest = force_observation(steps[:1], loading, smooth.noise)
    seen = (experiment.theta_air, experiment.theta_clamp)
    data = Measured(face.specimen, *seen, None, None, rest, {"all": loading}, summary["load_start_s"], phases)
    moved, patches = computed_motion(study, data, face.mesh, parameters), face_patches(face.mesh, face.points)
    summary["nodal_values"] = []
    if study.evaluation.interpolation == "three-point":
        theta = _three_pixel(study, record, interpolate_displacements(moved, face.points.xy), face, summary)
    else:
        whole = np.ones(moved.displacement.shape[:2], dtype=bool)
        theta = _projected_temperature(study, record, moved, whole, face, patches, summary)
    inside = patches.of(moved.reference[:, :2]) >= 0
    size = float(np.linalg.norm(moved.displacement[:, inside], axis=2).max())
    over = (size / camera.scale, size / patches.spacing)
    summary["elongation"] = {"missing": "the experiment has no displacements"}
    summary["motion"] = {
        "computed": True,
        "parameters": used_parameters(study, parameters),
        "largest_mm": size,
        "largest_px": over[0],
        "largest_patches": over[1],
    }
    summary["remarks"].append(
        f"no displacements were measured: the motion is computed under the measured force with {in_words(study, parameters)}; points move "
        f"by up to {size:.2g} mm, {over[0]:.2g} pixels or {over[1]:.2g} times the distance of two nodes; slip in the jaws is not in it"
    )
    return [theta]


def _projected_temperature(
    study: Study, record: Record, dic: DicField, good: np.ndarray, face: Face, patches: Patches, summary: dict[str, Any]
) -> FieldObservation:
    """Temperatures as means over the patches; `good` (n_t, n_s) are the DIC points that tell the motion."""
    infrared, camera = _infrared(record)
    on_specimen = _on_specimen(record, face.specimen, study.ir.edge_margin)
    raw = temperature_noise(infrared, on_specimen, summary["load_start_s"])
    times = _frame_times(study, infrared, dic.time)
    at_edge = face.near_edge(patches.raster().places, study.ir.edge_margin, study.geometry.shape)
    sight = sight_of(pixel_map(camera), dic, patches, good, at_edge, infrared.time)
    pattern = fixed_pattern(infrared, rests(infrared, sight), raw)
    taken = replace(raw, sigma=float(np.hypot(raw.temporal.sigma, pattern.left)))
    noise = _temperature_noise(study, taken, camera, summary)
    if not np.array_equal(times, infrared.time):
        sight = sight_of(pixel_map(camera), dic, patches, good, at_edge, times)
    at = project_temperatures(infrared, sight, patches, pattern.value, study.ir.blur * camera.scale)
    theta = _means("theta", at, face, np.array([noise]), "K")
    scatter = _scatter(theta, study.noise.temperature is None, summary)
    theta = replace(theta, sigma=scatter * theta.sigma)
    summary["temperature"] |= {
        "registration": registration_sigma(record),
        "nodes": len(patches.xy),
        "frames_beyond_dic": int(len(infrared.time) - len(times)) if study.evaluation.temperature_times == "frames" else 0,
        "fixed_pattern_K": pattern.size,
        "fixed_pattern_left_K": pattern.left,
        "fixed_pattern_frames": pattern.frames,
        "fixed_pattern_stays": None if pattern.stays is None else pattern.stays[0],
        "bad_pixels": pattern.bad,
        **at.counts,
    }
    summary["nodal_values"].append(_used(at, "pixels", theta, scatter * noise))
    summary["remarks"] += _pattern_remark(pattern, noise)
    summary["remarks"] += _sparse_remark(at.there, "theta", "pixels", f"a pixel is {camera.scale:.3g} mm wide")
    return theta


_NOTABLE = 0.3
"""Pattern of a camera over the noise of a pixel from which on it is worth a word."""


def _pattern_remark(pattern: FixedPattern, noise: float) -> list[str]:
    """What the user is told of a pattern that may be the specimen's own."""
    if pattern.moves and pattern.stays is not None:
        return [
            f"theta: the fine pattern of {1e3 * pattern.size:.2g} mK in the frames at rest moves with the specimen "
            f"({pattern.stays[0]:.0%} of it stay): it is paint or temperature, and is not taken off as the camera's"
        ]
    if pattern.stays is None and pattern.frames and pattern.size > _NOTABLE * noise:
        return [
            f"theta: a pattern of {1e3 * pattern.size:.2g} mK is taken off as the camera's, but the specimen rests at one place only, "
            "where a fine pattern of its own looks the same: record some frames at rest after loading too"
        ]
    return []


_FEW = 0.01
"""Share of the node-times without any data up to which nothing is said."""


def _sparse_remark(number: np.ndarray, name: str, what: str, why: str) -> list[str]:
    """What the user is told where nodes have no data of their own, `number` (n_t, n) of them: they are not compared."""
    empty = number <= 0.0
    never, some = int(empty.all(axis=0).sum()), int((empty & ~empty.all(axis=0)).any(axis=0).sum())
    if empty.mean() <= _FEW:
        return []
    count = f"{int(empty.sum())} of {empty.size} node-times have no {what} of their own and are left out"
    return [
        f"{name}: {count} ({never} nodes always, {some} now and then): {why}; evaluation.nodes: coarse has wider patches, "
        "evaluation.window keeps to the field"
    ]


def _distances(dic: DicField, face: Face) -> str:
    """Distance of the points and of the nodes, in words."""
    apart = [point_spacing(np.unique(xy, axis=0)) for xy in (dic.reference[:, :2], face.points.xy)]
    return f"points are {apart[0]:.3g} mm apart, nodes {apart[1]:.3g} mm"


def _means(name: str, at: Projected, face: Face, noise: np.ndarray, unit: str) -> FieldObservation:
    """Projected values of points with the `noise` (n_c,) as an observation."""
    return FieldObservation(name, at.time, face.points.xy, at.value, at.sigma_factor[:, :, None] * noise, at.mask, unit, at.moments)


_EXCESS = 1.1
"""Scatter of the nodal values over what independent noise of the points makes, above which it counts: their noise hangs together."""


def _scatter(field: FieldObservation, estimated: bool, summary: dict[str, Any]) -> float:
    """Factor on the noise of nodal values where they scatter more than independent noise of their points explains, else one.

    The scatter is that of `temporal_noise`, of the values themselves. Where the study declares the noise it is what it says.
    """
    own = np.where(field.mask[:, :, None], field.sigma, np.nan)
    said, found = summary["displacement" if field.name == "u" else "temperature"], []
    said["scatter_over_noise"] = None
    for k in range(field.value.shape[2]):
        try:
            seen = temporal_noise(field.time, field.value[:, :, k], field.mask, summary["load_start_s"], field.xy)
        except DataError:  # too few nodes or times to tell
            return 1.0
        found.append(seen.sigma / float(np.sqrt(np.nanmean(own[:, :, k] ** 2))))
    ratio = said["scatter_over_noise"] = float(np.median(found))
    if not estimated or ratio <= _EXCESS:
        return 1.0
    summary["remarks"].append(
        f"{field.name}: nodal values scatter {ratio:.2f} times what independent noise makes; their sigma is that much larger"
    )
    return ratio


def _off_chords(fields: Fields, smooth: SmoothForce, summary: dict[str, Any]) -> Fields:
    """The fields without the times at which the record cuts a knee of the force off; the notes count them."""
    kept, chords = [], cut_knees(smooth)
    for field in fields:
        left = off_chords(field, chords)
        lost = np.setdiff1d(field.time, left.time)
        if len(lost):
            at = ", ".join(f"{t:.2f}" for t in lost)
            summary["notes"].append(
                f"{field.name}: {len(lost)} of {len(field.time)} times ({at} s) left out and not compared; the force goes straight between "
                "two near knees there, and a record that cuts a knee off follows no law"
            )
        kept.append(left)
    return kept


def _used(at: Projected, what: str, field: FieldObservation, noise: float) -> dict[str, Any]:
    """What is told of a field: share of the data used, median standard error of a nodal value, and the one that all data of its patch would
    give. `noise` is the standard error of one value."""
    whole = noise / np.sqrt(np.maximum(at.there, 1.0))
    return {
        "field": field.name,
        "nodes": at.mask.shape[1],
        "data": what,
        "used": at.counts[f"{what}_used"],
        "in_window": at.counts[f"{what}_in_window"],
        "share_used": at.counts[f"{what}_used"] / max(at.counts[f"{what}_in_window"], 1),
        "standard_error": float(np.nanmedian(field.sigma)),
        "best": float(np.median(whole[at.there > 0])) if (at.there > 0).any() else None,
        "unit": field.unit,
    }


def _three_point(study: Study, dic: DicField, frames: Frames | None, face: Face, summary: dict[str, Any]) -> Fields:
    """Displacements and, where the cameras saw them, temperatures linear between the three next points and pixels (algorithms 2 and 3)."""
    nodal, points = interpolate_displacements(dic, face.points.xy), face.points
    wanted = study.evaluation.displacement_times
    at = nodal if wanted == "stages" else displacements_at(nodal, np.asarray(wanted, dtype=float))
    noise = _displacement_noise(study, dic, summary)
    summary["displacement"] |= {
        "points_lost": int(at.counts.points_lost.sum()),
        "nodes": len(points.xy),
        "nodes_outside": at.counts.nodes_outside,
        "retriangulated": at.counts.retriangulated,
        "times_outside": at.counts.times_outside,
        "masked": at.counts.masked,
    }
    sigma = at.sigma_factor[:, :, None] * noise
    fields = [FieldObservation("u", at.time, points.xy, at.value[:, :, :2], sigma, at.mask, "mm")]
    if frames is not None:
        fields.append(_three_pixel(study, frames(), nodal, face, summary))
    return fields


def _three_pixel(study: Study, record: Record, nodal: NodalDisplacement, face: Face, summary: dict[str, Any]) -> FieldObservation:
    """Temperatures at the evaluation times at the current positions of the material points."""
    points, margin = face.points, study.ir.edge_margin
    infrared, camera = _infrared(record)
    times = _frame_times(study, infrared, nodal.time)
    usable = edge_distance(face.specimen, points.xy) >= margin
    at = interpolate_temperatures(infrared, pixel_map(camera), points.xy, displacements_at(nodal, times), usable)
    raw = temperature_noise(infrared, _on_specimen(record, face.specimen, margin), summary["load_start_s"])
    noise = _temperature_noise(study, raw, camera, summary)
    summary["temperature"] |= {
        "frames_beyond_dic": int(len(infrared.time) - len(times)) if study.evaluation.temperature_times == "frames" else 0,
        "nodes_at_edge": at.counts.nodes_at_edge,
        "times_outside": at.counts.times_outside,
        "no_position": at.counts.no_position,
        "outside_image": at.counts.outside_image,
        "dead_pixel": at.counts.dead_pixel,
        "masked": at.counts.masked,
    }
    return FieldObservation("theta", at.time, points.xy, at.value[:, :, None], (noise * at.sigma_factor)[:, :, None], at.mask, "K")


def _displacement_noise(study: Study, dic: DicField, summary: dict[str, Any]) -> np.ndarray:
    """Noise (2,) mm of u_x and u_y of one point, estimated or declared; what is found is added to the summary."""
    raw = displacement_noise(dic, summary["load_start_s"])
    if study.noise.displacement is None:
        summary["notes"] += _floor_note("displacement", "stages", raw[0].temporal, summary["load_start_s"])
    noise = np.array([raw[0].sigma, raw[1].sigma]) if study.noise.displacement is None else np.full(2, study.noise.displacement)
    noise = np.maximum(noise, _LEAST_NOISE["mm"])
    summary["displacement"] = {
        "noise_mm": noise.tolist(),
        "noise_method": raw[0].temporal.method,
        "noise_spatial_mm": [raw[0].spatial.sigma, raw[1].spatial.sigma],
        "correlation_length_mm": max(raw[0].correlation_length, raw[1].correlation_length),
    }
    return noise


def _temperature_noise(study: Study, raw: FieldNoise, camera: CameraPose, summary: dict[str, Any]) -> float:
    """Noise K of one pixel, estimated or declared; what is found is added to the summary."""
    if study.noise.temperature is None:
        summary["notes"] += _floor_note("temperature", "frames", raw.temporal, summary["load_start_s"])
    noise = max(raw.sigma if study.noise.temperature is None else study.noise.temperature, _LEAST_NOISE["K"])
    summary["temperature"] = {
        "noise_K": noise,
        "noise_method": raw.temporal.method,
        "noise_spatial_K": raw.spatial.sigma,
        "correlation_length_px": raw.correlation_length,
        "correlation_length_mm": raw.correlation_length * camera.scale,
    }
    return noise


def registration_sigma(record: Record) -> dict[str, float]:
    """Standard errors of the pose of the camera by Param of `ir_registration`: of its origin along and across the load (mm), of its roll
    (rad) and of its scale (relative). Empty where the record tells none."""
    doubt = record.summary.get("uncertainty")
    if doubt is None:
        return {}
    pose, origin = record.summary["pose"], np.array(doubt["origin_px"])
    scale = pose["scale_mm_per_px"]
    across, along = (scale * float(np.linalg.norm(origin * np.array(pose[axis]))) for axis in ("axis_x", "axis_y"))
    return {
        "ir_registration.shift_y": along,
        "ir_registration.shift_x": across,
        "ir_registration.rotation": float(np.deg2rad(doubt["roll_deg"])),
        "ir_registration.scale": doubt["scale_mm_per_px"] / scale,
    }


def _infrared(record: Record) -> tuple[InfraredSequence, CameraPose]:
    """Calibrated frames and the pose of the camera."""
    pose = record.summary["pose"]
    camera = CameraPose(
        pose["scale_mm_per_px"], np.array(pose["origin_px"]), np.array(pose["axis_x"]), np.array(pose["axis_y"]), str(pose["side"])
    )
    return InfraredSequence(record["time"].value, record["frames"].value), camera


def _frame_times(study: Study, infrared: InfraredSequence, stages: np.ndarray) -> np.ndarray:
    """Times s of the temperatures: those of the study, or the frames between the first and the last DIC stage."""
    wanted = study.evaluation.temperature_times
    if wanted != "frames":
        return np.asarray(wanted, dtype=float)
    return np.asarray(infrared.time[(infrared.time >= stages[0]) & (infrared.time <= stages[-1])])


def _floor_note(channel: str, fields: str, found: NoiseEstimate, load_start: float) -> list[str]:
    """What the user is told where the noise of a channel does not come from the rest before loading."""
    if found.at_rest >= LEAST_AT_REST:
        return []
    return [
        f"{channel} noise is estimated by {found.method}: only {found.at_rest} {fields} with {LEAST_VALUES} values or more before loading "
        f"at {load_start:.1f} s; record {LEAST_AT_REST} or more for a direct estimate"
    ]


def _on_specimen(record: Record, specimen: Specimen, margin: float) -> np.ndarray:
    """True (n_row, n_col) for pixels on the resting specimen, away from its blurred edge."""
    place = record["coordinates"].value
    flat = place.reshape(-1, 2)
    inside = (edge_distance(specimen, flat) > margin) & (np.abs(flat[:, 1]) < 0.5 * specimen.total_length)
    return np.asarray(inside.reshape(place.shape[:2]))


def _step_times(study: Study, smooth: SmoothForce, times: np.ndarray) -> np.ndarray:
    """Times (n,) s of the load steps that hit the given ones."""
    numerics = study.numerics
    steps = step_times(smooth, times, numerics.force_tolerance, numerics.max_time_step)
    return refined(_merged(steps, times), numerics.steps_per_interval)


def _force_datasets(study: Study, experiment: MeasuredTest, smooth: SmoothForce, observed: Mapping[str, np.ndarray]) -> dict[str, Dataset]:
    """Raw and smoothed force, the load steps for each set of observation times, and the course of the force between them; `observed`: the
    times of the fields "u" and "theta", or of the one that there is."""
    u_time, theta_time = (observed.get(name, observed.get(other)) for name, other in (("u", "theta"), ("theta", "u")))
    assert u_time is not None and theta_time is not None
    required = {"displacement": u_time, "temperature": theta_time, "all": np.union1d(u_time, theta_time)}
    datasets = {
        "force/time": Dataset(experiment.force.time, "s", ("sample",)),
        "force/raw": Dataset(experiment.force.force, "N", ("sample",)),
        "force/smooth": Dataset(smooth.evaluate(experiment.force.time), "N", ("sample",)),
        "force/sigma": Dataset(smooth.sigma(experiment.force.time), "N", ("sample",)),
    }
    for name, times in required.items():
        steps = _step_times(study, smooth, times)
        datasets[f"steps/{name}/time"] = Dataset(steps, "s", ("step",))
        datasets[f"steps/{name}/force"] = Dataset(smooth.evaluate(steps), "N", ("step",))
        datasets[f"steps/{name}/force_error"] = Dataset(smooth.error_modes(steps), "N", ("step", "mode"))
        if experiment.force.crosshead is not None:
            crosshead = np.interp(steps, experiment.force.time, experiment.force.crosshead)
            datasets[f"steps/{name}/crosshead"] = Dataset(crosshead, "mm", ("step",))
    steps = np.unique(np.concatenate([datasets[f"steps/{name}/time"].value for name in required]))
    bends = programme_times(smooth)
    course = refined(np.union1d(steps, bends[(bends > steps[0]) & (bends < steps[-1])]), _PARTS)
    datasets["course/time"] = Dataset(course, "s", ("instant",))
    datasets["course/force"] = Dataset(smooth.evaluate(course), "N", ("instant",))
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


_PARTS = 16
"""Parts of a load step in each of which the course of the force is straight: it misses a 256th of what the chord of the step does."""
_CLOSEST = 1e-3
"""s; two step times that are nearer than this are one: the observation's where one of them is an observation."""


def _merged(steps: np.ndarray, required: np.ndarray) -> np.ndarray:
    """Step times without near-coincident ones; every required time is kept exactly."""
    distance = np.min(np.abs(steps[:, None] - required[None, :]), axis=1)
    others = steps[distance > _CLOSEST]
    return np.union1d(others[np.concatenate([[True], np.diff(others) > _CLOSEST])], required)


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
    said = {"u": "motion computed, not measured"}
    for field in fields:
        noise = summary["displacement" if field.name == "u" else "temperature"]
        size = f"{1e3 * float(np.mean(noise['noise_mm'])):.2f} um" if field.name == "u" else f"{1e3 * noise['noise_K']:.1f} mK"
        said[field.name] = f"{field.name} at {len(field.time)} times, noise {size}"
    parts = [f"{fields[0].mask.shape[1]} points; {said.pop('u')}", *said.values()]
    force = summary["force"]
    parts.append(f"force smoothed to {force['residual_rms_N']:.2f} N (noise {force['noise_N']:.2f} N)")
    small = {"mm": "um", "K": "mK"}
    each = [f"{1e3 * float(np.nanmedian(f.sigma)):.2f} {small[f.unit]}" for f in fields]
    out, of = sum(int((~f.mask).sum()) for f in fields), sum(f.mask.size for f in fields)
    lost = [f"standard error of a nodal value {', '.join(each)}", f"{out} of {of} nodal values left out ({100.0 * out / of:.1f} %)"]
    return "; ".join(parts + lost)
