"""Starts spread over the bounds of the free parameters: Latin hypercube or Sobol sequence (scrambled; Owen 1998, as in scipy).

A range over more than two decades is drawn by its logarithm, as the order of magnitude is what is unknown there. Where the hardening law
must rise (M_yinf above M_y0), the higher parameter is drawn from the part of its range above the lower one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import qmc

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters, param
from thermofit.law.hardening.catalogue import Hardening, hardening
from thermofit.study.search import DrawnStarts
from thermofit.study.study import Study

DECADES = 100.0
"""Upper over lower end from which a range is drawn by its logarithm."""
_HARDER = 1.01
"""A parameter over the one that it must exceed, at least."""


def drawn_starts(study: Study, draw: DrawnStarts, base: Parameters) -> tuple[dict[str, float], ...]:
    """`draw.number` starts of the free parameters of `base`. StudyError names a parameter whose range has no end."""
    names = base.free
    if other := [name for name in draw.within if name not in names]:
        raise StudyError(
            f"{study.source.name}: key 'gridsearch.draw.within' gives {', '.join(other)}, which the stage does not identify; expected some "
            f"of {', '.join(names)}"
        )
    ranges = {name: _range(study, draw, name) for name in names}
    points = _points(draw, len(names))
    law = hardening(study.hardening_law)
    return tuple(_start(dict(zip(names, point.tolist(), strict=True)), ranges, base, law) for point in points)


def _points(draw: DrawnStarts, dimensions: int) -> np.ndarray:
    """Points (number, dimensions) of the unit cube."""
    if draw.method == "latin-hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(draw.seed)).random(draw.number))
    sobol = qmc.Sobol(dimensions, rng=np.random.default_rng(draw.seed))
    # A whole power of two is drawn, which is what a Sobol sequence is made for; the first of them are taken.
    return np.asarray(sobol.random_base2(int(np.ceil(np.log2(max(draw.number, 1)))))[: draw.number])


def _range(study: Study, draw: DrawnStarts, name: str) -> tuple[float, float]:
    low, high = draw.within.get(name, study.bounds(name))
    bound = study.bounds(name)
    if not bound[0] <= low < high <= bound[1]:
        raise StudyError(
            f"{study.source.name}: key 'gridsearch.draw.within.{name}' is [{low:g}, {high:g}]; expected a range inside the bounds "
            f"{bound[0]:g} to {bound[1]:g} of parameters.{name}"
        )
    if not np.isfinite([low, high]).all():
        raise StudyError(f"{study.source.name}: starts of {name} cannot be drawn without bounds: add parameters.{name}.bounds")
    return low, high


def _start(point: Mapping[str, float], ranges: Mapping[str, tuple[float, float]], base: Parameters, law: Hardening) -> dict[str, float]:
    """A start from a point of the unit cube, by name."""
    out: dict[str, float] = {}
    rising = [name for chain in law.ascending for name in chain]
    for name in sorted(point, key=lambda name: rising.index(name) if name in rising else 0):
        low, high = ranges[name]
        if (below := law.above(name)) is not None:
            low = max(low, _HARDER * out.get(below, base[below]))
            if low >= high:
                unit = "" if param(below).unit == "1" else f" {param(below).unit}"
                raise StudyError(
                    f"gridsearch.draw: {name} cannot lie above {below} = {low / _HARDER:.4g}{unit} within its range, which ends at "
                    f"{high:g}; raise its upper bound or narrow gridsearch.draw.within.{below}"
                )
        out[name] = between(point[name], low, high)
    return {name: out[name] for name in point}


def between(share: float, low: float, high: float) -> float:
    """The value at a share of 0 to 1 of a range; by logarithm where the range spans more than two decades."""
    if low > 0.0 and high / low > DECADES:
        return float(np.clip(low * (high / low) ** share, low, high))
    return float(np.clip(low + share * (high - low), low, high))
