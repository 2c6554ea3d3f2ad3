"""Which fitted parameter wants to change with what: a hint at what is missing that needs no catalogue.

The column J of a parameter, restricted to the rows of a block of a state variable v, is what the parameter would do if it were another one
there. So J (v - v_0) is what it would do if it changed linearly with v. With s what of that no change of all fitted parameters could do,

    slope = -s.r / s.s,   z = slope / sd,

and the variance is never taken smaller than blocks of time and length show it (`LinearModel.score`). All columns exist: no model is run.
A drift is told where its chance, corrected for the number of pairs asked, is below LEVEL, where it lowers the error on held-out data, and
where the error of mesh and steps alone would not make it. The one that explains most is told first; the others are asked beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from thermofit.core.parameters import param
from thermofit.diagnose.held_out import proof
from thermofit.diagnose.score import ALIKE, OVER_NUMERICAL
from thermofit.diagnose.trace import Traced
from thermofit.experiment.row_states import VARIABLES
from thermofit.fit.linear_model import LinearModel

LEVEL = 0.01
"""Chance that any pair of a parameter and a variable is told where nothing drifts."""
SHARE = 0.1
"""Part of the fall of the square sum that the first drift makes, below which a further one is not told. What a linear step leaves of a
large one looks like others."""
AS_MUCH = 0.9
"""Part of the fall of the strongest that one which is not told apart from it explains as well."""
MOST = 3
"""Drifts that are told at most."""
BLOCKS = 4
"""Blocks of a variable in which a drifting parameter is given, of equal information on it."""
_OWN = 0.05
"""Part of its column that a drift must have for itself beside the fitted parameters."""
_SPREAD: Mapping[str, float] = {"time": 0.0, "plastic strain": 1e-4, "rate": 0.2, "temperature": 0.2, "place y": 0.0}
"""Standard deviation over the rows that tell a parameter from which a variable is one: with less there is one rate, one temperature."""
_WORDS: Mapping[str, str] = {
    "time": "time",
    "plastic strain": "plastic strain",
    "rate": "the rate",
    "temperature": "temperature",
    "place y": "the place y",
}


@dataclass(frozen=True)
class Drift:
    """A parameter that wants to change with a variable: slope and standard error in its unit per unit of the variable (the rate: per
    e-fold), z, chance by luck corrected for all that was asked; `alike`: (parameter, variable) that these data do not tell from it;
    `blocks`: centre of the variable, the parameter there as a one-step estimate and its standard error."""

    parameter: str
    variable: str
    slope: float
    sigma: float
    z: float
    chance: float
    alike: tuple[tuple[str, str], ...]
    blocks: tuple[tuple[float, float, float], ...]

    @property
    def unit(self) -> str:
        """Unit of the slope."""
        per = VARIABLES[self.variable]
        return param(self.parameter).unit if per == "1" else f"{param(self.parameter).unit} per {per}"

    @property
    def words(self) -> str:
        """The drift in one clause."""
        return f"{self.parameter} wants to {'rise' if self.slope > 0.0 else 'fall'} with {_WORDS[self.variable]}"


@dataclass(frozen=True)
class Drifts:
    """What drifts, the strongest first, and how many pairs of a parameter and a variable were asked."""

    found: tuple[Drift, ...]
    asked: int


@dataclass(frozen=True, eq=False)
class _Asked:
    parameter: str
    variable: str
    column: np.ndarray
    """Column (n,) for one standard deviation of the variable."""
    spread: float


def drifts(here: Traced, states: Mapping[str, np.ndarray]) -> Drifts:
    """The drifts of a traced case; `states`: by variable its value at every row (n,), nan where it has none (`row_states`)."""
    asked = _asked(here, states)
    model = here.problem.model
    found: list[Drift] = []
    left, largest = list(asked), 0.0
    while left and len(found) < MOST:
        scored = [(a, *_scored(here, model, a)) for a in left]
        told = [
            (a, z, step, sigma, drop)
            for a, z, step, sigma, drop, numerical in scored
            if _stands(z, len(asked)) and drop > OVER_NUMERICAL * numerical
        ]
        told = [t for t in sorted(told, key=lambda t: -t[4]) if t[4] >= SHARE * largest]
        first = next((t for t in told if _proved(here, model, t[0])), None)
        if first is None:
            break
        # Of those that explain as much, and that these data do not tell apart, the plainest is named.
        peers = [t for t in told if t[4] >= AS_MUCH * first[4] and (t is first or _cosine(model, first[0], t[0]) > ALIKE)]
        one, z, step, sigma, drop = min(peers, key=lambda t: _plainness(here, t[0]))
        left.remove(one)
        alike = tuple((a.parameter, a.variable) for a in left if _cosine(model, one, a) > ALIKE)
        blocks = _blocks(here, one, states[one.variable])
        found.append(Drift(one.parameter, one.variable, step / one.spread, sigma / one.spread, z, _chance(z, len(asked)), alike, blocks))
        model, largest = model.with_columns(one.column[:, None]), max(largest, drop)
    return Drifts(tuple(found), len(asked))


def _asked(here: Traced, states: Mapping[str, np.ndarray]) -> list[_Asked]:
    """Pairs of which these data tell something beside the fitted parameters."""
    model, out = here.problem.model, []
    for k, name in enumerate(here.case.parameters.free):
        if name in here.case.pose:
            continue
        column = model.columns[:, k]
        for variable in VARIABLES:
            v = states[variable]
            known = np.isfinite(v)
            weight = np.where(known, column**2, 0.0)
            if not weight.sum() > 0.0:
                continue
            mean = float(weight @ np.where(known, v, 0.0) / weight.sum())
            spread = float(np.sqrt(weight @ np.where(known, v - mean, 0.0) ** 2 / weight.sum()))
            if not spread > max(_SPREAD[variable], 1e-12):
                continue
            own = column * np.where(known, (v - mean) / spread, 0.0)
            if np.linalg.norm(model.projected(own)) > _OWN * np.linalg.norm(own):
                out.append(_Asked(name, variable, own, spread))
    return out


def _chance(z: float, asked: int) -> float:
    """Chance that the largest of so many |z| is that large."""
    return float(-np.expm1(asked * np.log1p(-min(2.0 * norm.sf(abs(z)), 1.0 - 1e-16))))


def _stands(z: float, asked: int) -> bool:
    """True where chance does not make it."""
    return _chance(z, asked) < LEVEL


def _plainness(here: Traced, one: _Asked) -> tuple[int, int]:
    """Place of the variable, then of the parameter in the fit: the smaller the plainer."""
    return list(VARIABLES).index(one.variable), here.case.parameters.free.index(one.parameter)


def _scored(here: Traced, model: LinearModel, one: _Asked) -> tuple[float, float, float, float, float]:
    """z, step, standard error, fall of the square sum, and that which the error of mesh and steps alone would make."""
    s = model.projected(one.column)[:, None]
    if np.linalg.norm(s) <= _OWN * np.linalg.norm(one.column):
        return 0.0, 0.0, 1.0, 0.0, 0.0
    scored = model.score(s, here.problem.groups)
    error = here.problem.may_be_left
    step, sigma = float(scored.step[0]), float(scored.sigma[0])
    return step / sigma, step, sigma, scored.drop, 0.0 if error is None else scored.drop_of(error)


def _proved(here: Traced, model: LinearModel, one: _Asked) -> bool:
    """True where the drift lowers the error on held-out data."""
    anywhere = np.array([-np.inf]), np.array([np.inf])
    return proof(model, one.column[:, None], anywhere, here.rows, here.split).convinces


def _cosine(model: LinearModel, one: _Asked, other: _Asked) -> float:
    a, b = model.projected(one.column), model.projected(other.column)
    return float(abs(a @ b) / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def _blocks(here: Traced, one: _Asked, v: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    """One-step estimates of the parameter in blocks of the variable, beside all other fitted ones."""
    model, names = here.problem.model, here.case.parameters.free
    k = names.index(one.parameter)
    column = model.columns[:, k]
    known = np.isfinite(v) & (column != 0.0)
    order = np.argsort(v[known], kind="stable")
    share = np.cumsum(column[known][order] ** 2)
    edges = [float(v[known][order][np.searchsorted(share, share[-1] * b / BLOCKS)]) for b in range(1, BLOCKS)]
    label = np.where(known, np.searchsorted(edges, np.where(known, v, 0.0), side="right"), -1)
    columns, centres = [], []
    for b in range(BLOCKS):
        own = label == b
        if own.any():
            columns.append(np.where(own, column, 0.0))
            centres.append(float(np.average(v[own], weights=column[own] ** 2)))
    # Rows without a value of the variable keep the parameter of the fit.
    others = model.only([i for i in range(len(names)) if i != k])
    felt = others.sensitive(np.stack(columns, axis=1))
    if felt.shape[1] != len(columns):
        return ()
    found = others.score(felt, here.problem.groups)
    value = here.case.parameters[one.parameter]
    return tuple((c, value + float(s), float(e)) for c, s, e in zip(centres, found.step, found.sigma, strict=True))
