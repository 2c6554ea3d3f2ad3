"""Second saturating hardening term (Voce, Chaboche's isotropic part): slot yield_stress. Off at Q = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.parameters import Param, Parameters

SLOT = "yield_stress"
PARAMS = (
    Param("second_hardening.Q", "MPa", 0.0, -1000.0, 1000.0, 10.0, "saturation stress of the second term", probe=20.0),
    Param("second_hardening.b", "1", 60.0, 0.1, 5000.0, 30.0, "its saturation speed", scan=(3.0, 20.0, 60.0, 200.0, 800.0)),
)
FORMULA = "sigma_y += Q (1 - exp(-b Lambda))"
SOURCE = "Voce 1955; Chaboche 1989, International Journal of Plasticity 5"
STORED = True


def yield_stress(accumulated: float, rate: float, theta: float, law: Any, Q: float, b: float) -> float:
    """Q (1 - exp(-b Lambda)), MPa."""
    return Q * (1.0 - np.exp(-b * accumulated))


def twin(at: Parameters) -> dict[str, float]:
    """The term of the base law of model 1, (M_yinf - M_y0) (1 - exp(-H_exp Lambda)), in the stead of this one."""
    Q, b = at["second_hardening.Q"], at["second_hardening.b"]
    base = at["M_yinf"] - at["M_y0"]
    return {"second_hardening.Q": base, "second_hardening.b": at["H_exp"], "M_yinf": at["M_y0"] + Q, "H_exp": b}
