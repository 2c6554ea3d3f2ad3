"""What an evaluation of a fit tells whoever watches: its error over the noise, and the parameters that have moved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from thermofit.identify.reciprocal import Reciprocal
from thermofit.records.progress import Advance

_MOVED = 1e-3
"""Relative change from which a parameter is worth a word; those of finite differences are smaller."""
_SHOWN = 4


class Follower:
    """Tells `advance` of every evaluation of a fit of parameters `names`; the optimiser's variables become parameters by `change`."""

    def __init__(self, advance: Advance, names: Sequence[str], change: Reciprocal) -> None:
        self.advance, self.names, self.change = advance, tuple(names), change
        self.before: np.ndarray | None = None

    def __call__(self, evaluation: Any, residual: np.ndarray | None) -> None:
        """One evaluation, with its residual (n,) in units of the noise; None where it failed."""
        values = np.asarray(self.change.parameters(np.asarray(evaluation.x, dtype=float)), dtype=float)
        parameters = {name: float(value) for name, value in zip(self.names, values, strict=True)}
        if residual is None:
            self.advance(1, "failed", {"parameters": parameters, "failed": True})
            return
        over_noise = float(np.sqrt(evaluation.f / max(len(residual), 1)))
        note = f"{over_noise:.4g} times the noise"
        if moved := self._moved(values):
            note += "; " + ", ".join(f"{name} {parameters[name]:.5g}" for name in moved)
        self.before = values
        self.advance(1, note, {"objective_over_noise": over_noise, "parameters": parameters})

    def _moved(self, values: np.ndarray) -> list[str]:
        """Names of the parameters that have moved most since the last evaluation."""
        if self.before is None:
            return list(self.names[:_SHOWN])
        change = np.abs(values - self.before) / np.maximum(np.abs(self.before), np.finfo(float).tiny)
        return [self.names[k] for k in np.argsort(-change)[:_SHOWN] if change[k] > _MOVED]
