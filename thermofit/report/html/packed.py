"""Arrays in a page: 16 bits per value with an offset and a step, as base64; NaN is the smallest integer."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

_NONE = -32768
_MOST = 32767


def packed(values: np.ndarray) -> dict[str, Any]:
    """{"shape", "offset", "step", "data"}: values (any shape) to 1/65534 of their range; value = offset + step * integer."""
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    offset, step = 0.5 * (low + high), max(high - low, 1e-300) / (2 * _MOST)
    integers = np.full(values.shape, _NONE, dtype="<i2")
    integers[known] = np.rint((values[known] - offset) / step)
    return {"shape": list(values.shape), "offset": offset, "step": step, "data": base64.b64encode(integers.tobytes()).decode("ascii")}


def unpacked(what: dict[str, Any]) -> np.ndarray:
    """The values of `packed`."""
    integers = np.frombuffer(base64.b64decode(what["data"]), dtype="<i2").reshape(what["shape"])
    return np.asarray(np.where(integers == _NONE, np.nan, what["offset"] + what["step"] * integers.astype(float)))


def levels(picture: np.ndarray, low: float, high: float) -> str:
    """A picture (n_row, n_col) in 255 levels between two values, as base64 of bytes; 0 is not a number."""
    share = (np.asarray(picture, dtype=float) - low) / max(high - low, 1e-300)
    grey = np.where(np.isfinite(share), 1.0 + np.rint(254.0 * np.clip(np.nan_to_num(share), 0.0, 1.0)), 0.0).astype(np.uint8)
    return base64.b64encode(grey.tobytes()).decode("ascii")
