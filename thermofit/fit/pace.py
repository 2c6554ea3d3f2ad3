"""The pace of a search: whether the evaluations that are left are worth their time."""

from __future__ import annotations

from dataclasses import dataclass, field

from thermofit.fit.evaluate import Evaluations
from thermofit.fit.settings import Settings

PACE = 5
"""Steps whose mean fall of f is the pace of a search: in a bent valley single ones go far and near by turns."""


class Crawls(Exception):
    """The evaluations that are left are not worth their time; ends a search from inside, never reaches the user."""


@dataclass
class Pace:
    """f after the steps of a search so far, against `worth` and `to_beat` of its settings."""

    evaluations: Evaluations
    settings: Settings
    falls: list[float] = field(default_factory=list)

    def after(self, f: float) -> None:
        """One more step, after which the best point has that f. Crawls where the evaluations left would not lower it by what is worth
        them."""
        self.falls.append(f)
        settings = self.settings
        if settings.worth <= 0.0 or len(self.falls) <= PACE:
            return
        pace, left = (self.falls[-1 - PACE] - f) / PACE, settings.max_evaluations - len(self.evaluations.log)
        there = f - pace * left
        if pace * left < settings.worth * f:
            raise Crawls(
                f"not converged: at the pace of the last {PACE} steps the {left} evaluations left would lower f by "
                f"{pace * left / f:.1e} of itself, less than {settings.worth:g}"
            )
        if there > (1.0 - settings.worth) * settings.to_beat:
            raise Crawls(
                f"not converged: at the pace of the last {PACE} steps the {left} evaluations left would lower f to {there:.6g}, not below "
                f"{settings.to_beat:.6g} of another start by more than {settings.worth:g} of it"
            )
