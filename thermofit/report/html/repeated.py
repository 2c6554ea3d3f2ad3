"""Scatter between specimens: how far records of one programme lie apart, which no model of one material can be better than."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.records.artefact import Record

_SAME_RATE = 1.25
"""Factor between the strain rates of records that count as repeated."""
_SAME_TEMPERATURE = 3.0
"""K between their temperatures before the test."""
_FROM, _LEVELS = 0.2, 100
"""Share of the common strain from which records are compared, beyond where they find their grip, and the number of levels."""
_TURN = 0.02
"""Part of its largest strain by which a record must go back before its first loading ends."""
_LEAST = 10


@dataclass(frozen=True)
class Loading:
    """First loading of a record: strain and stress in MPa (n,), its strain rate 1/s, its temperature before the test in K."""

    strain: np.ndarray
    stress: np.ndarray
    rate: float
    theta: float


def first_loading(time: np.ndarray, strain: np.ndarray, stress: np.ndarray, theta: float) -> Loading | None:
    """The part of a record (n,) up to its first turn; None where that is too short. Strain and stress are counted in its sense."""
    moved = strain - strain[0]
    end = int(np.argmax(np.abs(moved)))
    sense = float(np.sign(moved[end]))
    most = np.maximum.accumulate(sense * moved)
    back = np.flatnonzero(most - sense * moved > _TURN * most[-1])
    end = int(np.argmax(most[: back[0]])) if len(back) else end
    if end < _LEAST or not time[end] > time[0]:
        return None
    keep = np.r_[True, np.diff(most[: end + 1]) > 0.0]
    rate = sense * float(moved[end]) / float(time[end] - time[0])
    return Loading((sense * moved)[: end + 1][keep], sense * stress[: end + 1][keep], sense * rate, theta)


def scatter_of(loadings: Sequence[Loading]) -> float | None:
    """Standard deviation in MPa between repeated records at the same strain, rms over the strain and over all groups; None where no test
    was repeated."""
    found = [_scatter(group) for group in _groups(loadings) if len(group) > 1]
    weight = sum(n for n, _ in found)
    return float(np.sqrt(sum(n * variance for n, variance in found) / weight)) if weight else None


def _groups(loadings: Sequence[Loading]) -> Iterator[list[Loading]]:
    """Records of one sense, rate and temperature; each belongs to the first one that it resembles."""
    left = list(loadings)
    while left:
        first = left[0]
        alike = [
            one
            for one in left
            if one.rate * first.rate > 0.0
            and 1.0 / _SAME_RATE <= one.rate / first.rate <= _SAME_RATE
            and abs(one.theta - first.theta) <= _SAME_TEMPERATURE
        ]
        left = [one for one in left if not any(one is other for other in alike)]
        yield alike


def _scatter(group: Sequence[Loading]) -> tuple[int, float]:
    """Degrees of freedom and mean variance of the stress between records at the strains that all of them reach."""
    reach = min(float(one.strain[-1]) for one in group)
    level = np.linspace(_FROM * reach, reach, _LEVELS)
    stress = np.stack([np.interp(level, one.strain, one.stress) for one in group])
    return len(group) - 1, float(np.mean(np.var(stress, axis=0, ddof=1)))


def scatter_of_records(verify: Record, interpolate: Record | None) -> float | None:
    """The same of the records of a verified run of coupons. None without records, or where none was repeated."""
    rows = () if interpolate is None else interpolate.summary.get("tests", ())
    found = []
    for k, facts in enumerate(rows):
        names = [f"curves/{k}/{key}" for key in ("time", "measured_strain", "measured_stress")]
        if all(verify.has(name) for name in names):
            time, strain, stress = (verify[name].value for name in names)
            if (one := first_loading(time, strain, stress, float(facts["theta_start"]))) is not None:
                found.append(one)
    return scatter_of(found)
