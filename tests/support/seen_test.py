"""A test under cameras that is made up in memory: a strip that is pulled, drifts sideways and gets warm; and its raw folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from scipy.special import ndtr

from thermofit.core.experiment import CELSIUS, DicField, ForceRecord, InfraredSequence, Landmarks, MeasuredTest, Specimen
from thermofit.observe.camera import CameraPose, make_pose, pixel_coordinates, specimen_to_pixel

SPECIMEN = Specimen(20.0, 1.5, 80.0, 20.0, 30.0, 120.0, 10.0)
POINTS = np.stack([g.ravel() for g in np.meshgrid(np.linspace(-9, 9, 7), np.linspace(-35, 35, 25))], axis=1)
SHAPE = (240, 90)
"""Rows and columns of a frame; at 0.4 mm/px it sees 96 mm, hence the shoulders too."""
NETD = 0.025


def pulled(modulus: float, limit: float, noise: float = 2e-3, rate: float = 6e-4, drift: float = 0.1) -> MeasuredTest:
    """A test of a metal that hardens by a thirtieth of its modulus above `limit` MPa, up to 3 % of strain at `rate` 1/s, with a rigid
    motion and a drift sideways in mm."""
    strain = np.r_[np.linspace(0.0, 0.03, 34), np.full(7, 0.03)]
    time = np.linspace(0.0, 0.03 / rate * 40.0 / 33.0, 41)
    yielded = limit / modulus
    stress = np.where(strain < yielded, modulus * strain, limit + modulus / 30.0 * (strain - yielded))
    moved = np.zeros((len(time), len(POINTS), 3))
    moved[:, :, 0] = drift * np.sin(3.0 * time[:, None] / time[-1]) - 0.4 * strain[:, None] * POINTS[:, 0]
    moved[:, :, 1] = strain[:, None] * POINTS[:, 1] + 0.4 * time[:, None] * rate / 6e-4
    moved += noise * np.random.default_rng(1).normal(size=moved.shape)
    moved[3, 5] = np.nan
    place = np.column_stack([POINTS, np.full(len(POINTS), 0.75)])
    dic = DicField(time, np.arange(len(POINTS)), place, moved)
    area = SPECIMEN.gauge_width * SPECIMEN.thickness
    return MeasuredTest(Path("raw"), SPECIMEN, 296.0, 296.0, ForceRecord(time, area * stress), dic, None, None)


def pose_at(side: str = "back", roll_deg: float = 1.1, scale: float = 0.4) -> CameraPose:
    """A camera slightly rolled, with the centre of the specimen off the middle of the frame."""
    roll = np.deg2rad(roll_deg)
    return make_pose(scale, np.array([121.0, 44.3]), np.array([-np.cos(roll), np.sin(roll)]), side)


def frame_of(
    pose: CameraPose, specimen: Specimen, across: float = 0.0, warm: float = 2.0, seed: int = 0, shape: tuple[int, int] = SHAPE
) -> np.ndarray:
    """Frame (n_row, n_col) K of the unloaded outline, moved by `across` mm along x and `warm` K above the background; blur and noise."""
    place = pixel_coordinates(pose, shape)
    beyond = np.clip(np.abs(place[..., 1]) - 0.5 * specimen.parallel_length, 0.0, specimen.shoulder_radius)
    half = 0.5 * specimen.gauge_width + specimen.shoulder_radius - np.sqrt(specimen.shoulder_radius**2 - beyond**2)
    half = np.minimum(half, 0.5 * specimen.grip_width)
    share = ndtr((half - np.abs(place[..., 0] - across)) / (0.8 * pose.scale))
    return 296.0 + warm * share + NETD * np.random.default_rng(seed).standard_normal(shape)


def landmarks_of(pose: CameraPose, specimen: Specimen) -> Landmarks:
    """What a careful hand picks in the first frame: left and right as seen in the image."""
    left, half = (1.0 if pose.side == "back" else -1.0), 0.5 * specimen.gauge_width
    px = {
        "length": [(0.0, -30.0), (0.0, 30.0)],
        "edge_left": [(left * half, -30.0), (left * half, 30.0)],
        "edge_right": [(-left * half, 3.0)],
        "circle": [(6.0, 0.0), (-3.0, 5.0), (-3.0, -5.2)],
    }
    found = {key: specimen_to_pixel(pose, np.array(xy)) for key, xy in px.items()}
    ring = specimen_to_pixel(pose, 6.0 * np.array([[np.cos(a), np.sin(a)] for a in (0.3, 2.4, 4.4)]))
    return Landmarks(0, found["length"], 60.0, found["edge_left"], found["edge_right"][0], ring)


def watched(experiment: MeasuredTest, side: str = "back", rise: float = 3.0) -> MeasuredTest:
    """The same test with an infrared camera on that side, which sees the specimen drift and get warmer by `rise` K."""
    assert experiment.dic is not None
    pose, time = pose_at(side), experiment.dic.time[::2] + 0.01 * experiment.dic.time[1]
    time = time[:-1]
    drift = np.interp(time, experiment.dic.time, np.nanmean(experiment.dic.displacement[:, :, 0], axis=1))
    warm = 0.5 + rise * time / time[-1]
    frames = np.stack([frame_of(pose, experiment.specimen, d, w, seed=k) for k, (d, w) in enumerate(zip(drift, warm, strict=True))])
    infrared = InfraredSequence(time, frames.astype(np.float32), side)
    return replace(experiment, ir=infrared, landmarks=landmarks_of(pose, experiment.specimen))


def write_raw(folder: Path, e: MeasuredTest, **more: object) -> None:
    """The raw folder of a test; `more` are further keys of experiment.yaml."""
    assert e.dic is not None
    (folder / "dic").mkdir(parents=True)
    own = {"gripped_length": "gripped_length_each_end"}
    lengths = {f"{own.get(key, key)}_mm": value for key, value in vars(e.specimen).items()}
    temperatures = {"theta_air_degC": e.theta_air - CELSIUS, "theta_clamp_degC": e.theta_clamp - CELSIUS}
    tree: dict[str, object] = {"specimen": lengths, "temperatures": temperatures, "force": {"file": "force.csv"}, "dic": {"folder": "dic"}}
    if e.ir is not None:
        tree["ir"] = {"folder": "ir", "unit": "degC", "side": e.ir.side}
        (folder / "ir").mkdir()
        for n, (time, frame) in enumerate(zip(e.ir.time, e.ir.frames, strict=True)):
            path = folder / "ir" / f"frame_{n:04d}.csv"
            np.savetxt(path, frame - CELSIUS, delimiter=",", header=f"# time_s: {time:g}", comments="", fmt="%.3f")
    (folder / "experiment.yaml").write_text(yaml.safe_dump({**tree, **more}), encoding="utf-8")
    force = np.stack([e.force.time, e.force.force], axis=1)
    np.savetxt(folder / "force.csv", force, delimiter=",", header="time_s,force_N", comments="", fmt="%.9g")
    for n, (time, moved) in enumerate(zip(e.dic.time, e.dic.displacement, strict=True)):
        rows = np.column_stack([e.dic.point_id, e.dic.reference, moved])
        head = f"# time_s: {time:g}\nid,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"
        known = np.isfinite(rows).all(axis=1)
        np.savetxt(folder / "dic" / f"stage_{n:04d}.csv", rows[known], delimiter=",", header=head, comments="", fmt="%.9g")
