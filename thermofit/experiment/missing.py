"""Terms that no law names: hat functions over place and time, and what the fitted model would show of each of them.

A missing heat source q(x, y, t), displacement or stress is sought as a sum of hats. Its answer is linear: by back-substitution with the
conduction of the fitted model where it is a heat source, the hat itself where it is what an instrument shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import norm

from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_records import CouponTest


@dataclass(frozen=True)
class Kind:
    """A kind of missing term: the unit of its coefficients and what it is in words. `alike`: where one is that is the same everywhere (the
    "surface" that is free, the "jaws" or the "image" of a camera), and `which` of them; empty: it has places, or is that of a record.
    `drifts`: it never jumps, as jaws and cameras that warm up; a constant part of one is taken by other parameters. `about`: it grows from
    a height at which it is nothing, the one knot of its grid in y. `from_rest`: it is nothing at the first time, from which displacements
    are measured."""

    unit: str
    words: str
    alike: str = ""
    which: str = "all"
    drifts: bool = False
    about: bool = False
    from_rest: bool = False


KINDS: Mapping[str, Kind] = {
    "heat": Kind("mW/mm^3", "heat source"),
    "displacement": Kind("mm", "displacement"),
    "stress": Kind("MPa", "stress"),
    "flux": Kind("mW/mm^2", "heat through the free surface", "surface"),
    "film": Kind("W/(m^2 K)", "change of the film coefficient", "surface"),
    "jaws": Kind("K", "change of the temperature of the jaws", "jaws", drifts=True),
    "jaw_upper": Kind("K", "change of the temperature of the upper jaw", "jaws", "upper", drifts=True),
    "jaw_lower": Kind("K", "change of the temperature of the lower jaw", "jaws", "lower", drifts=True),
    "offset": Kind("K", "offset of the infrared camera", "image"),
    "gradient": Kind("mK/mm", "offset of the infrared camera along the load", "image", drifts=True, about=True),
    "clock": Kind("s", "error of the clock of temperatures", "image", drifts=True),
    "strain": Kind("mm/m", "apparent strain of the displacement cameras", "image", drifts=True, from_rest=True),
    "scale": Kind("mm/m", "error of the scale of displacements", "image", drifts=True, from_rest=True),
}
"""All kinds of terms that any model may lack."""


@dataclass(frozen=True)
class Grid:
    """Knots of hats: `time` s (n_k,) with the number `part` (n_k,) of the record that each belongs to, `x` and `y` mm over the face.

    A coupon has one place. `components` is 2 for displacements. Coefficients are ordered (n_k, n_y, n_x, components). With a `spread` s mm
    the one place is the normal density exp(-((y - y_0) / s)^2 / 2) / (sqrt(2 pi) s) 1/mm about the one knot y_0, in the stead of a hat.
    One that travels lies higher by `along` (n_k,) mm at each knot in time. Of a film, what its hats do is that beside changes of `level`
    (n_k,) W/(m^2 K) that are there; None: beside none.
    """

    time: np.ndarray
    part: np.ndarray
    x: np.ndarray
    y: np.ndarray
    components: int = 1
    spread: float = 0.0
    along: np.ndarray | None = None
    level: np.ndarray | None = None

    @property
    def heights(self) -> np.ndarray:
        """Middle of the place in mm: (1,), or (n_k,) where it travels."""
        return self.y if self.along is None else self.y[0] + self.along

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Numbers of hats in time, y, x, and of components."""
        return len(self.time), len(self.y), len(self.x), self.components

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(np.prod(self.shape))

    @property
    def places(self) -> int:
        """Number of hats over the face."""
        return len(self.y) * len(self.x)


def hats(knots: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (..., n) of the hats at increasing knots (n,); one knot stands for everywhere, beyond the last ones there is nothing."""
    if len(knots) == 1:
        return np.ones((*at.shape, 1))
    rows = np.eye(len(knots))
    return np.stack([np.interp(at, knots, row, left=0.0, right=0.0) for row in rows], axis=-1)


def time_hats(grid: Grid, time: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Values (n_t, n_k) of the hats in time; `part` (n_t,) is the record of every time."""
    out = np.zeros((len(time), len(grid.time)))
    for record in np.unique(grid.part):
        own, here = grid.part == record, part == record
        out[np.ix_(here, own)] = hats(grid.time[own], time[here])
    return out


def place_hats(grid: Grid, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values (..., n_y n_x) of the hats over the face, x beyond the last knot counts as that; with a spread, of the place, (..., n_k) where
    it travels."""
    if grid.spread:
        return np.asarray(norm.pdf(y[..., None], grid.heights, grid.spread))
    across = hats(grid.x, np.clip(x, grid.x[0], grid.x[-1]))
    along = hats(grid.y, y)
    return np.asarray((along[..., :, None] * across[..., None, :]).reshape(*along.shape[:-1], grid.places))


def spot_values(grid: Grid, low: np.ndarray, high: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values (n_el, n_q, 1) in 1/mm at points of integration y (n_el, n_q) of the place p(y) of a grid with a spread, (n_el, n_q, n_k) of
    one that travels, in elements between heights low and high (n_el,) mm: the straight line with its zeroth and first moments there,

        v = m_0 / 2 + 3/2 xi m_1,   m_k = int_-1^1 xi^k p(c + h xi) d xi,   xi = (y - c) / h,

    c the middle and h half of the height. So what is smaller than an element has the nodal heat of its own density.
    """
    c, h = 0.5 * (low + high)[:, None], 0.5 * (high - low)[:, None]
    off, s = grid.heights - c, grid.spread
    a, b = ((end[:, None] - grid.heights) / s for end in (low, high))
    power = norm.cdf(b) - norm.cdf(a)
    zeroth, first = power / h, (off * power - s * (norm.pdf(b) - norm.pdf(a))) / h**2
    xi = (y - c) / h
    return np.asarray(0.5 * zeroth[:, None] + 1.5 * xi[..., None] * first[:, None])


@dataclass(frozen=True)
class MissingTerm:
    """A term that a model lacks: its kind, the chosen hats (m,) of a grid and their coefficients (m,)."""

    kind: str
    grid: Grid
    chosen: np.ndarray
    amount: np.ndarray

    def by_units(self, missing: Missing, parameters: Parameters) -> Mapping[str, np.ndarray]:
        """What unit coefficients add to observed fields (n_t, n_s, n_c, m) by a model at parameters."""
        return missing.answers(self.kind, parameters, self.grid, self.chosen)

    def shown(self, missing: Missing, parameters: Parameters) -> Mapping[str, np.ndarray]:
        """What it adds to observed fields (n_t, n_s, n_c, 1) by a model at parameters."""
        return missing.answers(self.kind, parameters, self.grid, self.chosen, self.amount)


class YieldTerms(Protocol):
    """What a missing stress shows where it is a step of the yield stress over a state variable."""

    def yielding(self, parameters: Parameters, variable: str, edges: np.ndarray, width: float) -> np.ndarray:
        """Change (n_t, 1, 1, m) of the stress by steps of one MPa at edges (m,) of a state variable, all of one width."""

    def yield_variables(self, parameters: Parameters, variable: str) -> np.ndarray:
        """Values (n,) of a state variable wherever the material flows."""


class Missing(Protocol):
    """What a model knows of terms that it lacks, by their `KINDS`: a flux is one per current area, and a strain or a scale that of what the
    displacement cameras say of all lengths, or of displacements."""

    @property
    def records(self) -> tuple[CouponTest, ...]:
        """The records of the point driver behind it, by the number `part` of a grid; empty where a term has a place on a specimen."""

    @property
    def offsets(self) -> np.ndarray:
        """What was added to the time of each record (n_records,) s."""

    @property
    def folded(self) -> bool:
        """True where the model is one half in x: a source stands on both sides."""

    @property
    def of_yield(self) -> YieldTerms | None:
        """What it knows of the yield stress; None where stresses are not what is shown."""

    @property
    def kinds(self) -> Mapping[str, str]:
        """Kind by the observed field that shows it."""

    @property
    def of_instruments(self) -> Mapping[str, tuple[str, ...]]:
        """Kinds by the observed field of what its instrument may add to it: the same wherever it looks, and any history over time."""

    @property
    def of_surface(self) -> Mapping[str, tuple[str, ...]]:
        """Kinds by the observed field of what may come through the surface of a body, all that is free of it alike or from its jaws, with
        any history over time."""

    def grid(self, kind: str, counts: tuple[int, int, int]) -> Grid:
        """Hats over all that is observed, about `counts` of them in time, y and x."""

    def everywhere(self, counts: tuple[int, int]) -> Grid | None:
        """Hats of a heat source over the whole specimen, beyond what is observed too, `counts` of them in time and in y where it is
        observed; None where a term has no place on a specimen."""

    def spot(self, count: int) -> Grid | None:
        """A spot of heat in the middle of what is observed, with `count` hats in time and the least spread that the mesh shows; None where
        a term has no place on a specimen."""

    def answers(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray | None = None
    ) -> Mapping[str, np.ndarray]:
        """Change (n_t, n_s, n_c, m) by unit coefficients of the m chosen hats of the observed field that shows the kind, and of others that
        feel it, by field; (n_t, n_s, n_c, 1) by an `amount` (m,) of each, which costs one of them."""

    def slopes(
        self, kind: str, parameters: Parameters, grid: Grid, chosen: np.ndarray, amount: np.ndarray, names: Sequence[str]
    ) -> Mapping[str, np.ndarray]:
        """Derivatives (n_t, n_s, n_c, n) along the named parameters of what the term with these coefficients (m,) adds to observed fields;
        none where they are nothing or not known."""

    def volumes(self, grid: Grid) -> np.ndarray | None:
        """Volume (n_places,) mm^3 of the specimen under each hat over the face; None where it is not known (coupons)."""

    def states(self, parameters: Parameters, grid: Grid) -> Mapping[str, np.ndarray]:
        """State variables (n_k, n_places) at the knots, by name."""
