"""Virtual image correlation of the front face: irregular points, noise, lost points, rigid-body motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.observe.face import FaceGrid, displacement_at, locate
from thermofit.study.virtual import VirtualDic
from thermofit.virtual.setup import RigidMotion, VirtualFields, stream

_PATCH_SHARE = 0.05
"""Share of the stages in which a whole patch is lost (a reflection, a flake of paint)."""
_EDGE = 1.0
"""mm to the edge of the specimen that a correlation facet needs."""


@dataclass(frozen=True)
class DicStages:
    """What the DIC system measures: `reference` (n_s, 3) mm, `displacement` (n_t, n_s, 3) mm, `lost` (n_t, n_s)."""

    reference: np.ndarray
    displacement: np.ndarray
    lost: np.ndarray


def point_cloud(settings: VirtualDic, half_width: float, half_height: float, rng: np.random.Generator) -> np.ndarray:
    """Irregular points (n_s, 2) mm over the measured area, about `spacing` apart, to the 1e-4 mm of the file."""
    wide = min(settings.half_width, half_width - _EDGE)
    high = min(settings.half_height, half_height - _EDGE)
    if wide < settings.spacing or high < settings.spacing:
        raise StudyError(
            f"simulate.dic: a spacing of {settings.spacing:g} mm leaves no grid of points on {2 * wide:.1f} x {2 * high:.1f} mm; "
            "make it smaller"
        )
    # The outermost points keep half a jitter width inside the area.
    jitter = 0.15 * settings.spacing
    x = np.linspace(-wide + jitter, wide - jitter, round(2.0 * wide / settings.spacing))
    y = np.linspace(-high + jitter, high - jitter, round(2.0 * high / settings.spacing))
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.round(points + rng.uniform(-jitter, jitter, points.shape), 4)


def _lost(points: np.ndarray, n_stages: int, settings: VirtualDic, rng: np.random.Generator) -> np.ndarray:
    """Mask (n_t, n_s) of points that could not be evaluated: single ones at random, in a few stages a whole patch."""
    lost = np.asarray(rng.uniform(size=(n_stages, len(points))) < settings.lost_fraction)
    if settings.lost_fraction > 0.0:
        for stage in rng.choice(n_stages, max(1, round(_PATCH_SHARE * n_stages)), replace=False):
            centre = points[rng.integers(len(points))]
            lost[stage] |= np.hypot(*(points - centre).T) < rng.uniform(1.2, 2.5) * settings.spacing
    return lost


def measure_dic(fields: VirtualFields, grid: FaceGrid, motion: RigidMotion, settings: VirtualDic, seed: int) -> DicStages:
    """Displacements relative to the unloaded specimen of stage 0, with rigid-body motion and noise.

    x = R (X + u) + d at the front face z = +t/2; displacement x - X + noise. The displacement of stage 0 (thermal strain
    against the stress-free temperature) belongs to the reference image and is taken off.
    """
    rng = stream(seed, "dic.points")
    points = point_cloud(settings, 0.5 * fields.specimen.gauge_width, 0.5 * fields.specimen.parallel_length, rng)
    height = np.round(0.5 * fields.specimen.thickness + settings.noise_in_plane * rng.standard_normal(len(points)), 4)
    reference = np.column_stack([points, height])
    place = locate(grid, points)
    noise = stream(seed, "dic.noise")
    sigma = np.array([settings.noise_in_plane, settings.noise_in_plane, settings.noise_out_of_plane])
    lost = _lost(points, len(fields.dic_time), settings, stream(seed, "dic.lost"))
    measured = np.empty((len(fields.dic_time), len(points), 3))
    first = fields.dic_u[0] if fields.load.force[0] == 0.0 and fields.dic_time[0] == fields.load.time[0] else 0.0 * fields.dic_u[0]
    for k, u in enumerate(fields.dic_u):
        local = displacement_at(place, (u - first)[grid.order])
        position = (reference + local) @ motion.rotation[k].T + motion.shift[k]
        measured[k] = position - reference + sigma * noise.standard_normal(reference.shape)
    return DicStages(reference, measured, lost)


def write_dic(folder: Path, time: np.ndarray, stages: DicStages) -> None:
    """One file `stage_NNNN.csv` per stage; ids count from 1, lost points are missing."""
    folder.mkdir()
    row = "%d,%.4f,%.4f,%.4f,%.5f,%.5f,%.5f"
    ids = np.arange(1, len(stages.reference) + 1)
    for k, t in enumerate(time):
        kept = ~stages.lost[k]
        table = np.column_stack([ids, stages.reference, stages.displacement[k]])[kept]
        lines = [f"# time_s: {t:.3f}", "id,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"]
        lines += [row % tuple(values) for values in table.tolist()]
        (folder / f"stage_{k:04d}.csv").write_text("\n".join(lines) + "\n", encoding="ascii")
