"""Backstresses of Armstrong and Frederick on the intermediate configuration, integrated in closed form over a step.

With the relative stress S = mu dev C_el - sum X_i, |S|_G = sqrt(S : G : S) and N = G : S / |S|_G (4.14), (4.19),

    dX_i = C_i S / |S|_G dLambda - gamma_i X_i dLambda,      |S|_G = sigma_y.

S / |S|_G is a unit tensor of the norm |.|_G, so that x = |X|_G follows dx = C dLambda - gamma x dLambda in monotonic loading: the
law in one dimension, whatever the Hill tensor. The energy stored is |X_i|_G^2 / (2 C_i), the heat gamma_i |X_i|_G^2 / C_i dLambda >= 0.

Over a step along one direction, z = gamma dLambda, phi(z) = (1 - exp(-z)) / z, psi(z) = (1 - phi(z)) / z:

    X = exp(-z) X_n + C dLambda phi S/|S|_G,      mean of X = phi X_n + C dLambda psi S/|S|_G,

so that the work of X over the step is X_n : G : (X - exp(-z) X_n) / C + C dLambda^2 psi.

S is parallel to T = mu dev C_el - sum exp(-z_i) X_n,i, and |S|_G = |T|_G - sum C_i dLambda phi_i: the backstresses need no unknowns.

A modulus that changes with temperature or flow (an effect file may say so) acts on the strain-like Y = X / C, dY = S/|S|_G dLambda -
gamma Y dLambda, which is the variable of the free energy C |Y|_G^2 / 2: X_n above then stands for C Y_n, C that of the end of the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import thermofit.core.lanes  # noqa: F401, see law.composition
from thermofit.core.jit import kernel

_SMALL_PHI, _SMALL_PSI = 1e-2, 0.1


class Recall(NamedTuple):
    """X = kept X_n + gained S/|S|_G; gained in MPa."""

    kept: float
    gained: float


@kernel(forceinline=True)
def decay_series(z: float) -> float:
    """phi(z) for |z| < 1e-2."""
    return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0 * (1.0 - z / 6.0 * (1.0 - z / 7.0)))))


@kernel(forceinline=True)
def decay_share(z: float) -> float:
    """phi(z) = (1 - exp(-z)) / z, the mean of exp(-z s) over 0 < s < 1; by its series for small z."""
    if abs(z.real) < _SMALL_PHI:
        return decay_series(z)
    return (1.0 - np.exp(-z)) / z


@kernel(forceinline=True)
def gain_share(z: float) -> float:
    """psi(z) = (1 - phi(z)) / z, the mean of (1 - exp(-z s)) / z over 0 < s < 1; by its series for small z."""
    if abs(z.real) < _SMALL_PSI:
        deep = 1.0 - z / 8.0 * (1.0 - z / 9.0 * (1.0 - z / 10.0 * (1.0 - z / 11.0)))
        return 0.5 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0 * (1.0 - z / 6.0 * (1.0 - z / 7.0 * deep)))))
    return (1.0 - decay_share(z)) / z


@kernel(forceinline=True)
def recall_over(d_lambda: float, modulus: float, recall: float) -> Recall:
    """Recall of a backstress with modulus C in MPa and recall gamma over d_lambda."""
    z = recall * d_lambda
    return Recall(np.exp(-z), modulus * d_lambda * decay_share(z))


@kernel(forceinline=True)
def recalled_energy(before: float, across: float, after: float, d_lambda: float, modulus: float, recall: float) -> float:
    """Heat of the recall of one backstress over d_lambda, mJ/mm^3: the work X : D less what is stored, C |Y|_G^2 / 2.

    before = |Y_n|_G^2, across = Y_n : G : Y and after = |Y|_G^2 tell how the direction of flow lies to Y_n. Not negative where C >= 0.
    """
    z = recall * d_lambda
    work = across - np.exp(-z) * before + d_lambda * d_lambda * gain_share(z)
    return modulus * (work - 0.5 * (after - before))
