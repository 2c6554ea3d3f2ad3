"""Published coefficients of yield surfaces, and the equivalent stress by a second implementation in numpy that tests compare with."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.core.slots import Slots
from thermofit.law.page import Law, law_of
from thermofit.law.surface.catalogue import COEFFICIENTS, NUMBERS

_ORDER = ("12", "13", "21", "23", "31", "32", "44", "55", "66")


def _yld2004(a: float, first: tuple[float, ...], second: tuple[float, ...]) -> dict[str, float]:
    return {"yld2004.a": a} | {f"yld2004.c{n}_{at}": c for n, row in ((1, first), (2, second)) for at, c in zip(_ORDER, row, strict=True)}


AA2090_T3 = _yld2004(
    8.0,
    (-0.069888, 0.936408, 0.079143, 1.003060, 0.524741, 1.363180, 1.023770, 1.069060, 0.954322),
    (0.981171, 0.476741, 0.575316, 0.866827, 1.145010, -0.079294, 1.051660, 1.147100, 1.404620),
)
"""AA2090-T3 of Barlat et al. 2005, Int. J. Plasticity 21, as TFEL repeats it (docs/web/barlat-yld2004.md, and in the paper's order in
tests/Material): c12, c13, c21, c23, c31, c32, c44, c55, c66."""
TWISTED = {name: (0.85 + 0.02 * k) if "_" in name else 6.3 for k, name in enumerate(AA2090_T3)}
"""Coefficients of no published material, all different and plainly not 1."""


def law_with(name: str, values: Mapping[str, float], hardening: int | str = 1, **others: float) -> Law:
    """The law of a surface with given values of its Params."""
    return law_of(Parameters.of({"theta_ref": 297.0, **values, **others}), Slots(hardening, name))


def numbers_of(law: Law) -> np.ndarray:
    """Exponent and both transformations (19,) in the axes of the law."""
    return np.array([getattr(law, name) for name in NUMBERS])


def full(s: np.ndarray) -> np.ndarray:
    """(3, 3) of the components 11, 22, 33, 12, 23, 13."""
    return np.array([[s[0], s[3], s[5]], [s[3], s[1], s[4]], [s[5], s[4], s[2]]])


def equivalent(stress: np.ndarray, numbers: np.ndarray) -> float:
    """phi of components (6,) with a matrix for each transformation and numpy's principal values."""
    deviator = full(stress) - np.trace(full(stress)) / 3.0 * np.eye(3)
    values = []
    for c in (numbers[1:10], numbers[10:]):
        at = dict(zip(COEFFICIENTS, c, strict=True))
        normal = -np.array([[0.0, at["12"], at["13"]], [at["21"], 0.0, at["23"]], [at["31"], at["32"], 0.0]]) @ np.diag(deviator)
        shear = np.array([at["66"] * deviator[0, 1], at["44"] * deviator[1, 2], at["55"] * deviator[0, 2]])
        values.append(np.linalg.eigvalsh(full(np.concatenate([normal, shear]))))
    apart = np.abs(values[0][:, None] - values[1][None, :])
    largest = apart.max()
    return float(largest * (0.25 * np.sum((apart / largest) ** numbers[0])) ** (1.0 / numbers[0])) if largest > 0.0 else 0.0


def normal(stress: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """dphi/dS (3, 3) of a stress (3, 3), with numpy's principal axes; not where two principal values are equal by chance."""
    deviator, a = stress - np.trace(stress) / 3.0 * np.eye(3), numbers[0]
    s = np.array([deviator[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))])
    maps, found = [], []
    for c in (numbers[1:10], numbers[10:]):
        at = dict(zip(COEFFICIENTS, c, strict=True))
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = -np.array([[0.0, at["12"], at["13"]], [at["21"], 0.0, at["23"]], [at["31"], at["32"], 0.0]])
        matrix[3, 3], matrix[4, 4], matrix[5, 5] = at["66"], at["44"], at["55"]
        maps.append(matrix)
        found.append(np.linalg.eigh(full(matrix @ s)))
    d = found[0][0][:, None] - found[1][0][None, :]
    size = float((0.25 * np.sum(np.abs(d) ** a)) ** (1.0 / a))
    h = 0.25 * np.abs(d / size) ** (a - 2.0) * d / size
    out = np.zeros((3, 3))
    for matrix, (_, axes), slopes in zip(maps, found, (h.sum(axis=1), -h.sum(axis=0)), strict=True):
        g = (axes * slopes) @ axes.T
        # Off-diagonal components of a transformation are diagonal in it: the transpose acts on components as they stand.
        out += full(matrix.T @ np.array([g[0, 0], g[1, 1], g[2, 2], g[0, 1], g[1, 2], g[0, 2]]))
    return np.asarray(out - np.trace(out) / 3.0 * np.eye(3))
