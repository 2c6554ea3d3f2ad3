"""What the thesis printed: tables 5.2 to 5.22, in the units of thermofit (1/K, mW/(mm K), mJ/(mm^3 K), W/(m^2 K), K^2)."""

from __future__ import annotations

from collections.abc import Mapping

Values = Mapping[str, float]
LITERATURE: Values = {"E": 69000.0, "nu": 0.33, "alpha_exp": 23.0e-6, "kappa": 200.0, "c0": 2.43}
"""For the alloy AW6016, beside Tables 5.2 and 5.9; c0 at constant pressure."""
TABLE_5_2: Mapping[str, Values] = {"displacements": {"E": 58317.0, "nu": 0.10}, "relative displacements": {"E": 67913.0, "nu": 0.35}}
TABLE_5_3: Values = {"M_y0": 129.71, "M_yinf": 253.12, "H_lin": 173.30, "H_exp": 14.11, "F": 0.38}
TABLE_5_6: Values = {"alpha_exp": 25.40e-6, "kappa": 91.19, "c0": 3.10, "f": 9.61}
TABLE_5_8: Mapping[int, Values] = {
    1: {"M_y0": 131.13, "M_yinf": 297.97, "H_exp": 10.62, "F": 0.37},
    2: {"M_y0": 130.38, "M_yinf": 295.60, "H_exp": 10.92, "F": 0.37},
}
TABLE_5_10: tuple[Values, ...] = (
    {"alpha_exp": 28.74e-6, "kappa": 99.32, "c0": 3.68, "beta": 1.13, "f": 8.76},
    {"alpha_exp": 37.06e-6, "kappa": 128.15, "c0": 4.68, "beta": 1.46, "f": 8.76},
    {"alpha_exp": 30.57e-6, "kappa": 105.65, "c0": 3.90, "beta": 1.21, "f": 8.76},
    {"alpha_exp": 18.97e-6, "kappa": 65.49, "c0": 2.46, "beta": 0.75, "f": 8.76},
)
TABLE_5_11: Values = {"alpha_exp": 53.74e-6, "kappa": 166.53, "c0": 6.31, "beta": 2.29, "f": 8.63}
TABLE_5_12: Values = {"E": 67026.0, "nu": 0.36}
TABLE_5_13: Mapping[int, Values] = {
    1: {"M_y0": 129.27, "M_yinf": 293.38, "H_exp": 10.82, "F": 0.37},
    2: {"M_y0": 129.28, "M_yinf": 293.36, "H_exp": 10.97, "F": 0.37},
}
TABLE_5_14: tuple[Values, ...] = (
    {"alpha_exp": 421.56e-6, "kappa": 2653.29, "beta": 18.92, "f": 211.63},
    {"alpha_exp": 421.40e-6, "kappa": 2652.13, "beta": 18.91, "f": 211.63},
    {"alpha_exp": 421.35e-6, "kappa": 2651.07, "beta": 18.90, "f": 211.63},
    {"alpha_exp": 421.47e-6, "kappa": 2652.10, "beta": 18.91, "f": 211.63},
)
"""c0 is printed as << 1."""
TABLE_5_15: Values = {"alpha_exp": 19.83e-6, "kappa": 189.89, "c0": 2.21, "beta": 0.81, "f": 26.73}
TABLE_5_16: Values = {"E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35}
TABLE_5_17: Values = {"alpha_exp": 20.04e-6, "kappa": 175.17, "c0": 2.35, "beta": 0.81, "f": 20.04}
TABLE_5_19: Values = {
    "alpha_exp": 20.21e-6,
    "kappa": 133.45,
    "c0": 2.22,
    "beta": 0.79,
    "alpha_air": 14.72,
    "alpha_clamp": 236.30,
    "f": 14.97,
}
TABLE_5_22: Values = {"beta": 0.93, "alpha_air": 2.18, "alpha_clamp": 976.0, "f": 23.59}

_SIX = ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp", "f")


def _six(*row: float) -> Values:
    return dict(zip(_SIX, (1e-6 * row[0], *row[1:]), strict=True))


TABLE_5_20: Mapping[float, Values] = {
    296.70: _six(20.01, 154.32, 2.19, 0.79, 11.99, 183.16, 16.87),
    296.80: _six(20.11, 144.84, 2.20, 0.79, 13.35, 182.76, 16.52),
    297.00: _six(20.19, 136.80, 2.21, 0.79, 14.41, 197.83, 15.88),
    297.20: _six(20.23, 133.11, 2.22, 0.79, 14.85, 217.62, 15.35),
    297.30: _six(20.21, 133.43, 2.22, 0.79, 14.75, 227.67, 15.14),
    297.50: _six(20.20, 133.63, 2.21, 0.79, 14.66, 244.89, 14.84),
    297.60: _six(20.15, 137.06, 2.21, 0.78, 14.13, 250.65, 14.74),
    297.80: _six(20.03, 146.58, 2.20, 0.78, 12.63, 264.28, 14.65),
}
"""Optima for prescribed air temperatures in K; measured: 297.40 K (Table 5.19). Three larger ones cannot be read in the copy at hand."""
TABLE_5_21: Mapping[float, Values] = {
    297.30: _six(20.07, 144.83, 2.20, 0.79, 13.35, 182.78, 16.55),
    297.10: _six(20.17, 136.91, 2.21, 0.79, 14.40, 197.50, 15.88),
    296.90: _six(20.21, 133.48, 2.22, 0.79, 14.79, 217.69, 15.35),
    296.80: _six(20.21, 133.59, 2.22, 0.79, 14.73, 227.86, 15.14),
    296.60: _six(20.20, 133.43, 2.21, 0.79, 14.70, 244.26, 14.84),
    296.50: _six(20.16, 137.06, 2.21, 0.78, 14.13, 250.65, 14.74),
    296.30: _six(20.06, 146.53, 2.20, 0.78, 12.64, 264.03, 14.65),
}
"""Optima for prescribed jaw temperatures in K; measured: 296.70 K (Table 5.19)."""
