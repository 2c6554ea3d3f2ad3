"""What every effect answers at points worked out by hand: one row for each effect file and each effect of the base law.

The numbers come from the formula in the literature that the file names, with arguments at which it can be done on paper (b Lambda = ln 2,
(1 + rate / reference) = 4, ...), and never from the effect itself. A new effect without a row fails here.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from math import erf, exp, log, pi, sqrt
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

import thermofit.effects
from thermofit.core.parameters import Parameters
from thermofit.effects.base import BASE as BASE_EFFECTS
from thermofit.effects.catalogue import NO_EFFECTS, effect, effects
from thermofit.effects.film_exchange import outward_flux
from thermofit.effects.linear_hardening import yield_stress as linear_hardening
from thermofit.effects.scene import Scene
from thermofit.law.page import hill, hill_gradient, law_of, pressure_factor, thermoelastic_heat

FILES = sorted(p.stem for p in Path(thermofit.effects.__file__).parent.glob("*.py") if p.stem not in (*NO_EFFECTS, "__init__"))
LN2, LN3, LN4 = log(2.0), log(3.0), log(4.0)


def curve_at(u: float) -> float:
    """Lambda over the range at which `hardening_curve` has this u."""
    offset = 24.0**-1.5
    return (1.0 / 24.0 + u * ((1.0 + offset) ** (2.0 / 3.0) - 1.0 / 24.0) / 12.0) ** 1.5 - offset


ROOT = sqrt(2.0 * pi)
NONE: Any = None
"""An argument that the effect must not look at."""


@dataclass(frozen=True)
class Row:
    """The slot of an effect, its points = (arguments, answer), the kinds of facet sets that it acts on, and whether its work is stored."""

    slot: str
    points: tuple[tuple[tuple[Any, ...], Any], ...]
    on: tuple[str, ...] = ()
    stored: bool = False


def a(*numbers: float) -> np.ndarray:
    return np.array(numbers, dtype=float)


def looking(time: np.ndarray, position: Any = (0.0, 0.0), strain: Any = 0.0, load: Any = 0.0, theta_air: float = 300.0) -> Scene:
    """A scene of points at rest in `position` [mm] whose gradient is not asked for."""
    place = np.atleast_2d(np.asarray(position, dtype=float))
    n_t, n_s = len(time), len(place)
    nothing = csr_array((n_s, n_s))
    shape = (n_t, n_s)
    return Scene(
        time,
        np.broadcast_to(place, (*shape, 2)),
        np.broadcast_to(np.asarray(strain, dtype=float), shape),
        np.broadcast_to(np.asarray(load, dtype=float), (n_t,)),
        nothing,
        nothing,
        theta_air,
    )


def column(*values: float) -> np.ndarray:
    """A field (n_t, 1)."""
    return a(*values)[:, None]


# Three points (0, 0), (2, 0), (0, 4) mm: the slopes of a linear field are its differences over 2 and 4 mm.
CORNER = Scene(
    a(0.0),
    np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 4.0]]]),
    np.zeros((1, 3)),
    a(1.0),
    csr_array(np.array(3 * [[-0.5, 0.5, 0.0]])),
    csr_array(np.array(3 * [[-0.25, 0.0, 0.25]])),
    300.0,
)
VOCE = SimpleNamespace(model=1, M_y0=130.0, M_yinf=290.0, H_exp=10.0)
"""Base hardening 160 MPa (1 - exp(-10 Lambda))."""
HALF_TIME = 10.0 * LN2
"""s; in it a lag of 10 s loses half."""

ROWS: dict[str, Row] = {
    # rate time (1 - exp(-elapsed / time)): half of rate x time after time ln 2, three quarters after time ln 4; the clock does not matter.
    "air_drift": Row(
        "boundary_temperature",
        (
            ((a(-10.0, 10.0), 900.0, 200.0 * LN2, 0.01, 200.0), a(1.0, 1.0)),
            ((a(5.0), 0.0, 200.0 * LN4, 0.01, 200.0), a(1.5)),
            ((a(5.0), 70.0, 50.0 * LN2, -0.02, 50.0), a(-0.5)),
        ),
        on=("air",),
    ),
    "clamp_drift": Row(
        "boundary_temperature",
        (
            ((a(-10.0, 10.0), 900.0, 300.0 * LN4, 0.02, 0.0, 300.0), a(4.5, 4.5)),
            ((a(-10.0, 5.0), 0.0, 300.0 * LN2, -0.02, 0.04, 300.0), a(-6.0, 0.0)),
        ),
        on=("clamp",),
    ),
    # 3/4 of it at (ln 3 / 2) onsets after the start, 1/4 as long before; above by half of `apart` more than below.
    "clamp_step": Row(
        "boundary_temperature",
        (
            ((a(-10.0, 0.0, 10.0), 40.0 + 2.5 * LN3, 7.0, 2.0, 0.4, 40.0, 5.0), a(1.35, 1.5, 1.65)),
            ((a(-10.0, 5.0), 40.0 - LN3, 0.0, 1.0, -2.0, 40.0, 2.0), a(0.5, 0.0)),
        ),
        on=("clamp",),
    ),
    # dX = C N dLambda - gamma X dLambda: modulus and recall, in this order.
    "backstress_first": Row(
        "backstress", (((0.02, 1e-3, 300.0, NONE, 4000.0, 100.0), (4000.0, 100.0)), ((0.5, 1.0, 250.0, NONE, 7.0, 3.0), (7.0, 3.0)))
    ),
    "backstress_second": Row(
        "backstress", (((0.02, 1e-3, 300.0, NONE, 900.0, 5.0), (900.0, 5.0)), ((0.5, 1.0, 250.0, NONE, 2.0, 0.0), (2.0, 0.0)))
    ),
    # At (3, 4) mm: u_x = -k (16 + 0.3 x 9) / 2 = -9.35 k, u_y = 12 k, k = 1e-4 / 2 at half the load. At (-2, 5) without contraction:
    # -12.5 k, -10 k.
    "bending": Row(
        "kinematics",
        (
            ((a(0.1, 0.2)[None, None], looking(a(0.0), (3.0, 4.0), load=0.5), 1e-4, 0.3), a(0.1 - 4.675e-4, 0.2 + 6e-4)[None, None]),
            ((a(0.0, 0.0)[None, None], looking(a(0.0), (-2.0, 5.0), load=1.0), -2e-4, 0.0), a(2.5e-3, 2e-3)[None, None]),
        ),
    ),
    "capacity_by_temperature": Row(
        "capacity", (((a(310.0, 286.0), 296.0, 0.005), a(1.07, 0.95)), ((a(296.0, 396.0), 300.0, -0.002), a(1.008, 0.808)))
    ),
    "conductivity_by_temperature": Row(
        "conductivity", (((a(320.0, 280.0), 290.0, 0.003), a(1.09, 0.97)), ((a(300.0, 400.0), 310.0, -0.001), a(1.01, 0.91)))
    ),
    # Half of what the upper jaw is warmer, above; the other half less, below.
    "clamp_difference": Row(
        "boundary_temperature",
        (((a(-40.0, 0.0, 3.0), 7.0, 7.0, 3.0), a(-1.5, 0.0, 1.5)), ((a(-1.0, 60.0), 0.0, 0.0, -0.8), a(0.4, -0.4))),
        on=("clamp",),
    ),
    # Apparent strain 0.002 at a quarter of the load about the middle of the picture: 5e-4 of the current place (3, 4) mm.
    "dic_out_of_plane": Row(
        "camera",
        (
            ((a(0.1, 0.2)[None, None], looking(a(0.0), (3.0, 4.0), load=0.25), 2e-3), a(0.1015, 0.202)[None, None]),
            ((a(0.1, -0.2)[None, None], looking(a(0.0), (-5.0, 20.0), load=1.0), -1e-3), a(0.105, -0.22)[None, None]),
        ),
    ),
    # Scale 1 + load (across x + along y) about the middle of the picture; at (3, 4) mm and half of the load 0.5 (0.003 + 0.008) = 0.0055.
    "dic_tilt": Row(
        "camera",
        (
            ((a(0.1, 0.2)[None, None], looking(a(0.0), (3.0, 4.0), load=0.5), 2e-3, 1e-3), a(0.1165, 0.222)[None, None]),
            ((a(0.0, 0.0)[None, None], looking(a(0.0), (0.0, -40.0), load=1.0), -5e-7, 0.0), a(0.0, -8e-4)[None, None]),
            ((a(0.0, 0.0)[None, None], looking(a(0.0), (0.0, 40.0), load=1.0), -5e-7, 0.0), a(0.0, -8e-4)[None, None]),
        ),
    ),
    # A tenth of the way to the jaws is lost at 10 mm with 1e-3 per square mm; the parabola lies about its centre.
    "heating_profile": Row(
        "axial_temperature",
        (
            ((a(-10.0, 0.0, 10.0, 20.0), 400.0, 1e-3, 0.0), a(-40.0, 0.0, -40.0, -160.0)),
            ((a(-2.0, 3.0), 400.0, 1e-3, 3.0), a(-10.0, 0.0)),
        ),
    ),
    "dic_scale": Row(
        "camera",
        (
            ((a(0.1, -0.4)[None, None], looking(a(0.0), (3.0, 4.0), load=0.3), 0.02), a(0.102, -0.408)[None, None]),
            ((a(0.5, 1.0)[None, None], looking(a(0.0), (3.0, 4.0), load=0.3), -0.1), a(0.45, 0.9)[None, None]),
        ),
    ),
    # Half of the amount is lost at scale ln 2, three quarters at scale ln 4.
    "elastic_degradation": Row(
        "free_energy", (((0.05 * LN2, NONE, 0.2, 0.05), 0.9), ((0.05 * LN4, NONE, 0.2, 0.05), 0.85), ((0.01 * LN2, NONE, 0.6, 0.01), 0.7))
    ),
    # Outward, mW/mm^2: 50 W/(m^2 K) x 20 K = 1000 W/m^2 out of the warmer body, 25 x 20 = 500 W/m^2 into the colder one.
    "film_exchange": Row("surface_flux", (((320.0, 300.0, 50.0), 1.0), ((280.0, 300.0, 25.0), -0.5))),
    "force_offset": Row(
        "load",
        (
            ((a(1000.0, -200.0), a(0.3, 0.4), 50.0), (a(1050.0, -150.0), a(0.3, 0.4))),
            ((a(0.0, 10.0), a(0.0, 1.0), -7.0), (a(-7.0, 3.0), a(0.0, 1.0))),
        ),
    ),
    "force_scale": Row(
        "load",
        (
            ((a(1000.0, -200.0), a(0.3, 0.4), 0.02), (a(1020.0, -204.0), a(0.3, 0.4))),
            ((a(0.0, 500.0), a(0.0, 1.0), -0.1), (a(0.0, 450.0), a(0.0, 1.0))),
        ),
    ),
    # cos(pi / 3) = 1/2 at a third of the length above the middle, where the tilt has grown to 2/3; at the ends the tilt alone.
    "initial_gradient": Row(
        "initial_temperature",
        (
            ((a(1.0, 2.0, 3.0, 4.0), a(50.0, -50.0, 0.0, 75.0), 150.0, 2.0, 0.6), a(1.8, 0.2, 2.0, 1.2)),
            ((a(0.0, 0.0), a(30.0, -60.0), 120.0, -1.0, -0.5), a(-sqrt(0.5) + 0.25, -0.5)),
        ),
    ),
    # What the frame shows is that much later than its stamp; at rest before the first and after the last time.
    "ir_clock": Row(
        "sensor",
        (
            ((column(10.0, 14.0, 20.0), looking(a(0.0, 2.0, 6.0)), 1.0), column(12.0, 15.5, 20.0)),
            ((column(10.0, 14.0, 20.0), looking(a(0.0, 2.0, 6.0)), -1.0), column(10.0, 12.0, 18.5)),
        ),
    ),
    "ir_drift": Row(
        "sensor",
        (
            ((column(300.0, 301.0, 302.0), looking(a(2.0, 5.0, 9.0)), 0.01), column(300.0, 301.03, 302.07)),
            ((column(300.0, 300.0), looking(a(-4.0, 6.0)), -0.2), column(300.0, 298.0)),
        ),
    ),
    # A share 0.5 x 0.05 of the 20 K above the air is not seen; of what is colder than the air more than all.
    "ir_emissivity": Row(
        "emission",
        (
            ((column(320.0), looking(a(0.0), strain=0.05, theta_air=300.0), -0.5), column(319.5)),
            ((column(290.0), looking(a(0.0), strain=0.1, theta_air=300.0), 2.0), column(288.0)),
        ),
    ),
    "ir_gain": Row(
        "sensor",
        (
            ((column(320.0, 290.0), looking(a(0.0, 1.0), theta_air=300.0), 0.05), column(321.0, 289.5)),
            ((column(320.0, 290.0), looking(a(0.0, 1.0), theta_air=310.0), -0.2), column(318.0, 294.0)),
        ),
    ),
    # A rise of 2 K/s seen by a lag of 10 s stays behind by 20 K (1 - exp(-t / 10 s)): 10 K, 15 K; then at rest, half of that.
    "ir_lag": Row(
        "sensor",
        (
            (
                (300.0 + 2.0 * HALF_TIME * column(0.0, 1.0, 2.0, 2.0), looking(HALF_TIME * a(0.0, 1.0, 2.0, 3.0)), 10.0),
                300.0 + 2.0 * HALF_TIME * column(0.0, 1.0, 2.0, 2.0) - column(0.0, 10.0, 15.0, 7.5),
            ),
            # Far slower than the steps: behind by the rate times the lag.
            ((column(300.0, 400.0, 350.0), looking(a(0.0, 50.0, 100.0)), 0.01), column(300.0, 399.98, 350.01)),
        ),
    ),
    # At y = 10 mm 1.2 times as much as in the middle, a quarter of it after a quarter of the time; at y = -25 mm half.
    "ir_reflection": Row(
        "reflection",
        (
            ((column(300.0, 300.0, 300.0), looking(a(2.0, 5.0, 14.0), (3.0, 10.0)), 0.6, 0.02), column(300.0, 300.18, 300.72)),
            ((column(310.0, 310.0), looking(a(0.0, 7.0), (3.0, -25.0)), -0.6, 0.02), column(310.0, 309.7)),
        ),
    ),
    # theta = 300 + 0.1 x - 0.2 y. At (2, 0): xi = (0.5 + 0.05 x 2, 0.25 + 0.02 x 2); at (0, 4): xi = (0.5 - 0.02 x 4, 0.25 + 0.05 x 4).
    "ir_registration": Row(
        "optics",
        (
            ((a(300.0, 300.2, 299.2)[None], CORNER, 0.25, 0.5, 0.02, 0.05), a(300.0, 300.202, 299.152)[None]),
            ((a(300.0, 300.2, 299.2)[None], CORNER, -1.0, 0.0, 0.0, -0.1), a(300.2, 300.38, 299.48)[None]),
        ),
    ),
    # Half of the slip at force ln 2, three quarters at force ln 4; what has slipped does not come back, and pressing does not slip.
    "jaw_slip": Row(
        "load",
        (
            (
                (1000.0 * a(-0.5, LN2, 0.0, LN4), a(0.0, 1.0, 1.0, 2.0), 0.4, 1000.0),
                (1000.0 * a(-0.5, LN2, 0.0, LN4), a(0.0, 0.8, 0.8, 1.7)),
            ),
            ((200.0 * a(LN2), a(0.5), 1.0, 200.0), (200.0 * a(LN2), a(0.0))),
        ),
    ),
    # (1 + tanh x) / 2 = 1 / (1 + exp(-2 x)), x in onsets after the start: 3/4 at x = ln 3 / 2, 1/4 as long before, half at the start.
    "lamp": Row(
        "surface_flux",
        (
            ((a(300.0), 40.0 + 0.5 * LN3, a(297.0), 0.2, 40.0, 1.0), a(-0.15)),
            ((a(320.0), 40.0 - 1.5 * LN3, a(297.0), 0.2, 40.0, 3.0), a(-0.05)),
            ((a(320.0), -5.0, a(297.0), -0.4, -5.0, 1.0), a(0.2)),
        ),
        on=("air",),
    ),
    # One in the middle, 1/2 at half a width. A width away 1 / (2 cosh(1 / rounding) + 3): cosh(ln 8) = 4.0625, so 1 / 11.125.
    "latent_heat": Row(
        "heat_source",
        (
            ((a(290.0), a(0.06), a(2.0), 1.0, a(0.0), a(0.0), 40.0, 0.06, 0.008, 0.3), a(80.0)),
            ((2 * a(150.0, 1.0), a(0.056, 0.064), a(3.0, 0.1), 1.0, a(0.0, 0.0), a(0.0, 0.0), 40.0, 0.06, 0.008, 0.3), a(60.0, 2.0)),
            ((a(300.0), a(0.068), a(5.0), 9.0, a(1.0), a(1.0), -89.0, 0.06, 0.008, 1.0 / log(8.0)), a(-40.0)),
        ),
    ),
    "linear_hardening": Row("yield_stress", (((0.03, 200.0), 6.0), ((0.5, 1000.0), 500.0))),
    # exp(-x^2 / 2) = 1/2 at x = sqrt(2 ln 2) widths from its middle, 3/4 of the power ln 3 / 2 onsets after the start, 1/4 as long before.
    # Powers are sqrt(2 pi) times a number: divided by the width that is the power per volume in the middle.
    "local_source": Row(
        "heat_source",
        (
            (
                (60.0 + 0.5 * LN3, a(3.0), a(-4.0 + 2.0 * sqrt(2.0 * LN2)), a(0.4), 1.6 * ROOT, -4.0, 2.0, 60.0, 1.0, 0.0),
                a(0.3),
            ),
            (
                (60.0 - 2.0 * LN3, a(0.0), a(-4.0 - 5.0 * sqrt(2.0 * LN2)), a(0.0), -4.0 * ROOT, -4.0, 5.0, 60.0, 4.0, 0.0),
                a(-0.1),
            ),
            ((5.0, a(0.0, 1.0), a(7.0, 7.0), a(0.0, 0.5), 1.2 * ROOT, 7.0, 3.0, 5.0, 1.0, 0.0), a(0.2, 0.2)),
            # exp(-xi^2) has the mean sqrt(pi) erf(1) / 2 between middle and edge, exp(xi^2) sqrt(pi) erfi(1) / 2.
            (
                (5.0, a(0.0, 9.0), a(7.0, 7.0), a(0.0, 1.0), 1.2 * ROOT, 7.0, 3.0, 5.0, 1.0, 2.0),
                0.4 / (sqrt(pi) * erf(1.0)) * a(1.0, exp(-1.0)),
            ),
            (
                (5.0, a(0.0, 9.0), a(7.0, 7.0), a(0.0, -1.0), 1.2 * ROOT, 7.0, 3.0, 5.0, 1.0, -2.0),
                0.4 / (sqrt(pi) * 1.6504257587975429) * a(1.0, exp(1.0)),
            ),
        ),
    ),
    "machine_compliance": Row(
        "load",
        (
            ((a(2000.0, -500.0), a(0.3, 0.4), 1e-5), (a(2000.0, -500.0), a(0.28, 0.405))),
            ((a(1e4), a(1.0), -2e-5), (a(1e4), a(1.2))),
        ),
    ),
    # 0.05 W/(m^2 K mm) over 40 mm: 2 W/(m^2 K) more at the top than in the middle, 2 less at the bottom.
    "film_by_height": Row(
        "surface_flux",
        (
            ((a(310.0, 310.0, 310.0), 5.0, a(300.0, 300.0, 300.0), a(-40.0, 0.0, 40.0), 0.05), a(-0.02, 0.0, 0.02)),
            ((a(290.0), 90.0, a(300.0), a(20.0), -0.1), a(0.02)),
        ),
        on=("air",),
    ),
    # Half of an exponent of a sum that is 16, 4096 or 0.01 K^2: 2, 4 and 0.1^(1/2) W/(m^2 K) per W/(m^2 K) at 1 K, inwards if colder.
    "free_convection": Row(
        "surface_flux",
        (
            ((300.0 + a(sqrt(15.99), -sqrt(15.99)), 5.0, a(300.0, 300.0), 3.0, 0.5), 6e-3 * a(sqrt(15.99), -sqrt(15.99))),
            ((300.0 + a(sqrt(4095.99), 0.0), 90.0, a(300.0, 300.0), 1.0, 1.0 / 3.0), a(4e-3 * sqrt(4095.99), 0.0)),
            ((a(250.0), 5.0, a(250.0 - 3e-9), 2.0, 0.5), a(6e-12 * sqrt(0.1))),
        ),
        on=("air",),
    ),
    # x = 0.399, 0.198, 0.03 make the root 0.401, 0.202, 0.05; at 293.15 K nothing changes.
    "modulus_by_temperature": Row(
        "elasticity",
        (
            ((293.15, NONE, 2e-3), 1.0),
            ((894.15, NONE, 1e-3), 0.8 / (1.0 + sqrt(1.0016))),
            ((694.15, NONE, 2e-3), 0.4 / (1.0 + sqrt(1.0016))),
            ((390.15, NONE, 0.01), 0.08 / (1.0 + sqrt(1.0016))),
        ),
    ),
    # sigma (400^4 - 300^4) = 5.670374419e-8 x 1.75e10 = 992.315523325 W/m^2 for a black body; half of it for a grey one, inwards if colder.
    "radiation": Row(
        "surface_flux",
        (((a(400.0), 5.0, a(300.0), 0.5), a(0.4961577616625)), ((a(300.0, 350.0), 5.0, a(400.0, 350.0), 1.0), a(-0.992315523325, 0.0))),
        on=("air",),
    ),
    # 100 K above 293.15 K at seven times the reference rate, ln 8 = 3 ln 2; 50 K below it at three times, ln 4, with the other sign.
    "rate_by_temperature": Row(
        "yield_factor",
        (((0.2, 7e-4, 393.15, NONE, 0.02, 1e-4), 1.0 + 0.06 * LN2), ((0.0, 3e-3, 243.15, NONE, 0.1, 1e-3), 1.0 - 0.05 * LN4)),
    ),
    # ln 2 at the reference rate, ln 10 = 2.302585 at nine times it.
    "rate_logarithmic": Row(
        "yield_factor",
        (
            ((0.1, 1e-4, 300.0, NONE, 0.01, 1e-4), 1.00693147180559945),
            ((0.0, 9e-3, 400.0, NONE, 0.02, 1e-3), 1.04605170185988091),
        ),
    ),
    # (1 + 3)^(1/2) - 1 = 1, (1 + 15)^(1/4) - 1 = 1, (1 + 3)^1 - 1 = 3.
    "rate_power": Row(
        "yield_stress",
        (
            ((0.1, 3e-4, 300.0, NONE, 10.0, 0.5, 1e-4), 10.0),
            ((0.0, 0.15, 400.0, NONE, 20.0, 0.25, 1e-2), 20.0),
            ((0.0, 0.03, 400.0, NONE, 20.0, 1.0, 1e-2), 60.0),
        ),
    ),
    # Half of Q at b Lambda = ln 2, three quarters at ln 4.
    # u = 2 is where the first step has ended, and a sixth of it was done at first yield. With c = (1/24)^(3/2), b = (1 + c)^(2/3), at
    # u = m is (Lambda / range + c)^(2/3) = 1/24 + m (b - 1/24) / 12. Half of the third step is done at u = 5/2, all of it at u = 4.
    "hardening_curve": Row(
        "yield_stress",
        (
            ((0.0, 1.0, 300.0, NONE, 3.0, *[5.0] * 12, 0.18), 3.0),
            ((0.18 * curve_at(2.0), 1.0, 300.0, NONE, 0.0, 12.0, *[0.0] * 11, 0.18), 10.0),
            ((0.18 * curve_at(2.5), 1.0, 300.0, NONE, 1.0, 0.0, 0.0, 12.0, *[0.0] * 9, 0.18), 7.0),
            ((0.18 * curve_at(4.0), 1.0, 300.0, NONE, 1.0, 0.0, 0.0, 12.0, *[0.0] * 9, 0.18), 13.0),
            ((0.18, 1.0, 300.0, NONE, 0.0, *[0.0] * 11, 12.0, 0.18), 10.0),
            ((1.8, 1.0, 300.0, NONE, 0.0, *[0.0] * 11, 12.0, 0.18), 12.0),
        ),
    ),
    "second_hardening": Row(
        "yield_stress",
        (
            ((LN2 / 40.0, 1.0, 300.0, NONE, 120.0, 40.0), 60.0),
            ((LN4 / 40.0, 1e-6, 250.0, NONE, 120.0, 40.0), 90.0),
            ((LN2 / 3.0, 1.0, 300.0, NONE, -50.0, 3.0), -25.0),
        ),
        stored=True,
    ),
    # s = 1 at 393.15 K, -1 at 193.15 K, 2 at 493.15 K; the rounding makes s^3 of s (s^2 + 1e-4), and nothing of s^1.
    "softening_power": Row(
        "yield_factor",
        (
            ((0.1, 1e-3, 393.15, NONE, 0.05, 1.0), 0.95),
            ((0.1, 1e-3, 393.15, NONE, 0.05, 3.0), 0.949995),
            ((0.0, 1e-6, 193.15, NONE, 0.05, 3.0), 1.050005),
            ((0.0, 1e-6, 493.15, NONE, 0.05, 3.0), 0.59999),
        ),
    ),
    "stored_energy": Row("dissipation", (((0.1, 1.0, 300.0, NONE, 2.0), 1.2), ((0.05, 1e-6, 250.0, NONE, -3.0), 0.85))),
    "tension_compression": Row("asymmetry", (((1.0, NONE, 0.25), 1.0), ((-1.0, NONE, 0.25), 1.25))),
    "thermal_softening": Row(
        "yield_factor", (((0.1, 1.0, 343.15, NONE, 0.002, 293.15), 0.9), ((0.0, 1e-6, 273.15, NONE, 0.002, 293.15), 1.04))
    ),
    # Hardening counts from g(Lambda - l) - g(-l), g(x) = (x + sqrt(x^2 + (l / 10)^2)) / 2. With l = 0.02: g(-l) = 4.98756211208903e-5,
    # at the end of the plateau g(0) = 0.001, and 0.16 beyond it g = 0.160006249755878. The upper yield point falls by half in drop ln 2.
    "yield_plateau": Row(
        "yield_stress",
        (
            ((0.0, 1.0, 300.0, VOCE, 0.5, 0.02, 30.0, 1e-3), 15.0),
            ((0.02, 1.0, 300.0, VOCE, 1.0, 0.02, 0.0, 1e-3), 160.0 * (exp(-0.2) - exp(-10.0 * 9.50124378879110e-4))),
            ((0.18, 1e-6, 250.0, VOCE, 0.5, 0.02, 0.0, 1e-3), 80.0 * (exp(-1.8) - exp(-10.0 * 0.159956374134757))),
            (
                (0.02, 1.0, 300.0, VOCE, 2.0, 0.02, 40.0, 0.02 / LN2),
                2.0 * (160.0 * (exp(-0.2) - exp(-10.0 * 9.50124378879110e-4)) + 20.0),
            ),
        ),
        stored=True,
    ),
}
"""By name of the file."""


def law(**numbers: float) -> Any:
    return SimpleNamespace(**numbers)


HILL = law_of(Parameters.of({"F": 0.4, "G": 0.6, "H": 0.7, "L": 1.8, "M": 1.5, "N": 1.2}))
HOT = law(alpha_exp=1e-5, bulk=150e3, lame=100e3, mu=75e3, theta_ref=300.0)
BASE_ROWS: dict[str, tuple[tuple[Callable[..., Any], tuple[Any, ...], Any], ...]] = {
    "linear_hardening": tuple((linear_hardening, *point) for point in ROWS["linear_hardening"].points),
    # Half of the gradient of F (M11 - M22)^2 + G (M33 - M11)^2 + H (M22 - M33)^2 at (1, 2, 5): F -1, G 4, H -3.
    "hill_anisotropy": (
        (hill_gradient, (1.0, 2.0, 5.0, HILL), (-0.4 - 2.4, -2.1 + 0.4, 2.4 + 2.1)),
        (hill_gradient, (1.0, 1.0, 0.0, law(F=0.5, G=0.5, H=0.5)), (0.5, 0.5, -1.0)),
        (lambda *given: plain(hill)(*given)[3:], ((0.0, 0.0, 0.0, 3.0, 2.0, 5.0), HILL), (5.4, 3.0, 6.0)),
    ),
    # d/dF of -3 alpha K (theta - theta_0) ln J / J: 225 MPa times -(1 - ln J) / J; heat -3 alpha K theta d(ln J / J).
    "thermal_expansion": (
        (lambda *given: plain(pressure_factor)(*given)[0], (0.0, 1.0, 350.0, HOT), -75e3 - 225.0),
        (
            lambda *given: plain(pressure_factor)(*given)[0],
            (log(1.25), 1.25, 350.0, HOT),
            100e3 * log(1.25) - 75e3 - 180.0 * (1.0 - log(1.25)),
        ),
        (lambda *given: plain(pressure_factor)(*given)[1], (0.0, 1.0, 250.0, HOT), 100e3 - 450.0),
        (thermoelastic_heat, (350.0, 0.001, 0.002, HOT), -1.575),
    ),
    "air_convection": tuple((outward_flux, *point) for point in ROWS["film_exchange"].points),
    "clamp_conductance": tuple((outward_flux, *point) for point in (*ROWS["film_exchange"].points, ((310.0, 300.0, 1e4), 100.0))),
}
"""By name of the effect of the base law: the formula of the kernels that it acts in, arguments, answer."""


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel as the Python function that it is."""
    return getattr(function, "py_func", function)  # type: ignore[no-any-return]


def act_of(name: str) -> Callable[..., Any]:
    """The function of an effect file; of the base model's surface flux it has a name of its own."""
    module = importlib.import_module(f"thermofit.effects.{name}")
    return plain(outward_flux if name == "film_exchange" else getattr(module, module.SLOT))


def agree(found: Any, expected: Any) -> None:
    parts = zip(found, expected, strict=True) if isinstance(expected, tuple) else ((found, expected),)
    for one, other in parts:
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)
        assert np.shape(one) == np.shape(other)


def test_every_effect_file_has_a_row() -> None:
    assert sorted(ROWS) == FILES, "a new effect needs a row of values worked out by hand"


def test_every_effect_of_the_base_law_has_a_row() -> None:
    assert sorted(BASE_ROWS) == sorted(e.name for e in BASE_EFFECTS)
    assert {e.name for e in effects() if not e.of_user} <= {*ROWS, *BASE_ROWS}


@pytest.mark.parametrize("name", FILES)
def test_answers_are_those_worked_out_by_hand(name: str) -> None:
    for arguments, expected in ROWS[name].points:
        agree(act_of(name)(*arguments), expected)


@pytest.mark.parametrize("name", FILES)
def test_a_row_says_where_its_effect_acts(name: str) -> None:
    module, row = importlib.import_module(f"thermofit.effects.{name}"), ROWS[name]
    assert len(row.points) >= 2
    assert (module.SLOT, getattr(module, "ON", ()), getattr(module, "STORED", False)) == (row.slot, row.on, row.stored)
    if any(e.name == name and e.slot != "base" for e in effects()):
        e = effect(name)
        assert (e.slot, e.on, e.stored) == (row.slot, row.on, row.stored)


ONE_WAY = {
    *("backstress_first", "backstress_second", "elastic_degradation", "ir_lag", "jaw_slip", "radiation", "rate_logarithmic", "rate_power"),
    *("modulus_by_temperature", "heating_profile", "free_convection"),
    *("yield_plateau", "linear_hardening", "hill_anisotropy", "thermal_expansion", "air_convection", "clamp_conductance"),
}
"""Effects whose amplitude physics allows on one side of nothing alone: moduli, films, emissivity, lags, overstress, damage, slip."""


def test_an_amplitude_is_bounded_by_nothing_where_physics_says_so() -> None:
    """A sign that cannot be is what vetoes an estimate; every other amplitude may go both ways."""
    assert {e.name for e in effects() if e.amplitude.lower >= 0.0} == ONE_WAY
    assert all(e.amplitude.lower < e.amplitude.neutral < e.amplitude.upper for e in effects() if e.name not in ONE_WAY)
    assert effect("radiation").amplitude.upper == 1.0 and effect("elastic_degradation").amplitude.upper < 1.0


@pytest.mark.parametrize("name", sorted(BASE_ROWS))
def test_kernels_of_the_base_law_answer_as_worked_out_by_hand(name: str) -> None:
    assert len(BASE_ROWS[name]) >= 2
    for function, arguments, expected in BASE_ROWS[name]:
        agree(plain(function)(*arguments), expected)
