"""Heat exchange through a film with a medium of given temperature: slot surface_flux (thesis 4.13).

Air convection (alpha_air, theta_air) and contact with the jaws (alpha_clamp, theta_clamp) are this one effect on two
named facet sets. Off at alpha = 0.
"""

from __future__ import annotations

from thermofit.core.jit import kernel

SLOT = "surface_flux"
PARAMS = ("alpha_air", "theta_air", "alpha_clamp", "theta_clamp")
FORMULA = "q_0 = -alpha_con (theta_M - theta)"
SOURCE = "thesis (4.13)"

FILM_UNIT = 1e-3
"""1 W/(m^2 K) in mW/(mm^2 K)."""


@kernel(inline="always")
def outward_flux(theta: float, theta_medium: float, film_coefficient: float) -> float:
    """q_0 = -alpha_con (theta_M - theta) in mW/mm^2 of current area (4.13); film_coefficient in W/(m^2 K)."""
    return -FILM_UNIT * film_coefficient * (theta_medium - theta)
