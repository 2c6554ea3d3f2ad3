"""Local balances of a small body: nothing where nothing is missing, a source at its place and time (made by another discretisation),
nothing of what comes from beyond the observed length, and a law that the model lacks in the force of sections."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.linalg import solve_banded
from virtual_pulls import SIZE, SPECIMEN, TRUTH, study

from thermofit.body.solve.march import Loading
from thermofit.core.parameters import Parameters
from thermofit.diagnose.balances import where_of
from thermofit.diagnose.significance import SignificanceMap, significance
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.forward import MechanicalRun, march_settings, sampler, specimen_body
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.local_balance import JointErrors
from thermofit.experiment.piece_heat import piece_heat
from thermofit.experiment.residuals import named_phases
from thermofit.experiment.section_force import last_rate, measured_flow, predicted_states, section_force
from thermofit.observe.observation import FieldObservation
from thermofit.point.driver import PointSettings, Programme, simulate

FREE = ("E", "M_y0", "M_yinf", "H_exp", "kappa", "c0", "beta", "alpha_air")
TIME = np.linspace(0.0, 48.0, 65)
FORCE = np.interp(TIME, [0.0, 3.0, 7.0, 20.0, 26.0, 33.0, 36.0, 39.0, 48.0], [0.0, 0.0, 3600.0, 4700.0, 5300.0, 5500.0, 0.0, 0.0, 0.0])
"""Fast, slow, fast, unloaded, cooled: N over s."""
HELD = np.interp(TIME, [0.0, 3.0, 7.0, 9.0, 33.0, 36.0, 48.0], [0.0, 0.0, 3600.0, 4500.0, 4500.0, 0.0, 0.0])
"""Held at the largest force, where the strain does not grow by its noise."""
X, Y = np.meshgrid([-8.0, -4.0, 0.0, 4.0, 8.0], np.linspace(-20.0, 20.0, 17))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)
NOISE = {"u": 5e-4, "theta": 0.01}
PHASES = (
    TestPhase(0.0, 3.0, "rest"),
    TestPhase(3.0, 7.0, "elastic"),
    TestPhase(7.0, 33.0, "loading"),
    TestPhase(33.0, 36.0, "unloading"),
    TestPhase(36.0, 48.0, "cooling"),
)
TRUE = Parameters.of(TRUTH).with_free(FREE)


def fields(values: dict[str, float] | None = None, force: np.ndarray = FORCE) -> dict[str, np.ndarray]:
    """Displacements and temperatures of a body with these values under a force (n_t,) N, without noise."""
    truth = TRUE.replace(**(values or {}))
    empty = Measured(SPECIMEN, truth["theta_air"], truth["theta_clamp"], None, None, None, {}, 3.0, ())  # type: ignore[arg-type]
    body = specimen_body(study(), empty, SIZE)
    history = MechanicalRun(body, Loading(TIME, force), march_settings(study(), "full"))(truth)
    shape = (len(TIME), len(XY))
    blank = FieldObservation("u", TIME, XY, np.zeros((*shape, 2)), np.ones((*shape, 2)), np.ones(shape, dtype=bool), "mm")
    look = sampler(body, blank, LoadSteps(TIME, force))
    return {"u": look.displacement(history), "theta": look.temperature(history.theta)}


@lru_cache(maxsize=2)
def joint(held: bool = False) -> tuple[Joint, dict[str, np.ndarray]]:
    """The joint problem of that test, or of the one that is held, and its derivatives at the truth."""
    pulled = HELD if held else FORCE
    found = fields(force=pulled)
    everywhere = np.ones((len(TIME), len(XY)), dtype=bool)
    seen = {
        name: FieldObservation(name, TIME, XY, value, np.full(value.shape, NOISE[name]), everywhere, {"u": "mm", "theta": "K"}[name])
        for name, value in found.items()
    }
    steps = LoadSteps(TIME, pulled)
    every = {"displacement": steps, "temperature": steps, "all": steps}
    force = force_observation(TIME, steps, 4.0)
    air, clamp = TRUTH["theta_air"], TRUTH["theta_clamp"]
    data = Measured(SPECIMEN, air, clamp, seen["u"], seen["theta"], force, every, 3.0, PHASES)
    made = Joint(study(), data, joint_settings(study(), FREE, data), SIZE)
    assert made.model.linearise is not None
    return made, dict(made.model.linearise(TRUE, FREE)[1])


def shown(seed: int, added: dict[str, np.ndarray] | None = None, *, held: bool = False) -> JointErrors:
    """What the true model leaves of a measurement with noise that holds more than the model by `added`."""
    made, slopes = joint(held)
    rng = np.random.default_rng(seed)
    errors = {}
    for name, observation in made.model.observations.items():
        more = (added or {}).get(name, np.zeros_like(observation.value))
        errors[name] = -more - NOISE[name] * rng.normal(size=observation.value.shape)
    return JointErrors(made, TRUE, errors, slopes, {})


def maps(seen: JointErrors) -> tuple[SignificanceMap, SignificanceMap]:
    """Maps of force and heat."""
    spans = named_phases(PHASES)
    force, heat = section_force(seen, spans), piece_heat(seen, measured_flow(seen, spans))
    assert force is not None and heat is not None
    return significance(force), significance(heat)


def conducted(power: float, place: float, window: tuple[float, float]) -> np.ndarray:
    """Rise (n_t, n_s, 1) K by a source of `power` mW/mm^3 within 3 mm of a place: finite differences in 0.5 mm and 0.05 s along a bar."""
    y, dt = np.arange(-74.75, 75.0, 0.5), 0.05
    v = TRUE.values
    loss = 2.0e-3 * v["alpha_air"] * (1.0 / SPECIMEN.thickness + 1.0 / SPECIMEN.gauge_width)
    r = dt * v["kappa"] / v["c0"] / 0.25
    band = np.zeros((3, len(y)))
    band[0, 1:], band[2, :-1] = -r, -r
    band[1] = 1.0 + 2.0 * r + dt * loss / v["c0"]
    source = power * (np.abs(y - place) < 3.0) * dt / v["c0"]
    rise, out, at = np.zeros(len(y)), np.zeros((len(TIME), len(XY), 1)), 0
    for n, t in enumerate(TIME):
        while at * dt < t - 1e-9:
            at += 1
            rise = solve_banded((1, 1), band, rise + source * (window[0] < at * dt <= window[1]))
        out[n, :, 0] = np.interp(XY[:, 1], y, rise)
    return out


def test_maps_of_a_test_that_lacks_nothing_are_standard_normal() -> None:
    both = [maps(shown(seed)) for seed in range(12)]
    for each in zip(*both, strict=True):
        z = np.concatenate([m.z[np.isfinite(m.z)] for m in each])
        assert 0.8 < z.std() < 1.1 and np.mean(np.abs(z) > 3.0) < 0.008, (each[0].balance.kind, z.std())
        assert 0.7 < np.mean([m.chi2 / m.degrees for m in each]) < 1.15
        assert not any(m.stands_out for m in each)
        assert all(m.balance.dropped == 0 for m in each)


def test_noise_that_turns_flow_into_unloading_is_no_missing_force() -> None:
    """At a force that is held the strain does not grow: a far error of it unloads the section, elastically and stiffly."""
    spans = named_phases(PHASES)
    found = [significance(balance) for seed in range(8) if (balance := section_force(shown(seed, held=True), spans)) is not None]
    assert len(found) == 8 and not any(m.stands_out for m in found)
    assert np.mean([m.chi2 / m.degrees for m in found]) < 1.0


def test_a_source_is_found_at_its_place_and_time() -> None:
    _, heat = maps(shown(30, {"theta": conducted(0.3, 8.0, (20.0, 30.0))}))
    assert heat.stands_out and where_of(True, heat.stands_out) == "inside"
    block, b = heat.block, heat.balance
    assert block.y[0] < 8.0 < block.y[1] and abs(block.time[0] - 20.0) < 4.0 and abs(block.time[1] - 30.0) < 5.0
    assert abs(b.y[heat.peak] - 8.0) < 0.5 * b.extent and 18.0 < b.time[heat.peak] < 32.0
    assert heat.z[heat.peak] > 8.0


def test_without_displacements_the_stretch_is_that_of_the_run() -> None:
    """Conduction goes along the stretched specimen: by a tenth of it at 5 % of strain."""
    whole = shown(36, {"theta": conducted(0.3, 8.0, (20.0, 30.0))})
    data = replace(whole.joint.data, displacement=None)
    alone = Joint(study(), data, joint_settings(study(), FREE, data), SIZE)
    heat = [
        piece_heat(replace(whole, joint=one, errors=errors))
        for one, errors in ((whole.joint, whole.errors), (alone, {"theta": whole.errors["theta"]}))
    ]
    assert heat[0] is not None and heat[1] is not None
    assert np.allclose(heat[1].amount, heat[0].amount, atol=2e-3 * np.abs(heat[0].amount).max())


def test_heat_from_beyond_the_observed_length_is_not_missing_inside() -> None:
    rise = conducted(3.0, 40.0, (10.0, 48.0))
    assert rise[-1].max() > 20.0 * NOISE["theta"], "it is seen in the whole field"
    force, heat = maps(shown(31, {"theta": rise}))
    assert not heat.stands_out and not force.stands_out and where_of(True, heat.stands_out) == "outside"


@pytest.mark.parametrize("planted", [{"rate_logarithmic.C": 0.02}, {"backstress_first.C": 3000.0, "backstress_first.gamma": 100.0}])
def test_a_law_that_is_missing_shows_in_the_force_of_sections(planted: dict[str, float]) -> None:
    found, clean = fields(planted), joint()[0].model.observations
    force, _ = maps(shown(32, {name: found[name] - clean[name].value for name in found}))
    assert force.stands_out
    assert force.balance.time[force.peak] > 5.0, "nothing flows before"


def test_the_force_of_a_section_is_what_its_law_makes_of_its_strain() -> None:
    # A section that is strained by 2e-3 more while it flows has to carry the hardening of that.
    made, _ = joint()
    ramp = np.interp(TIME, [12.0, 20.0, 33.0, 48.0], [0.0, 2e-3, 2e-3, 2e-3])
    more = np.zeros_like(made.model.observations["u"].value)
    more[:, :, 1] = ramp[:, None] * XY[:, 1]
    seen = shown(33, {"u": more})
    balance = section_force(seen, named_phases(PHASES))
    state = predicted_states(seen, named_phases(PHASES))
    assert balance is not None and state is not None
    flowing = (balance.time > 22.0) & (balance.time < 32.0)
    law, alpha = TRUE.values, np.interp(27.0, state.time, state.accumulated.mean(axis=1))
    slope = law["H_exp"] * (law["M_yinf"] - law["M_y0"]) * np.exp(-law["H_exp"] * alpha) / (law["F"] + law["H"])
    expected = 25.0 * 1.2 * 2e-3 * slope
    assert balance.amount[flowing].mean() == pytest.approx(expected, rel=0.25)


def test_states_of_sections_follow_the_flow() -> None:
    state = predicted_states(shown(34), named_phases(PHASES))
    assert state is not None
    assert np.all(np.diff(state.accumulated, axis=0) > -1e-12) and state.accumulated[-1].mean() > 0.01
    assert np.isnan(state.rate[0]).all() and np.all(state.rate[-1] == state.rate[-2]), "held after the last flow"
    assert last_rate(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.02, 0.02]))[1:].tolist()[1:] == [0.02, 0.02]


def test_errors_of_the_force_are_common_to_all_sections() -> None:
    made, _ = joint()
    steps = replace(made.data.steps["all"], error=20.0 * np.exp(-0.5 * ((TIME - 15.0) / 2.0) ** 2)[:, None])
    other = replace(made, data=replace(made.data, steps={**made.data.steps, "all": steps}))
    seen = replace(shown(35), joint=other)
    balance = section_force(seen, named_phases(PHASES))
    assert balance is not None and balance.beside.shape[1] == 1
    assert balance.beside[:, 0] == pytest.approx(np.interp(balance.time, TIME, steps.error[:, 0]), abs=4.0)


def test_a_prescribed_temperature_is_that_of_the_point() -> None:
    time, strain = np.linspace(0.0, 10.0, 41), np.linspace(0.0, 0.02, 41)
    theta = 296.7 + np.linspace(0.0, 30.0, 41)
    found = simulate(TRUE, replace(Programme.by_strain(time, strain, 250.0), theta=theta), PointSettings())
    # In the middle of every interval, and at the start.
    assert found.theta[0] == pytest.approx(theta[0]) and found.theta[1:] == pytest.approx(0.5 * (theta[1:] + theta[:-1]), abs=1e-3)
    cold = simulate(TRUE, replace(Programme.by_strain(time, strain), theta=np.full(41, 296.7)), PointSettings())
    # Held strain, warmer: less elastic strain, which the stress shows before flow.
    shift = found.stress[3] - cold.stress[3]
    assert shift == pytest.approx(-TRUE["E"] * TRUE["alpha_exp"] * (found.theta[3] - 296.7), rel=0.05)
