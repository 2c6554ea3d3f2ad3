"""Measured fields at material points: displacements by Algorithm 2, temperatures by Algorithm 3 (section 2.5 of the thesis).

Everything is linear in the measured values, so that the noise goes through the same weights: the standard deviation of a nodal
value is sigma_factor times that of one measured value, sigma_factor = sqrt(sum of squared weights), for independent noise.
Where there is no value the mask is False and value and sigma_factor are nan; nothing is extrapolated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence, Specimen
from thermofit.observe.camera import CameraPose
from thermofit.observe.triangles import GAP_FACTOR, Weights, point_spacing, triangle_weights


@dataclass(frozen=True)
class DisplacementCounts:
    """`points_lost` (n_t,) per stage; `nodes_outside` the field or in a hole at all stages; node-stages that were `retriangulated`
    because a point was lost; `times_outside` the record; node-times `masked` in the end (all causes).
    """

    points_lost: np.ndarray
    nodes_outside: int
    retriangulated: int
    times_outside: int
    masked: int


@dataclass(frozen=True)
class NodalDisplacement:
    """`time` s (n_t,), `value` mm (n_t, m, 3), `sigma_factor` (n_t, m), `mask` (n_t, m), `counts`."""

    time: np.ndarray
    value: np.ndarray
    sigma_factor: np.ndarray
    mask: np.ndarray
    counts: DisplacementCounts


@dataclass(frozen=True)
class TemperatureCounts:
    """`nodes_at_edge` left out by the caller's choice; `times_outside` the record of frames. Of the other node-times: without a
    measured position (`no_position`), `outside_image`, on a `dead_pixel`; node-times `masked` in the end (all causes).
    """

    nodes_at_edge: int
    times_outside: int
    no_position: int
    outside_image: int
    dead_pixel: int
    masked: int


@dataclass(frozen=True)
class NodalTemperature:
    """`time` s (n_t,), `value` K (n_t, m), `sigma_factor` (n_t, m), `mask` (n_t, m), `counts`."""

    time: np.ndarray
    value: np.ndarray
    sigma_factor: np.ndarray
    mask: np.ndarray
    counts: TemperatureCounts


@dataclass(frozen=True)
class PixelMap:
    """Pixel (row, col) of a place (x, y) mm in space: `matrix` (2, 2) px/mm times (x, y) plus `offset` (2,) px."""

    matrix: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class TimeWeights:
    """Value at a time = (1 - share) * value[left] + share * value[right]; all (k,). `inside` is False beyond the ends of the record."""

    left: np.ndarray
    right: np.ndarray
    share: np.ndarray
    inside: np.ndarray

    def of(self, some: slice) -> TimeWeights:
        """Those of some of the times."""
        return TimeWeights(self.left[some], self.right[some], self.share[some], self.inside[some])


def pixel_map(pose: CameraPose) -> PixelMap:
    """The affine map of a camera's pose (Algorithm 1)."""
    return PixelMap(np.stack([pose.axis_x, pose.axis_y], axis=1) / pose.scale, np.asarray(pose.origin, dtype=float))


def edge_distance(specimen: Specimen, xy: np.ndarray) -> np.ndarray:
    """Distance in mm (m,) of points (m, 2) mm from the long edges of the unloaded dogbone, negative outside.

    w/2 - |x| in the gauge, distance to the arc in the shoulders, and the grip's half width minus |x| beyond.
    """
    x, y = np.abs(np.asarray(xy, dtype=float)).T
    radius, half = specimen.shoulder_radius, 0.5 * specimen.gauge_width
    beyond = np.maximum(y - 0.5 * specimen.parallel_length, 0.0)
    arc = np.hypot(half + radius - x, beyond) - radius
    return np.minimum(np.where(beyond > 0.0, arc, half - x), 0.5 * specimen.grip_width - x)


def interpolate_displacements(dic: DicField, targets: np.ndarray, max_distance: float | None = None) -> NodalDisplacement:
    """Displacement at material points `targets` (m, 2) mm (reference configuration) at the stages of the DIC field. Algorithm 2.

    Triangles are those of all points that were ever measured. A target of which a point is lost at a stage gets a triangle
    of the points that are there; all others keep theirs. A point counts as measured where u_x and u_y are.
    `max_distance` mm: see `triangle_weights`. DataError where no target lies in the field.
    """
    points, u = dic.reference[:, :2], dic.displacement
    present = np.isfinite(u[:, :, :2]).all(axis=2)
    ever = present.any(axis=0)
    longest = GAP_FACTOR * point_spacing(points[ever]) if max_distance is None else max_distance
    base = triangle_weights(points, targets, ever, longest)
    if not base.inside.any():
        raise DataError(_nothing_inside(points[ever], targets))
    value = np.full((len(u), len(base.inside), 3), np.nan)
    factor = np.full(value.shape[:2], np.nan)
    retriangulated = 0
    for stage, (weights, changed) in enumerate(_stage_weights(points, targets, present, base, longest)):
        ok = weights.inside
        value[stage, ok] = np.einsum("mk,mkj->mj", weights.weight[ok], u[stage][weights.index[ok]])
        factor[stage, ok] = np.linalg.norm(weights.weight[ok], axis=1)
        retriangulated += changed
    mask = np.isfinite(factor)
    counts = DisplacementCounts(
        points_lost=(ever & ~present).sum(axis=1),
        nodes_outside=int((~base.inside).sum()),
        retriangulated=retriangulated,
        times_outside=0,
        masked=int((~mask).sum()),
    )
    return NodalDisplacement(np.asarray(dic.time, dtype=float), value, factor, mask, counts)


def _stage_weights(
    points: np.ndarray, targets: np.ndarray, present: np.ndarray, base: Weights, longest: float
) -> Iterator[tuple[Weights, int]]:
    """Weights of every stage and the number of targets whose triangle had to change; equal sets of points are done once."""
    known: dict[bytes, tuple[Weights, int]] = {}
    for here in present:
        key = np.packbits(here).tobytes()
        if key not in known:
            hit = np.flatnonzero(base.inside & ~here[base.index].all(axis=1))
            known[key] = (_repaired(base, hit, triangle_weights(points, targets[hit], here, longest)) if len(hit) else base, len(hit))
        yield known[key]


def _repaired(base: Weights, hit: np.ndarray, new: Weights) -> Weights:
    index, weight, inside = base.index.copy(), base.weight.copy(), base.inside.copy()
    index[hit], weight[hit], inside[hit] = new.index, new.weight, new.inside
    return Weights(index, weight, inside)


def _nothing_inside(points: np.ndarray, targets: np.ndarray) -> str:
    if len(points) < 3:
        return f"dic: {len(points)} points are measured in at least one stage, at least 3 are needed; check the DIC export"
    low, high = points.min(axis=0), points.max(axis=0)
    return (
        f"dic: none of the {len(targets)} nodes lies in a triangle of measured points; the field covers x {low[0]:g} to {high[0]:g} mm and "
        f"y {low[1]:g} to {high[1]:g} mm, check the origin and axes of the DIC export and the evaluation window"
    )


def time_weights(source_time: np.ndarray, times: np.ndarray) -> TimeWeights:
    """Weights of linear interpolation between the two neighbours in `source_time` (n,) s, increasing, at `times` (k,) s."""
    source_time, times = np.asarray(source_time, dtype=float), np.asarray(times, dtype=float)
    last = len(source_time) - 1
    left = np.clip(np.searchsorted(source_time, times, side="right") - 1, 0, max(last - 1, 0))
    right = np.minimum(left + 1, last)
    span = source_time[right] - source_time[left]
    share = np.where(span > 0.0, (times - source_time[left]) / np.where(span > 0.0, span, 1.0), 0.0)
    inside = (times >= source_time[0]) & (times <= source_time[-1])
    return TimeWeights(left, right, np.clip(share, 0.0, 1.0), inside)


def _mix(left: np.ndarray, right: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(1 - share) left + share right, where a neighbour of weight zero is not looked at (it may be missing)."""
    return np.where(share == 0.0, left, np.where(share == 1.0, right, (1.0 - share) * left + share * right))


def displacements_at(nodal: NodalDisplacement, times: np.ndarray) -> NodalDisplacement:
    """Displacements at other `times` (k,) s, linear between the two neighbouring stages and never beyond the ends (section 2.5.3).

    Both neighbours must be measured, except at the time of a stage itself.
    """
    w = time_weights(nodal.time, times)
    share = w.share[:, None]
    mask = (nodal.mask[w.left] | (share == 1.0)) & (nodal.mask[w.right] | (share == 0.0)) & w.inside[:, None]
    value = _mix(nodal.value[w.left], nodal.value[w.right], share[:, :, None])
    factor = np.sqrt(_mix_squares(nodal.sigma_factor[w.left], nodal.sigma_factor[w.right], share))
    value[~mask], factor[~mask] = np.nan, np.nan
    old = nodal.counts
    counts = DisplacementCounts(old.points_lost, old.nodes_outside, old.retriangulated, int((~w.inside).sum()), int((~mask).sum()))
    return NodalDisplacement(np.asarray(times, dtype=float), value, factor, mask, counts)


def _mix_squares(left: np.ndarray, right: np.ndarray, share: np.ndarray) -> np.ndarray:
    return np.where(share == 0.0, left**2, np.where(share == 1.0, right**2, ((1.0 - share) * left) ** 2 + (share * right) ** 2))


def interpolate_temperatures(
    infrared: InfraredSequence, place: PixelMap, targets: np.ndarray, displacement: NodalDisplacement, usable: np.ndarray | None = None
) -> NodalTemperature:
    """Temperature K of material points `targets` (m, 2) mm at the times of `displacement`, at their CURRENT position X + u. Algorithm 3.

    `displacement` belongs to the same targets (see `displacements_at`). The frames are interpolated in time at fixed pixels,
    then in space, linear in the half pixel cell that contains the point. `usable` (m,) False leaves a node out, for instance
    where `edge_distance` is below the blur of the camera. DataError where no node-time has a temperature.
    """
    m = len(targets)
    if displacement.value.shape[1] != m:
        raise ValueError(f"displacement has {displacement.value.shape[1]} nodes, targets {m}: they must be the same nodes")
    wanted = np.ones(m, dtype=bool) if usable is None else np.asarray(usable, dtype=bool)
    w = time_weights(infrared.time, displacement.time)
    value, factor = np.full((len(w.left), m), np.nan), np.full((len(w.left), m), np.nan)
    no_position = outside = dead = 0
    for k in np.flatnonzero(w.inside).tolist():
        ready = np.flatnonzero(displacement.mask[k] & wanted)
        pixel = (targets[ready] + displacement.value[k, ready, :2]) @ place.matrix.T + place.offset
        seen = _in_image(pixel, infrared.frames.shape[1:])
        cell = cell_weights(pixel[seen], (infrared.frames.shape[1], infrared.frames.shape[2]))
        theta, noise = _frame_values(infrared.frames, w, k, cell)
        good = np.isfinite(theta)
        value[k, ready[seen][good]], factor[k, ready[seen][good]] = theta[good], noise[good]
        no_position += int(wanted.sum()) - len(ready)
        outside += int((~seen).sum())
        dead += int((~good).sum())
    mask = np.isfinite(value)
    counts = TemperatureCounts(int((~wanted).sum()), int((~w.inside).sum()), no_position, outside, dead, int((~mask).sum()))
    if not mask.any():
        raise DataError(
            f"ir: no node has a temperature at any of the {len(w.left)} times ({counts.nodes_at_edge} of {m} nodes left out at the edge, "
            f"{counts.times_outside} times outside the record, {no_position} node-times without position, {outside} outside the image, "
            f"{dead} on dead pixels); check the landmarks, the evaluation window and the times"
        )
    return NodalTemperature(displacement.time, value, factor, mask, counts)


def _in_image(pixel: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """True (m,) where a pixel position lies between pixel centres; nan is not in the image."""
    return np.asarray(((pixel >= 0.0) & (pixel <= np.array(shape) - 1.0)).all(axis=1))


def cell_weights(pixel: np.ndarray, shape: tuple[int, int]) -> Weights:
    """Weights at positions (m, 2) (row, col) within an image of that shape; `index` counts pixels row by row.

    The cell of four pixel centres is cut into two right triangles, which can never be degenerate.
    """
    if min(shape) < 2:
        raise DataError(f"ir: frames of {shape[0]} x {shape[1]} pixels found, at least 2 x 2 are needed; check the export")
    corner = np.clip(np.floor(pixel).astype(np.intp), 0, np.array(shape) - 2)
    r, c = (pixel - corner).T
    first = corner[:, 0] * shape[1] + corner[:, 1]
    below, right, opposite = first + shape[1], first + 1, first + shape[1] + 1
    far = r + c > 1.0
    index = np.stack([np.where(far, opposite, first), below, right], axis=1)
    weight = np.stack([np.abs(r + c - 1.0), np.where(far, 1.0 - c, r), np.where(far, 1.0 - r, c)], axis=1)
    return Weights(index, weight, np.ones(len(pixel), dtype=bool))


def _frame_values(frames: np.ndarray, w: TimeWeights, k: int, cell: Weights) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures and noise factors (m,) in the frame interpolated to time k; only the pixels that are touched are read."""
    share = w.share[k]
    left, right = (np.asarray(frames[n]).ravel()[cell.index].astype(float) for n in (w.left[k], w.right[k]))
    theta = np.einsum("mk,mk->m", cell.weight, _mix(left, right, share))
    return theta, np.linalg.norm(cell.weight, axis=1) * np.hypot(1.0 - share, share)
