"""A thin strip that conducts heat in its plane, in numpy: a body without mechanics for tests of missing heat sources.

The heat capacity is known: without mechanics nothing else says how much a kelvin is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.missing import Grid, place_hats, time_hats
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.residuals import Span
from thermofit.observe.comparison import plain
from thermofit.observe.observation import FieldObservation

WIDTH, LENGTH, THICK = 24.0, 60.0, 1.2
SIGMA = 0.02
BASE = Parameters.of({"kappa": 30.0, "c0": 3.6, "beta": 0.8})
KNOWN = tuple(effect(name) for name in ("ir_drift", "ir_gain", "ir_emissivity", "stored_energy"))
SPANS = (Span("loading", 0.0, 70.0), Span("cooling", 70.0, 120.0))
Source = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Power in mW/mm^3 of points x, y (n,) mm at a time s."""


@dataclass(frozen=True)
class Strip:
    """Cells of a strip: n_x by n_y of them, at their midpoints; ends at zero, sides insulated; n_t steps of backward Euler."""

    n_x: int
    n_y: int
    n_t: int

    @property
    def time(self) -> np.ndarray:
        return np.linspace(0.0, 120.0, self.n_t + 1)

    @property
    def x(self) -> np.ndarray:
        return np.tile((np.arange(self.n_x) + 0.5) * WIDTH / self.n_x - 0.5 * WIDTH, self.n_y)

    @property
    def y(self) -> np.ndarray:
        return np.repeat((np.arange(self.n_y) + 0.5) * LENGTH / self.n_y - 0.5 * LENGTH, self.n_x)

    @property
    def cell(self) -> float:
        """Volume of a cell in mm^3."""
        return WIDTH * LENGTH * THICK / (self.n_x * self.n_y)

    def conduction(self) -> np.ndarray:
        """Laplace operator (n, n) in 1/mm^2."""

        def line(n: int, h: float, open_ends: bool) -> np.ndarray:
            a = np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
            a[0, 0] = a[-1, -1] = 3.0 if open_ends else 1.0
            return a / h**2

        a_x, a_y = line(self.n_x, WIDTH / self.n_x, False), line(self.n_y, LENGTH / self.n_y, True)
        return np.kron(np.eye(self.n_y), a_x) + np.kron(a_y, np.eye(self.n_x))

    def run(self, p: Parameters, power: np.ndarray) -> np.ndarray:
        """Temperature (n_t + 1, n, m) over the ends for powers (n_t, n, m) in mW/mm^3 of the steps."""
        answer = _answer(self, p["kappa"], p["c0"])
        out, dt = np.zeros((self.n_t + 1, *power.shape[1:])), 120.0 / self.n_t
        for k in range(self.n_t):
            out[k + 1] = answer @ (p["c0"] / dt * out[k] + power[k])
        return out

    def plastic(self, p: Parameters) -> np.ndarray:
        """Power (n_t, n, 1) of plastic flow up to 70 s, stronger towards the middle."""
        middle = 0.5 * (self.time[1:] + self.time[:-1])
        share = 1.0 - 0.5 * (self.y / (0.5 * LENGTH)) ** 2
        factor = 1.0 + p["stored_energy.slope"] * middle / 70.0 if "stored_energy.slope" in p.values else np.ones(len(middle))
        return (p["beta"] * 0.5 * factor * (middle < 70.0))[:, None, None] * share[None, :, None]

    def sourced(self, source: Source) -> np.ndarray:
        """Power (n_t, n, 1) of a source."""
        middle = 0.5 * (self.time[1:] + self.time[:-1])
        return np.stack([source(self.x, self.y, float(t)) for t in middle])[:, :, None]


@lru_cache(maxsize=64)
def _answer(strip: Strip, kappa: float, c0: float) -> np.ndarray:
    """Temperatures (n, n) after a step by unit powers."""
    dt = 120.0 / strip.n_t
    return np.linalg.inv(c0 / dt * np.eye(strip.n_x * strip.n_y) + kappa * strip.conduction())


MODEL = Strip(6, 18, 60)


def seen(p: Parameters, theta: np.ndarray) -> np.ndarray:
    """What a camera shows (n_t, n) of temperatures (n_t, n)."""
    t, y = MODEL.time[:, None], MODEL.y[None, :]
    shown = 297.0 + theta * (1.0 + p["ir_gain.gain"]) + p["ir_drift.rate"] * t
    return np.asarray(shown + p["ir_emissivity.slope"] * 0.002 * (t / 120.0) ** 3 * (1.0 + y / 60.0) * theta)


@dataclass(frozen=True)
class StripMissing:
    """Heat sources of the strip, and offsets of the camera."""

    records = ()
    offsets = np.zeros(0)
    folded = False
    of_yield = None

    @property
    def kinds(self) -> Mapping[str, str]:
        return {"theta": "heat"}

    @property
    def of_instruments(self) -> Mapping[str, tuple[str, ...]]:
        return {"theta": ("offset",)}

    @property
    def of_surface(self) -> Mapping[str, tuple[str, ...]]:
        return {"theta": ("flux",)}

    def grid(self, kind: str, counts: tuple[int, int, int]) -> Grid:
        if kind in ("offset", "flux"):
            count = min(counts[0], len(MODEL.time))
            return Grid(np.linspace(0.0, 120.0, count), np.zeros(count, dtype=int), np.zeros(1), np.zeros(1))
        x, y = (np.linspace(v.min(), v.max(), n) for v, n in ((MODEL.x, counts[2] + 2), (MODEL.y, counts[1])))
        return Grid(np.linspace(0.0, 120.0, counts[0]), np.zeros(counts[0], dtype=int), x, y)

    def spot(self, count: int) -> Grid:
        return Grid(np.linspace(0.0, 120.0, count), np.zeros(count, dtype=int), np.zeros(1), np.zeros(1), spread=1.0)

    def answers(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        if amount is not None:
            return {"theta": (self.answers(kind, parameters, grid, chosen)["theta"] @ amount)[..., None]}
        if kind == "offset":
            one = time_hats(grid, MODEL.time, np.zeros(len(MODEL.time), dtype=int))[:, chosen]
            return {"theta": np.repeat(one[:, None, None, :], len(MODEL.x), axis=1)}
        middle = 0.5 * (MODEL.time[1:] + MODEL.time[:-1])
        k, place = np.unravel_index(chosen, (len(grid.time), grid.places))
        place = place if grid.along is None else k
        strength = time_hats(grid, middle, np.zeros(len(middle), dtype=int))[:, k]
        over = THICK if kind == "flux" else 1.0
        theta = MODEL.run(parameters, strength[:, None, :] * place_hats(grid, MODEL.x, MODEL.y)[None, :, place] / over)
        return {"theta": theta[:, :, None, :]}

    def slopes(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray, names: Sequence[str]
    ) -> dict[str, np.ndarray]:
        """By differences, 1e-6 of the usual size of a parameter."""
        if kind == "offset":
            return {}
        first, out = self.answers(kind, parameters, grid, chosen)["theta"] @ amount, []
        for name in names:
            step = 1e-6 * param(name).scale
            moved = parameters.replace(**{name: parameters[name] + step})
            out.append((self.answers(kind, moved, grid, chosen)["theta"] @ amount - first) / step)
        return {"theta": np.stack([np.zeros_like(first), *out], axis=-1)[..., 1:]}

    def volumes(self, grid: Grid) -> np.ndarray:
        return MODEL.cell * place_hats(grid, MODEL.x, MODEL.y).sum(axis=0)

    def states(self, parameters: Parameters, grid: Grid) -> Mapping[str, np.ndarray]:
        middle = 0.5 * (MODEL.time[1:] + MODEL.time[:-1])
        power = np.interp(grid.time, middle, MODEL.plastic(parameters)[:, 0, 0])
        x, y = np.tile(grid.x, len(grid.y)), np.repeat(grid.y, len(grid.x))
        n = len(grid.time)
        return {"plastic power": np.repeat(power[:, None], grid.places, axis=1), "x": np.tile(x, (n, 1)), "y": np.tile(y, (n, 1))}


FINE = Strip(12, 36, 180)


def on_cells(theta: np.ndarray) -> np.ndarray:
    """Temperatures (180 + 1, n) of the fine strip at the times and cells of the model."""
    return np.asarray(theta[::3].reshape(MODEL.n_t + 1, 18, 2, 6, 2).mean(axis=(2, 4)).reshape(MODEL.n_t + 1, -1))


def numerical() -> np.ndarray:
    """Error (n,) of the discretisation in the residual."""
    coarse, fine = (strip.run(BASE, strip.plastic(BASE))[:, :, 0] for strip in (MODEL, FINE))
    return np.asarray((coarse - on_cells(fine)).ravel() / SIGMA)


def strip_case(
    seed: int,
    source: Source | None = None,
    known: tuple[Effect, ...] = KNOWN,
    offset: Callable[[np.ndarray], np.ndarray] | None = None,
    lab: Strip = FINE,
    **planted: float,
) -> Case:
    """A case whose data come from a finer strip (or from `lab` with the cells of the model), with a source that the model does not have,
    planted effects of the camera, and an offset of it over time."""
    truth = BASE.replace(**planted)
    power = lab.plastic(truth) + (0.0 if source is None else lab.sourced(source))
    theta = lab.run(truth, power)[:, :, 0]
    theta = on_cells(theta) if lab is FINE else theta
    theta = theta if offset is None else theta + offset(MODEL.time)[:, None]
    value = seen(truth, theta) + SIGMA * np.random.default_rng(seed).normal(size=theta.shape)
    shape = (*value.shape, 1)
    xy = np.stack([MODEL.x, MODEL.y], axis=1)
    observed = FieldObservation("theta", MODEL.time, xy, value[:, :, None], np.full(shape, SIGMA), np.ones(shape[:2], dtype=bool), "K")

    def field(p: Parameters) -> np.ndarray:
        return seen(p, MODEL.run(p, MODEL.plastic(p))[:, :, 0])

    def errors(p: Parameters) -> Errors:
        return {"theta": field(p)[:, :, None] - observed.value}

    def linearise(p: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        columns = []
        for name in names:
            h = 1e-4 * param(name).scale
            columns.append((field(p.replace(**{name: p[name] + h})) - field(p.replace(**{name: p[name] - h}))) / (2.0 * h))
        return errors(p), {"theta": np.stack(columns, axis=-1)[:, :, None, :]}

    model = StageModel(errors, (plain(observed),), {"theta": observed}, "", linearise=linearise, missing=StripMissing())
    instruments = frozenset(name for e in known for name in e.names if not name.startswith("stored"))
    return Case(model, BASE.with_free(("kappa", "beta")), known, SPANS, instruments)


def spot(power: float, x0: float, y0: float, when: tuple[float, float], size: float = 3.0) -> Source:
    """A Gaussian spot of that power in mW through the thickness, on between two times."""
    density = power / (2.0 * np.pi * size**2 * THICK)

    def source(x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
        on = float(when[0] <= time < when[1])
        return np.asarray(on * density * np.exp(-0.5 * ((x - x0) ** 2 + (y - y0) ** 2) / size**2))

    return source
