"""What drives the loaded end of a body over time, and the solution steps between the times that are recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.fem.body import Body

_CONTROLS = ("force", "displacement", "arc")


@dataclass(frozen=True)
class Loading:
    """What drives the loaded end over time s, piecewise linear: total force in N, its displacement in mm, or arc length in mm.

    A displacement counts from the stress-free reference state, or `from_rest` from the resting specimen, which its temperature has
    already lengthened. Control "arc" (of a body under force control) goes on along the path of equilibria (`fem.arc`) where neither
    force nor end displacement grows, and back along it, unloading, where the value falls; it starts without force.
    """

    time: np.ndarray
    value: np.ndarray
    control: str = "force"
    from_rest: bool = False

    def at(self, t: float) -> float:
        """Value at time t."""
        return float(np.interp(t, self.time, self.value))

    def check(self, body: Body, times: np.ndarray) -> None:
        """StudyError where the body or the solution times (n_t,) s do not suit the control."""
        if self.control not in _CONTROLS:
            raise StudyError(f"march: control '{self.control}' found; expected one of {', '.join(_CONTROLS)}")
        if (self.control == "displacement") != (body.top < 0):
            raise StudyError(
                f"march: the loading prescribes a {self.control}, but the body was made for the other control; use one control for both"
            )
        if self.control == "arc" and np.any(np.diff([self.at(float(t)) for t in times]) == 0.0):
            raise StudyError("march: the arc length stands still between two times; under arc control it must change in every step")


def solution_times(start: float, end: float, longest: float) -> np.ndarray:
    """Times after `start` up to `end` in equal steps of at most `longest`, all in s."""
    n = max(1, int(np.ceil((end - start) / longest * (1.0 - 1e-9))))
    return np.append(start + (end - start) * np.arange(1, n) / n, end)
