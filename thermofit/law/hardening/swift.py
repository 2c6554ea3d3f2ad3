"""Swift's power law, which does not saturate; associated, alpha = Lambda.

As published sigma_y = K (e0 + Lambda)^n; here K e0^n = M_y0, the yield stress at Lambda = 0.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.parameters import Param

PARAMS = (
    "M_y0",
    Param("swift.e0", "1", 0.01, 1e-5, 10.0, 0.01, "plastic strain that the material seems to have had before the test"),
    Param("swift.n", "1", 0.2, 0.0, 1.0, 0.1, "hardening exponent"),
)
FORMULA = "sigma_y = M_y0 (1 + Lambda / e0)^n"
SOURCE = "Swift 1952, Journal of the Mechanics and Physics of Solids 1"
METALS = {"M_y0": (2e2, 1.0, 1e4), "swift.e0": (0.01, 1e-4, 1.0), "swift.n": (0.2, 0.01, 0.8)}
MEANING = {"M_y0": "MPa", "swift.e0": "plastic strain before the test", "swift.n": "exponent"}


def yield_stress(alpha: float, M_y0: float, e0: float, n: float) -> tuple[float, float]:
    """Yield stress in MPa and its derivative by alpha."""
    reach = 1.0 + alpha / e0
    value = M_y0 * np.exp(n * np.log(reach))
    return value, n * value / (e0 * reach)


def stored_energy(alpha: float, M_y0: float, e0: float, n: float) -> float:
    """Integral of sigma_y - M_y0 in mJ/mm^3."""
    reach = 1.0 + alpha / e0
    return M_y0 * (e0 / (n + 1.0) * (np.exp((n + 1.0) * np.log(reach)) - 1.0) - alpha)


def search(stress: float, strain: float) -> dict[str, tuple[float, float, float]]:
    """Start and bounds by the largest stress of a test in MPa and its largest strain."""
    return {
        "M_y0": (0.7 * stress, 0.02 * stress, 5.0 * stress),
        "swift.e0": (0.1 * strain, max(1e-3 * strain, 1e-5), min(10.0 * strain, 10.0)),
        "swift.n": (0.2, 0.01, 0.8),
    }


def first_guess(accumulated: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    """The exponent by the last half of the curve over the logarithm of strain, e0 by its whole rise."""
    first, end, last = float(stress[0]), float(accumulated[-1]), float(stress[-1])
    middle = float(np.interp(0.5 * end, accumulated, stress))
    n = float(np.clip(np.log(last / middle) / np.log(2.0), 0.02, 0.8))
    rise = max(last / first, 1.001) ** (1.0 / n) - 1.0
    return {"M_y0": first, "swift.e0": float(np.clip(end / rise, 1e-4, 1.0)), "swift.n": n}
