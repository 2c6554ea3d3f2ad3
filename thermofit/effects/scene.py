"""What a measuring instrument looks at: the specimen's points over time, for the effects of the measuring chain.

All operations are linear in the field and allow complex numbers, so that derivatives by complex step are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array


@dataclass(frozen=True)
class Scene:
    """`time` s (n_t,), current `position` mm (n_t, n_s, 2), axial logarithmic `strain` (n_t, n_s), `load` (n_t,) over its maximum.

    `name`: the record where a sensor looks at a coupon. `by_x`, `by_y` (n_s, n_s): derivatives in the reference configuration of a
    field at the points; `theta_air` K.
    """

    time: np.ndarray
    position: np.ndarray
    strain: np.ndarray
    load: np.ndarray
    by_x: csr_array
    by_y: csr_array
    theta_air: float
    name: str = ""

    def gradient(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of a field (n_t, n_s) by x and y in the reference configuration, 1/mm (strain of a few per cent neglected)."""
        return np.asarray((self.by_x @ field.T).T), np.asarray((self.by_y @ field.T).T)

    def later(self, field: np.ndarray, offset: float) -> np.ndarray:
        """A field (n_t, n_s) at t + offset, by straight lines between the times; at rest before the first, as at the end after the last."""
        wanted = self.time + offset
        index = np.clip(np.searchsorted(self.time, wanted.real, side="right") - 1, 0, len(self.time) - 2)
        part = (wanted - self.time[index]) / (self.time[index + 1] - self.time[index])
        part = np.where(part.real < 0.0, 0.0 * part, np.where(part.real > 1.0, 1.0 + 0.0 * part, part))
        return np.asarray(field[index] + part[:, None] * (field[index + 1] - field[index]))

    def lagged(self, field: np.ndarray, tau: float) -> np.ndarray:
        """Solution s (n_t, n_s) of tau ds/dt = field - s at rest at the first time, the field straight between the times.

        Far below the time step s = field - tau d(field)/dt, which is also the derivative at tau = 0.
        """
        dt = np.diff(self.time)
        rate = np.diff(field, axis=0) / dt[:, None]
        out = np.array(field + 0.0 * tau)
        behind = 0.0 * (field[0] + tau)
        for n, (step, slope) in enumerate(zip(dt, rate, strict=True), start=1):
            decay = np.exp(-step / tau) if np.real(tau) > 1e-3 * step else 0.0
            behind = tau * slope + (behind - tau * slope) * decay
            out[n] = field[n] - behind
        return out
