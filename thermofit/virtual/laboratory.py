"""Virtual experiment: the raw folder of a test that a finite-element run has produced, as a laboratory would hand it over.

The format is that of the raw experiment folder: `experiment.yaml`, `force.csv`, `dic/stage_NNNN.csv`, `ir/frame_NNNN.csv`.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.experiment import CELSIUS, Landmarks
from thermofit.core.files import remove_partial, temporary_beside
from thermofit.observe.face import face_grid
from thermofit.study.virtual import VirtualInstruments
from thermofit.virtual.dic import measure_dic, write_dic
from thermofit.virtual.infrared import camera_pose, measure_infrared, pick_landmarks, scene_of, write_infrared
from thermofit.virtual.setup import VirtualFields, rigid_motion, stream


@dataclass(frozen=True)
class RawSummary:
    """What was written: `counts` by name, and the `truth` of the instruments (plain numbers and lists, for a YAML file)."""

    counts: dict[str, int]
    truth: dict[str, Any]


def _check(fields: VirtualFields) -> None:
    """NaN and mismatched shapes are errors of the caller; found here, not in a reader days later."""
    n, d, f = len(fields.face), len(fields.dic_time), len(fields.ir_time)
    expected = {"face": (n, 2), "dic_u": (d, n, 3), "ir_u": (f, n, 3), "ir_theta": (f, n), "top": (len(fields.load.time),)}
    for name, shape in expected.items():
        array = getattr(fields, name)
        if array.shape != shape:
            raise ValueError(f"virtual experiment: {name} has the shape {array.shape}, expected {shape}")
        if not np.isfinite(array).all():
            raise NumericsError(f"virtual experiment: the simulated {name} holds values that are not finite; take smaller time steps")
    end = fields.load.time[-1]
    for name in ("dic_time", "ir_time"):
        time = getattr(fields, name)
        if np.diff(time).min(initial=1.0) <= 0.0 or time[0] < fields.load.time[0] or time[-1] > end:
            raise ValueError(f"virtual experiment: {name} must increase inside the force history, which ends at {end:g} s")


def _write_force(path: Path, fields: VirtualFields, settings: VirtualInstruments, seed: int) -> int:
    """`force.csv` at the rate of the load cell; crosshead = u_top + compliance F + slip, with noise. Returns the rows."""
    load, force = fields.load, settings.force
    time = np.arange(int(np.floor(load.time[-1] * force.rate + 1e-6)) + 1) / force.rate
    true = np.interp(time, load.time, load.force)
    crosshead = np.interp(time, load.time, fields.top - fields.top[0] + settings.machine.compliance * load.force + load.slip)
    measured = true + force.noise * stream(seed, "force").standard_normal(len(time))
    position = crosshead + force.crosshead_noise * stream(seed, "crosshead").standard_normal(len(time))
    table = np.column_stack([time, measured, position])
    lines = ["time_s,force_N,crosshead_mm"] + [f"{row[0]:.3f},{row[1]:.2f},{row[2]:.4f}" for row in table.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return len(time)


def _landmark_keys(landmarks: Landmarks) -> dict[str, Any]:
    """Landmarks with the keys of the raw format."""

    def points(array: np.ndarray) -> dict[str, list[float]]:
        return {f"p{i + 1}": [float(v) for v in row] for i, row in enumerate(np.atleast_2d(array))}

    return {
        "length": {**points(landmarks.length), "length_mm": landmarks.length_mm},
        "edge_left": points(landmarks.edge_left),
        "edge_right": points(landmarks.edge_right),
        "circle": {**points(landmarks.circle), "note": "three points on a circle concentric with the specimen centre"},
        "note": "left and right as seen in the image",
    }


def _instrument_keys(fields: VirtualFields, settings: VirtualInstruments, landmarks: Landmarks) -> dict[str, Any]:
    """The entries `force`, `dic` and `ir` of `experiment.yaml`."""
    ir, dic = settings.ir, settings.dic
    return {
        "force": {"file": "force.csv", "rate_Hz": settings.force.rate, "load_cell": "100 kN"},
        "dic": {
            "folder": "dic",
            "stages": len(fields.dic_time),
            "side": "front (z = +t/2)",
            "coordinates": "origin at the specimen centre, x across the width, y along the load (positive towards the moving crosshead), "
            "z outwards; reference coordinates of the unloaded specimen",
            "nominal_noise_mm": {"in_plane": dic.noise_in_plane, "out_of_plane": dic.noise_out_of_plane},
        },
        "ir": {
            "folder": "ir",
            "frames": len(fields.ir_time),
            "unit": "degC",
            "side": "back (z = -t/2): left and right are interchanged with respect to the DIC view",
            "pixel_size": f"about {ir.pixel_size:g} mm",
            "image_shape": [int(v) for v in ir.image_shape],
            "netd_K": ir.netd,
            "absolute_accuracy_K": 1.0,
            "pixel_convention": "(row, col), zero-based, integer values are pixel centres, row 0 is the top line of the image; "
            "the moving crosshead is at the top",
            "landmarks_frame": 0,
            "landmarks": _landmark_keys(landmarks),
        },
    }


def _description(fields: VirtualFields, settings: VirtualInstruments, landmarks: Landmarks, read: np.ndarray) -> dict[str, Any]:
    """The content of `experiment.yaml`; `read` (2,) K are the thermocouple readings of air and jaws."""
    s = fields.specimen
    return {
        "specimen": {
            "material": "virtual sheet metal",
            "shape": "dogbone tensile specimen (DIN 50125 type H)",
            "gauge_width_mm": s.gauge_width,
            "thickness_mm": s.thickness,
            "parallel_length_mm": s.parallel_length,
            "shoulder_radius_mm": s.shoulder_radius,
            "grip_width_mm": s.grip_width,
            "total_length_mm": s.total_length,
            "gripped_length_each_end_mm": s.gripped_length,
            "loading_direction": "y",
            "note": f"The jaws hold the last {s.gripped_length:g} mm at each end (faces, edges and end faces in contact with the jaws).",
        },
        "temperatures": {
            "theta_air_degC": float(np.round(read[0] - CELSIUS, 2)),
            "theta_clamp_degC": float(np.round(read[1] - CELSIUS, 2)),
            "sensor": f"thermocouples, read before the test, accuracy about {settings.thermocouple_error:g} K",
            "initial_state": "specimen was left in the closed jaws until the temperature field was steady",
        },
        "time": {
            "unit": "s",
            "zero": "trigger signal shared by testing machine, DIC and IR system",
            "note": "DIC stages and IR frames are taken at different times; see the first line of each file.",
        },
        **_instrument_keys(fields, settings, landmarks),
        "programme": list(fields.programme),
    }


def _write_all(folder: Path, fields: VirtualFields, settings: VirtualInstruments, seed: int) -> RawSummary:
    """Everything into an empty folder."""
    grid = face_grid(fields.face)
    pose = camera_pose(settings.ir, seed)
    landmarks = pick_landmarks(pose, fields.specimen, settings.ir, seed)
    read = np.array([fields.theta_air, fields.theta_clamp]) + settings.thermocouple_error * stream(seed, "thermocouple").standard_normal(2)
    motion_dic = rigid_motion(fields.load, settings.machine, seed, fields.dic_time)
    motion_ir = rigid_motion(fields.load, settings.machine, seed, fields.ir_time)
    rows = _write_force(folder / "force.csv", fields, settings, seed)
    stages = measure_dic(fields, grid, motion_dic, settings.dic, seed)
    write_dic(folder / "dic", fields.dic_time, stages)
    scene = scene_of(fields, grid, settings.ir, seed)
    write_infrared(folder / "ir", fields.ir_time, measure_infrared(fields, scene, motion_ir, seed))
    text = yaml.safe_dump(_description(fields, settings, landmarks, read), sort_keys=False, allow_unicode=False)
    (folder / "experiment.yaml").write_text(text, encoding="ascii")
    counts = {
        "force_rows": rows,
        "stages": len(fields.dic_time),
        "points": len(stages.reference),
        "lost_points": int(stages.lost.sum()),
        "frames": len(fields.ir_time),
        "pixels": int(np.prod(settings.ir.image_shape)),
    }
    truth = {
        "seed": seed,
        "camera": {"centre_px": list(map(float, pose.centre)), "pixel_size_mm": pose.pixel_size, "roll_deg": settings.ir.roll_deg},
        "ir_offset_K": settings.ir.offset,
        "thermocouple_error_K": [float(v) for v in read - [fields.theta_air, fields.theta_clamp]],
        "last_shift_mm": motion_dic.shift[-1].tolist(),
    }
    return RawSummary(counts, truth)


def write_raw(folder: Path, fields: VirtualFields, settings: VirtualInstruments, seed: int) -> RawSummary:
    """Write the raw folder of a virtual experiment; the same seed gives the same bytes.

    Written to a temporary folder beside it and renamed, so that a killed run leaves nothing half made. A raw folder that
    is already there is replaced; any other folder is refused (StudyError). NumericsError where a field is not finite,
    ValueError where shapes or times do not fit together.
    """
    _check(fields)
    folder = Path(folder)
    if folder.exists() and not (folder / "experiment.yaml").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise StudyError(f"{folder}: is not a raw experiment folder and is left alone; choose another run_dir or move it away")
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_partial(folder.parent, folder.name)
    temporary = temporary_beside(folder)
    try:
        made = temporary / "new"
        made.mkdir(parents=True)
        summary = _write_all(made, fields, settings, seed)
        if folder.exists():
            os.replace(folder, temporary / "old")
        os.replace(made, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return summary
