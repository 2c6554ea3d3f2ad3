"""The elastic part of a coupon record: its straight line and where the record leaves it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

_TOE = 0.1
"""Share of the stress at the end of the line below which a record may still settle (toe of the curve)."""
_SHARE = 0.9
"""The elastic window ends at this share of the stress at which the strain leaves the straight line."""
PROOF, _OF_PROOF = 0.002, 0.5
"""Plastic strain of the proof stress, and the share of it at which the window ends at the latest, where enough samples lie below: the
range in which ISO 6892-1 (2019, annex on the modulus) takes the slope. Above, microplasticity bends the line by some per cent, which the
deviation that is allowed of a straight line hides: two per cent of strain at its ends are twelve per cent of slope."""
_TURNS = 5
"""Turns in which the slope and the proof stress that follows from it settle."""
_DEVIATION = 0.02
"""Deviation of the strain from the line, as a share of the elastic strain, that counts as plastic, on top of three times its noise."""
_AT_REST = 0.5
"""Share of the stress at the end of the line below which a record must begin, unless the line passes zero: else it may begin in flow."""
_BEFORE, _OFF_ZERO = 0.25, 0.1
"""Strains by which the line may miss the record: at its first stress on the stiff side, and at zero stress; shares of the line's strain."""
_BY_CHANCE = 0.05
"""Probability with which slopes of one modulus differ as much by the errors of their lines alone."""
STRAIGHT = 0.03
"""Part by which the slope of an elastic range may be off at least: gauges of class 1 err by 1 % in strain, and the usual ranges,
up to 40 or 50 % of the proof stress or as far as a line looks straight, give slopes some per cent apart."""
_LEAST = 5
_NO_TURN = 0.02
"""Share of the largest stress within which a fall is no reversal: the noise of a record that begins at rest reverses at once."""
_LEVELS = 60


@dataclass(frozen=True)
class ElasticLine:
    """stress = slope (strain - offset) from `begin` (after the toe) to `end` (indices of the first and last samples of the elastic window)
    at `stress` MPa; slope in MPa, `error`, its relative standard error from the scatter about the line, and `straight`, the last sample at
    which the record still looks straight: zeros are told by more samples than the slope."""

    slope: float
    offset: float
    end: int
    stress: float
    begin: int = 0
    error: float = 0.0
    straight: int = 0

    @property
    def samples(self) -> int:
        """Number of samples of the elastic window."""
        return self.end + 1 - self.begin


def first_branch(stress: np.ndarray) -> int:
    """Number of samples up to the first reversal of the stress by a tenth of what was reached; all where there is none."""
    size = np.abs(stress - stress[0])
    reached = np.maximum.accumulate(size)
    back = np.flatnonzero(size < 0.9 * reached - _NO_TURN * size.max())
    turn = int(back[0]) if len(back) else len(stress)
    return int(np.argmax(size[:turn])) + 1


def elastic_line(time: np.ndarray, strain: np.ndarray, stress: np.ndarray, noise: float) -> ElasticLine | None:
    """The straight line of the first loading, None where no five samples lie on one; `noise` is that of the strain.

    Lines are fitted to growing parts of the first branch; the largest part that is straight at both of its ends counts. A line that does
    not come from rest is none: a record that begins in flow, or jumps into it between two samples, is straight for a while as well.
    """
    n = first_branch(stress)
    strain, stress = strain[:n], stress[:n]
    size = np.abs(stress - stress[0])
    if n < _LEAST + 1 or not size.max() > 0.0:
        return None
    limit = None
    for level in np.geomspace(0.05, 1.0, _LEVELS) * size.max():
        part = _part(size, level)
        if len(part) >= _LEAST and _straight(strain[part], stress[part], level, noise):
            limit = level
    if limit is None:
        return None
    part = _part(size, _SHARE * limit)
    if len(part) < _LEAST - 1:
        return None
    straight = int(part[-1])
    for _ in range(_TURNS):
        below = _part(size, min(_SHARE * limit, _OF_PROOF * proof_stress(strain, stress, *_line(strain[part], stress[part]))))
        if len(below) < _LEAST:
            break
        part = below
    slope, offset = _line(strain[part], stress[part])
    end = int(part[-1])
    error = _error(strain[part], stress[part], slope, offset, noise)
    found = ElasticLine(slope, offset, end, float(stress[end]), int(part[0]), error, straight)
    return found if slope > 0.0 and _from_rest(found, strain, stress, noise) else None


def proof_stress(strain: np.ndarray, stress: np.ndarray, slope: float, offset: float) -> float:
    """Size in MPa of the stress of a first branch (n,), from its first sample, that has left the line by a strain of `PROOF`; the largest
    one where none has."""
    size, sense = np.abs(stress - stress[0]), np.sign(stress[int(np.argmax(np.abs(stress - stress[0])))] - stress[0])
    past = np.flatnonzero(sense * (strain - offset - stress / slope) > PROOF) if slope > 0.0 else np.zeros(0, dtype=int)
    return float(size[past[0]] if len(past) else size.max())


def _error(strain: np.ndarray, stress: np.ndarray, slope: float, offset: float, noise: float) -> float:
    """Relative standard error of the slope of a line through samples (n,)."""
    left = strain - offset - stress / slope if slope > 0.0 else strain
    scatter = max(noise, float(np.sqrt(left @ left / max(len(left) - 2, 1))))
    spread = float(np.sum((stress - stress.mean()) ** 2)) ** 0.5
    return scatter * slope / spread if spread > 0.0 else float("inf")


def modulus_error(lines: Sequence[ElasticLine]) -> float:
    """Relative standard error of one modulus for all records: from the scatter about each line, and between them; infinite without one."""
    if not lines:
        return float("inf")
    slopes = np.array([line.slope for line in lines])
    own = float(np.mean([line.error for line in lines])) / len(lines) ** 0.5
    between = float(slopes.std(ddof=1) / slopes.mean()) / len(lines) ** 0.5 if len(lines) > 1 else 0.0
    return float(np.hypot(own, between))


def slope_scatter(lines: Sequence[ElasticLine]) -> tuple[float, float]:
    """Mean in MPa of the slopes of records of one material, and their relative standard deviation beyond the errors of their lines.

    Extensometers, seats and bending differ from record to record (variance components, Hedges and Olkin 1985, chapter 9). It is zero where
    the errors of the lines explain all of it: below the value of Q = sum (slope - mean)^2 / error^2 that chance reaches in one of twenty.
    """
    slopes, errors = (np.array(values) for values in ([line.slope for line in lines], [line.slope * line.error for line in lines]))
    mean, precision = float(slopes.mean()), 1.0 / errors**2
    Q = float(precision @ (slopes - float(precision @ slopes) / float(precision.sum())) ** 2)
    if Q <= chdtri(len(lines) - 1, _BY_CHANCE):
        return mean, 0.0
    return mean, float(max(slopes.var(ddof=1) - np.mean(errors**2), 0.0) ** 0.5 / mean)


def _from_rest(line: ElasticLine, strain: np.ndarray, stress: np.ndarray, noise: float) -> bool:
    """Does the line begin where the record does, at little stress, or else pass zero?"""
    sense, span = np.sign(line.stress), abs(line.stress) / line.slope
    if abs(line.offset) <= _OFF_ZERO * span + 3.0 * noise:
        return True
    if sense * stress[0] > _AT_REST * abs(line.stress):
        return False
    early = sense * (strain[0] - (line.offset + stress[0] / line.slope))
    return bool(early <= _BEFORE * span + 3.0 * noise)


def contradicts(strain: np.ndarray, stress: np.ndarray) -> bool:
    """True where the stress of the first loading falls as the strain rises: a sign is wrong, and nothing about it is elastic."""
    n = first_branch(stress)
    return bool(n > 1 and (stress[n - 1] - stress[0]) * (strain[n - 1] - strain[0]) < 0.0)


def _part(size: np.ndarray, level: float) -> np.ndarray:
    """Samples up to the first one at a level of stress, without the toe."""
    last = int(np.argmax(size >= level))
    return np.arange(last + 1)[size[: last + 1] >= _TOE * level]


def _straight(strain: np.ndarray, stress: np.ndarray, level: float, noise: float) -> bool:
    """Does the strain stay on its line over the stress, at the lower end (a fifth of the stress) and at the upper one (a tenth)?"""
    slope, offset = _line(strain, stress)
    if not slope > 0.0:
        return False
    away = strain - (stress / slope + offset)
    place = np.abs(stress - stress[-1]) / np.abs(stress[-1] - stress[0]) if stress[-1] != stress[0] else np.ones(len(stress))
    for end in (place <= 0.1, place >= 0.8):
        allowed = _DEVIATION * level / slope + 3.0 * noise / np.sqrt(max(int(end.sum()), 1))
        if not end.any() or abs(float(away[end].mean())) > allowed:
            return False
    return True


def _line(strain: np.ndarray, stress: np.ndarray) -> tuple[float, float]:
    """Slope and strain at zero stress of the least-squares line of strain over stress, whose noise is the smaller one."""
    centred = stress - stress.mean()
    by_stress = float(centred @ (strain - strain.mean()) / (centred @ centred)) if np.any(centred) else 0.0
    if not by_stress > 0.0:
        return 0.0, 0.0
    return 1.0 / by_stress, float(strain.mean() - by_stress * stress.mean())
