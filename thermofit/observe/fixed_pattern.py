"""Fixed pattern of an infrared camera: what stands still in the image, from frames in which the specimen stands still.

Where nothing moves, conduction leaves the temperature of the specimen smooth over a few millimetres: the mean of the frames less the
quadratic surface through the pixels around is the pattern and what is left of the noise. Of that the share is taken that is the pattern's,
p^2 / (p^2 + sigma^2 / n), with p the standard deviation of the pattern, sigma that of the noise and n the number of frames (Wiener's
filter). The pattern belongs to pixels and moves with nothing: where the specimen rests at two places, the same pixels show it in both. What
moves with the specimen instead, such as paint or a temperature that conduction has not levelled, is left in the frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import correlate1d

from thermofit.core.experiment import InfraredSequence
from thermofit.observe.noise import FieldNoise

BAD = 6.0
"""Distance from the smooth surface, in standard deviations, at which a pixel is bad."""
_APART = 2.0
"""px between two places of the specimen from which on the fine patterns of one and the other pixel have nothing in common."""
_MOST_MOVING, _SURE = 0.5, 3.0
"""A pattern of which less than this stays, by this many standard errors, is not that of the camera."""
_HALF = 7
"""Half width in pixels of the square whose quadratic surface is the smooth part."""
_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


@dataclass(frozen=True)
class Rest:
    """Frames (k,) by number in which nothing moves, the `pixels` (n_row, n_col) that are on the specimen in all of them, and the `place`
    (2,) px of the specimen, from anywhere."""

    frames: np.ndarray
    pixels: np.ndarray
    place: np.ndarray


@dataclass(frozen=True)
class FixedPattern:
    """`value` (n_row, n_col) K, to be taken off every frame, nan for a bad pixel; its `size` K and what is `left` of it, as standard
    deviations of single pixels; number of `frames` at rest and of `bad` pixels. `stays`: the share of the pattern that stays with the
    pixels while the specimen goes to another place, and its standard error; None where the specimen rests at one place only. Where less
    than half stays nothing is taken off."""

    value: np.ndarray
    size: float
    left: float
    frames: int
    bad: int
    stays: tuple[float, float] | None = None

    @property
    def moves(self) -> bool:
        """Does the pattern go with the specimen?"""
        return _moves(self.stays)


def _moves(stays: tuple[float, float] | None) -> bool:
    return stays is not None and stays[0] + _SURE * stays[1] < _MOST_MOVING


def fixed_pattern(infrared: InfraredSequence, rests: Sequence[Rest], noise: FieldNoise) -> FixedPattern:
    """Pattern of the pixels that are seen at rest; zero elsewhere. `noise` is that of `temperature_noise`: it tells the pattern's size."""
    shape = infrared.frames.shape[1:]
    total, number = np.zeros(shape), np.zeros(shape)
    seen_at: list[tuple[Rest, np.ndarray]] = []
    for rest in rests:
        mean, seen = _mean(infrared, rest)
        rough = mean - smooth_surface(mean, seen)
        known = seen & np.isfinite(rough)
        total[known] += len(rest.frames) * rough[known]
        number[known] += len(rest.frames)
        seen_at.append((rest, np.where(known, rough, np.nan)))
    known, frames = number > 0, sum(len(rest.frames) for rest in rests)
    if not known.any():
        return FixedPattern(np.zeros(shape), noise.pattern, noise.pattern, 0, 0)
    stays = _stays(seen_at, noise)
    if _moves(stays):
        return FixedPattern(np.zeros(shape), noise.pattern, noise.pattern, frames, 0, stays)
    rough = total / np.maximum(number, 1)
    scatter = noise.temporal.sigma / np.sqrt(np.maximum(number, 1))
    bad = known & (np.abs(rough) > BAD * np.hypot(noise.pattern, scatter))
    share = noise.pattern**2 / np.maximum(noise.pattern**2 + scatter**2, np.finfo(float).tiny)
    left = noise.pattern * float(np.sqrt(1.0 - np.median(share[known])))
    return FixedPattern(np.where(bad, np.nan, np.where(known, share * rough, 0.0)), noise.pattern, left, frames, int(bad.sum()), stays)


def _stays(seen_at: Sequence[tuple[Rest, np.ndarray]], noise: FieldNoise) -> tuple[float, float] | None:
    """Covariance of the roughness (n_row, n_col) that the same pixels show at two rests, over its variance without that of the noise; and
    the standard error. None where no two rests are apart, or no roughness stands out of the noise."""
    both = own = weight = 0.0
    for k, (rest, rough) in enumerate(seen_at):
        for other, again in seen_at[:k]:
            common = np.isfinite(rough) & np.isfinite(again)
            common &= np.hypot(rough, again) < 2.0 * BAD * np.hypot(noise.pattern, noise.temporal.sigma)
            if float(np.linalg.norm(rest.place - other.place)) < _APART or not common.any():
                continue
            x, y = rough[common], again[common]
            scatter = noise.temporal.sigma**2 * np.array([1.0 / len(rest.frames), 1.0 / len(other.frames)])
            precision = float(common.sum()) / float(np.prod(noise.pattern**2 + scatter))
            both += precision * float(np.mean(x * y))
            own += precision * 0.5 * float(np.mean(x**2) + np.mean(y**2) - scatter.sum())
            weight += precision
    error = np.sqrt(weight)
    return (both / own, float(error / own)) if own > _OWN * error else None


_OWN = 5.0
"""Standard errors by which a roughness must stand out of the noise before it is asked where it belongs."""


def _mean(infrared: InfraredSequence, rest: Rest) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n_row, n_col) of the frames and where it is known: pixels on the specimen that are there in all of them."""
    total = np.zeros(infrared.frames.shape[1:])
    for n in rest.frames.tolist():
        total += infrared.frames[n]
    seen = rest.pixels & np.isfinite(total)
    return np.where(seen, total / len(rest.frames), 0.0), seen


def smooth_surface(field: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Value (n_row, n_col) at every pixel of the quadratic surface through the `seen` pixels of the square about it; nan where these tell
    none."""
    level = float(field[seen].mean()) if seen.any() else 0.0
    ramp = np.arange(-_HALF, _HALF + 1) / _HALF
    weight, value = seen.astype(float), np.where(seen, field - level, 0.0)

    def moment(image: np.ndarray, i: int, j: int) -> np.ndarray:
        down = correlate1d(image, ramp**i, axis=0, mode="constant")
        return np.asarray(correlate1d(down, ramp**j, axis=1, mode="constant"))[seen]

    sums = {(i, j): moment(weight, i, j) for i in range(5) for j in range(5 - i)}
    matrix = np.stack([np.stack([sums[a + c, b + d] for c, d in _POWERS], axis=-1) for a, b in _POWERS], axis=-2)
    right = np.stack([moment(value, i, j) for i, j in _POWERS], axis=-1)
    out = np.full(field.shape, np.nan)
    enough = np.linalg.cond(matrix) < 1e6
    found = np.full(len(right), np.nan)
    found[enough] = level + np.linalg.solve(matrix[enough], right[enough][:, :, None])[:, 0, 0]
    out[seen] = found
    return out
