"""Noise floor of measured fields from the data themselves: standard deviations, and how far the noise is correlated in space.

Two independent ways. In time: scatter at rest before loading, without what moves or warms smoothly there, else the distance of every
value from the straight line between its two neighbours in time. In space: the distance of every value from the plane through its
neighbours. The first sees noise that is correlated in space, the second a fixed pattern, which stands still in time; where both agree,
the noise is white.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.stats import norm

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField, InfraredSequence
from thermofit.observe.triangles import point_spacing

CLIP = 3.5
"""Residuals beyond this many standard deviations are outliers or signal and do not count."""
LEAST_AT_REST = 3
"""Stages or frames before loading of which the scatter about a mean can be taken."""
LEAST_VALUES = 30
"""Measured values of a field that give a standard deviation of their own."""
_MAD = float(norm.ppf(0.75))
_DEGREE = 3
_NEIGHBOURS = 8
NEIGHBOURS = 12
"""Points of a plane of `local_scatter` besides the one that is judged: a patch of about four spacings, over which an elastic field is
nearly linear."""
_LAGS = 6.0
MOST_PAIRS = 20_000_000
"""Pairs of points whose correlation is looked at: twenty times those of 20,000 points on a grid."""
_BLOCK = 64
_FIELDS = 60


@dataclass(frozen=True)
class NoiseEstimate:
    """`sigma` standard deviation of one measured value, in its unit; `n` residuals used; `method` in words.

    `at_rest`: usable stages or frames found before loading; 0 where nobody asked for them. With fewer than LEAST_AT_REST of them the
    estimate is by differences.
    """

    sigma: float
    n: int
    method: str
    at_rest: int = 0


@dataclass(frozen=True)
class FieldNoise:
    """`sigma` of one value; estimates `temporal` and `spatial`; `pattern` standard deviation of the rough part that stands still.

    `correlation_length` in mm (DIC) or px (infrared) is the lag at which the autocorrelation of the noise falls below 1/e; for
    independent neighbours it is below one point spacing. At the end of the range looked at (6 spacings) it means: at least that.
    """

    sigma: float
    temporal: NoiseEstimate
    spatial: NoiseEstimate
    pattern: float
    correlation_length: float


def robust_sigma(residual: np.ndarray) -> tuple[float, int]:
    """Standard deviation of normal residuals with outliers among them, and how many residuals were used; nan are left out.

    From the median absolute deviation, then by clipping at CLIP sigma with the variance lost by the clipping given back, until
    nothing changes. nan and 0 for fewer than two values.
    """
    r = np.asarray(residual, dtype=float).ravel()
    r = r[np.isfinite(r)]
    if len(r) < 2:
        return float("nan"), 0
    r = r - np.median(r)
    kept_share = 1.0 - 2.0 * CLIP * norm.pdf(CLIP) / (2.0 * norm.cdf(CLIP) - 1.0)
    sigma, n = float(np.median(np.abs(r)) / _MAD), -1
    for _ in range(50):
        kept = r[np.abs(r) <= CLIP * sigma]
        if len(kept) == n:
            break
        sigma, n = float(np.sqrt(np.mean(kept**2) / kept_share)), len(kept)
    return sigma, n


def second_differences(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Distance (n_t - 2, n_s) of every value (n_t, n_s) from the line between its neighbours in time, over the norm of its weights.

    r_i = (x_i - a x_{i-1} - b x_{i+1}) / sqrt(1 + a^2 + b^2), a = (t_{i+1} - t_i) / (t_{i+1} - t_{i-1}), b = 1 - a: exactly zero for
    signals linear in time at any spacing, and of the standard deviation of one value for white noise.
    """
    after, before = np.diff(time)[1:], np.diff(time)[:-1]
    a = (after / (after + before))[:, None]
    b = 1.0 - a
    return np.asarray((value[1:-1] - a * value[:-2] - b * value[2:]) / np.sqrt(1.0 + a**2 + b**2))


def temporal_noise(
    time: np.ndarray, value: np.ndarray, mask: np.ndarray, load_start: float | None = None, xy: np.ndarray | None = None
) -> NoiseEstimate:
    """Noise of values (n_t, n_s), measured where `mask`, from their scatter in time.

    With at least three usable stages at t <= load_start (s): scatter of at most 60 of them about the mean of each point. Else second
    differences in time. With positions `xy` (n_s, 2) a cubic polynomial in space is taken out of each field first: the motion of the
    specimen in its grips and the warming of a rest that is none, and the signal that is smooth in space at kinks of the programme;
    without, the mean over the points from fields at rest. A stage is usable where at least LEAST_VALUES of its values are measured
    and are not all the same, as those of the reference stage itself are. DataError for fewer than three stages.
    """
    return _temporal(time, np.where(mask, value, np.nan), load_start, xy)[0]


def _temporal(time: np.ndarray, value: np.ndarray, load_start: float | None, xy: np.ndarray | None) -> tuple[NoiseEstimate, np.ndarray]:
    """The estimate and its fields (k, n_s) of unit noise gain, nan where not measured."""
    if len(time) < LEAST_AT_REST:
        raise DataError(f"noise: {len(time)} stages or frames found, at least {LEAST_AT_REST} are needed; give the noise in the study")
    terms = None if xy is None else _polynomial(xy)
    quiet = value[:0] if load_start is None else _usable(value[time <= load_start])
    if len(quiet) >= LEAST_AT_REST:
        quiet = _about_mean(_some(quiet), np.ones((value.shape[1], 1)) if terms is None else terms)
    if len(quiet) >= LEAST_AT_REST:
        fields, method = quiet, f"{len(quiet)} stages before loading without smooth part in space"
    else:
        fields, method = _some(second_differences(time, value)), "second differences in time"
        if terms is not None:
            fields, method = np.stack([_without_trend(field, terms) for field in fields]), f"{method} without smooth part in space"
    return replace(_estimate(fields, method), at_rest=len(quiet)), fields


def _usable(value: np.ndarray) -> np.ndarray:
    """Stages (k', n_s) with a scatter of their own. The reference stage has none, and would weaken the mean of the others."""
    return _measured(value[[bool(np.nanmax(field, initial=-np.inf) > np.nanmin(field, initial=np.inf)) for field in value]])


def _about_mean(value: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Fields (k', n_s) of unit noise gain from values (k, n_s) at rest: without what is smooth in space and the mean of each point; nan
    where it is measured once.

    What is smooth goes out before the mean as well, which else would be that of other moments wherever a value is missing; and with
    it the outliers, which the mean would carry into all stages.
    """
    flat = [_left(field, terms) for field in value]
    quiet = np.array([np.where(kept, left, np.nan) for left, kept in flat])
    number = np.isfinite(quiet).sum(axis=0)
    gain = np.sqrt(1.0 - 1.0 / np.maximum(number, 2))
    scatter = np.where(number >= 2, (quiet - np.nansum(quiet, axis=0) / np.maximum(number, 1)) / gain, np.nan)
    return np.reshape([_without_trend(field, terms) for field in _measured(scatter)], (-1, value.shape[1]))


def _measured(fields: np.ndarray) -> np.ndarray:
    """Those of the fields (k, n_s) of which enough values are measured for a standard deviation."""
    return fields[np.isfinite(fields).sum(axis=1) >= LEAST_VALUES]


def _some(fields: np.ndarray) -> np.ndarray:
    """At most 60 of the fields (k, n_s), evenly taken: enough for a percent, whatever the length of the record."""
    return fields[np.unique(np.linspace(0, len(fields) - 1, _FIELDS).astype(int))]


def _estimate(fields: np.ndarray, method: str) -> NoiseEstimate:
    """Median over fields of their standard deviations: stages at which the signal is rough do not count. Few points are pooled."""
    each = [robust_sigma(field) for field in fields if np.isfinite(field).sum() >= LEAST_VALUES]
    if len(each) >= 1:
        sigma, n = float(np.median([s for s, _ in each])), sum(n for _, n in each)
    else:
        sigma, n = robust_sigma(fields)
    if n == 0:
        raise DataError(f"noise: no value is measured at enough neighbouring times or places ({method}); give the noise in the study")
    return NoiseEstimate(sigma, n, method)


def _polynomial(xy: np.ndarray) -> np.ndarray:
    """Terms (n_s, 10) x^i y^j, i + j <= 3, of positions scaled to [-1, 1]."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    x, y = (2.0 * (xy - low) / np.maximum(high - low, np.finfo(float).tiny) - 1.0).T
    return np.stack([x**i * y**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=1)


def _left(field: np.ndarray, terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Field (n_s,) minus its least-squares polynomial, and True (n_s,) where it was fitted: outliers are not. nan for too few values."""
    kept = np.isfinite(field)
    residual = field
    for _ in range(3):
        if kept.sum() <= 2 * terms.shape[1]:
            return np.full_like(field, np.nan), np.zeros(len(field), dtype=bool)
        residual = field - terms @ np.linalg.lstsq(terms[kept], field[kept], rcond=None)[0]
        sigma, _ = robust_sigma(residual[kept])
        kept = np.abs(residual) <= CLIP * sigma
    return residual, kept


def _without_trend(field: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Field (n_s,) minus its polynomial, over the square root of the degrees of freedom left."""
    residual, kept = _left(field, terms)
    return np.asarray(residual / np.sqrt(1.0 - terms.shape[1] / max(int(kept.sum()), terms.shape[1] + 1)))


def spatial_noise(xy: np.ndarray, value: np.ndarray, mask: np.ndarray) -> NoiseEstimate:
    """Noise of values (n_t, n_s) at points (n_s, 2) from their distance to the plane through the 8 nearest other points.

    A residual counts where all nine values are measured. DataError for fewer than ten points.
    """
    return _estimate(_spatial_residual(xy, np.where(mask, value, np.nan)), f"distance from the plane through {_NEIGHBOURS} neighbours")


def _spatial_residual(xy: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Plane residuals (k, n_s) of some of the stages; nan where one of the nine values is."""
    # nan times a weight is nan, also in the sparse product: one missing value takes out its own residuals and no others.
    return np.asarray(_plane_residual(xy) @ _some(value).T).T


def _fixed_pattern(residual: np.ndarray, sigma: float) -> float:
    """Standard deviation of the median over stages of spatial residuals (k, n_s), less what noise sigma leaves in it.

    A median of k normal values has the variance pi sigma^2 / (2 k); a mean would keep every outlier.
    """
    often = np.isfinite(residual).sum(axis=0) > 0.5 * len(residual)
    scatter, n = robust_sigma(np.nanmedian(residual[:, often], axis=0))
    return float(np.sqrt(max(scatter**2 - 0.5 * np.pi * sigma**2 / len(residual), 0.0))) if n else 0.0


def _plane_residual(xy: np.ndarray, neighbours: int = _NEIGHBOURS) -> csr_array:
    """Sparse operator (n_s, n_s): value minus the plane fitted to its neighbours alone, over the norm of the weights, so that white noise
    keeps its standard deviation."""
    n = len(xy)
    if n < _NEIGHBOURS + 2:
        raise DataError(f"noise: {n} points found, at least {_NEIGHBOURS + 2} are needed for a noise estimate; give the noise in the study")
    _, near = cKDTree(xy).query(xy, k=neighbours + 1)
    near = np.where(near[:, :1] == np.arange(n)[:, None], near, np.roll(near, 1, axis=1))[:, 1:]
    away = xy[near] - xy[:, None, :]
    design = np.concatenate([np.ones((n, neighbours, 1)), away], axis=2)
    # The plane's value at the point itself is its constant term: the first row of the pseudo-inverse.
    weight = np.linalg.pinv(design)[:, 0, :]
    gain = np.sqrt(1.0 + np.sum(weight**2, axis=1))
    row = np.concatenate([np.arange(n), np.repeat(np.arange(n), neighbours)])
    column = np.concatenate([np.arange(n), near.ravel()])
    return csr_array((np.concatenate([1.0 / gain, (-weight / gain[:, None]).ravel()]), (row, column)), shape=(n, n))


def correlation_length(xy: np.ndarray, fields: np.ndarray) -> float:
    """Lag at which the autocorrelation of noise fields (k, n_s) at points (n_s, 2) falls below 1/e; nan are left out.

    Pairs of points up to 6 spacings apart, in bins of half a spacing; straight lines between the bins and the value 1 at lag 0.
    0 where nothing scatters. DataError where half of the points lie where another one does.
    """
    spacing = point_spacing(xy)
    if not spacing > 0.0:
        raise DataError("noise: most points lie where another one lies, expected points at places of their own; export every point once")
    tree = cKDTree(xy)
    while tree.count_neighbors(tree, _LAGS * spacing) > 2 * MOST_PAIRS:  # crowds of points: every second one tells as much
        xy, fields = xy[::2], fields[:, ::2]
        tree = cKDTree(xy)
    pair = tree.query_pairs(_LAGS * spacing, output_type="ndarray")
    lag = np.linalg.norm(xy[pair[:, 0]] - xy[pair[:, 1]], axis=1)
    bin_of = np.floor(lag / (0.5 * spacing)).astype(int)
    total, count, weighted, square = np.zeros(bin_of.max() + 1), np.zeros(bin_of.max() + 1), np.zeros(bin_of.max() + 1), []
    for field in fields:
        unit = _unit(field)
        if not np.isfinite(unit).any():
            continue
        product = unit[pair[:, 0]] * unit[pair[:, 1]]
        known = np.isfinite(product)
        total += np.bincount(bin_of[known], product[known], len(total))
        count += np.bincount(bin_of[known], minlength=len(total))
        weighted += np.bincount(bin_of[known], lag[known], len(total))
        square.append(unit[np.isfinite(unit)] ** 2)
    if not square or not count.any():
        return 0.0
    filled = count > 0.01 * count.max()
    return _falls_below(weighted[filled] / count[filled], total[filled] / count[filled] / np.concatenate(square).mean())


def _unit(field: np.ndarray) -> np.ndarray:
    """Field over its standard deviation, nan for outliers and where nothing scatters."""
    sigma, _ = robust_sigma(field)
    unit = field / sigma if sigma > 0.0 else np.full_like(field, np.nan)
    return np.where(np.abs(unit) <= CLIP, unit, np.nan)


def _falls_below(lag: np.ndarray, correlation: np.ndarray) -> float:
    """First lag at which the line through (0, 1) and the points falls below 1/e; the last lag where it never does."""
    level = np.exp(-1.0)
    below = np.flatnonzero(correlation < level)
    if not len(below):
        return float(lag[-1])
    k = int(below[0])
    lag0, c0 = (0.0, 1.0) if k == 0 else (float(lag[k - 1]), float(correlation[k - 1]))
    return float(lag0 + (lag[k] - lag0) * (c0 - level) / (c0 - correlation[k]))


def displacement_noise(dic: DicField, load_start: float | None = None) -> tuple[FieldNoise, FieldNoise, FieldNoise | None]:
    """Noise in mm of the displacement components x, y, z of single DIC points; None for z if it was never measured.

    `load_start` s: end of the rest before loading, if known. sigma is the temporal estimate: what stands still on the
    specimen is strain or its localisation. DataError for fewer than three stages or ten points.
    """
    xy, u = dic.reference[:, :2], dic.displacement
    x, y = (_field_noise(dic.time, u[:, :, j], xy, load_start) for j in (0, 1))
    return x, y, _field_noise(dic.time, u[:, :, 2], xy, load_start) if np.isfinite(u[:, :, 2]).any() else None


def temperature_noise(infrared: InfraredSequence, pixels: np.ndarray | None = None, load_start: float | None = None) -> FieldNoise:
    """Noise in K of single pixels; correlation length in px.

    `pixels` (n_row, n_col) is True on the specimen, away from its blurred edge (default: everywhere). The central 64 x 64 of them
    are used. `load_start` as for `displacement_noise`. The fixed pattern of the sensor counts as noise, because the specimen moves
    over it: sigma^2 = temporal^2 + pattern^2. DataError for fewer than three frames or ten pixels.
    """
    wanted = np.ones(infrared.frames.shape[1:], dtype=bool) if pixels is None else np.asarray(pixels, dtype=bool)
    if not wanted.any():
        raise DataError("noise: no pixel of the frames lies on the specimen; check the landmarks")
    rows, columns = _central(np.asarray(wanted.any(axis=1))), _central(np.asarray(wanted.any(axis=0)))
    inside = wanted[rows, columns]
    value = np.asarray(infrared.frames[:, rows, columns], dtype=float)[:, inside]
    noise = _field_noise(infrared.time, value, np.argwhere(inside).astype(float), load_start)
    return replace(noise, sigma=float(np.hypot(noise.temporal.sigma, noise.pattern)))


def _central(used: np.ndarray) -> slice:
    """At most 64 places in the middle of the range that is used."""
    first, last = np.flatnonzero(used)[[0, -1]]
    start = max(int(first), int(first + last + 1 - _BLOCK) // 2)
    return slice(start, min(start + _BLOCK, int(last) + 1))


def _field_noise(time: np.ndarray, value: np.ndarray, xy: np.ndarray, load_start: float | None) -> FieldNoise:
    """All estimates for values (n_t, n_s) at xy (n_s, 2), nan where not measured."""
    temporal, fields = _temporal(time, value, load_start, xy)
    spatial = spatial_noise(xy, value, np.isfinite(value))
    pattern = _fixed_pattern(_spatial_residual(xy, value), temporal.sigma)
    return FieldNoise(temporal.sigma, temporal, spatial, pattern, correlation_length(xy, fields))


def local_scatter(xy: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Robust standard deviation (n_c,) of one field u (n, n_c) about local planes over xy (n, 2) mm. DataError for fewer than 10 points."""
    residual = _plane_residual(xy, min(NEIGHBOURS, len(xy) - 1)) @ u
    return np.asarray(np.median(np.abs(residual - np.median(residual, axis=0)), axis=0) / _MAD)
