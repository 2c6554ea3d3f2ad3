"""Data that the fit did not see: folds of whole load phases, else buffered blocks of space and time; never random pixels.

A fold is predicted from the others by the linearised model: the parameters move by the Gauss-Newton step of the rows that are seen,
J_seen x = -r_seen, and the rows that are not seen change to r + J x. So a proof costs linear algebra only; what is accepted is refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.fit.linear_model import Fold, LinearModel, Room, projection

SURE = 2.0
"""Standard errors by which held-out error has to fall."""
PRACTICAL = 3e-3
"""Least relative fall of the held-out mean square that is worth an effect."""
FAR, MOVES = 5.0, 0.02
"""Standard errors beside an effect, and part of its value, by which a parameter of the material moves far. The effect is then worth it,
however little it takes of the error. An unloading is a small part of a test, and may tell the modulus."""
DOUBTLESS = 4.0
"""Standard errors by which held-out error has to fall for that: an error of the mesh is small, and moves parameters as well."""
LEAST_SEEN = 0.2
"""Share of what all rows tell of a direction of the parameters that the rows which a fold sees must tell. A step that they ask for then
changes held-out rows by no more than twice what it changes theirs."""
FEWEST = 5
"""Blocks of time of a record or experiment at least: one for each fold."""


@dataclass(frozen=True)
class Rows:
    """Where every residual row is from (n,): channel number, time s, point position mm (n, 2), load phase number."""

    channel: np.ndarray
    time: np.ndarray
    xy: np.ndarray
    phase: np.ndarray


@dataclass(frozen=True)
class Split:
    """Folds: True where a row is held out, and where it is too near to that to be seen; `by` says in words what was held out."""

    held_out: tuple[np.ndarray, ...]
    buffer: tuple[np.ndarray, ...]
    by: str

    @property
    def folds(self) -> list[Fold]:
        """Rows that are held out and rows that are not seen of every fold."""
        hidden = [held | near for held, near in zip(self.held_out, self.buffer, strict=True)]
        return list(zip(self.held_out, hidden, strict=True))


def split_by_phase(rows: Rows, names: Sequence[str], buffer_s: float) -> Split | None:
    """One fold per load phase in which every channel is compared; None where there are fewer than two."""
    phases = [k for k in range(len(names)) if np.any(rows.phase == k)]
    if len(phases) < 2:
        return None
    held, near = [], []
    for k in phases:
        out = rows.phase == k
        t0, t1 = float(rows.time[out].min()), float(rows.time[out].max())
        held.append(out)
        near.append(~out & (rows.time > t0 - buffer_s) & (rows.time < t1 + buffer_s))
    return Split(tuple(held), tuple(near), "load phases " + ", ".join(names[k] for k in phases))


def split_by_blocks(
    rows: Rows,
    shape: tuple[int, int],
    buffer: tuple[float, float],
    folds: int = 5,
    weight: np.ndarray | None = None,
    clock: str = "s",
    *,
    part: np.ndarray | None = None,
    fitted: np.ndarray | None = None,
    memory: float = 0.0,
) -> Split:
    """Blocks of time and of length along the load, `shape` = (in time, in y), dealt out to folds as on a chess board with a shift.

    `buffer` = (s, mm): rows nearer than that to a held-out block are not seen either; `clock` is the unit of their times. Blocks of time
    hold equal shares of `weight` (n,), which says how much every row tells of the parameters: else a short phase that tells most would be
    one block.

    `part` (n,) numbers the records or experiments that rows are of. Blocks and their buffers do not reach from one into another, all parts
    have about `shape[0]` together, FEWEST each at least, buffers as much shorter as the blocks, and every part deals them out one fold
    later than the one before: of equal records no fold holds out the same phase.

    `memory`: time over which the noise of neighbours is alike. Buffers in time are not shorter, up to half of a block.

    `fitted` (n, p): columns of the fitted parameters. A fold sees LEAST_SEEN of what all rows tell of every direction of them at least; the
    blocks that tell most of a direction which a fold would lose are never held out.
    """
    n_t, n_y = shape
    number = np.zeros(len(rows.time), dtype=int) if part is None else np.unique(part, return_inverse=True)[1]
    parts = int(number.max(initial=0)) + 1
    each = n_t if parts == 1 else max(-(-n_t // parts), FEWEST)
    y, span = rows.xy[:, 1], float(np.ptp(rows.time))
    y_edges = np.linspace(y.min() - 1e-9, y.max() + 1e-9, n_y + 1)
    j = np.clip(np.searchsorted(y_edges, y, side="right") - 1, 0, n_y - 1)
    blocks: list[_Block] = []
    near_by = []
    for k in range(parts):
        own = number == k
        t = rows.time[own]
        edges = _edges_of_time(t, None if weight is None else weight[own], each)
        i = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, each - 1)
        reach = buffer[0] * (float(np.ptp(t)) / each) / (span / n_t) if span > 0.0 else 0.0
        reach = max(reach, min(memory, 0.5 * float(np.ptp(t)) / each))
        near_by.append(reach)
        for a, b in sorted({(int(a), int(b)) for a, b in zip(i, j[own], strict=True)}):
            inside = np.zeros(len(own), dtype=bool)
            inside[own] = (i == a) & (j[own] == b)
            close = own & (rows.time > edges[a] - reach) & (rows.time < edges[a + 1] + reach)
            close &= (y > y_edges[b] - buffer[1]) & (y < y_edges[b + 1] + buffer[1])
            blocks.append(_Block((a + 2 * b + k) % folds, inside, close))
    left, kept = _predictable(blocks, folds, fitted)
    held = [_any(len(y), [b.inside for b in left if b.fold == f]) for f in range(folds)]
    near = [_any(len(y), [b.close for b in left if b.fold == f]) & ~out for f, out in enumerate(held)]
    whole = f"{each} x {n_y} blocks of time and length" + (f" of each of {parts} tests" if parts > 1 else "")
    seen = f", {kept} of {len(blocks)} blocks never held out, because a parameter rests on them" if kept else ""
    return Split(tuple(held), tuple(near), f"{whole}, {folds} folds{seen}, buffers {max(near_by):.3g} {clock} and {buffer[1]:.3g} mm")


@dataclass(frozen=True, eq=False)
class _Block:
    """A block: the fold that holds it out, its rows (n,), and those within its buffer (n,)."""

    fold: int
    inside: np.ndarray
    close: np.ndarray


def _any(n: int, masks: Sequence[np.ndarray]) -> np.ndarray:
    return np.logical_or.reduce(masks) if masks else np.zeros(n, dtype=bool)


def _edges_of_time(time: np.ndarray, weight: np.ndarray | None, count: int) -> np.ndarray:
    """Edges (count + 1,) of blocks of time that hold equal shares of the weight (n,); of the rows where none has any."""
    order = np.argsort(time, kind="stable")
    share = np.cumsum((np.ones(len(time)) if weight is None or not np.any(weight) else weight)[order])
    inner = np.interp(np.linspace(0.0, share[-1], count + 1)[1:-1], share, time[order])
    return np.concatenate([[time.min()], inner, [time.max()]])


def _predictable(blocks: Sequence[_Block], folds: int, fitted: np.ndarray | None) -> tuple[list[_Block], int]:
    """The blocks that are held out, and how many are not because a fold without them would lose a direction of the parameters.

    With Q an orthonormal basis of the fitted columns, hidden rows H of a fold tell the share v^T Q_H^T Q_H v of a direction v (leverage).
    """
    if fitted is None or fitted.shape[1] == 0:
        return list(blocks), 0
    basis = projection(fitted).basis
    left, kept = [], 0
    for fold in range(folds):
        own = [b for b in blocks if b.fold == fold]
        while own:
            hidden = basis[_any(len(basis), [b.close | b.inside for b in own])]
            values, vectors = np.linalg.eigh(hidden.T @ hidden)
            if values[-1] <= 1.0 - LEAST_SEEN:
                break
            told = basis @ vectors[:, -1]
            own.remove(max(own, key=lambda b: float(np.sum(told[b.inside | b.close] ** 2))))
            kept += 1
        left += own
    return left, kept


def restricted(split: Split, mine: np.ndarray) -> Split:
    """The same folds of those rows alone where `mine` (n,) is True."""
    return Split(tuple(held[mine] for held in split.held_out), tuple(near[mine] for near in split.buffer), split.by)


@dataclass(frozen=True)
class Proof:
    """Held-out mean squares of whitened residuals without and with an effect: overall, per channel, and the gain with its spread.

    `gain` is (without - with) / without; `sigma` its standard error, see `compared`.
    """

    without: float
    with_effect: float
    by_channel: dict[int, tuple[float, float]]
    gain: float
    sigma: float
    folds: int
    on: str = ""
    """The held-out tests that say so; empty: rows of the fitted ones."""
    moves: bool = False
    """Whether the effect moves a parameter of the material `far`, beside nothing else that was added."""

    @property
    def convinces(self) -> bool:
        """True where the held-out error falls by more than its uncertainty, and by what is worth an effect; or beyond doubt, where the
        effect `moves` what the test is made for."""
        worth = self.gain > max(SURE * self.sigma, PRACTICAL)
        return worth or (self.moves and self.gain > DOUBTLESS * self.sigma)

    def not_less_than(self, other: Proof) -> bool:
        """True where this gain is below another one by no more than the standard errors of both: as if they were independent, which is too
        much for gains on the same rows."""
        return other.gain - self.gain <= float(np.hypot(self.sigma, other.sigma))

    @property
    def words(self) -> str:
        """By how much the held-out error falls or rises."""
        where = f" on {self.on}" if self.on else ""
        if self.gain < -1.0:
            return f"held-out error{where} rises to {1.0 - self.gain:.3g} times as much"
        way = "rises" if self.gain < 0.0 else "falls"
        return f"held-out error{where} {way} by {100 * abs(self.gain):.2f} % +- {100 * self.sigma:.2f} %"


def far(by: np.ndarray, value: np.ndarray, sigma: np.ndarray) -> bool:
    """Whether one of parameters of these values (p,) moves far: by more than FAR of its standard errors (p,) and MOVES of its value."""
    return bool(np.any(np.abs(by) > np.maximum(FAR * sigma, MOVES * np.abs(value))))


Noise = Callable[[np.ndarray], np.ndarray]


def proof(model: LinearModel, effect: np.ndarray, room: Room, rows: Rows, split: Split) -> Proof:
    """Held-out error of the fitted parameters without and with an effect by linear algebra: its columns (n, k) and their room."""
    whole = model.with_columns(effect, room)
    before, after = model.predicted(split.folds), whole.predicted(split.folds)
    return compared(before, after, rows, len(split.held_out), model.noise, whole.remaining)


def compared(
    before: np.ndarray, after: np.ndarray, rows: Rows, folds: int, noise: Noise | None = None, left: np.ndarray | None = None
) -> Proof:
    """Proof from held-out residuals (n,) without and with an effect, nan in rows that were never held out.

    With d the change that the effect makes of them, |r|^2 falls by -2 (r + d).d + d.d. Its standard error has two bounds from above, and
    the smaller is taken. In the one r + d, what is left, is noise: that of 2 (r + d).d, from the correlation of the noise (`noise` applies
    it to columns (n, k); None: independent) or from what groups of rows show, whichever is larger. `left` (n,) is what a fit of all rows
    with the effect leaves, nothing but noise where the model is complete; without it r + d stands for that, which scatters more where
    the effect is predicted imperfectly. The other is the scatter of the gain between groups, which holds how unevenly the effect shows
    in the test. It is never smaller than what independent noise makes of it: groups that agree by chance tell nothing.
    """
    used = np.isfinite(before) & np.isfinite(after)
    without, with_effect = before[used] ** 2, after[used] ** 2
    change = np.where(used, after - before, 0.0)
    spread = change if noise is None else noise(change[:, None])[:, 0]
    groups = groups_of(rows, used)
    variance = max(float(change @ spread), scatter((after if left is None else left)[used] * change[used], groups))
    total = float(without.sum())
    channel = rows.channel[used]
    by_channel = {int(c): (float(without[channel == c].mean()), float(with_effect[channel == c].mean())) for c in np.unique(channel)}
    gain = 1.0 - float(with_effect.sum()) / total
    uneven = scatter(without - with_effect - gain * without, groups)
    least = 4.0 * float(change @ change)
    sigma = max(least, min(4.0 * variance, uneven)) ** 0.5 / total
    return Proof(float(without.mean()), float(with_effect.mean()), by_channel, gain, sigma, folds)


def groups_of(rows: Rows, used: np.ndarray, n_t: int = 12, n_y: int = 3) -> np.ndarray:
    """Blocks of rows that may be taken as independent: by time and by place along the load."""
    t, y = rows.time[used], rows.xy[used, 1]
    edges = np.unique(np.quantile(t, np.linspace(0.0, 1.0, n_t + 1)))
    i = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
    j = np.zeros(len(y), dtype=int) if np.ptp(y) == 0.0 else np.minimum((n_y * (y - y.min()) / np.ptp(y)).astype(int), n_y - 1)
    _, group = np.unique(i * n_y + j, return_inverse=True)
    return np.asarray(group)


def scatter(value: np.ndarray, groups: np.ndarray) -> float:
    """Variance of the sum of values (n,) of zero mean, from the sums over groups (n,) of them that are independent of each other."""
    count = int(groups.max()) + 1
    sums = np.bincount(groups, value, count)
    return count / max(count - 1, 1) * float(sums @ sums)


def rms_with_error(residual: np.ndarray, rows: Rows, used: np.ndarray) -> tuple[float, float]:
    """Rms of the rows of a residual (n,) that are used (n,), and its standard error.

    That of the mean of r^2 is its scatter between groups of rows, as that of a gain is; the rms varies by half of it over the rms. nan
    where there is one group only.
    """
    square, groups = residual[used] ** 2, groups_of(rows, used)
    rms = float(np.sqrt(square.mean()))
    if int(groups.max()) == 0 or rms == 0.0:
        return rms, float("nan")
    return rms, scatter(square - rms**2, groups) ** 0.5 / (2.0 * rms * len(square))


def split_by_experiment(rows: Rows, channels: Sequence[str], held_out: Sequence[str]) -> Split:
    """One fold for each experiment named in `held_out`; `channels` are those of the rows by number, called du@first as in a joint fit."""
    of_row = np.array([*(name.partition("@")[2] for name in channels), ""])[rows.channel]
    held = tuple(of_row == name for name in held_out)
    near = np.zeros(len(of_row), dtype=bool)
    return Split(held, tuple(near for _ in held), f"experiments {', '.join(held_out)}")
