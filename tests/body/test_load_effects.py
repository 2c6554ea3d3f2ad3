"""Effects of the machine on the load: closed forms, exactly off at neutral, and their influence on whole runs in both controls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_bodies import NOMINAL, SPECIMEN

from thermofit.body.body import tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.loading import acting_force, acting_force_rate, moving, shown_force, shown_force_rate
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters, load_mode, load_modes
from thermofit.effects.catalogue import LOAD, effect, effects

BASE = NOMINAL.replace(H_lin=20.0, theta_ref=295.2)
TIME = np.array([0.0, 1.0, 25.0, 35.0, 37.0, 60.0])
RECORDED = np.array([0.0, 0.0, 5200.0, 5200.0, 300.0, 300.0])
FORCE = Loading(TIME, RECORDED)
CROSSHEAD = Loading(TIME, np.array([0.0, 0.0, 3.0, 3.0, 2.6, 2.6]), "displacement", from_rest=True, force=RECORDED)
OWN_END = replace(CROSSHEAD, force=None)
TIMES = np.array([0.0, 1.0, 5.0, 9.0, 13.0, 17.0, 21.0, 25.0, 30.0, 35.0, 36.0, 37.0, 45.0, 60.0])
SETTINGS = MarchSettings(newton=NewtonSettings(tolerance=2e-9, max_iterations=80), coupling_tolerance=1e-8)
AMPLITUDES = ("force_offset.offset", "force_scale.gain", "jaw_slip.slip", "machine_compliance.compliance")
ON = {"force_offset.offset": 40.0, "force_scale.gain": 0.01, "jaw_slip.slip": 0.04, "machine_compliance.compliance": 1e-5}
TINY = {name: 1e-3 * value for name, value in ON.items()}
FELT = {"force": AMPLITUDES[:2], "displacement": AMPLITUDES}
"""Amplitudes that a run feels by its control: a force does not pass jaws and frame, but with them its error moves the end."""


def run(loading: Loading, parameters: Parameters, names: tuple[str, ...] = ()) -> tuple[History, dict[str, np.ndarray]]:
    """A run and the derivatives of its fields (n_t, ..., n_p)."""
    kept: dict[str, list[np.ndarray]] = {"u": [], "theta": [], "force": []}

    def collect(n: int, at: StepRates) -> None:
        for field, values in kept.items():
            values.append(np.array(getattr(at, field)))

    body = tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1), control=loading.control)
    watch = Watch(sensitivities=Sensitivities(names, collect, tolerance=1e-9)) if names else Watch()
    history = march(body, parameters, loading, TIMES, SETTINGS, watch)
    return history, {field: np.stack(values) for field, values in kept.items() if values}


def test_the_slot_holds_these_effects_and_the_force_is_corrected_before_the_end() -> None:
    assert [e.amplitude.name for e in effects(LOAD)] == list(AMPLITUDES)


def test_closed_forms() -> None:
    force, end = np.array([0.0, 1000.0, 3000.0, 500.0]), np.array([0.0, 0.1, 0.5, 0.4])
    assert np.allclose(effect("force_scale").act(force, end, 0.02)[0], 1.02 * force)
    assert np.allclose(effect("force_offset").act(force, end, -25.0)[0], force - 25.0)
    assert np.allclose(effect("machine_compliance").act(force, end, 2e-5)[1], end - [0.0, 0.02, 0.06, 0.01])
    slipped = 0.3 * (1.0 - np.exp(-np.array([0.0, 1.0, 3.0, 3.0])))
    assert np.allclose(effect("jaw_slip").act(force, end, 0.3, 1000.0)[1], end - slipped), "jaws do not let go"
    for name in ("force_scale", "force_offset"):
        assert effect(name).act(force, end, 0.1)[1] is end
    assert effect("machine_compliance").act(force, end, 0.1)[0] is force
    assert effect("jaw_slip").act(force, end, 0.1, 500.0)[0] is force


@pytest.mark.parametrize("loading", [FORCE, CROSSHEAD, OWN_END], ids=["force", "crosshead", "own end"])
def test_loading_is_the_same_object_at_neutral(loading: Loading) -> None:
    assert loading.acting(BASE) is loading
    assert loading.acting(BASE.replace(**{"jaw_slip.force": 500.0})) is loading


def test_acting_load_in_closed_form() -> None:
    """Force: (F + offset)(1 + gain). End: crosshead less compliance and slip of the force as corrected, from where it rested."""
    on = BASE.replace(**ON)
    force = 1.01 * (RECORDED + 40.0)
    assert np.allclose(FORCE.acting(on).value, force, rtol=1e-15)
    assert np.array_equal(acting_force(RECORDED, on), FORCE.acting(on).value)
    peak = np.array([40.4, 40.4, *[force[2]] * 4])
    give = 1e-5 * force + 0.04 * (1.0 - np.exp(-peak / 1000.0))
    assert np.allclose(CROSSHEAD.acting(on).value, CROSSHEAD.value - give + give[0], rtol=1e-14)
    assert OWN_END.acting(on) is OWN_END
    assert not OWN_END.rates(on, AMPLITUDES).any()


@pytest.mark.parametrize("loading", [FORCE, CROSSHEAD], ids=["force", "crosshead"])
@pytest.mark.parametrize("values", [{}, ON], ids=["neutral", "on"])
def test_rates_of_the_acting_load_are_those_of_differences(loading: Loading, values: dict[str, float]) -> None:
    parameters, names = BASE.replace(**values), (*AMPLITUDES, "jaw_slip.force", "E")
    found = loading.rates(parameters, names)
    assert not found[:, -1].any()
    for k, name in enumerate(names[:-1]):
        h = 1e-3 * ON.get(name, 1000.0)
        there, back = (loading.acting(parameters.replace(**{name: parameters[name] + x})).value for x in (h, -h))
        expected = (there - back) / (2.0 * h)
        assert np.allclose(found[:, k], expected, rtol=1e-5, atol=1e-6 * max(np.abs(expected).max(), 1e-9)), name
        if loading is FORCE:
            assert np.allclose(acting_force_rate(RECORDED, parameters, name), found[:, k], rtol=1e-15)


def test_a_load_cell_shows_what_makes_the_force_that_acts() -> None:
    """F = (1 + gain)(R + offset) the other way round: halving all forces halves what is left, and is no better for it."""
    force, on = RECORDED + np.linspace(-30.0, 50.0, len(RECORDED)), BASE.replace(**{**ON, "force_scale.gain": -0.5})
    assert np.allclose(shown_force(force, RECORDED, BASE), force, rtol=1e-12)
    assert np.allclose(shown_force(acting_force(RECORDED, on), RECORDED, on), RECORDED, rtol=1e-12)
    assert np.allclose(shown_force(force, RECORDED, on), force / 0.5 - on["force_offset.offset"], rtol=1e-9)
    none = np.zeros(len(force))
    assert np.allclose(shown_force_rate(force, none, RECORDED, on, "force_scale.gain"), -force / 0.25, rtol=1e-9)
    assert np.allclose(shown_force_rate(force, none, RECORDED, on, "force_offset.offset"), -1.0, rtol=1e-9)
    assert np.allclose(shown_force_rate(force, force, RECORDED, on, "E"), force / 0.5, rtol=1e-9)
    upside_down = BASE.replace(**{"force_scale.gain": -1.0})
    with pytest.raises(NumericsError, match="with force_scale the force on the specimen does not grow with the recorded one"):
        shown_force(force, RECORDED, upside_down)


@pytest.mark.parametrize("loading", [FORCE, CROSSHEAD], ids=["force", "crosshead"])
@pytest.mark.parametrize("values", [ON, TINY, {}], ids=["on", "tiny", "dormant"])
def test_influence_on_a_whole_run_is_that_of_differences(loading: Loading, values: dict[str, float]) -> None:
    """Displacement, temperature and force by every amplitude, beside Params of the material that are asked for in the same run."""
    parameters = BASE.replace(**values)
    history, rates = run(loading, parameters, ("E", *AMPLITUDES, "M_y0"))
    if not values:
        plain, _ = run(loading, BASE)
        assert np.abs(history.u - plain.u).max() < 1e-8
    for k, name in enumerate(AMPLITUDES, start=1):
        if name not in FELT[loading.control] or (loading is CROSSHEAD and not values and name.startswith("force_")):
            assert not any(rates[field][..., k].any() for field in rates), name
            continue
        h = 0.03 * ON[name]
        there, back = (run(loading, parameters.replace(**{name: parameters[name] + x}))[0] for x in (h, -h))
        for field, value in rates.items():
            expected = (getattr(there, field) - getattr(back, field)) / (2.0 * h)
            size = np.abs(expected).max()
            noise = 4e-8 * np.abs(getattr(there, field)).max() / h
            assert np.abs(value[..., k] - expected).max() < 2e-4 * size + noise, (field, name, size)


def test_a_run_is_differentiated_along_modes_of_its_force() -> None:
    """Second-order Taylor test of a whole run, beside a Param of the material, with an effect of the machine in between; another mode of
    the same run has its own derivative. Both rest where the force rests: whether a force at its largest flows on has
    no derivative."""
    time = np.array([0.0, 1.0, 9.0, 25.0, 35.0, 37.0, 60.0])
    recorded = np.interp(time, TIME, RECORDED)
    modes = np.array([[0.0, 0.0, 30.0, 30.0, 30.0, 0.0, 0.0], [0.0, 0.0, -25.0, 20.0, 20.0, -5.0, 0.0]]).T
    loading, on = Loading(time, recorded, modes=modes), BASE.replace(**{"force_scale.gain": 0.01})
    names = load_modes(2)
    history, rates = run(loading, on, (names[1], "E", names[0]))
    assert [load_mode(n) for n in (*names, "E")] == [0, 1, -1]
    for place, mode in ((0, 1), (2, 0)):
        for field, size in (("u", 1e-3), ("theta", 1e-2), ("force", 1.0)):
            left = []
            for h in (1.0, 0.5):
                there = run(replace(loading, value=recorded + h * modes[:, mode]), on)[0]
                left.append(np.abs(getattr(there, field) - getattr(history, field) - h * rates[field][..., place]).max())
            assert left[1] < 0.35 * left[0] + 1e-6 * size, (field, mode, left)
    assert np.allclose(rates["force"][1:, 2], 1.01 * np.interp(TIMES[1:], time, modes[:, 0]), atol=1e-9)


def test_modes_are_of_what_is_prescribed_itself() -> None:
    """A force, or the motion of the specimen: what acts of a crosshead hangs on the force that was recorded with it."""
    for loading in (FORCE, replace(CROSSHEAD, modes=np.zeros((6, 1)))):
        with pytest.raises(StudyError, match="expected a prescribed load with modes"):
            loading.rates(BASE, load_modes(1))
    modes = np.linspace(0.0, 1.0, 6)[:, None]
    assert np.array_equal(replace(OWN_END, modes=modes).rates(BASE.replace(**ON), load_modes(1)), modes)


def test_what_moves_nothing_takes_no_part_and_keeps_its_zero_columns() -> None:
    """Under a prescribed force jaws and frame move nothing; at a crosshead they do. Names and columns stay in their places."""
    names = ("E", *AMPLITUDES, "M_y0")
    assert moving(names, FORCE.rates(BASE, names)) == [0, 1, 2, 5]
    assert moving(names, CROSSHEAD.rates(BASE.replace(**ON), names)) == [0, 1, 2, 3, 4, 5]
    assert moving(names, OWN_END.rates(BASE, names)) == [0, 5]
    handed: list[StepRates] = []
    asked = Sensitivities(names, lambda n, at: handed.append(at)).of([0, 5])
    assert asked.names == ("E", "M_y0")
    asked.collect(0, StepRates(np.full((2, 3, 2), [1.0, 2.0]), np.full((2, 2), [3.0, 4.0]), np.array([5.0, 6.0])))
    np.testing.assert_array_equal(handed[0].u[1, 2], [1.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    np.testing.assert_array_equal(handed[0].theta[1], [3.0, 0.0, 0.0, 0.0, 0.0, 4.0])
    np.testing.assert_array_equal(handed[0].force, [5.0, 0.0, 0.0, 0.0, 0.0, 6.0])


def test_an_error_of_force_cannot_be_told_from_a_modulus_while_all_is_elastic() -> None:
    """u depends on F/E alone: the columns of force_scale and of E lie on one line where nothing flows, not where it does."""
    cosines = []
    for plastic in (False, True):
        cold = BASE.replace(alpha_exp=0.0)
        body, names = tension_body(dogbone_mesh(SPECIMEN, 1, 8, 1)), ("E", "force_scale.gain")
        kept: list[np.ndarray] = []
        watch = Watch(sensitivities=Sensitivities(names, lambda n, at, kept=kept: kept.append(np.array(at.u))))
        march(body, cold, FORCE, TIMES, replace(SETTINGS, plastic=plastic), watch)
        a, b = np.stack(kept).reshape(-1, 2).T
        cosines.append(abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b))
    assert cosines[0] > 0.9999
    assert cosines[1] < 0.9


def test_hill_parameter_of_the_thickness_is_a_convention_in_a_uniaxial_test() -> None:
    """Why the base effect hill_anisotropy does not hold H: its column is in the span of those of F, G and the yield stresses."""
    names = ("F", "M_y0", "M_yinf", "H_lin", "G", "L", "H")
    _, rates = run(FORCE, BASE, names)
    columns = rates["u"].reshape(-1, len(names))
    columns = columns / np.linalg.norm(columns, axis=0)
    left = [columns[:, k] - columns[:, :k] @ np.linalg.lstsq(columns[:, :k], columns[:, k], rcond=None)[0] for k in (4, 6)]
    assert np.linalg.norm(left[1]) < 1e-3 < np.linalg.norm(left[0])
