"""Backstresses of Armstrong and Frederick on the intermediate configuration, integrated in closed form over a step.

With the relative stress S = mu dev C_el - sum X_i, |S|_G = sqrt(S : G : S) and N = G : S / |S|_G (4.14), (4.19),

    dX_i = C_i S / |S|_G dLambda - gamma_i X_i dLambda,      |S|_G = sigma_y.

S / |S|_G is a unit tensor of the norm |.|_G, so that x = |X|_G follows dx = C dLambda - gamma x dLambda in monotonic loading: the
law in one dimension, whatever the Hill tensor. The energy stored is |X_i|_G^2 / (2 C_i), the heat gamma_i |X_i|_G^2 / C_i dLambda >= 0.

Over a step along one direction, z = gamma dLambda, phi(z) = (1 - exp(-z)) / z, psi(z) = (1 - phi(z)) / z:

    X = exp(-z) X_n + C dLambda phi S/|S|_G,      mean of X = phi X_n + C dLambda psi S/|S|_G.

S is parallel to T = mu dev C_el - sum exp(-z_i) X_n,i, and |S|_G = |T|_G - sum C_i dLambda phi_i: the backstresses need no unknowns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import thermofit.core.lanes  # noqa: F401, see law.composition
from thermofit.core.jit import kernel

_SMALL_PHI, _SMALL_PSI = 1e-2, 0.1


class Recall(NamedTuple):
    """X = kept X_n + gained S/|S|_G, mean of X over the step = mean_kept X_n + mean_gained S/|S|_G; gains in MPa."""

    kept: float
    gained: float
    mean_kept: float
    mean_gained: float


@kernel(forceinline=True)
def decay_share(z: float) -> float:
    """phi(z) = (1 - exp(-z)) / z, the mean of exp(-z s) over 0 < s < 1; by its series for small z."""
    if abs(z.real) < _SMALL_PHI:
        return 1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0 * (1.0 - z / 6.0 * (1.0 - z / 7.0)))))
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
    share, straight = decay_share(z), modulus * d_lambda
    return Recall(np.exp(-z), straight * share, share, straight * gain_share(z))
