"""Nodal values from all DIC points and all pixels: the mean over the patch of every node, in the material frame.

    z_i = 1/n_i sum over the points (pixels) p of patch i of T_p

This is the L2 projection onto functions that are constant in every patch. No point is in two patches: white noise sigma of the points gives
Var z_i = sigma^2 / n_i and no covariance. The prediction is averaged over the same points (`patches`), so that smoothing is no bias.
Points and pixels that are missing or out of line are simply not there; everything that is left out is counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from thermofit.body.mesh.mesh import Mesh
from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence
from thermofit.observe.fixed_pattern import Rest
from thermofit.observe.interpolation import PixelMap, TimeWeights, time_weights
from thermofit.observe.noise import robust_sigma
from thermofit.observe.observation_points import ObservationPoints, observation_points
from thermofit.observe.patches import MOMENTS, terms
from thermofit.observe.triangles import point_spacing

LEAST_PIXELS = 3
"""Pixels in a patch below which a node has no temperature."""
GAP = 1.5
"""A place farther than this many point spacings from any DIC point has no measured motion."""
OUT_OF_LINE = 6.0
"""Distance from the surface through its neighbours, in standard deviations, at which a DIC point is out of line."""
_MANY_OUT = 0.03
"""Share of points out of line at a stage above which they are signal, a neck for instance, and stay."""
_NEIGHBOURS = 16
_JUDGED = 0.75
"""Share of its neighbours that must be measured for a point to be judged."""
_FILLS, _JUDGEMENTS = 4, 5
_THIN = 0.125
"""Share of the range of distances to the next points that counts as near where points lie much farther apart than most do."""
_MOST_PLACES = 250_000
"""Places of the grid of a motion, or as many as there are points."""
_SAME_PLACE = 1e-6
"""mm; nodes that are nearer are one."""
_RASTER = 12
"""Raster cells along the shortest distance between two nodes."""
_LATTICE = 0.5
"""Distance between places whose motion is inverted, over the spacing of the DIC points; pixels lie straight in between."""
STILL, LEAST_STILL = 0.1, 2
"""Motion in pixels below which a specimen stands still, and frames at least in a rest that tells something of a camera."""
AT_ONCE = 1_000_000
"""Values of points at stages that are worked on together: this bounds the memory, and changes results by rounding alone."""
_ROUNDS, _CONVERGED = 60, 1e-5
"""Passes of the inverse motion, and its last change in mm."""


@dataclass(frozen=True)
class Projected:
    """`time` s (n_t,), `value` (n_t, m, n_c), `points` (n_t, m) in every mean of the `there` (n_t, m) that lie in the patch, `sigma_factor`
    (n_t, m) of a value over that of one point, `mask` (n_t, m), `moments` (n_t, m, 5) mm, mm^2 of the points about the node (`patches`),
    `counts` of what was used and left out."""

    time: np.ndarray
    value: np.ndarray
    points: np.ndarray
    there: np.ndarray
    sigma_factor: np.ndarray
    mask: np.ndarray
    moments: np.ndarray
    counts: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Patches:
    """Patches of the nodes xy (m, 2) mm that are compared, beside the other nodes of the face `others` (n, 2) mm, whose patches are not."""

    xy: np.ndarray
    others: np.ndarray

    def of(self, places: np.ndarray) -> np.ndarray:
        """Number (k,) of the patch that material places (k, 2) mm are in, -1 where they are in none."""
        every = np.concatenate([self.xy, self.others])
        _, nearest = cKDTree(every).query(places)
        limit = self.reach
        inside = ((places >= limit[0]) & (places <= limit[1])).all(axis=1)
        return np.where((nearest < len(self.xy)) & inside, nearest, -1)

    @property
    def spacing(self) -> float:
        """Median distance in mm of a node to the next one."""
        return point_spacing(np.concatenate([self.xy, self.others]))

    @property
    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (2,) mm of a box that holds all patches: no place off the face of the model, or farther from the compared
        nodes than one of their distances."""
        every = np.concatenate([self.xy, self.others])
        low, high = self.xy.min(axis=0), self.xy.max(axis=0)
        gap = np.array([float(np.diff(np.unique(np.round(every[:, k], 6))).max(initial=0.0)) for k in (0, 1)])
        return np.maximum(low - gap, every.min(axis=0)), np.minimum(high + gap, every.max(axis=0))

    def raster(self) -> Raster:
        """The same as a table, for many places."""
        step = self.spacing / _RASTER
        low, high = self.reach
        shape = np.ceil((high - low) / step).astype(int) + 1
        x, y = (low[k] + step * (np.arange(shape[k]) + 0.5) for k in (0, 1))
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return Raster(low, step, places, self.of(places).reshape(len(y), len(x)).astype(np.int32))

    def areas(self) -> np.ndarray:
        """Area (m,) of every patch, mm^2."""
        raster = self.raster()
        number = raster.label.ravel()
        return np.bincount(number[number >= 0], minlength=len(self.xy)) * raster.step**2


@dataclass(frozen=True)
class Raster:
    """Patch of every cell of a grid: corner `low` (2,) mm, `step` mm, centres `places` (n_y n_x, 2) mm, `label` (n_y, n_x), -1 for none."""

    low: np.ndarray
    step: float
    places: np.ndarray
    label: np.ndarray

    def at(self, places: np.ndarray) -> np.ndarray:
        """Label (k,) of places (k, 2) mm; -1 outside the grid."""
        column, row = ((places[:, k] - self.low[k]) / self.step for k in (0, 1))
        inside = (column >= 0.0) & (column < self.label.shape[1]) & (row >= 0.0) & (row < self.label.shape[0])
        out = np.full(len(places), -1, dtype=np.int32)
        out[inside] = self.label[row[inside].astype(np.intp), column[inside].astype(np.intp)]
        return out


def face_patches(mesh: Mesh, points: ObservationPoints) -> Patches:
    """Patches of the compared points among all nodes of the face of their mesh, on both sides of its symmetry plane."""
    every = observation_points(mesh.nodes, mesh.node_sets["face"], np.inf, np.inf).xy
    away, _ = cKDTree(points.xy).query(every)
    return Patches(points.xy, every[away > _SAME_PLACE])


def mixed(at: Callable[[np.ndarray], np.ndarray], w: TimeWeights) -> np.ndarray:
    """Values at other times, linear between the two neighbours; both must be there, but for one of weight zero. `at` gives the values
    (k, ...) of some stages (k,)."""
    left, right = at(w.left), at(w.right)
    share = w.share.reshape((-1,) + (1,) * (left.ndim - 1))
    return np.where(share == 0.0, left, np.where(share == 1.0, right, (1.0 - share) * left + share * right))


def _blocks(n: int, size: int) -> Iterator[slice]:
    """Runs of n stages of `size` values, of about AT_ONCE values each."""
    step = max(1, AT_ONCE // max(size, 1))
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))


def project_displacements(dic: DicField, patches: Patches, good: np.ndarray, times: np.ndarray | None = None) -> Projected:
    """Mean displacements of the patches at the stages of the DIC field, or at `times` s: linear between two stages at every point.

    `good` (n_t, n_s): the points that are measured and in line (`in_line`). DataError where no point is in a patch.
    """
    label = patches.of(dic.reference[:, :2])
    own = np.flatnonzero(label >= 0)
    if not len(own) or not np.isfinite(dic.displacement[:, own, :2]).any():
        low, high = dic.reference[:, :2].min(axis=0), dic.reference[:, :2].max(axis=0)
        raise DataError(
            f"dic: none of the {len(patches.xy)} nodes lies in the measured field, x {low[0]:g} to {high[0]:g} mm and y {low[1]:g} to "
            f"{high[1]:g} mm; check the origin and axes of the DIC export and the evaluation window"
        )
    measured = np.isfinite(dic.displacement[:, :, :2]).all(axis=2)
    w = time_weights(dic.time, dic.time if times is None else times)
    m, n_t = len(patches.xy), len(w.left)
    gather = csr_array(coo_array((np.ones(len(own)), (label[own], np.arange(len(own)))), shape=(m, len(own))))
    away = terms(dic.reference[own, :2] - patches.xy[label[own]])
    value, moments, number, used = np.full((n_t, m, 2), np.nan), np.zeros((n_t, m, MOMENTS)), np.zeros((n_t, m)), 0

    def at_stages(stages: np.ndarray) -> np.ndarray:
        """Displacements (k, n_own, 2) of the good points in the patches at some stages."""
        return np.where(good[stages][:, own, None], dic.displacement[stages][:, own, :2], np.nan)

    for block in _blocks(n_t, len(own)):
        part = w.of(block)
        u = mixed(at_stages, part)
        there = np.isfinite(u).all(axis=2) & part.inside[:, None]
        number[block] = (gather @ there.T.astype(float)).T
        some = number[block] > 0
        for k in range(2):
            total = (gather @ np.where(there, u[:, :, k], 0.0).T).T
            value[block, :, k][some] = total[some] / number[block][some]
        for k in range(MOMENTS):
            total = (gather @ np.where(there, away[:, k], 0.0).T).T
            moments[block, :, k][some] = total[some] / number[block][some]
        used += int(there.sum())
    some = number > 0
    ever = measured.any(axis=0)
    counts = {
        "points_lost": int((ever & ~measured).sum()),
        "points_out_of_line": int((measured & ~good).sum()),
        "points_in_window": len(own) * n_t,
        "points_used": used,
        "times_outside": int((~w.inside).sum()),
        "nodes_outside": int((np.bincount(label[own], minlength=m) == 0).sum()),
        "masked": int((~some).sum()),
    }
    factor = np.where(some, np.hypot(1.0 - w.share, w.share)[:, None] / np.sqrt(np.maximum(number, 1.0)), np.nan)
    whole = np.broadcast_to(np.bincount(label[own], minlength=m), number.shape)
    return Projected(np.asarray(dic.time if times is None else times, dtype=float), value, number, whole, factor, some, moments, counts)


def in_line(dic: DicField, sigma: np.ndarray) -> np.ndarray:
    """True (n_t, n_s) where a point is measured and lies on the quadratic through its neighbours, within OUT_OF_LINE standard deviations.

    A standard deviation is `sigma` (2,) mm, or the usual scatter of the stage where that is more. A point that is out of line, or lost, is
    replaced by the surface and all are judged again, so that the neighbours of a bad point come back. Where more than 3 % would go at a
    stage they are signal and stay; what has too few measured neighbours is not judged.
    """
    measured = np.isfinite(dic.displacement[:, :, :2]).all(axis=2)
    ever = np.flatnonzero(measured.any(axis=0))
    good = measured.copy()
    if len(ever) <= _NEIGHBOURS:
        return good
    surface = _surface(dic.reference[ever, :2])
    for block in _blocks(len(good), len(ever)):
        good[block, ever] = _in_line(dic.displacement[block, ever, :2], measured[block, ever], surface, sigma)
    return good


def _in_line(u: np.ndarray, here: np.ndarray, over: tuple[csr_array, np.ndarray, np.ndarray], sigma: np.ndarray) -> np.ndarray:
    """The same of displacements u (k, n, 2) that are measured `here` (k, n); `over` is the surface through the neighbours (`_surface`)."""
    surface, gain, near = over
    judged = here & (here[:, near].mean(axis=2) >= _JUDGED)
    line = here.copy()
    for _ in range(_JUDGEMENTS):
        out = np.zeros_like(here)
        for k in range(2):
            value = _filled(u[:, :, k], line, surface, near)
            residual = np.abs(u[:, :, k] - (surface @ value.T).T) / gain
            usual = np.array([robust_sigma(r[ok])[0] if ok.sum() > _NEIGHBOURS else np.inf for r, ok in zip(residual, judged, strict=True)])
            out |= judged & (residual > OUT_OF_LINE * np.maximum(np.nan_to_num(usual), sigma[k])[:, None])
        if np.array_equal(line, here & ~out):
            break
        line = here & ~out
    signal = (here & ~line).sum(axis=1) > _MANY_OUT * np.maximum(judged.sum(axis=1), 1)
    return np.where(signal[:, None], here, line)


def _surface(xy: np.ndarray) -> tuple[csr_array, np.ndarray, np.ndarray]:
    """Value (n, n) at every point of the quadratic through its neighbours, standard deviation (n,) of a point's distance from it over that
    of a value, and the neighbours (n, 16)."""
    n = len(xy)
    near = cKDTree(xy).query(xy, k=_NEIGHBOURS + 1)[1][:, 1:]
    weight = np.empty((n, _NEIGHBOURS))
    for block in _blocks(n, 6 * _NEIGHBOURS):
        away = xy[near[block]] - xy[block, None, :]
        size = np.sqrt((away**2).sum(axis=(1, 2)) / _NEIGHBOURS)[:, None, None]
        design = np.concatenate([np.ones((len(away), _NEIGHBOURS, 1)), terms(away / size)], axis=2)
        weight[block] = np.linalg.pinv(design)[:, 0]
    matrix = csr_array((weight.ravel(), (np.repeat(np.arange(n), _NEIGHBOURS), near.ravel())), shape=(n, n))
    return matrix, np.sqrt(1.0 + (weight**2).sum(axis=1)), near


def _filled(value: np.ndarray, good: np.ndarray, surface: csr_array, near: np.ndarray) -> np.ndarray:
    """Values (n_t, n) with those that are not good replaced by the surface through their neighbours, in a few passes from their mean."""
    known = np.where(good, value, 0.0)
    if good.all():
        return known
    number = good[:, near].sum(axis=2)
    usual = known.sum(axis=1) / np.maximum(good.sum(axis=1), 1)
    mean = np.where(number > 0, known[:, near].sum(axis=2) / np.maximum(number, 1), usual[:, None])
    out = np.where(good, value, mean)
    for _ in range(_FILLS):
        out = np.where(good, value, (surface @ out.T).T)
    return out


@dataclass(frozen=True)
class Motion:
    """Displacements u (n_t, n_y, n_x, 2) mm on a grid of material places: corner `low` (2,) mm, distance `step` mm."""

    low: np.ndarray
    step: float
    u: np.ndarray

    def at(self, n: int, places: np.ndarray) -> np.ndarray:
        """Displacement (k, 2) of material places (k, 2) mm at time n, bilinear; beyond the grid that of its rim."""
        u = self.u[n]
        s = np.clip((places - self.low) / self.step, 0.0, np.array([u.shape[1], u.shape[0]]) - 1.0 - 1e-9)
        corner = s.astype(np.intp)
        x, y = (s - corner).T[:, :, None]
        c, r = corner.T
        flat = u.reshape(-1, 2)
        first = r * u.shape[1] + c
        below = first + u.shape[1]
        return (1.0 - y) * ((1.0 - x) * flat[first] + x * flat[first + 1]) + y * ((1.0 - x) * flat[below] + x * flat[below + 1])

    def stretch(self, n: int) -> np.ndarray:
        """Mean stretch (2,) along x and y at time n: what makes the inverse contract quickly."""
        u = self.u[n]
        across = (u[:, -1, 0] - u[:, 0, 0]).mean() / (self.step * (u.shape[1] - 1))
        along = (u[-1, :, 1] - u[0, :, 1]).mean() / (self.step * (u.shape[0] - 1))
        return np.maximum(1.0 + np.array([across, along]), 0.2)

    def inverse(self, n: int, current: np.ndarray, guess: np.ndarray) -> np.ndarray:
        """Material places X (k, 2) mm of which X + u(X) are the places `current` (k, 2) mm; nan where there is none."""
        stretch, places = self.stretch(n), guess.copy()
        active = np.arange(len(current))
        for _ in range(_ROUNDS):
            error = current[active] - places[active] - self.at(n, places[active])
            places[active] += error / stretch
            active = active[np.abs(error).max(axis=1) > _CONVERGED]
            if not len(active):
                return places
        places[active] = np.nan
        return places


def motion_of(dic: DicField, patches: Patches, good: np.ndarray, times: np.ndarray) -> Motion:
    """Motion of the specimen under all patches at `times` s, from the points that are `good` (n_t, n_s): planes through the next points.

    Places of the grid are as far apart as the points, or farther where most points crowd in one place (_MOST_PLACES).
    """
    measured = good.any(axis=0)
    points = dic.reference[measured, :2]
    low, high = patches.reach
    spacing = max(point_spacing(points), float(np.sqrt(np.prod(high - low) / max(len(points), _MOST_PLACES))))
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    grid = np.stack(np.meshgrid(*(low[k] + spacing * np.arange(shape[k]) for k in (0, 1))), axis=-1).reshape(-1, 2)
    count = min(_NEIGHBOURS, len(points))
    distance, near = cKDTree(points).query(grid, k=count)
    weight = np.empty((len(grid), count))
    for block in _blocks(len(grid), 3 * count):
        farther = distance[block] - distance[block, :1]
        width = np.maximum(spacing, _THIN * farther[:, -1:])
        away = (points[near[block]] - grid[block, None, :]) / width[:, :, None]
        # Near points tell most; far off the field, where all are far, those that are nearest.
        closeness = np.exp(-0.5 * (farther / width) ** 2)
        design = np.concatenate([np.ones((len(away), count, 1)), away], axis=2)
        weight[block] = np.linalg.pinv(closeness[:, :, None] * design)[:, 0] * closeness
    plane = csr_array((weight.ravel(), (np.repeat(np.arange(len(grid)), count), near.ravel())), shape=(len(grid), len(points)))
    surface, _, around = _surface(points) if len(points) > _NEIGHBOURS else (csr_array((len(points),) * 2), None, near[:0])
    w = time_weights(dic.time, times)
    out = np.empty((len(times), shape[1], shape[0], 2))
    on_grid = np.empty((len(good), len(grid)))
    for k in range(2):
        for block in _blocks(len(good), len(points)):
            whole = _filled(dic.displacement[block, :, k][:, measured], good[block, measured], surface, around)
            on_grid[block] = (plane @ whole.T).T
        for block in _blocks(len(times), len(grid)):
            out[block, ..., k] = mixed(on_grid.__getitem__, w.of(block)).reshape(-1, shape[1], shape[0])
    return Motion(low, spacing, out)


_SECOND = np.array([0.0, 0.0, 1.0, 0.0, 1.0])
"""The moments m_xx and m_yy."""
_AT_EDGE, _NO_MOTION = -2, -3
"""Labels of places in a patch that are not used: near the edge of the specimen, far from all DIC points."""


@dataclass(frozen=True)
class Sight:
    """What an infrared camera sees of the patches: its `place`, the `motion` of the specimen at `times` s, the `whole` patches and the
    `raster` of them with what is not used marked, and whether the motion is measured at a time, `known` (n_t,)."""

    place: PixelMap
    motion: Motion
    times: np.ndarray
    whole: Raster
    raster: Raster
    known: np.ndarray

    def at(self, n: int, image: tuple[int, int]) -> tuple[slice, slice, np.ndarray, np.ndarray] | None:
        """Rows and columns of the image that may see the patches at time n, the material places (k, 2) mm of their pixels, and their labels
        (k,); None where there are no such pixels."""
        view = _view(self.place, self.motion, n, self.raster, image)
        return None if view is None else (*view, self.raster.at(view[2]))


def sight_of(place: PixelMap, dic: DicField, patches: Patches, good: np.ndarray, at_edge: np.ndarray, times: np.ndarray) -> Sight:
    """Sight of a camera at `times` s. `good` (n_t, n_s) as from `in_line`; `at_edge` (n,) is True for the places of the raster of
    `patches` that are too near to the edge of the specimen."""
    whole = patches.raster()
    label = whole.label.ravel().copy()
    inside = label >= 0
    measured = dic.reference[good.any(axis=0), :2]
    distance, _ = cKDTree(measured).query(whole.places)
    label[inside & (distance > GAP * point_spacing(measured))] = _NO_MOTION
    label[inside & at_edge] = _AT_EDGE
    raster = replace(whole, label=label.reshape(whole.label.shape))
    known = time_weights(dic.time, times).inside
    return Sight(place, motion_of(dic, patches, good, times), np.asarray(times, dtype=float), whole, raster, known)


def rests(infrared: InfraredSequence, sight: Sight) -> list[Rest]:
    """Runs of frames in which no place under the patches moves by more than STILL pixels; `sight` is at the times of all frames."""
    image = (infrared.frames.shape[1], infrared.frames.shape[2])
    least = STILL / float(np.linalg.norm(sight.place.matrix, axis=0).mean())
    u, found, first = sight.motion.u, [], 0
    for n in range(1, len(u) + 1):
        if n < len(u) and sight.known[first] and sight.known[n] and np.abs(u[n] - u[first]).max() <= least:
            continue
        view = sight.at((first + n - 1) // 2, image) if sight.known[first] and n - first >= LEAST_STILL else None
        if view is not None:
            rows, columns, _, label = view
            pixels = np.zeros(image, dtype=bool)
            pixels[rows, columns] = (label >= 0).reshape(pixels[rows, columns].shape)
            found.append(Rest(np.arange(first, n), pixels, u[first].reshape(-1, 2).mean(axis=0) * STILL / least))
        first = n
    return found


def project_temperatures(
    infrared: InfraredSequence, sight: Sight, patches: Patches, pattern: np.ndarray | None = None, blur: float = 0.0
) -> Projected:
    """Mean temperatures K of the patches at the times of `sight`, from all pixels that see their material then.

    The frames are interpolated in time at fixed pixels, less the fixed `pattern` (n_row, n_col) K, nan for a bad pixel; the material place
    of a pixel is its place in space moved back by the measured motion. A pixel shows the mean over a point spread of standard deviation
    `blur` mm in space, which adds to the second moments. DataError where no node has a temperature.
    """
    times = sight.times
    w = time_weights(infrared.time, times)
    m, image = len(patches.xy), (infrared.frames.shape[1], infrared.frames.shape[2])
    value, moments = np.full((len(times), m, 1), np.nan), np.zeros((len(times), m, MOMENTS))
    number, there = np.zeros((len(times), m)), np.zeros((len(times), m))
    left_out = dict.fromkeys(("pixels_in_window", "pixels_used", "pixels_at_edge", "pixels_without_motion", "pixels_dead"), 0)
    outside = ~(w.inside & sight.known)
    for k in np.flatnonzero(~outside).tolist():
        view = sight.at(k, image)
        if view is None:
            continue
        rows, columns, where, here = view
        left, right = (np.asarray(infrared.frames[n, rows, columns], dtype=float).ravel() for n in (w.left[k], w.right[k]))
        theta = left if w.share[k] == 0.0 else right if w.share[k] == 1.0 else (1.0 - w.share[k]) * left + w.share[k] * right
        if pattern is not None:
            theta = theta - pattern[rows, columns].ravel()
        seen = here >= 0
        used = np.flatnonzero(seen & np.isfinite(theta))
        patch = here[used]
        number[k] = np.bincount(patch, minlength=m)
        some = number[k] >= LEAST_PIXELS
        share = 1.0 / np.maximum(number[k], 1.0)
        value[k, some, 0] = (np.bincount(patch, theta[used], m) * share)[some]
        away = terms(where[used] - patches.xy[patch])
        for j in range(MOMENTS):
            moments[k, some, j] = (np.bincount(patch, away[:, j], m) * share)[some]
        moments[k, some] += terms(np.diag(blur / sight.motion.stretch(k))).sum(axis=0) * _SECOND
        left_out["pixels_used"] += len(used)
        left_out["pixels_dead"] += int(seen.sum()) - len(used)
        left_out["pixels_at_edge"] += int((here == _AT_EDGE).sum())
        left_out["pixels_without_motion"] += int((here == _NO_MOTION).sum())
        left_out["pixels_in_window"] += int((here != -1).sum())
        whole = sight.whole.at(where)
        there[k] = np.bincount(whole[whole >= 0], minlength=m)
    mask = np.isfinite(value[:, :, 0])
    counts = {**left_out, "times_outside": int(outside.sum()), "masked": int((~mask).sum())}
    if not mask.any():
        raise DataError(
            f"ir: no node has a temperature at any of the {len(times)} times ({counts['times_outside']} outside the record; of "
            f"{counts['pixels_in_window']} pixels {counts['pixels_at_edge']} at the edge, {counts['pixels_without_motion']} without "
            f"measured motion, {counts['pixels_dead']} dead); check the landmarks, the evaluation window and the times"
        )
    factor = np.where(mask, np.hypot(1.0 - w.share, w.share)[:, None] / np.sqrt(np.maximum(number, 1.0)), np.nan)
    return Projected(times, value, number, there, factor, mask, moments, counts)


def _view(place: PixelMap, motion: Motion, n: int, raster: Raster, image: tuple[int, int]) -> tuple[slice, slice, np.ndarray] | None:
    """Rows and columns of the image that may see the patches at time n, and the material places (k, 2) mm of their pixels; None for none.

    The motion is inverted on a lattice of pixels and taken straight in between.
    """
    high = raster.low + raster.step * np.array(raster.label.shape[::-1])
    corner = np.stack(np.meshgrid(*(np.linspace(raster.low[k], high[k], 5) for k in (0, 1))), axis=-1).reshape(-1, 2)
    pixel = (corner + motion.at(n, corner)) @ place.matrix.T + place.offset
    first = np.maximum(np.floor(pixel.min(axis=0)).astype(int), 0)
    last = np.minimum(np.ceil(pixel.max(axis=0)).astype(int), np.array(image) - 1)
    if (last < first).any():
        return None
    scale = np.linalg.norm(place.matrix, axis=0).mean()
    every = max(1, int(_LATTICE * motion.step * scale))
    rows, columns = (np.arange(first[k], last[k] + 1, dtype=float) for k in (0, 1))
    knots = [_knots(first[k], last[k], every) for k in (0, 1)]
    lattice = np.stack(np.meshgrid(*knots, indexing="ij"), axis=-1).reshape(-1, 2)
    current = (lattice - place.offset) @ np.linalg.inv(place.matrix).T
    middle = raster.low + 0.5 * (high - raster.low)
    guess = middle + (current - middle - motion.at(n, middle[None])) / motion.stretch(n)
    found = motion.inverse(n, current, guess).reshape(len(knots[0]), len(knots[1]), 2)
    down, across = _hats(knots[0], rows), _hats(knots[1], columns)
    where = np.stack([down @ (across @ found[:, :, k].T).T for k in (0, 1)], axis=-1).reshape(-1, 2)
    return slice(int(first[0]), int(last[0]) + 1), slice(int(first[1]), int(last[1]) + 1), where


def _knots(first: int, last: int, every: int) -> np.ndarray:
    """Pixels from first to last, about `every` so many one."""
    return np.linspace(first, last, max(2, int(np.ceil((last - first) / every)) + 1)) if last > first else np.array([float(first)])


def _hats(knots: np.ndarray, places: np.ndarray) -> csr_array:
    """Weights (n, n_k) of straight lines between knots at places (n,)."""
    if len(knots) == 1:
        return csr_array(np.ones((len(places), 1)))
    w = time_weights(knots, places)
    row = np.arange(len(places))
    data = (np.concatenate([1.0 - w.share, w.share]), (np.concatenate([row, row]), np.concatenate([w.left, w.right])))
    return csr_array(data, shape=(len(places), len(knots)))
