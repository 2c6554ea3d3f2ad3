"""Linear isotropic hardening: slot yield_stress, psi = H_lin Lambda^2 / 2 (thesis 4.6). Off at H_lin = 0."""

from __future__ import annotations

from thermofit.core.jit import kernel

SLOT = "yield_stress"
PARAMS = ("H_lin",)
FORMULA = "K_bar += H_lin Lambda"
SOURCE = "thesis (4.6)"


@kernel(inline="always")
def yield_stress(accumulated: float, H_lin: float) -> float:
    """Contribution H_lin Lambda (MPa) to the yield stress; Lambda is the accumulated plastic multiplier (1)."""
    return H_lin * accumulated
