"""The residual of a stage on a small body: zero at the truth, the right fields, force where displacement drives."""

from pathlib import Path

import numpy as np
import pytest

from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.study import Study, load_study
from thermofit.core.study_section import MeshSize
from thermofit.fem.march import Loading
from thermofit.identify.forward import Run, Sampler, march_settings, sampler, specimen_body
from thermofit.identify.inputs import LoadSteps, Measured, TestPhase, force_observation
from thermofit.identify.model import StageModel, stage_model
from thermofit.measure.observation import FieldObservation

SIZE = MeshSize(n_x=2, n_y=8, n_z=1)
SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
TRUTH = {
    "E": 68000.0, "nu": 0.33, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "F": 0.4, "alpha_exp": 2e-5, "kappa": 130.0, "c0": 2.2,
    "beta": 0.8, "alpha_air": 15.0, "alpha_clamp": 240.0, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7,
}  # fmt: skip
TIME = np.array([0.0, 2.0, 3.0, 4.0, 8.0, 16.0, 30.0, 40.0])
FORCE = np.array([0.0, 0.0, 1500.0, 3000.0, 4400.0, 4800.0, 5200.0, 1000.0])


def study(folder: Path, extra: str = "") -> Study:
    starts = ", ".join(f"{name}: {value}" for name, value in TRUTH.items())
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
    history = Run(body, Loading(TIME, FORCE), settings)(Parameters.of(TRUTH))
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


def test_one_way_and_full_coupling_of_the_thermal_stage_agree(data: Measured, tmp_path: Path) -> None:
    fast, base = model_of(study(tmp_path, "stages:\n  thermal: {free: [c0]}\n"), data, "thermal")
    full, _ = model_of(study(tmp_path, "stages:\n  thermal: {free: [c0], coupling: full}\n"), data, "thermal")
    moved = base.replace(c0=1.1 * base["c0"])
    difference = np.abs(fast.errors(moved)["theta"] - full.errors(moved)["theta"])
    assert 0.0 < difference.max() < 5e-3
