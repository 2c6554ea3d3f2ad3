"""What a specimen that hangs free expands by where it becomes warmer than its run had it.

Thermal strain is alpha_exp (theta - theta_ref) in every direction and adds to the strain that the force makes (4.4). In a specimen that is
pulled by a force nothing holds it back but what is colder at its side. Where that is taken for nothing, the strain of a section is

    de_y = (alpha_exp (1 + g_y) + s_y) dtheta,    du_y(y) = int de_y dy,    du_x = (alpha_exp (1 + g_x) + s_x) dtheta x,

dtheta the mean over the section, y and x where the material is now, from the end that does not move. A section that yields flows further
as it warms, for the force then pulls at the same area of a longer piece, and its yield stress may fall. Of a bar,
P e^(e + alpha_exp dtheta) = tau(e, theta) with the nominal stress P gives g_y = P / (dP/de) and s_y = -e^-e (dtau/dtheta) / (dP/de), which
are large where the force hardly grows. Both are those of the run (`Flow`). What has flowed stays where the section flows no longer, and
follows dtheta again where it does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.body.body import Body
from thermofit.body.sensitivity.march import Sensitivities
from thermofit.body.solve.history import State, Watch
from thermofit.point.state import LAMBDA

DIGITS = 6
"""Digits of a mm by which nodes are on different sections."""
LEAST_NODES = 4
"""Nodes of a section of a mesh of bricks at least; a mesh with fewer at one height has no sections."""

ALONG = ("theta_ref", "theta_air", "theta_clamp")
"""What a run is differentiated along: with all of them higher a specimen is warmer by as much."""


@dataclass(frozen=True)
class CrossSections:
    """Sections of a mesh along the load: `of` (n_np,) the number of that of every node, upwards, and the number of nodes (n,) of each;
    `between` (n_el,) the number of the piece between two of them that an element belongs to."""

    of: np.ndarray
    count: np.ndarray
    between: np.ndarray

    def mean(self, nodal: np.ndarray) -> np.ndarray:
        """Means (n, m) over the sections of nodal values (n_np, m)."""
        order = np.argsort(self.of, kind="stable")
        first = np.append(0, np.cumsum(self.count)[:-1])
        return np.asarray(np.add.reduceat(nodal[order], first, axis=0) / self.count[:, None])

    def lengths(self, position: np.ndarray) -> np.ndarray:
        """Lengths (n - 1,) mm of the pieces, of nodes that are at `position` (n_np, 3) mm."""
        return np.diff(self.mean(position[:, 1:2])[:, 0])

    def flows(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Whether anything in a piece flows (n - 1,) between two accumulated multipliers (n_el, 8)."""
        grown = np.bincount(self.between, (after - before).max(axis=1), minlength=len(self.count) - 1)
        return np.asarray(grown > 0.0)


@dataclass(frozen=True)
class Flow:
    """How much further a specimen flows as it warms, at the times of its run: `along` (2, n_t, n - 1) g_y and s_y in 1/K of the pieces
    between sections, `across` (2, n_t, n) g_x and s_x of the sections, and whether a piece flows (n_t, n - 1) in the step that ends there.
    """

    along: np.ndarray
    across: np.ndarray
    flowing: np.ndarray

    @property
    def at_sections(self) -> np.ndarray:
        """Whether a section flows (n_t, n): a piece on either side does."""
        still = np.zeros((len(self.flowing), 1), dtype=bool)
        return np.concatenate([self.flowing, still], axis=1) | np.concatenate([still, self.flowing], axis=1)

    @property
    def last(self) -> np.ndarray:
        """Whether something flows in a step (n_t,) that does not in the next one: what has flowed there stays."""
        nothing = np.zeros((1, self.flowing.shape[1]), dtype=bool)
        return np.asarray((self.flowing & ~np.concatenate([self.flowing[1:], nothing])).any(axis=1))


class FlowOfRun:
    """Collects the `Flow` of a run that is differentiated along theta_ref, the temperature of air and that of the jaws. With all three 1 K
    higher a specimen is 1 K warmer at all times and expands no more; with theta_ref 1 K lower it expands as one that is warmer."""

    def __init__(self, sections: CrossSections, position: np.ndarray, alpha_exp: float, n_times: int) -> None:
        """`position` (n_np, 3) mm of the nodes at rest."""
        n = len(sections.count)
        self._sections, self._position, self._alpha = sections, position, alpha_exp
        self.flow = Flow(np.zeros((2, n_times, n - 1)), np.zeros((2, n_times, n)), np.zeros((n_times, n - 1), dtype=bool))
        self._accumulated = np.zeros(0)

    @property
    def watch(self) -> Watch:
        """What has a run collected."""
        return Watch(sensitivities=Sensitivities(ALONG, lambda n, at: None), state=self._passed)

    def _passed(self, n: int, state: State) -> None:
        """Take the state at recorded time n."""
        accumulated = state.points[:, :, LAMBDA].copy()
        if n > 0:
            self.flow.flowing[n] = self._sections.flows(self._accumulated, accumulated)
        self._accumulated = accumulated
        assert state.rates is not None, "the run is differentiated"
        there, rates, every = self._position + state.u, state.rates, slice(len(ALONG))
        warmer = self._sections.mean(rates.theta[:, every].sum(axis=1)[:, None])[:, 0]
        longer, wider = self._strains(there, rates.u[:, :2, every].sum(axis=2))
        self.flow.along[1, n], self.flow.across[1, n] = longer / (0.5 * (warmer[1:] + warmer[:-1])), wider / warmer
        if self._alpha > 0.0:
            longer, wider = self._strains(there, -rates.u[:, :2, ALONG.index("theta_ref")])
            self.flow.along[0, n], self.flow.across[0, n] = longer / self._alpha - 1.0, wider / self._alpha - 1.0

    def _strains(self, there: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Strains (n - 1,) of the pieces and (n,) across the sections by what moves nodes that are there (n_np, 3), (n_np, 2)."""
        longer = np.diff(self._sections.mean(moved[:, 1:])[:, 0]) / self._sections.lengths(there)
        wide = self._sections.mean(there[:, :1] ** 2)[:, 0]
        return longer, self._sections.mean(moved[:, :1] * there[:, :1])[:, 0] / wide


class Expansion:
    """Displacements of a specimen that warms beside its run, time after time."""

    def __init__(self, sections: CrossSections, flow: Flow, alpha_exp: float) -> None:
        self._sections, self._flow, self._alpha = sections, flow, alpha_exp
        self._longer, self._wider = (alpha_exp * of[0] + of[1] for of in (flow.along, flow.across))
        self._at_sections = flow.at_sections
        self.last = flow.last
        self._along: np.ndarray | float = 0.0
        self._across: np.ndarray | float = 0.0

    def at(self, n: int, position: np.ndarray, warmer: np.ndarray) -> np.ndarray:
        """Displacements (n_np, 3, m) mm at recorded time n by temperatures (n_np, m) K that are added, of nodes that are at `position`
        (n_np, 3) mm. Times are passed in their order."""
        mean = self._sections.mean(warmer)
        between = 0.5 * (mean[1:] + mean[:-1])
        self._along = np.where(self._flow.flowing[n][:, None], self._longer[n][:, None] * between, self._along)
        self._across = np.where(self._at_sections[n][:, None], self._wider[n][:, None] * mean, self._across)
        longer = (self._alpha * between + self._along) * self._sections.lengths(position)[:, None]
        along = np.concatenate([np.zeros((1, longer.shape[1])), np.cumsum(longer, axis=0)])
        out = np.zeros((len(position), 3, warmer.shape[1]))
        out[:, 1] = along[self._sections.of]
        out[:, 0] = (self._alpha * mean + self._across)[self._sections.of] * position[:, :1]
        return out


def sections_of(body: Body) -> CrossSections | None:
    """The sections of a mesh that is made of rows across the load; None of one that is not."""
    _, of, count = np.unique(np.round(body.mesh.nodes[:, 1], DIGITS), return_inverse=True, return_counts=True)
    if count.min() < LEAST_NODES:
        return None
    return CrossSections(of, count, of[body.mesh.hexes].min(axis=1))
