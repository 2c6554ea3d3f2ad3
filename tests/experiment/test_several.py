"""Several experiments in one fit: each sees its own boundary, all share the material; one Jacobian, one optimum."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from virtual_pulls import FORCE, SIZE, TRUTH, pulled, study

from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, joined_rows, scans
from thermofit.effects.catalogue import effect
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.joint import THERMOCOUPLE
from thermofit.experiment.many import SeveralExperiments
from thermofit.experiment.model import StageModel, stage_model
from thermofit.experiment.several import JointSeveral, free_in, joined, own_names, seen_by
from thermofit.identify.solve import solve
from thermofit.records.staging import Job
from thermofit.study.study import Study

OTHER = {"alpha_air": 40.0, "alpha_clamp": 900.0, "theta_air": 300.0, "theta_clamp": 295.5, "theta_ref": 295.5}
TWO = (
    "experiments:\n  first: {experiment: a}\n"
    "  second: {experiment: b, parameters: {alpha_air: {start: 30, bounds: [0, 200]}}, windows: {elastic: [0, 3.5]}}\n"
    "  third: {experiment: c, held_out: true}\n"
)
STARTS = {name: value for name, value in TRUTH.items() if not name.startswith("theta")}
THERMAL = "stages:\n  thermal: {free: [c0, alpha_air, alpha_clamp], coupling: full, channels: {dtheta: {}, du: {}}}\n"


def case(extra: str = THERMAL) -> Study:
    return study(TWO + extra, STARTS, raw="")


def both_of(whole: Study) -> SeveralExperiments:
    pulls = {"first": pulled(), "second": pulled(OTHER, 0.9 * FORCE, seed=8)}
    return SeveralExperiments(whole, tuple(BodyExperiment(whole.one_of(name), name, data) for name, data in pulls.items()))


@lru_cache(maxsize=1)
def data() -> SeveralExperiments:
    set_threads(1)
    return both_of(case())


def joint_of(several: SeveralExperiments, names: tuple[str, ...]) -> JointSeveral:
    parts = several.joint(several.joint_settings(names), Parameters.of(TRUTH), SIZE).parts
    assert isinstance(parts, JointSeveral)
    return parts


def model(names: tuple[str, ...], base: Parameters) -> StageModel:
    both = case()
    settings = both.stage("thermal").model_copy(update={"free": names})

    return data().model(settings, base, SIZE)


def test_names_of_one_experiment() -> None:
    assert param("alpha_air@second").unit == "W/(m^2 K)" and param("ir_gain.gain@second").name == "ir_gain.gain@second"
    p = Parameters.of({"alpha_air": 3.0, "alpha_air@second": 0.0, "c0": 2.0}, ("alpha_air@second",))
    assert p["alpha_air@second"] == 0.0 and p["alpha_air@first"] == 3.0 and p["c0@second"] == 2.0
    assert seen_by(p, "second")["alpha_air"] == 0.0 and seen_by(p, "first")["alpha_air"] == 3.0
    assert "alpha_air@second" in p.given() and p.replace(c0=1.0)["alpha_air@second"] == 0.0
    assert free_in(("c0", "alpha_air", "alpha_air@second"), "first") == {"c0": "c0", "alpha_air": "alpha_air"}
    assert free_in(("c0", "alpha_air", "alpha_air@second"), "second") == {"c0": "c0", "alpha_air@second": "alpha_air"}


def test_own_parameters_are_those_of_boundary_and_measurement() -> None:
    own = own_names(case())
    assert {"alpha_air", "theta_clamp", "ir_drift.rate", "dic_scale.error", "machine_compliance.compliance", "radiation.emissivity"} <= own
    assert not own & {"E", "c0", "kappa", "rate_power.K", "latent_heat.heat", "capacity_by_temperature.slope"}
    assert "alpha_air" not in own_names(case(THERMAL + "shared: [alpha_air]\n"))


def test_start_bounds_and_windows_of_each() -> None:
    both = case()
    start = data().start()
    assert start["alpha_air@first"] == 15.0 and start["alpha_air@second"] == 30.0 and start["theta_air@second"] == 300.0
    assert start["theta_ref@second"] == 295.5  # at rest in its own jaws
    assert both.bounds("alpha_air@second") == (0.0, 200.0) and both.bounds("alpha_air@first") == (0.0, 1e5)
    assert both.one_of("second").stages.elastic.window == (0.0, 3.5) and both.one_of("first").stages.elastic.window == "auto"
    assert data().expanded(("E", "alpha_air")) == ("E", "alpha_air@first", "alpha_air@second")
    assert both.fitted == ("first", "second") and both.held_out == ("third",)


def test_residual_is_that_of_each_alone() -> None:
    base = Parameters.of({**TRUTH, "c0": 2.3, "alpha_air@second": 20.0, "theta_air@second": 300.0})
    both = model(("c0", "alpha_air@first", "alpha_air@second"), base)
    parts = []
    for part, own in zip(data().tests, ({}, {"alpha_air": 20.0, "theta_air": 300.0}), strict=True):
        alone = part.study.stage("thermal")
        here = Parameters.of({**TRUTH, "c0": 2.3, **own})
        parts.append(stage_model(part.study, part.data, alone, here.with_free(("c0",)), SIZE, (0.0, 40.0, "")).residual(here))
    np.testing.assert_allclose(both.residual(base), np.concatenate(parts), atol=1e-9)
    assert [c.channel for c in both.comparisons] == ["dtheta@first", "du@first", "dtheta@second", "du@second"]
    assert set(both.observations) == {"u@first", "theta@first", "u@second", "theta@second"}


def test_jacobian_of_the_joint_fit_is_that_of_differences() -> None:
    base = Parameters.of({**TRUTH, **{f"{n}@second": v for n, v in OTHER.items()}})
    names = ("c0", "M_y0", "alpha_air@first", "alpha_clamp@second", "theta_clamp@second", "kappa")
    steps = (0.01, 0.1, 0.1, 5.0, 0.01, 1.0)
    both = model(names, base)
    residual, jacobian = both.linearised(base, names)
    ends = np.cumsum([c.n for c in both.comparisons])
    for k, (name, h) in enumerate(zip(names, steps, strict=True)):
        up, down = (both.residual(base.replace(**{name: base[name] + s * h})) for s in (1.0, -1.0))
        expected = (up - down) / (2.0 * h)
        assert np.abs(jacobian[:, k] - expected).max() < 0.01 * np.abs(expected).max() + 1e-6 / h, name
        first, second = np.abs(jacobian[: ends[1], k]).max() > 0.0, np.abs(jacobian[ends[1] :, k]).max() > 0.0
        assert (first, second) == (not name.endswith("second"), not name.endswith("first")), name
    np.testing.assert_allclose(residual, both.residual(base), atol=1e-4)


def test_joint_fit_finds_one_material_and_two_boundaries(tmp_path: Path) -> None:
    """Everything within four standard errors, and the common parameter better known than from either test."""
    both = case()
    settings = both.stage("thermal")
    free = data().expanded(settings.free)
    settings = settings.model_copy(update={"free": free})
    start = data().start().replace(c0=2.6)

    def on(size: object, base: Parameters) -> StageModel:
        return model(free, base)

    job = Job("identify-thermal", tmp_path / "identify-thermal.h5", {}, {})
    solved = solve(both, settings, start, on, job, scalable=True)
    truth = {"c0": 2.2, "alpha_air@first": 15.0, "alpha_air@second": 40.0, "alpha_clamp@first": 240.0, "alpha_clamp@second": 900.0}
    assert solved.covariance is not None and set(free) == set(truth)
    sigma = dict(zip(free, solved.covariance.sigma, strict=True))
    for name, value in truth.items():
        assert abs(solved.parameters[name] - value) < 4.0 * sigma[name], (name, solved.parameters[name], sigma[name])
    assert sigma["c0"] < 0.02


def test_what_contradicts_itself_is_one_sentence() -> None:
    for extra, match in (
        ("experiments: {a: {experiment: x}}\n", r"key 'experiment' is given, and so is 'a' under 'experiments'"),
        ("experiments: {a: {held_out: true}}\n", r"key 'experiments\.a\.experiment' is missing"),
        ("experiments: {a: {experiment: x, held_out: true}}\nstages:\n  plastic: {free: ['E@b']}\n", r"there is no experiment 'b'"),
        ("experiments: {a: {experiment: x, held_out: true}}\nstages:\n  plastic: {free: ['alpha_air@a']}\n", r"'a' is held out"),
        ("experiments: {a: {experiment: x, fit_own: [alpha_air], held_out: false}}\n", r"this test is fitted anyway"),
        ("experiments: {a b: {experiment: x}}\n", r"a b"),
        ("experiments: {a: {experiment: x, held_out: true, parameters: {alpha_air: -3}}}\n", r"experiments\.a\.parameters\.alpha_air"),
        ("shared: [alpha_air]\n", r"there is only one experiment"),
    ):
        with pytest.raises(StudyError, match=match):
            study(extra)


def test_a_model_without_exact_derivatives_says_so() -> None:
    part = data().tests[0]
    alone = stage_model(part.study, part.data, part.study.stage("thermal"), Parameters.of(TRUTH), SIZE, (0.0, 40.0, ""))
    whole = joined({"first": alone, "second": StageModel(alone.errors, alone.comparisons, alone.observations, "slow")})
    assert whole.linearise is None and whole.remark == "second: slow"


NAMES = ("c0", "alpha_air@first", "theta_air@first", "theta_clamp@second", "ir_gain.gain@second")
DIRECTIONS = (
    ("stored_energy.slope", {}),
    ("air_drift.rate@second", {"air_drift.time@second": 20.0}),
    ("lamp.absorbed@first", {"lamp.start@first": 12.0}),
)


def test_joint_stage_of_several_is_that_of_each() -> None:
    """Residual, Jacobian and columns along the heat equation: rows of data, then of priors; each test feels what is its own."""
    joint = joint_of(data(), NAMES)
    base = Parameters.of({**TRUTH, "c0": 2.3, **{f"{n}@second": v for n, v in OTHER.items()}}, NAMES)
    residual, jacobian, along = joint.scored(base, NAMES, DIRECTIONS)
    plain, columns = joint.model.linearised(base, NAMES)
    assert [p.name for p in joint.model.priors] == ["theta_air@first", "theta_clamp@second"]
    np.testing.assert_allclose(residual, plain, atol=1e-6)
    np.testing.assert_allclose(jacobian, columns, atol=1e-5 * np.abs(columns).max())
    n = sum(c.n for c in joint.each["first"].model.comparisons)
    whole = sum(c.n for c in joint.model.comparisons)
    felt = [(bool(along[:n, k].any()), bool(along[n:whole, k].any())) for k in range(3)]
    assert felt == [(True, True), (False, True), (True, False)] and not along[whole:].any()
    second = joint.each["second"]
    alone = second.scored(seen_by(base, "second"), (), [("air_drift.rate", {"air_drift.time": 20.0})])[2]
    np.testing.assert_allclose(along[n:whole, 1], alone[: whole - n, 0])


def test_the_thickest_test_tells_how_many_layers_all_have() -> None:
    """Of 4 mm of 25 mm one layer of the coarse mesh is enough, of 8 mm it is not; alone each test has its own."""
    whole = case().model_copy(update={"mesh": "coarse"})
    for thick in (("first",), ("second",), ()):
        tests = tuple(
            replace(
                t, given=replace(t.data, specimen=replace(t.data.specimen, gauge_width=25.0, thickness=8.0 if t.name in thick else 4.0))
            )
            for t in both_of(whole).tests
        )
        several, base = SeveralExperiments(whole, tests), Parameters.of(TRUTH)
        assert several.joint(several.joint_settings(("E",)), base).size.n_z == (2 if thick else 1)
        for one in tests:
            assert one.joint(one.joint_settings(("E",)), base).size.n_z == (2 if one.name in thick else 1)


def test_a_common_parameter_meets_the_prior_of_every_test() -> None:
    joint = joint_of(both_of(case("shared: [theta_air]\n" + THERMAL)), ("theta_air",))
    base = Parameters.of(TRUTH, ("theta_air",))
    _, columns = joint.model.linearised(base, ("theta_air",))
    assert [p.name for p in joint.model.priors] == ["theta_air@first", "theta_air@second"]
    np.testing.assert_allclose(columns[-2:, 0], 1.0 / THERMOCOUPLE)


def test_effects_of_boundary_and_instruments_are_those_of_one_test() -> None:
    known = {e.name: e for e in data().known()}
    assert {"rate_logarithmic", "ir_drift@first", "ir_drift@second", "lamp@second", "thermal_expansion"} <= set(known)
    assert not {"ir_drift", "rate_logarithmic@first", "lamp"} & set(known)
    assert known["lamp@second"].names == ("lamp.absorbed@second", "lamp.start@second", "lamp.onset@second")
    assert effect("lamp@second").amplitude.unit == "mW/mm^2"


def test_one_test_whose_load_turns_tells_tension_from_compression_for_all() -> None:
    first, second = data().tests
    steps = second.data.steps["all"]
    pushed = replace(second.data, steps={**second.data.steps, "all": replace(steps, force=-steps.force + 0.5 * steps.force.max())})
    several = replace(data(), given=(first, replace(second, given=pushed)))
    assert "tension_compression" in {e.name for e in several.known()}
    assert "tension_compression" not in {e.name for e in data().known()}


def test_rows_of_two_tests_keep_apart() -> None:
    joint = joint_of(data(), NAMES)
    spans = data().spans
    rows = joined_rows({name: part.model for name, part in joint.each.items()}, spans)
    assert len(rows.time) == len(joint.model.residual(Parameters.of({**TRUTH, **{f"{n}@second": v for n, v in OTHER.items()}}, NAMES)))
    names = [c.channel for c in joint.model.comparisons]
    for k, name in enumerate(names):
        own = rows.channel == k
        assert own.sum() == joint.model.comparisons[k].n
        assert {spans[p].experiment for p in np.unique(rows.phase[own])} == {name.partition("@")[2]}
    first = np.isin(rows.channel, [k for k, name in enumerate(names) if name.endswith("@first")])
    data_rows = rows.channel >= 0
    assert rows.time[first].max() < rows.time[data_rows & ~first].min() and np.all(rows.phase[~data_rows] == -1)
    here = Case(joint.model, Parameters.of(TRUTH), (), spans, frozenset())
    assert scans(effect("lamp@second"), here)[1]["lamp.start@second"] == pytest.approx(40.0 * param("lamp.start").scan[0])
