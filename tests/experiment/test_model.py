"""The residual of a stage on a small body: zero at the truth, the right fields, force where displacement drives."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_pulls import SPECIMEN, TRUTH

from thermofit.body.body import Body
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.core import parameters as declared
from thermofit.core.errors import StudyError
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.effects import catalogue
from thermofit.effects.catalogue import BASE, HEAT, HEATING, effects, load_effect
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.forward import MechanicalRun, Sampler, march_settings, sampler, specimen_body
from thermofit.experiment.held import thermal_names
from thermofit.experiment.instruments import station_names
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.model import StageModel, stage_model
from thermofit.identify.solve import solve
from thermofit.observe.observation import FieldObservation
from thermofit.records.staging import Job
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study

SIZE = MeshSize(n_x=2, n_y=8, n_z=1)
TIME = np.array([0.0, 2.0, 3.0, 4.0, 8.0, 16.0, 30.0, 40.0])
FORCE = np.array([0.0, 0.0, 1500.0, 3000.0, 4400.0, 4800.0, 5200.0, 1000.0])


def study(folder: Path, extra: str = "", **more: float) -> Study:
    starts = ", ".join(f"{name}: {value}" for name, value in {**TRUTH, **more}.items())
    path = folder / "study.yaml"
    path.write_text(f"name: small\nexperiment: raw\nmesh: {{n_x: 2, n_y: 8, n_z: 1}}\nparameters: {{{starts}}}\n{extra}", encoding="utf-8")
    return load_study(path, [f"run_dir={folder}"])


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """A test without noise, observed at its own steps."""
    set_threads(1)
    case = study(tmp_path_factory.mktemp("truth"))
    settings = march_settings(case, "full")
    empty = Measured(SPECIMEN, 297.4, 296.7, None, None, None, {}, 2.0, ())  # type: ignore[arg-type]
    body = specimen_body(case, empty, SIZE)
    history = MechanicalRun(body, Loading(TIME, FORCE), settings)(Parameters.of(TRUTH))
    steps = LoadSteps(TIME, FORCE, history.u_top)
    xy = np.array([[0.0, -15.0], [8.0, -15.0], [-8.0, 3.0], [0.0, 15.0], [9.0, 12.0]])
    shape = (len(TIME), len(xy))
    blank = FieldObservation("u", TIME, xy, np.zeros((*shape, 2)), np.full((*shape, 2), 0.002), np.ones(shape, dtype=bool), "mm")
    look: Sampler = sampler(body, blank, steps)
    theta = look.temperature(history.theta)
    u = FieldObservation("u", TIME, xy, look.displacement(history), blank.sigma, blank.mask, "mm")
    t = FieldObservation("theta", TIME, xy, theta, np.full(theta.shape, 0.02), blank.mask, "K")
    phases = (TestPhase(0.0, 2.0, "rest"), TestPhase(2.0, 40.0, "loading"))
    every = {"displacement": steps, "temperature": steps, "all": steps}
    return Measured(SPECIMEN, 297.4, 296.7, u, t, force_observation(TIME, steps, 4.0), every, 2.0, phases)


def model_of(case: Study, data: Measured, key: str) -> tuple[StageModel, Parameters]:
    settings = case.stage(key)
    base = Parameters.of(TRUTH).with_free(settings.free)
    return stage_model(case, data, settings, base, SIZE, (0.0, 40.0, "")), base


def test_a_study_asks_for_the_accuracy_that_the_kernel_has_by_default(tmp_path: Path) -> None:
    """One default, measured as it is used."""
    settings = march_settings(study(tmp_path), "full")
    assert (settings.newton, settings.coupling_tolerance) == (MarchSettings().newton, MarchSettings().coupling_tolerance)


@pytest.mark.parametrize(("key", "moved"), [("plastic", "M_y0"), ("thermal", "c0")])
def test_residual_vanishes_at_the_truth_and_nowhere_near(data: Measured, tmp_path: Path, key: str, moved: str) -> None:
    case = study(tmp_path, "stages:\n  thermal: {free: [kappa, c0, beta]}\n")
    model, base = model_of(case, data, key)
    assert np.max(np.abs(model.residual(base))) < 2e-2, np.abs(model.residual(base)).reshape(-1, 5)
    assert np.max(np.abs(model.residual(base.replace(**{moved: 1.1 * base[moved]})))) > 1.0


def test_force_is_compared_where_the_crosshead_drives(data: Measured, tmp_path: Path) -> None:
    extra = "force: {drives: crosshead}\nstages:\n  plastic: {free: [M_y0, M_yinf], channels: {force: {}, du: {}}}\n"
    model, base = model_of(study(tmp_path, extra), data, "plastic")
    force = model.comparisons[0]
    assert (force.channel, force.unit, force.n) == ("force", "N", len(TIME))
    at_truth = model.assemble(model.errors(base))
    assert np.max(np.abs(at_truth[: force.n])) * 4.0 < 0.5  # N, of 5200
    softer = model.errors(base.replace(M_yinf=0.97 * base["M_yinf"]))["force"]
    assert softer[-2, 0, 0] < -50.0


def test_channel_force_needs_a_displacement_that_drives(data: Measured, tmp_path: Path) -> None:
    case = study(tmp_path, "stages:\n  plastic: {free: [M_y0], channels: {force: {}}}\n")
    with pytest.raises(StudyError, match=r"force\.drives: crosshead"):
        model_of(case, data, "plastic")


@pytest.mark.parametrize(
    ("free", "channels", "told"),
    [
        ("E, nu", "{du: {}}", False),
        ("E, M_y0, M_yinf", "{u: {}, du: {}}", False),
        ("E, M_yinf", "{du: {}}", True),
        ("E, M_y0", "{du: {}}", True),
        ("nu, F", "{du: {}}", True),
        ("E, M_y0", "{du: {}, force: {}}", True),
    ],
)
def test_displacements_under_a_displacement_tell_no_stress(data: Measured, tmp_path: Path, free: str, channels: str, told: bool) -> None:
    """All stresses could be twice as large, unless one of them is known or compared."""
    case = study(tmp_path, f"force: {{drives: crosshead}}\nstages:\n  plastic: {{free: [{free}], channels: {channels}}}\n")
    experiment = BodyExperiment(case, given=data)
    settings = case.stage("plastic")
    if told:
        experiment.model(settings, Parameters.of(TRUTH, settings.free), SIZE)
        return
    with pytest.raises(StudyError, match=r"E is free where .*du alone are compared, but force\.drives is crosshead, .* add 'force: \{\}'"):
        experiment.model(settings, Parameters.of(TRUTH, settings.free), SIZE)


def test_one_way_and_full_coupling_of_the_thermal_stage_agree(data: Measured, tmp_path: Path) -> None:
    fast, base = model_of(study(tmp_path, "stages:\n  thermal: {free: [c0]}\n"), data, "thermal")
    full, _ = model_of(study(tmp_path, "stages:\n  thermal: {free: [c0], coupling: full}\n"), data, "thermal")
    moved = base.replace(c0=1.1 * base["c0"])
    difference = np.abs(fast.errors(moved)["theta"] - full.errors(moved)["theta"])
    assert 0.0 < difference.max() < 5e-3


@pytest.fixture
def marches(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Coupling of every march that a model asks for, in turn."""
    asked: list[str] = []

    def counted(body: Body, parameters: Parameters, loading: Loading, times: np.ndarray, *rest: Any) -> History:
        asked.append(rest[0].coupling)
        return march(body, parameters, loading, times, *rest)

    monkeypatch.setattr("thermofit.experiment.forward.march", counted)
    return asked


def test_what_the_heat_equation_alone_feels_follows_from_the_slots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All Params of effects of the heat problem, none of another, and those of a user's file without a word here."""
    monkeypatch.setattr(catalogue, "EFFECTS", dict(catalogue.EFFECTS))
    monkeypatch.setattr(declared, "OF_EFFECTS", dict(declared.OF_EFFECTS))
    path = tmp_path / "humming.py"
    path.write_text(
        "from thermofit.core.parameters import Param\n"
        "SLOT, FORMULA, SOURCE = 'heat_source', 'r = power', 'none'\n"
        "PARAMS = (Param('humming.power', 'mW/mm^3', 0.0, -1.0, 1.0, 0.1, 'power', probe=0.5),)\n"
        "def heat_source(theta, accumulated, rate, time, x, y, power):\n    return power + 0.0 * theta\n",
        encoding="ascii",
    )
    load_effect(path)
    heating = {name for e in effects((*HEAT, "dissipation")) for name in e.names}
    others = {name for e in effects() if e.slot not in (*BASE, *HEATING) for name in e.names}
    assert {"humming.power", "lamp.absorbed", "stored_energy.slope", "initial_gradient.amplitude"} <= heating
    assert heating <= thermal_names() and not others & thermal_names()
    assert {"alpha_exp", "kappa", "theta_air"} <= thermal_names() and not {"E", "M_y0", "theta_ref", "H_lin"} & thermal_names()
    assert not station_names() & thermal_names()
    assert {"ir_lag.time", "dic_scale.error", "bending.curvature"} <= station_names() <= others


HEAT_FREE = {
    "of heat": {"c0": 2.1, "stored_energy.slope": 0.6, "latent_heat.heat": 3.0},
    "of the surface": {"c0": 2.1, "radiation.emissivity": 0.4, "clamp_drift.rate": 0.05},
    "of instruments": {"c0": 2.1, "ir_drift.rate": 5e-3, "ir_lag.time": 0.8},
}


@pytest.mark.parametrize("truth", HEAT_FREE.values(), ids=HEAT_FREE)
def test_effects_of_heat_and_instruments_are_fitted_on_mechanics_that_is_solved_once(
    data: Measured, tmp_path: Path, marches: list[str], truth: dict[str, float]
) -> None:
    """The fit is that of the coupled model, with a march for each turn instead of one for each evaluation."""
    found, starts = {}, {name: 0.5 * value for name, value in truth.items()}
    for coupling in ("full", "one-way"):
        case = study(
            tmp_path,
            f"stages:\n  thermal: {{free: [{', '.join(truth)}], coupling: {coupling}}}\n",
            **starts,
        )
        base = Parameters.of({**TRUTH, **starts}).with_free(tuple(truth))
        if coupling == "full":
            model = stage_model(case, data, case.stage("thermal"), base, SIZE, (0.0, 40.0, ""))
            seen = model.errors(base.replace(**truth))["theta"] + data.temperature.value
            measured = replace(data, temperature=replace(data.temperature, value=seen))
        marches.clear()
        found[coupling] = solve(
            case,
            case.stage("thermal"),
            base,
            lambda size, at, case=case, data=measured: stage_model(case, data, case.stage("thermal"), at, size, (0.0, 40.0, "")),
            Job(coupling, tmp_path / f"{coupling}.h5", {}, {}),
            scalable=True,
        )
        turns = 1 + len(found[coupling].earlier)
        if coupling == "one-way":
            assert marches == ["full"] * turns and turns <= 4
            assert found[coupling].model.one_way
        else:
            counts = [fit.counts for fit in (*found[coupling].earlier, found[coupling].fit)]
            assert turns == 1 and marches == ["full"] * sum(c.forward for c in counts) and len(marches) > 3
    jacobian = found["full"].fit.jacobian
    assert jacobian is not None
    sigma = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    assert found["full"].fit.x == pytest.approx(list(truth.values()), rel=1e-4)
    assert np.all(np.abs(found["one-way"].fit.x - found["full"].fit.x) < 0.02 * sigma), (found["one-way"].fit.x, sigma)


def test_a_mechanical_effect_or_channel_keeps_the_mechanics_in_the_fit(data: Measured, tmp_path: Path) -> None:
    for name, channels in (
        ("rate_power.K", ""),
        ("machine_compliance.compliance", ""),
        ("ir_lag.time", ", channels: {dtheta: {}, du: {}}"),
    ):
        case = study(tmp_path, f"stages:\n  thermal: {{free: [c0, {name}]{channels}}}\n", **{name: 0.0})
        assert not model_of(case, data, "thermal")[0].one_way, name


def test_a_run_is_not_repeated_for_what_only_instruments_feel(data: Measured, tmp_path: Path, marches: list[str]) -> None:
    """Other Params of instruments: the same run; another number of the body, or a wish for its derivatives: a run of its own."""
    free = ("c0", "ir_drift.rate", "ir_lag.time", "dic_scale.error")
    case = study(tmp_path)
    model = Joint(case, data, joint_settings(case, free, data), SIZE).model
    base = Parameters.of(TRUTH).with_free(free)
    first = model.errors(base)
    other = model.errors(base.replace(**{"ir_drift.rate": 1e-3})) | {"u": model.errors(base.replace(**{"dic_scale.error": 0.01}))["u"]}
    _, slopes = model.linearised(base.replace(**{"ir_lag.time": 0.5}), free[1:])
    assert len(marches) == 1 and np.abs(slopes).max() > 0.0
    assert np.allclose((other["theta"] - first["theta"])[:, :, 0], 1e-3 * TIME[:, None], atol=1e-12)
    assert not np.array_equal(other["u"], first["u"])
    moved = model.errors(base.replace(c0=2.3))
    assert len(marches) == 2 and np.abs(moved["theta"] - first["theta"]).max() > 1e-3
    model.linearised(base.replace(c0=2.3), free)
    assert len(marches) == 3
    again = model.errors(base.replace(c0=2.3))["theta"]  # of the run with derivatives, which keeps other factors
    assert np.abs(again - moved["theta"]).max() < 1e-4 and len(marches) == 3
