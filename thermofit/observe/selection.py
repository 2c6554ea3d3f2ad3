"""Which observations are compared: windows in space and time, and masks; positions are those in the resting specimen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermofit.core.errors import DataError
from thermofit.observe.observation import FieldObservation
from thermofit.study.stages import ChannelWindow, Region

_CLOSE = 1e-9
"""mm or s by which a limit reaches further than it says, so that a node on it belongs to it."""


def inside(region: Region, xy: np.ndarray, time: np.ndarray) -> np.ndarray:
    """True (n_t, n_s) at the points xy (n_s, 2) mm and times s (n_t,) that a region holds."""
    here = np.ones(len(xy), dtype=bool)
    for axis, limits in enumerate((region.x, region.y)):
        if limits is not None:
            here &= _within(xy[:, axis], limits)
    if region.centre is not None and region.radius is not None:
        here &= np.hypot(*(xy - np.array(region.centre)).T) <= region.radius + _CLOSE
    if region.polygon is not None:
        here &= in_polygon(np.array(region.polygon), xy)
    when = np.ones(len(time), dtype=bool) if region.t is None else _within(time, region.t)
    return np.asarray(when[:, None] & here)


def in_polygon(corner: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """True (n,) for points xy (n, 2) inside a polygon (m, 2) by the rule of even and odd crossings of a ray along x."""
    a, b = corner, np.roll(corner, -1, axis=0)
    crosses = (a[:, 1] > xy[:, None, 1]) != (b[:, 1] > xy[:, None, 1])
    rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
    at = a[:, 0] + (xy[:, None, 1] - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return np.asarray(np.sum(crosses & (xy[:, None, 0] < at), axis=1) % 2 == 1)


def _within(value: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    return np.asarray((value >= limits[0] - _CLOSE) & (value <= limits[1] + _CLOSE))


def kept(window: ChannelWindow, xy: np.ndarray, time: np.ndarray) -> np.ndarray:
    """True (n_t, n_s) within a window."""
    here = np.ones(len(xy), dtype=bool)
    for axis, limits in enumerate((window.x, window.y)):
        if limits is not None:
            here &= _within(xy[:, axis], limits)
    when = np.ones(len(time), dtype=bool)
    if window.t:
        when = np.any([_within(time, limits) for limits in window.t], axis=0)
    return np.asarray(when[:, None] & here)


def selected(
    observation: FieldObservation, window: ChannelWindow, mask: Sequence[Region], always: np.ndarray | None = None
) -> FieldObservation:
    """The observation as a channel sees it; at the times `always` (n_t,), those of the reference, limits in time do not count.

    DataError where nothing is left.
    """
    seen = _seen(observation, window, mask)
    if always is not None and always.any():
        timeless = [r.model_copy(update={"t": None}) for r in mask if r.t is None]
        ever = _seen(observation, window.model_copy(update={"t": ()}), timeless)
        seen = np.where(always[:, None], ever, seen)
    if not np.any(seen & observation.mask):
        raise DataError(f"{observation.name}: window and mask of the channel leave no observation; widen the window or shrink the mask")
    return replace(observation, mask=observation.mask & seen)


def masked(observation: FieldObservation, mask: Sequence[Region], key: str) -> FieldObservation:
    """The observation without what regions leave out: not measured, nan. DataError that names the key where nothing is left."""
    if not mask:
        return observation
    left = observation.mask & _seen(observation, ChannelWindow(), mask)
    if not left.any():
        raise DataError(f"{key}: its regions leave out every observation of {observation.name}; shrink them")
    hidden = left[:, :, None]
    return replace(
        observation, mask=left, value=np.where(hidden, observation.value, np.nan), sigma=np.where(hidden, observation.sigma, np.nan)
    )


def _seen(observation: FieldObservation, window: ChannelWindow, mask: Sequence[Region]) -> np.ndarray:
    seen = kept(window, observation.xy, observation.time)
    for region in mask:
        seen &= ~inside(region, observation.xy, observation.time)
    return seen
