"""`calibrate-ir`: Algorithm 1, from hand-picked pixels to the coordinates of every pixel in mm, with a picture to check it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, Experiment, InfraredSequence, Landmarks
from thermofit.observe.camera import CameraPose, landmark_checks, make_pose, pixel_coordinates, pose_from_landmarks, pose_uncertainty
from thermofit.observe.camera_edges import EdgeRefinement, pixel_noise, refine_pose
from thermofit.observe.check_picture import draw_check_picture
from thermofit.observe.phases import find_phases
from thermofit.read.plausible import asked
from thermofit.read.raw import read_experiment
from thermofit.records.artefact import Dataset
from thermofit.records.each import each
from thermofit.records.staging import Made, Outcome, job, produce
from thermofit.study.study import Study

NAME = "calibrate-ir"
PICKING_ERROR = 0.15
"""Standard deviation in px of a landmark picked by hand."""


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record with the frames (K), their times and the coordinates of the pixels; check picture `<run_dir>/calibrate-ir.png`.

    DataError for landmarks that contradict each other, the frame or the declared side.
    """
    if study.experiments:
        return each(study, NAME, run, lambda one: (one.experiment / "ir").is_dir(), force=force)
    if not study.experiment.is_dir():
        raise DataError(_no_folder(study))
    task = job(study.run_dir, NAME, study.config_of("ir", "specimen"), {"experiment": study.experiment})
    return produce(task, lambda: _make(study), force=force)


def _no_folder(study: Study) -> str:
    mend = f"run `thermofit simulate {study.source.name}` first" if study.virtual else "correct the key 'experiment' of the study"
    return f"{study.experiment}: the raw folder does not exist; {mend}"


def _make(study: Study) -> Made:
    experiment = read_experiment(study.experiment, ("force", "ir"))
    if experiment.ir is None:
        raise DataError(
            f"{study.experiment}: experiment.yaml declares no infrared frames; add its ir section, or identify without temperatures"
        )
    landmarks = _landmarks(study, experiment)
    specimen, ir = study.specimen_of(experiment.specimen), experiment.ir
    remarks = asked(replace(experiment, specimen=specimen))
    if not 0 <= landmarks.frame < len(ir.time):
        raise DataError(f"ir.landmarks_frame: frame {landmarks.frame} does not exist, there are {len(ir.time)}; give a number from 0")
    pose = pose_from_landmarks(landmarks, ir.side, ir.frames.shape[1:])
    if study.ir.rotation_deg is not None:
        roll = np.deg2rad(study.ir.rotation_deg)
        pose = make_pose(pose.scale, pose.origin, np.array([-np.cos(roll), np.sin(roll)]), ir.side)
    checks = landmark_checks(landmarks, pose, specimen)
    doubt = pose_uncertainty(landmarks, PICKING_ERROR)
    refined = _refine(study, experiment, pose) if study.ir.refine else None
    used = pose if refined is None or refined.pose is None else refined.pose
    frame = ir.frames[landmarks.frame]
    picture = draw_check_picture(study.run_dir / f"{NAME}.png", frame, used, specimen, landmarks)
    summary: dict[str, Any] = {
        "verdict": _verdict(used, refined, checks.width_error),
        "pose": _pose_dict(used),
        "uncertainty": {"origin_px": doubt.origin.tolist(), "roll_deg": float(np.rad2deg(doubt.roll)), "scale_mm_per_px": doubt.scale},
        "checks": {"width_mm": checks.width_mm, "width_error": checks.width_error, "centre_offset_mm": checks.centre_offset_mm},
        "refinement": None if refined is None else _refinement_dict(refined),
        "netd_K": pixel_noise(np.asarray(frame, dtype=float)),
        "landmarks": {
            "frame": landmarks.frame,
            "length": landmarks.length.tolist(),
            "edges": np.vstack([landmarks.edge_left, landmarks.edge_right[None]]).tolist(),
            "circle": landmarks.circle.tolist(),
        },
        "picture": str(picture),
        "repairs": list(experiment.repairs),
        "remarks": list(remarks),
        "range_degC": [float(ir.frames.min()) - CELSIUS, float(ir.frames.max()) - CELSIUS],
    }
    return Made(_datasets(ir, used), summary)


def _landmarks(study: Study, experiment: Experiment) -> Landmarks:
    """Landmarks of the study, else of experiment.yaml."""
    override = study.ir.landmarks
    given = experiment.landmarks if override is None else override.of_frame(0)
    if given is None:
        raise DataError(
            f"{study.experiment}: neither experiment.yaml nor the study gives ir.landmarks; pick length, edge_left, edge_right and circle"
        )
    return given if study.ir.landmarks_frame is None else replace(given, frame=study.ir.landmarks_frame)


def _refine(study: Study, experiment: Experiment, pose: CameraPose) -> EdgeRefinement:
    """Edges of the mean of the frames before loading."""
    ir = experiment.ir
    if ir is None:
        raise DataError(f"{study.experiment}: no infrared frames")
    kinks = find_phases(experiment.force).kinks
    before = ir.time <= (kinks[0] if len(kinks) else ir.time[0])
    before[0] = True
    return refine_pose(pose, ir.frames[before].mean(axis=0, dtype=float), study.specimen_of(experiment.specimen))


def _datasets(ir: InfraredSequence, pose: CameraPose) -> dict[str, Dataset]:
    return {
        "frames": Dataset(ir.frames, "K", ("frame", "row", "column")),
        "time": Dataset(ir.time, "s", ("frame",)),
        "coordinates": Dataset(pixel_coordinates(pose, ir.frames.shape[1:]), "mm", ("row", "column", "axis")),
    }


def _pose_dict(pose: CameraPose) -> dict[str, Any]:
    return {
        "scale_mm_per_px": pose.scale,
        "origin_px": pose.origin.tolist(),
        "axis_x": pose.axis_x.tolist(),
        "axis_y": pose.axis_y.tolist(),
        "roll_deg": float(np.rad2deg(pose.roll)),
        "side": pose.side,
    }


def _refinement_dict(refined: EdgeRefinement) -> dict[str, Any]:
    return {
        "used": refined.pose is not None,
        "reason": refined.reason,
        "shift_px": refined.shift_px,
        "roll_change_deg": float(np.rad2deg(refined.roll_change)),
        "width_mm": None if not np.isfinite(refined.width_mm) else refined.width_mm,
        "contrast": refined.contrast,
    }


def _verdict(pose: CameraPose, refined: EdgeRefinement | None, width_error: float) -> str:
    how = "by the landmarks alone"
    if refined is not None:
        how = f"edges moved it by {refined.shift_px:+.2f} px" if refined.pose is not None else f"edges not used: {refined.reason}"
    return f"{pose.scale:.4f} mm/px, roll {np.rad2deg(pose.roll):+.2f} deg ({how}); width between the picked edges {width_error:+.1%} off"
