"""Score of dormant effects: what the residual at the optimum says about Params that the model holds at neutral (design section 8).

Everything is whitened: r (n,) residual, J (n, p) columns of all fitted parameters and nuisances, S (n, k) those of a dormant effect. With
J = Q R only s = (I - Q Q^T) S can be told from a change of the fitted parameters. One Gauss-Newton step of the effect is

    a = -(s^T s)^-1 s^T r,   var a = (s^T s)^-1 s^T C s (s^T s)^-1,   predicted drop of r.r = r^T s (s^T s)^-1 s^T r,

C the correlation of the noise. For one Param z = a / sd(a) = -s.r / |s| where C = 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2, norm

from thermofit.core.errors import UntrustworthyError
from thermofit.core.parameters import param
from thermofit.diagnose.held_out import DOUBTLESS, FAR, MOVES, PRACTICAL, SURE, far
from thermofit.fit.linear_model import LinearModel, Room, projection
from thermofit.identify.variables import RECIPROCAL

ALIKE = 0.9
"""|cos| of two effects above which a test cannot tell them apart."""
LEVEL = 0.05
"""Chance that any effect at all passes the threshold where there is none."""
DRAWS, SEED = 20_000, 5
"""Residuals of noise from which that chance is told, and where their random numbers begin."""
OVER_NUMERICAL = 4.0
"""Multiple of what the discretisation error alone would let the square sum fall by."""
CONVINCING = SURE + (SURE**2 + 2.0) ** 0.5
"""|z| from which the held-out error is expected to fall by more than SURE standard errors: (z^2 - 2) / (2 z) > SURE, see `named_from`."""


BEYOND_DOUBT = DOUBTLESS + (DOUBTLESS**2 + 2.0) ** 0.5
"""The same for DOUBTLESS standard errors."""


@dataclass(frozen=True)
class Columns:
    """Linearised problem at the optimum with the columns (n, k) of dormant effects, per unit of the Params that stand before them.

    `groups` (n,) numbers rows that may be correlated with each other, whatever the reason: the variance is never taken smaller than these
    groups show it. `numerical` (n,): error of the discretisation that the correction of the data may have left in them. `channel` (n,):
    number of the channel of each row, -1 of a prior.
    """

    model: LinearModel
    dormant: Mapping[str, tuple[tuple[str, ...], np.ndarray]]
    groups: np.ndarray | None = None
    numerical: np.ndarray | None = None
    also_tried: tuple[np.ndarray, ...] = ()
    """Columns (n, k) that were tried besides, for other exponents: chance had as many more directions to pick from."""
    channel: np.ndarray | None = None
    material: Mapping[int, float] = field(default_factory=dict)
    """Places of columns of parameters of the material, and their values, where it is asked what an effect moves."""

    @cached_property
    def may_be_left(self) -> np.ndarray | None:
        """Error (n,) of mesh and steps that may be left in the residual at the optimum: without the part of it that the fitted parameters
        have taken up, bounds aside. None where it is not known."""
        return None if self.numerical is None else self.model.projected(self.numerical)

    def moves(self, block: np.ndarray, room: Room) -> bool:
        """Whether a step of an effect's columns (n, k) within their room moves a parameter of the material far."""
        places, values = list(self.material), np.array(list(self.material.values()))
        if not places:
            return False
        both = self.model.with_columns(block, room)
        sigma = np.sqrt(np.sum(both.root()[places] ** 2, axis=1))
        return far((both.step.d[: self.model.columns.shape[1]] - self.model.step.d)[places], values, sigma)

    def moving_from(self, block: np.ndarray, sd: float) -> float:
        """Amplitude, of columns (n, k) the first, of standard error `sd`, from which it moves a parameter of the material far; infinite
        where none is asked for."""
        places, values = list(self.material), np.array(list(self.material.values()))
        if not places:
            return float("inf")
        root = self.model.root()
        by = (root @ (self.model.basis.T @ block[:, 0]))[places]
        sigma = np.sqrt(np.sum(root[places] ** 2, axis=1) + (by * sd) ** 2)
        return float(np.min(np.maximum(FAR * sigma, MOVES * np.abs(values)) / np.maximum(np.abs(by), 1e-300)))

    def of_mesh(self, s: np.ndarray) -> tuple[float, bool]:
        """What the error of mesh and steps may leave of r.r in the channel where columns s (n, k) act most, and whether it holds no more
        beyond noise and chance: then nothing that acts there can be told from this error."""
        error = self.may_be_left
        if error is None or self.channel is None:
            return 0.0, False
        acts = np.sum(projection(s).basis ** 2, axis=1)
        of = np.unique(self.channel[self.channel >= 0])
        own = self.channel == max(of, key=lambda k: float(acts[self.channel == k].sum()))
        left, n = self.model.left[own], float(own.sum())
        may_be, chance = float(error[own] @ error[own]), SURE * float(np.sqrt(2.0 * n))
        # Where the declared noise is too large the channel seems to hold less than nothing, which a small error of the mesh does not make.
        return may_be, may_be > chance and float(left @ left) - n + chance < may_be


@dataclass(frozen=True)
class Score:
    """What the residual says of one effect.

    `z` is the normal quantile of its chi-square with as many degrees as Params felt; `estimate`, `sigma` per Param; `predicted_drop` of
    r.r, `numerical_drop` that of the discretisation error alone, all of what it may leave in a channel that holds no more;
    `detectability` |s| / |S| in 0..1; `detectable` the amplitude that is named with even odds, see `named_from`; `vetoed` says in words why
    the estimate cannot be, empty where it can.
    """

    effect: str
    z: float
    predicted_drop: float
    numerical_drop: float
    estimate: Mapping[str, float]
    sigma: Mapping[str, float]
    detectability: float
    detectable: float
    vetoed: str
    family: tuple[str, ...]


@dataclass(frozen=True)
class Ranking:
    """Scores, the strongest first; `threshold` of |z| for all effects together; effects that this test does not feel at all."""

    scores: tuple[Score, ...]
    threshold: float
    unfelt: tuple[str, ...]


def ranked(columns: Columns) -> Ranking:
    """Ranking of all dormant effects; one whose estimate cannot be is in nobody's family.

    UntrustworthyError where the fitted parameters already use up all data.
    """
    n, p = columns.model.columns.shape
    if n <= p:
        raise UntrustworthyError(
            f"diagnosis: {n} residuals and {p} fitted parameters leave nothing to judge; fix parameters or use more data"
        )
    felt = {effect: columns.model.sensitive(block) for effect, (_, block) in columns.dormant.items()}
    own = {effect: s for effect, s in felt.items() if s.shape[1] > 0}
    unfelt = [effect for effect in felt if effect not in own]
    besides = [columns.model.sensitive(block) for block in columns.also_tried]
    threshold = threshold_of([*own.values(), *(s for s in besides if s.shape[1] > 0)])
    alike = likeness(own)
    scores = [_score(columns, effect, *columns.dormant[effect], own[effect], threshold, _family(effect, alike)) for effect in own]
    impossible = {s.effect for s in scores if s.vetoed}
    scores = [replace(s, family=(s.effect, *(other for other in s.family[1:] if other not in impossible))) for s in scores]
    scores.sort(key=lambda s: (bool(s.vetoed), -s.z))
    return Ranking(tuple(scores), threshold, tuple(unfelt))


def drop_of(columns: Columns, names: tuple[str, ...], block: np.ndarray) -> float:
    """Predicted drop of r.r by one effect's columns (n, k); minus one where its estimate is outside the physical bounds or unfelt."""
    score = scored_alone(columns, "", names, block, 0.0)
    return -1.0 if score is None or score.vetoed else score.predicted_drop


def scored_alone(columns: Columns, effect: str, names: tuple[str, ...], block: np.ndarray, threshold: float) -> Score | None:
    """Score of one effect whose Params `names` have these columns (n, k), without its family; None where nothing is felt of it."""
    s = columns.model.sensitive(block)
    return None if s.shape[1] == 0 else _score(columns, effect, names, block, s, threshold, (effect,))


def likeness(own: Mapping[str, np.ndarray], of: Sequence[str] | None = None) -> dict[tuple[str, str], float]:
    """Largest |cos| between any two effects after projection: the cosine of the smallest angle between their column spaces; `of`: only of
    these with all."""
    bases = {effect: projection(s).basis for effect, s in own.items()}
    found = {}
    for one, a in bases.items() if of is None else [(name, bases[name]) for name in of]:
        for other, b in bases.items():
            found[one, other] = float(np.linalg.svd(a.T @ b, compute_uv=False).max(initial=0.0)) if one != other else 1.0
    return found


def projected_likeness(fitted: np.ndarray, blocks: Mapping[str, np.ndarray]) -> dict[tuple[str, str], float]:
    """`likeness` of columns (n, k) of effects after all that the fitted columns (n, p) can take of them."""
    model = projection(fitted)
    return likeness({effect: model.projected(block) for effect, block in blocks.items()})


def indistinguishable(fitted: np.ndarray, own: Mapping[str, Sequence[int]]) -> tuple[str, str, float] | None:
    """The two effects that are most alike, and their |cos|, where it is above ALIKE; None else.

    `fitted` (n, p) are the columns of all fitted parameters, `own` the numbers of those of each effect; the others can take their part.
    """
    taken = {k for columns in own.values() for k in columns}
    others = fitted[:, [k for k in range(fitted.shape[1]) if k not in taken]]
    alike = projected_likeness(others, {effect: fitted[:, list(columns)] for effect, columns in own.items()})
    pairs = [(cos, one, other) for (one, other), cos in alike.items() if one < other]
    cos, one, other = max(pairs, default=(0.0, "", ""))
    return (one, other, cos) if cos > ALIKE else None


def _family(effect: str, alike: Mapping[tuple[str, str], float]) -> tuple[str, ...]:
    others = [other for (one, other), cos in alike.items() if one == effect and other != effect and cos > ALIKE]
    return (effect, *sorted(others, key=lambda other: -alike[effect, other]))


def threshold_of(blocks: Sequence[np.ndarray]) -> float:
    """|z| that the largest of all effects exceeds by chance with probability LEVEL, columns (n, k) of each: the quantile of the largest of
    |U^T g| over the blocks, U an orthonormal basis of each, drawn for DRAWS residuals g of white noise."""
    if not blocks:
        return float(norm.isf(LEVEL / 2.0))
    bases = [projection(b).basis for b in blocks]
    whole = np.concatenate(bases, axis=1)
    values, vectors = np.linalg.eigh(whole.T @ whole)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    along = (root @ np.random.default_rng(SEED).normal(size=(len(root), DRAWS))) ** 2
    largest, at = np.zeros(DRAWS), 0
    for basis in bases:
        degrees = basis.shape[1]
        size = along[at : at + degrees].sum(axis=0)
        at += degrees
        # As unlikely as the |z| of one normal number.
        largest = np.maximum(largest, np.sqrt(size) if degrees == 1 else norm.isf(0.5 * chi2.sf(size, degrees)))
    return float(np.quantile(largest, 1.0 - LEVEL))


def _score(
    columns: Columns, effect: str, names: tuple[str, ...], block: np.ndarray, s: np.ndarray, threshold: float, family: tuple[str, ...]
) -> Score:
    """Score of an effect: `names` of its Params and their columns (n, k), s (n, k) of which are beyond the fitted ones."""
    model = columns.model
    found = model.score(s, columns.groups)
    size = float(found.step @ np.linalg.solve(found.covariance, found.step))
    felt = _felt_names(names, block, s)
    sigma = dict(zip(felt, found.sigma.tolist(), strict=True))
    estimate = {name: _moved(name, float(a)) for name, a in zip(felt, found.step, strict=True)}
    error = columns.may_be_left
    numerical = 0.0 if error is None else found.drop_of(error)
    may_be, hidden = columns.of_mesh(s)
    least = max(numerical, may_be / OVER_NUMERICAL)
    part = float(np.linalg.norm(model.data(s)) / np.linalg.norm(model.data(block)))
    return Score(
        effect=effect,
        z=_normal_quantile(size, len(found.step)),
        predicted_drop=found.drop,
        numerical_drop=max(numerical, may_be) if hidden else numerical,
        estimate=estimate,
        sigma=sigma,
        detectability=part,
        detectable=named_from(
            model, float(found.sigma[0]), float(found.inverse[0, 0]), least, threshold, columns.moving_from(block, float(found.sigma[0]))
        ),
        vetoed=veto(estimate, sigma),
        family=family,
    )


def named_from(model: LinearModel, sd: float, inverse: float, numerical: float, threshold: float, moving: float = np.inf) -> float:
    """Amplitude a of an effect of standard error `sd` that is expected to pass all that an effect has to pass to be named.

    z = a / sd passes the threshold. Held out, r.r falls by k (z^2 - 2), k = sd^2 / `inverse` = 1 for independent noise: a^2 / `inverse`
    that the effect explains, less what predicting the rows and fitting them cost. That is more than SURE of its standard errors 2 k z from
    CONVINCING on; it has to be worth an effect (PRACTICAL, or `moving` on), and more than the error of the discretisation explains.
    """
    k = sd**2 / inverse
    left = model.data(model.left)
    worth = PRACTICAL * float(left @ left)
    z = max(threshold, CONVINCING, min(np.sqrt(worth / k + 2.0), max(BEYOND_DOUBT, moving / sd)), np.sqrt(OVER_NUMERICAL * numerical / k))
    return float(z * sd)


def _moved(name: str, step: float) -> float:
    """The Param after a linear step; of a coefficient that acts by one over it, the step of that: R = 1/x - step/x^2."""
    x = param(name).neutral
    if name not in RECIPROCAL:
        return x + step
    resistance = 1.0 / x - step / x**2
    return 1.0 / resistance if resistance > 0.0 else float("inf")


def _felt_names(names: tuple[str, ...], block: np.ndarray, s: np.ndarray) -> tuple[str, ...]:
    """Names of the columns that remained; a block keeps the order of its names."""
    if s.shape[1] == len(names):
        return names
    kept = [name for name, column in zip(names, block.T, strict=True) if np.any(np.abs(s.T @ column) > 0.0)]
    return tuple(kept[: s.shape[1]])


def _normal_quantile(size: float, degrees: int) -> float:
    """The |z| of a normal number as unlikely as this chi-square."""
    if degrees == 1:
        return float(np.sqrt(size))
    log_p = float(chi2.logsf(size, degrees))
    if log_p > -600.0:
        return float(norm.isf(0.5 * np.exp(log_p)))
    return float(np.sqrt(max(size - 2.0 * degrees * np.log(max(size / degrees, 1.0)), 0.0)))


def veto(estimate: Mapping[str, float], sigma: Mapping[str, float]) -> str:
    """Why an estimate cannot be: outside the physical bounds by more than two standard errors."""
    for name, value in estimate.items():
        p = param(name)
        if value < p.lower - 2.0 * sigma[name] or value > p.upper + 2.0 * sigma[name]:
            return f"{name} would be {value:.3g} {p.unit}, outside {p.lower:g} to {p.upper:g}"
    return ""
