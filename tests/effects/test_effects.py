"""Laws that every effect keeps, found by itself: declared, off at neutral, visible at the probe, complex step, finite in bounds."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Param, Parameters, param
from thermofit.effects.catalogue import SLOTS, Effect, effect, effects, load_effect
from thermofit.effects.film_exchange import outward_flux
from thermofit.effects.linear_hardening import yield_stress
from thermofit.effects.scene import Scene
from thermofit.law.page import law_of
from thermofit.observe.stations import gradients

NAMES = tuple(e.name for e in effects() if e.slot != "base")
"""All effects but those that the base law already holds: these have no formula of their own."""
RNG = np.random.default_rng(11)
STEP = 1e-30
LAW = law_of(Parameters.of({"E": 68e3, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "theta_ref": 296.7}))
POINTS = np.array([(past, rate, theta) for past in (1e-3, 0.02, 0.15) for rate in (1e-6, 1e-4, 3e-2) for theta in (290.0, 330.0)])
"""Lambda, its rate 1/s and the temperature K at which the formulas of the law are looked at."""
Values = tuple[complex, ...]


def _grid() -> Scene:
    """Points in a patch of 8 x 20 mm that is stretched by up to 2 %."""
    time = np.array([0.0, 4.0, 9.0, 20.0, 26.0])
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-4.0, 4.0, 5), np.linspace(0.0, 20.0, 9)))
    strain = np.linspace(0.0, 0.02, 5)[:, None] * (1.0 + 0.01 * y)
    position = np.stack([x * (1.0 - 0.3 * strain), y * (1.0 + strain)], axis=-1)
    by_x, by_y = gradients(np.stack([x, y], axis=-1))
    return Scene(time, position, strain, np.linspace(0.0, 1.0, 5), csr_array(by_x), csr_array(by_y), 296.0)


SCENE = _grid()
TEMPERATURE = 297.0 + 3.0 * SCENE.strain / 0.02 + 0.02 * SCENE.position[..., 0] ** 2 + np.sin(SCENE.time)[:, None]
DISPLACEMENT = SCENE.position - SCENE.position[0]


def _in_law(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    """The formula at all POINTS, one argument moved by i h (none for a negative `moved`)."""
    points = POINTS + (1j * STEP * (np.arange(3) == moved) if moved >= 0 else 0.0)
    return np.array([e.act(*point, LAW, *values) for point in points]).reshape(len(points), -1)


def _of_moduli(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    past = POINTS[:, 0] + (1j * STEP if moved == 0 else 0.0)
    return np.array([e.act(one, LAW, *values) for one in past])


def _of_warm_moduli(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    return np.array([e.act(theta + (1j * STEP if moved == 0 else 0.0), LAW, *values) for theta in (250.0, 297.0, 600.0)])


def _of_sense(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    assert moved <= 0, "the sense of flow is one or the other: nothing is differentiated by it"
    return np.array([e.act(sense, LAW, *values) for sense in (1.0, -1.0)])


def _of_heat_content(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    return np.array([e.act(theta + (1j * STEP if moved == 0 else 0.0), 296.7, *values) for theta in (280.0, 296.7, 340.0)])


def _of_temperature(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    return np.asarray(e.act(TEMPERATURE + (1j * STEP if moved == 0 else 0.0), SCENE, *values))


def _of_displacement(e: Effect, values: Values, moved: int = -1) -> np.ndarray:
    return np.asarray(e.act(DISPLACEMENT + (1j * STEP if moved == 0 else 0.0), SCENE, *values))


Formula = Callable[..., np.ndarray]
LAWS: dict[str, tuple[Formula, float | np.ndarray]] = {
    "yield_stress": (_in_law, 0.0),
    "yield_factor": (_in_law, 1.0),
    "dissipation": (_in_law, 1.0),
    "free_energy": (_of_moduli, 1.0),
    "elasticity": (_of_warm_moduli, 1.0),
    "asymmetry": (_of_sense, 1.0),
    "capacity": (_of_heat_content, 1.0),
    "conductivity": (_of_heat_content, 1.0),
    **dict.fromkeys(("emission", "reflection", "optics", "sensor"), (_of_temperature, TEMPERATURE)),
    **dict.fromkeys(("kinematics", "camera"), (_of_displacement, DISPLACEMENT)),
}
"""How a formula of a slot is asked, and what it answers where the effect is off."""


def asked(name: str) -> tuple[Effect, Formula, float | np.ndarray]:
    e = effect(name)
    if e.slot == "backstress":
        return e, lambda e, values, moved=-1: _in_law(e, values, moved)[:, :1], 0.0
    if e.slot not in LAWS:
        pytest.skip(f"formulas of slot {e.slot} have arguments of their own: tested with what calls them")
    return e, *LAWS[e.slot]


def at_probe(e: Effect, share: float = 1.0) -> tuple[float, ...]:
    """Amplitudes at a share of their probe, other Params as they are."""
    return tuple(p.neutral if p.probe is None else share * p.probe for p in e.params)


def inside(p: Param, value: float) -> bool:
    return bool(p.lower <= value <= p.upper and np.isfinite(value))


def test_effects_are_found() -> None:
    assert {"rate_power", "thermal_softening", "backstress_first", "elastic_degradation", "ir_clock", "dic_scale"} <= set(NAMES)
    assert [e.slot for e in effects()] == sorted((e.slot for e in effects()), key=SLOTS.index)


@pytest.mark.parametrize("name", NAMES)
def test_declaration(name: str) -> None:
    e = effect(name)
    assert e.formula and e.source and e.amplitude.probe is not None
    for p in e.params:
        assert param(p.name) is p and p.name.startswith(f"{name}.") and p.unit and p.meaning
        assert p.lower < p.upper and p.scale > 0.0 and inside(p, p.neutral)
        assert p.scan_of in ("", "time", "duration", "strain", "place", "length")
        assert all(value > 0.0 if p.scan_of else inside(p, value) for value in p.scan)
        assert p.probe is None or (inside(p, p.probe) and p.probe != p.neutral)
        assert not (p.probe is not None and p.scan), "an amplitude is felt at neutral and needs no scan"


@pytest.mark.parametrize("name", NAMES)
def test_neutral_is_off_and_the_probe_is_visible(name: str) -> None:
    e, formula, off = asked(name)
    neutral, probe = formula(e, tuple(p.neutral for p in e.params)), formula(e, at_probe(e))
    size = np.abs(off).max() + (LAW.M_y0 if e.slot in ("yield_stress", "backstress") else 0.0)
    assert np.abs(neutral - off).max() <= 1e-13 * size
    assert np.abs(probe - off).max() > 1e-5 * size


@pytest.mark.parametrize("name", NAMES)
def test_complex_step_is_the_difference(name: str) -> None:
    """By every Param, at the probe and near neutral; and by the arguments of the formula."""
    e, formula, _ = asked(name)
    for share in (1.0, 0.1):
        start = at_probe(e, share)
        for k, p in enumerate(e.params):
            h = 1e-6 * (abs(start[k]) or p.scale)
            ahead, back = (formula(e, tuple(v + s * h * (i == k) for i, v in enumerate(start))) for s in (1.0, -1.0))
            slope = np.imag(formula(e, tuple(v + 1j * STEP * (i == k) for i, v in enumerate(start)))) / STEP
            noise = 1e-14 * np.abs(ahead).max() / h
            assert np.abs(slope - (ahead - back) / (2.0 * h)).max() <= 1e-6 * np.abs(slope).max() + noise, p.name
        moved = formula(e, start, 0)
        assert np.allclose(np.real(moved), formula(e, start), rtol=1e-14) and np.all(np.isfinite(np.imag(moved)))


@pytest.mark.parametrize("name", NAMES)
def test_finite_over_its_bounds(name: str) -> None:
    e, formula, _ = asked(name)
    ends = [tuple(getattr(p, end) for p in e.params) for end in ("lower", "upper")]
    drawn = [tuple(RNG.uniform(p.lower, p.upper) for p in e.params) for _ in range(200)]
    near = [tuple(p.neutral + p.scale * RNG.normal() for p in e.params) for _ in range(50)]
    for values in (*ends, *drawn, *(v for v in near if all(map(inside, e.params, v)))):
        assert np.all(np.isfinite(formula(e, values))), values


@given(st.floats(0.0, 2.0), st.floats(0.0, 1e4))
def test_linear_hardening(accumulated: float, H_lin: float) -> None:
    """H_lin Lambda, the derivative of H_lin Lambda^2 / 2 (4.6); exactly zero at H_lin = 0."""
    assert yield_stress(accumulated, 0.0) == 0.0
    assert yield_stress(accumulated, H_lin) == pytest.approx(H_lin * accumulated)


@given(st.floats(200.0, 1000.0), st.floats(200.0, 1000.0), st.floats(0.0, 1e8))
def test_film_exchange(theta: float, medium: float, alpha: float) -> None:
    """(4.13): outward, mW/mm^2 for a coefficient in W/(m^2 K); exactly zero at alpha = 0 or without a difference."""
    assert outward_flux(theta, medium, 0.0) == 0.0
    assert outward_flux(theta, theta, alpha) == 0.0
    watts_per_square_metre = alpha * (theta - medium)
    assert outward_flux(theta, medium, alpha) == pytest.approx(watts_per_square_metre * 1e3 / 1e6)


@pytest.mark.parametrize("slot", ["base", "flow"])
def test_slots_in_which_no_function_is_called_are_refused(tmp_path: Path, slot: str) -> None:
    """The base law acts in its kernels, and there is no slot of flow: such a file would be taken and do nothing."""
    path = tmp_path / "my_effect.py"
    path.write_text(
        "from thermofit.core.parameters import Param\n"
        f"SLOT, FORMULA, SOURCE = {slot!r}, 'made up', 'made up'\n"
        "PARAMS = (Param('my_effect.a', '1', 0.0, -1.0, 1.0, 0.1, 'amplitude', probe=0.1),)\n"
        f"def {slot}(*arguments):\n    return 0.0\n"
    )
    with pytest.raises(
        StudyError, match=rf"my_effect\.py: SLOT is '{slot}'; expected one of free_energy, elasticity, yield_stress, .*, sensor, camera$"
    ):
        load_effect(path)


def test_a_lamp_is_sought_from_every_begin_of_a_source() -> None:
    """Held at a begin that is far off, one of them looks like nothing, and the other is named in its stead."""
    begins = [next(p.scan for p in effect(name).params if p.scan_of == "time") for name in ("lamp", "local_source")]
    assert set(begins[1]) <= set(begins[0])
    for early in begins:
        assert max(b - a for a, b in pairwise(early) if b <= 0.2) < 0.051
    for close in (begins[0], next(p.scan for p in effect("clamp_step").params if p.scan_of == "time")):
        assert max(b - a for a, b in pairwise(close)) < 0.051
