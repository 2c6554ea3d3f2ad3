"""The joint model of all channels: the residual of the separate stages, and one Jacobian of specimen, machine and instruments."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from virtual_pulls import FORCE, SIZE, TIME, TRUTH, data, model, part, study

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, linearised, scans
from thermofit.diagnose.score import Columns, ranked
from thermofit.effects.catalogue import BASE, HEATING, KINEMATICS, LOAD, effect, effects
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.instruments import JointPrediction
from thermofit.experiment.joint import THERMOCOUPLE, Joint, joint_free, joint_settings, station_names
from thermofit.experiment.known_effects import effects_of_data, effects_of_fields
from thermofit.experiment.model import stage_model
from thermofit.experiment.residuals import Span
from thermofit.fit.linear_model import LinearModel
from thermofit.study.section import MeshSize

BODY = ("E", "M_y0", "c0", "alpha_air", "theta_air", "rate_power.K", "force_scale.gain", "force_offset.offset")
INSTRUMENTS = {
    "ir_drift.rate": 1e-3, "ir_gain.gain": 0.05, "ir_clock.offset": 0.5, "ir_lag.time": 0.7, "ir_emissivity.slope": 0.5,
    "ir_reflection.strength": 0.5, "ir_reflection.tilt": 0.01, "ir_registration.shift_y": 0.5, "ir_registration.shift_x": -0.3,
    "ir_registration.rotation": 0.02, "ir_registration.scale": 0.02, "dic_scale.error": 0.01, "dic_out_of_plane.strain": 1e-3,
    "bending.curvature": 1e-5, "dic_tilt.along": 1e-5, "dic_tilt.across": -1e-5,
}  # fmt: skip
ALL_ON = {**INSTRUMENTS, "rate_power.K": 5.0, "force_scale.gain": 0.01, "force_offset.offset": 20.0}
STEPS = {"E": 100.0, "M_y0": 0.1, "c0": 0.01, "alpha_air": 0.1, "theta_air": 0.02, "rate_power.K": 0.05}


def test_residual_is_that_of_the_separate_stages() -> None:
    extra = (
        "stages:\n  plastic: {free: [M_y0, M_yinf], coupling: full, channels: {du: {}}}\n  thermal: {free: [c0, kappa], coupling: full}\n"
    )
    case = study(extra)
    base = Parameters.of(TRUTH).replace(M_y0=133.0, c0=2.3)
    joint = model(case)
    residual = joint.residual(base)
    assert [c.channel for c in joint.comparisons] == ["du", "dtheta"]
    for key, channel in (("plastic", "du"), ("thermal", "dtheta")):
        settings = case.stage(key)
        alone = stage_model(case, data(), settings, base.with_free(settings.free), SIZE, (0.0, 40.0, "")).residual(base)
        here = residual[part(joint, channel)]
        assert np.abs(here).max() > 3.0
        assert np.allclose(here, alone, atol=1e-6), channel


def test_all_stages_are_free_together_each_parameter_once() -> None:
    case = study("stages:\n  elastic: {free: [E, nu]}\n  plastic: {free: [M_y0, E]}\n  thermal: {free: [c0]}\n")
    assert joint_free(case, [data()]) == ("E", "nu", "M_y0", "c0", "theta_air", "theta_clamp")


def test_what_no_datum_tells_is_not_free() -> None:
    """Without temperatures nothing of the heat balance; of a test that stays elastic nothing of plasticity."""
    case = study("stages:\n  elastic: {free: [E, nu]}\n  plastic: {free: [M_y0, E]}\n  thermal: {free: [c0]}\n")
    cold = replace(data(), temperature=None)
    assert joint_free(case, [cold]) == ("E", "nu", "M_y0")
    assert joint_free(case, [replace(cold, phases=(TestPhase(0.0, 1.0, "elastic"),))]) == ("E", "nu")
    assert joint_free(case, [cold, data()]) == joint_free(case, [data()]), "one of several tests tells it"
    still = replace(data(), displacement=None)
    assert joint_free(case, [still]) == ("c0", "theta_air", "theta_clamp"), "temperatures alone tell no mechanics"
    assert list(joint_settings(case, ("c0",), still).channels) == ["dtheta"]


def test_without_an_infrared_camera_no_effect_of_heat_is_asked() -> None:
    asked = {e.name for e in effects_of_fields(infrared=False)}
    assert not asked & {e.name for e in effects(HEATING)} and "stored_energy" in {e.name for e in effects_of_fields(infrared=True)}
    assert {"dic_tilt", "thermal_softening"} <= asked and "heating_profile" not in asked


@pytest.mark.parametrize(("least", "asked"), [(0.0, False), (-0.2, False), (-0.3, True), (-1.0, True)])
def test_tension_and_compression_are_told_apart_where_the_load_turns(least: float, asked: bool) -> None:
    """By a quarter of the largest load; pushed and pulled a little is the same the other way round."""
    for sense in (1.0, -1.0):
        steps = data().steps["all"]
        force = sense * np.interp(np.arange(len(steps.force)), [0, 1, len(steps.force) - 1], [0.0, 1000.0, 1000.0 * least])
        there = replace(data(), steps={**data().steps, "all": replace(steps, force=force)})
        assert ("tension_compression" in {e.name for e in effects_of_data(there, "hill")}) is asked
    assert "tension_compression" in {e.name for e in effects_of_fields(infrared=True)}


@pytest.mark.parametrize("values", [{}, ALL_ON], ids=["off", "on"])
def test_jacobian_is_that_of_differences(values: dict[str, float]) -> None:
    """Instruments exactly; the specimen up to the scene, which is taken as it is while effects are on."""
    joint, base = model(study()), Parameters.of(TRUTH).replace(**values)
    names = (*BODY, *INSTRUMENTS)
    residual, jacobian = joint.linearised(base, names)
    assert np.allclose(residual, joint.residual(base), atol=1e-4)
    for k, name in enumerate(names):
        of_instrument = name in INSTRUMENTS
        h = STEPS.get(name, (1e-3 if of_instrument else 0.1) * abs(ALL_ON.get(name, 0.0)))
        up = joint.residual(base.replace(**{name: base[name] + h}))
        one_sided = base[name] == param(name).neutral and name in ("ir_clock.offset", "rate_power.K")
        down = residual if one_sided else joint.residual(base.replace(**{name: base[name] - h}))
        expected = (up - down) / (h if one_sided else 2.0 * h)
        rows = np.ones(len(residual), dtype=bool)
        if name == "ir_clock.offset" and one_sided:  # nothing is known beyond the last frame
            rows[part(joint, "dtheta")] = joint.comparisons[1].rows[:, 0] < len(TIME) - 1
        size, error = np.abs(expected[rows]).max(), np.abs(jacobian[rows, k] - expected[rows]).max()
        assert (size > 0.0) == (name != "ir_reflection.tilt" or bool(values)), name
        assert error <= (1e-4 if of_instrument else 0.03) * size + 1e-6 / h, (name, error, size)


def test_instruments_change_what_is_seen_alone() -> None:
    """Closed forms at the end of the chain, and a channel that an instrument does not look at stays bit for bit."""
    joint, base = model(study()), Parameters.of(TRUTH)
    plain = joint.errors(base)
    drifted = joint.errors(base.replace(**{"ir_drift.rate": 2e-3}))
    assert np.allclose((drifted["theta"] - plain["theta"])[:, :, 0], 2e-3 * TIME[:, None], atol=1e-12)
    assert np.array_equal(drifted["u"], plain["u"])
    scaled = joint.errors(base.replace(**{"dic_scale.error": 0.01}))
    u = plain["u"] + data().displacement.value
    assert np.allclose(scaled["u"] - plain["u"], 0.01 * u, atol=1e-14)
    twice = joint.errors(base.replace(**{"dic_scale.error": 0.02}))["theta"] - plain["theta"]
    assert np.allclose(twice, 2.0 * (scaled["theta"] - plain["theta"]), atol=1e-12), (
        "a pixel is given to the point that is said to be there"
    )
    assert np.abs(twice).max() > 1e-6
    assert np.array_equal(joint.errors(base.replace(**{"jaw_slip.slip": 0.01}))["theta"], plain["theta"])
    neutral = joint.errors(base.with_free(tuple(INSTRUMENTS)))
    assert all(np.allclose(neutral[name], plain[name], atol=1e-12) for name in plain)
    assert station_names() >= set(INSTRUMENTS) and not station_names() & set(BODY)


def test_what_a_force_does_not_pass_is_unfelt() -> None:
    joint, names = model(study()), ("E", "machine_compliance.compliance", "jaw_slip.slip")
    residual, jacobian = joint.linearised(Parameters.of(TRUTH), names)
    assert not jacobian[:, 1:].any()
    dormant = {n.partition(".")[0]: ((n,), jacobian[:, [k]]) for k, n in enumerate(names) if k > 0}
    assert ranked(Columns(LinearModel(residual, jacobian[:, :1]), dormant)).unfelt == ("machine_compliance", "jaw_slip")


def test_thermocouples_are_data_with_an_error() -> None:
    free = ("c0", "theta_clamp", "theta_air")
    joint, base = model(study(), free), Parameters.of(TRUTH).replace(theta_air=297.25, theta_clamp=296.9)
    residual, jacobian = joint.linearised(base, free)
    assert [prior.name for prior in joint.priors] == ["theta_air", "theta_clamp"]
    assert residual[-2:] == pytest.approx(np.array([-0.15, 0.2]) / THERMOCOUPLE)
    assert np.allclose(jacobian[-2:], np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]) / THERMOCOUPLE)
    assert np.allclose(residual[:-2], model(study()).residual(base), atol=1e-4)
    assert not model(study(), ("c0",)).priors


CROSSHEAD = "force: {drives: crosshead}\n"
MACHINE = {"machine_compliance.compliance": 1e-5, "jaw_slip.slip": 0.02, "force_offset.offset": 20.0, "force_scale.gain": 0.01}


@pytest.mark.parametrize("values", [{}, MACHINE], ids=["off", "on"])
def test_where_the_crosshead_drives_the_force_is_compared_as_corrected(values: dict[str, float]) -> None:
    joint, base = model(study(CROSSHEAD)), Parameters.of(TRUTH).replace(**values)
    assert [c.channel for c in joint.comparisons] == ["du", "force", "dtheta"]
    names = ("M_y0", *MACHINE)
    residual, jacobian = joint.linearised(base, names)
    rows = part(joint, "force")
    if values:
        moved = joint.errors(base)["force"].ravel() - joint.errors(base.replace(**{"force_scale.gain": 0.0}))["force"].ravel()
        assert moved[6] == pytest.approx(-0.01 * (FORCE[6] + 20.0), rel=0.05)
    else:
        assert np.abs(residual[rows]).max() < 0.5
    for k, name in enumerate(names):
        h = STEPS.get(name, 0.05 * MACHINE.get(name, 0.0))
        up, down = (joint.residual(base.replace(**{name: base[name] + x})) for x in (h, -h))
        expected = (up - down) / (2.0 * h)
        for channel in ("du", "force", "dtheta"):
            here = part(joint, channel)
            size, error = np.abs(expected[here]).max(), np.abs(jacobian[here, k] - expected[here]).max()
            assert error <= 0.03 * size + 1e-4 / h, (name, channel, error, size)
    offset = jacobian[rows, names.index("force_offset.offset")]
    if not values:
        assert np.allclose(offset, -1.0 / 4.0), "N of offset by the noise of the load cell"


def test_an_effect_of_the_base_law_that_is_held_at_neutral_is_found() -> None:
    """Data with thermoelastic cooling, a model without: thermal_expansion comes first among the base law, the machine and the motion."""
    base = Parameters.of({**TRUTH, "alpha_exp": 0.0}).with_free(("E", "M_y0", "c0"))
    case = Case(model(study()), base, effects((*BASE, *LOAD, *KINEMATICS)), (), station_names())
    found = linearised(case)
    ranking = ranked(Columns(LinearModel(found.residual, found.fitted), found.dormant))
    assert ranking.scores[0].effect == "thermal_expansion"
    assert ranking.scores[0].estimate["alpha_exp"] == pytest.approx(2e-5, rel=0.1)
    assert set(ranking.unfelt) == {"machine_compliance", "jaw_slip"}


DIRECTIONS = (
    ("lamp.absorbed", {"lamp.start": 12.0}), ("lamp.absorbed", {"lamp.start": 28.0}), ("air_drift.rate", {"air_drift.time": 20.0}),
    ("stored_energy.slope", {}), ("capacity_by_temperature.slope", {}), ("initial_gradient.amplitude", {"initial_gradient.tilt": 3.0}),
)  # fmt: skip


@pytest.mark.parametrize("extra", [{}, {"ir_lag.time": 1.5, "ir_gain.gain": 0.1}], ids=["bare", "behind instruments"])
def test_effects_of_heat_are_felt_on_the_known_motion_as_in_whole_runs(extra: dict[str, float]) -> None:
    """Several values of an exponent at once, from one run; what they do to the motion is left out, and is small."""
    joint = Joint(study(), data(), joint_settings(study(), ("c0",), data()), SIZE)
    base = Parameters.of({**TRUTH, **extra}, ("c0",))
    residual, jacobian, along = joint.scored(base, ("c0",), DIRECTIONS)
    assert np.allclose(residual, joint.model.residual(base), atol=1e-3)  # in units of the noise; other directions keep other factors
    assert np.allclose(jacobian, joint.model.linearised(base, ("c0",))[1])
    warm = part(joint.model, "dtheta")
    for k, (name, others) in enumerate(DIRECTIONS):
        h = 0.02 * param(name).scale
        there = [joint.model.residual(base.replace(**others, **{name: sign * h})) for sign in (1.0, -1.0)]
        numeric = (there[0] - there[1]) / (2.0 * h)
        size = np.linalg.norm(numeric[warm])
        # The warming on the known motion is that of the heat capacity at constant stress, 4 % larger: a factor of it feels that.
        near = 0.1 if name.startswith("capacity") else 0.02
        assert np.linalg.norm(along[warm, k] - numeric[warm]) < near * size, name
        assert np.linalg.norm(numeric) < 1.02 * size and not along[part(joint.model, "du"), k].any(), name


def test_temperatures_alone_answer_to_thermal_parameters_as_in_the_joint_model() -> None:
    joint = Joint(study(), data(), joint_settings(study(), ("c0", "theta_air"), data()), SIZE)
    base = Parameters.of(TRUTH).replace(theta_air=297.6)
    alone = joint.heat(base)
    assert alone is not None and joint.mechanics is not None
    both, warm = joint.model.residual(base), part(joint.model, "dtheta")
    assert np.allclose(alone.residual(base), np.append(both[warm], both[-1]), atol=0.02)
    assert np.allclose(joint.mechanics.residual(base)[:-1], both[part(joint.model, "du")], atol=1e-6)
    names = ("kappa", "c0", "beta", "theta_air", "ir_lag.time")
    _, jacobian = joint.model.linearised(base, names)
    _, here = alone.linearised(base, names)
    for k, name in enumerate(names):
        assert np.linalg.norm(here[:-1, k] - jacobian[warm, k]) < 0.06 * np.linalg.norm(jacobian[warm, k]), name


def test_effects_are_scanned_where_a_run_tells_the_fields_apart() -> None:
    joint = Joint(study(), data(), joint_settings(study(), ("E", "c0"), data()), SIZE)
    base = Parameters.of(TRUTH, ("E", "c0"))
    spans = (Span("all", 0.0, 40.0),)
    case = Case(joint.model, base, effects(("surface_flux", "yield_factor", "sensor")), spans, station_names(), scored=joint.scored)
    found, plain = linearised(case), linearised(replace(case, scored=None))
    starts = [values["lamp.start"] for values in scans(effect("lamp"), case)]
    off, tried = param("lamp.start").neutral, [40.0 * share for share in param("lamp.start").scan]
    assert starts == [off, *(t for t in tried if t != off)] and len(found.scanned["lamp"]) == len(starts)
    assert np.allclose(found.residual, plain.residual, atol=1e-6)
    for name, (names, block) in plain.dormant.items():
        assert found.dormant[name][0] == names
        assert np.linalg.norm(found.dormant[name][1] - block) <= 0.05 * np.linalg.norm(block), name


def test_a_differentiated_run_is_not_made_again_for_other_data_of_the_same_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Data that hold the error of the mesh change no run; another mesh, other load steps and other names do."""
    runs: list[tuple[str, ...]] = []
    exact = JointPrediction.linearise

    def counted(self: JointPrediction, parameters: Parameters, names: tuple[str, ...]) -> Any:
        runs.append(names)
        return exact(self, parameters, names)

    monkeypatch.setattr(JointPrediction, "linearise", counted)
    names, parameters = ("c0",), Parameters.of(TRUTH, ("c0",))
    first = Joint(study(), data(), joint_settings(study(), names, data()), SIZE)
    plain = first.model.linearised(parameters, names)
    seen = first.data.displacement
    moved = replace(first, data=replace(first.data, displacement=replace(seen, value=1.05 * seen.value)))
    again = moved.model.linearised(parameters, names)
    assert len(runs) == 1
    fresh = replace(moved, kept=OrderedDict()).model.linearised(parameters, names)
    assert len(runs) == 2
    for a, b in zip(again, fresh, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    assert np.abs(again[0] - plain[0]).max() > 0.1
    others = replace(first, data=replace(first.data, steps=dict(first.data.steps)))
    # The other mesh first: it shares its load steps with what is kept.
    for joint, asked in ((replace(first, size=MeshSize(n_x=1, n_y=10, n_z=1)), names), (others, names), (first, ("c0", "beta"))):
        joint.model.linearised(parameters, asked)
    assert len(runs) == 5
