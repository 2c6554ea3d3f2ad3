"""The elastic part of a coupon record: its straight line and where the record leaves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_TOE = 0.1
"""Share of the stress at the end of the line below which a record may still settle (toe of the curve)."""
_SHARE = 0.9
"""The elastic window ends at this share of the stress at which the strain leaves the straight line."""
_DEVIATION = 0.02
"""Deviation of the strain from the line, as a share of the elastic strain, that counts as plastic, on top of three times its noise."""
_AT_REST = 0.5
"""Share of the stress at the end of the line below which a record must begin, unless the line passes zero: else it may begin in flow."""
_BEFORE, _OFF_ZERO = 0.25, 0.1
"""Strains by which the line may miss the record: at its first stress on the stiff side, and at zero stress; shares of the line's strain."""
_LEAST = 5
_NO_TURN = 0.02
"""Share of the largest stress within which a fall is no reversal: the noise of a record that begins at rest reverses at once."""
_LEVELS = 60


@dataclass(frozen=True)
class ElasticLine:
    """stress = slope (strain - offset) up to `end` (index of the last sample of the elastic window) at `stress` MPa; slope in MPa."""

    slope: float
    offset: float
    end: int
    stress: float


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
    slope, offset = _line(strain[part], stress[part])
    end = int(part[-1])
    found = ElasticLine(slope, offset, end, float(stress[end]))
    return found if slope > 0.0 and _from_rest(found, strain, stress, noise) else None


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
