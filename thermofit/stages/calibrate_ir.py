"""`calibrate-ir`: Algorithm 1, from landmarks, found or picked, to the coordinates of every pixel in mm, with a picture to check it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, InfraredSequence, Landmarks, MeasuredTest, Specimen
from thermofit.observe.camera import CameraPose, landmark_checks, make_pose, pixel_coordinates, pose_from_landmarks, pose_uncertainty
from thermofit.observe.camera_edges import EdgeRefinement, pixel_noise, refine_pose
from thermofit.observe.check_picture import draw_check_picture
from thermofit.observe.landmark_search import Proposal, disagreement, landmarks_from, propose
from thermofit.observe.phases import find_phases
from thermofit.observe.picking import Clicks
from thermofit.observe.picking import pick as pick_points
from thermofit.read.plausible import asked
from thermofit.read.raw import read_experiment
from thermofit.records.artefact import Dataset
from thermofit.records.staging import Made, Outcome, each, job, produce
from thermofit.study.study import Study

NAME = "calibrate-ir"
PICKING_ERROR = 0.15
"""Standard deviation in px of a landmark picked by hand."""
LARGEST_DISAGREEMENT = 2.0
"""px between given landmarks and those found in the frames, above which the user is told."""


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
    specimen, ir = study.specimen_of(experiment.specimen), experiment.ir
    remarks = list(asked(replace(experiment, specimen=specimen)))
    rest = _at_rest(experiment)
    found = propose(rest, specimen, ir.side)
    given = _given(study, experiment)
    landmarks = _proposed(study, found, specimen, ir) if given is None else given
    if not 0 <= landmarks.frame < len(ir.time):
        raise DataError(f"ir.landmarks_frame: frame {landmarks.frame} does not exist, there are {len(ir.time)}; give a number from 0")
    pose = pose_from_landmarks(landmarks, ir.side, ir.frames.shape[1:])
    if study.ir.rotation_deg is not None:
        roll = np.deg2rad(study.ir.rotation_deg)
        pose = make_pose(pose.scale, pose.origin, np.array([-np.cos(roll), np.sin(roll)]), ir.side)
    checks = landmark_checks(landmarks, pose, specimen)
    if given is not None:
        remarks += _disagreement(pose, found, specimen)
    doubt = pose_uncertainty(landmarks, PICKING_ERROR)
    refined = refine_pose(pose, rest, specimen) if study.ir.refine else None
    used = pose if refined is None or refined.pose is None else refined.pose
    frame = ir.frames[landmarks.frame]
    picture = draw_check_picture(study.run_dir / f"{NAME}.png", frame, used, specimen, landmarks)
    summary: dict[str, Any] = {
        "verdict": _verdict(used, refined, checks.width_error, "landmarks found in the frames" if given is None else ""),
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
        "remarks": remarks,
        "landmarks_from": "the frames" if given is None else "hand",
        "proposal": _proposal_dict(found),
        "range_degC": [float(ir.frames.min()) - CELSIUS, float(ir.frames.max()) - CELSIUS],
    }
    return Made(_datasets(ir, used), summary)


def _given(study: Study, experiment: MeasuredTest) -> Landmarks | None:
    """Landmarks of the study, else of experiment.yaml; None where neither has any."""
    override = study.ir.landmarks
    given = experiment.landmarks if override is None else override.of_frame(0)
    return given if given is None or study.ir.landmarks_frame is None else replace(given, frame=study.ir.landmarks_frame)


def _proposed(study: Study, found: Proposal, specimen: Specimen, ir: InfraredSequence) -> Landmarks:
    """Landmarks found in the frames before loading. DataError where these do not show enough."""
    if found.pose is None or not found.shoulders:
        seen = found.reason or "the edges are seen, but no shoulder, and nothing else tells where the middle is"
        raise DataError(
            f"{study.experiment}: neither experiment.yaml nor the study gives ir.landmarks, and the frames do not show them: {seen}; pick "
            f"length, edge_left, edge_right and circle, or run `thermofit {NAME} {study.source.name} --pick --length-mm MM`"
        )
    return landmarks_from(found.pose, specimen, study.ir.landmarks_frame or 0, (ir.frames.shape[1], ir.frames.shape[2]))


def _disagreement(given: CameraPose, found: Proposal, specimen: Specimen) -> list[str]:
    """What the user is told where the given landmarks are not where the frames show the specimen."""
    if found.pose is None:
        return []
    across, along = disagreement(given, found, specimen)
    off = [f"{value:.1f} px {word}" for value, word in ((across, "across"), (along, "along the axis")) if value > LARGEST_DISAGREEMENT]
    if not off:
        return []
    what = "edges and shoulders" if found.shoulders else "edges"
    return [f"the given landmarks lie {' and '.join(off)} from the {what} found in the frames; the given ones are used: look at {NAME}.png"]


def _proposal_dict(found: Proposal) -> dict[str, Any]:
    pose = None if found.pose is None else _pose_dict(found.pose)
    return {"pose": pose, "shoulders": found.shoulders, "scatter_px": found.scatter, "reason": found.reason}


def pick(study: Study, length_mm: float, clicks: Clicks | None = None) -> dict[str, Any]:
    """Section `ir.landmarks` of a study from points that are clicked in the frame of the landmarks. DataError without frames."""
    experiment = read_experiment(study.experiment, ("force", "ir"))
    if experiment.ir is None:
        raise DataError(f"{study.experiment}: experiment.yaml declares no infrared frames; there is nothing to pick in")
    number = min(study.ir.landmarks_frame or 0, len(experiment.ir.frames) - 1)
    return pick_points(np.asarray(experiment.ir.frames[number], dtype=float), length_mm, clicks)


def _at_rest(experiment: MeasuredTest) -> np.ndarray:
    """Mean (n_row, n_col) K of the frames before loading."""
    ir = experiment.ir
    assert ir is not None
    kinks = find_phases(experiment.force).kinks
    before = ir.time <= (kinks[0] if len(kinks) else ir.time[0])
    before[0] = True
    return np.asarray(ir.frames[before].mean(axis=0, dtype=float))


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


def _verdict(pose: CameraPose, refined: EdgeRefinement | None, width_error: float, origin: str) -> str:
    how = "by the landmarks alone"
    if refined is not None:
        how = f"edges moved it by {refined.shift_px:+.2f} px" if refined.pose is not None else f"edges not used: {refined.reason}"
    width = f"; {origin}" if origin else f"; width between the picked edges {width_error:+.1%} off"
    return f"{pose.scale:.4f} mm/px, roll {np.rad2deg(pose.roll):+.2f} deg ({how}){width}"
