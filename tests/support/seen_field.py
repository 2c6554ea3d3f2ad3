"""A temperature of few numbers as a case of the loop: two parameters of the law, three instruments."""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case
from thermofit.effects.catalogue import effect
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.residuals import Span
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation

N_T, N_S, SIGMA = 80, 30, 0.02
TIME = np.linspace(0.0, 120.0, N_T)
Y = np.linspace(-20.0, 20.0, N_S)
KNOWN = tuple(effect(name) for name in ("ir_drift", "ir_gain", "ir_emissivity"))
BASE = Parameters.of({"kappa": 120.0, "c0": 2.3})


def field(p: Parameters) -> np.ndarray:
    """A temperature (n_t, n_s) that depends on two parameters of the law and, bluntly, on three instruments."""
    warm = 300.0 / p["c0"] * (1.0 - np.exp(-TIME / 30.0))[:, None] * (1.0 - (Y / (0.3 * p["kappa"])) ** 2)
    seen = 297.0 + warm * (1.0 + p["ir_gain.gain"]) + p["ir_drift.rate"] * TIME[:, None]
    return np.asarray(seen + p["ir_emissivity.slope"] * 0.002 * (TIME[:, None] / 120.0) ** 3 * (1.0 + Y / 40.0) * warm)


def case_of(seed: int, **planted: float) -> Case:
    random = np.random.default_rng(seed)
    value = field(BASE.replace(**planted)) + SIGMA * random.normal(size=(N_T, N_S))
    xy = np.stack([np.zeros(N_S), Y], axis=1)
    shape = (N_T, N_S, 1)
    seen = FieldObservation("theta", TIME, xy, value[:, :, None], np.full(shape, SIGMA), np.ones(shape[:2], dtype=bool), "K")

    def errors(p: Parameters) -> Errors:
        return {"theta": field(p)[:, :, None] - seen.value}

    def linearise(p: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        columns = []
        for name in names:
            h = 1e-5 * param(name).scale
            columns.append((field(p.replace(**{name: p[name] + h})) - field(p.replace(**{name: p[name] - h}))) / (2.0 * h))
        return errors(p), {"theta": np.stack(columns, axis=-1)[:, :, None, :]}

    model = StageModel(errors, (plain(seen),), {"theta": seen}, "", linearise=linearise)
    instruments = frozenset(name for e in KNOWN for name in e.names)
    spans = (Span("loading", 0.0, 60.0), Span("cooling", 60.0, 120.0))
    return Case(model, BASE.with_free(("kappa", "c0")), KNOWN, spans, instruments)
