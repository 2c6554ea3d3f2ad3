"""A test driven by the elongation that DIC saw: the same parameters as driven by the force, and the force as a channel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from thermofit.body.solve.march import Loading
from thermofit.core.errors import StudyError
from thermofit.core.experiment import DicField, Specimen
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.forward import MechanicalRun, march_settings, sampler, specimen_body
from thermofit.experiment.model import stage_model
from thermofit.observe.end_motion import end_motion
from thermofit.observe.observation import FieldObservation, face_operator
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study

SPECIMEN = Specimen(25.0, 1.2, 60.0, 0.0, 25.0, 60.0, 0.0)
SIZE = MeshSize(n_x=2, n_y=4, n_z=1)
TRUTH = {"E": 68000.0, "nu": 0.34, "M_y0": 129.0, "M_yinf": 293.0, "H_exp": 10.9, "F": 0.35}
TIME = np.array([0.0, 2.0, 4.0, 6.0, 8.0, 11.0, 14.0, 17.0, 20.0])
FORCE = np.array([0.0, 0.0, 1800.0, 3600.0, 4200.0, 4700.0, 5100.0, 5300.0, 3000.0])
FREE = ("E", "M_y0", "M_yinf")


def study(folder: Path, drives: str, channels: str) -> Study:
    starts = ", ".join(f"{name}: {value}" for name, value in TRUTH.items())
    path = folder / "study.yaml"
    text = f"name: bar\nexperiment: raw\ngeometry: {{shape: bar}}\nforce: {{drives: {drives}}}\nparameters: {{{starts}}}\n"
    text += f"stages:\n  plastic: {{free: [{', '.join(FREE)}], channels: {channels}}}\n"
    path.write_text(text, encoding="utf-8")
    return load_study(path, [f"run_dir={folder}"])


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """A bar under a force history; its elongation is read off made-up DIC points with rigid motion and noise."""
    set_threads(1)
    case = study(tmp_path_factory.mktemp("truth"), "force", "{du: {}}")
    empty = Measured(SPECIMEN, 296.7, 296.7, None, None, None, {}, 2.0, ())  # type: ignore[arg-type]
    body = specimen_body(case, empty, SIZE)
    history = MechanicalRun(body, Loading(TIME, FORCE), march_settings(case, "full"))(Parameters.of(TRUTH))
    rng = np.random.default_rng(2)
    points = rng.uniform([-12.0, -29.9], [12.0, 29.9], (2000, 2))
    u = face_operator(body.mesh, points).displacement(history.u)
    u = u - u[0] + np.linspace(0.0, 0.4, len(TIME))[:, None, None] + 0.001 * rng.normal(size=u.shape)
    field = DicField(TIME, np.arange(len(points)), np.pad(points, ((0, 0), (0, 1))), np.pad(u, ((0, 0), (0, 0), (0, 1))))
    motion = end_motion(field, (-30.0, 30.0), 4.0)
    assert np.allclose(motion.elongation, history.u_top - history.u_top[0], atol=6.0 * motion.noise)
    steps = LoadSteps(TIME, FORCE, None, motion.at(TIME, 2.0))
    few = points[:60]
    look = sampler(
        body, FieldObservation("u", TIME, few, u[:, :60], np.full((len(TIME), 60, 2), 0.001), np.ones((len(TIME), 60), bool), "mm"), steps
    )
    shown = look.displacement(history) + 0.001 * rng.normal(size=(len(TIME), 60, 2))
    seen = FieldObservation("u", TIME, few, shown, np.full(shown.shape, 0.001), np.ones(shown.shape[:2], bool), "mm")
    every = {"displacement": steps, "temperature": steps, "all": steps}
    phases = (TestPhase(0.0, 2.0, "rest"), TestPhase(2.0, 20.0, "loading"))
    return Measured(SPECIMEN, 296.7, 296.7, seen, None, force_observation(TIME, steps, 4.0), every, 2.0, phases)


def identified(case: Study, data: Measured) -> np.ndarray:
    """E, M_y0, M_yinf by Gauss-Newton from starts that are ten percent off."""
    settings = case.stage("plastic")
    truth = np.array([TRUTH[name] for name in FREE])
    base = Parameters.of({**TRUTH, "theta_air": 296.7, "theta_clamp": 296.7, "theta_ref": 296.7}).with_free(FREE)
    model = stage_model(case, data, settings, base, SIZE, (0.0, 20.0, ""))

    def value(share: np.ndarray) -> np.ndarray:
        return model.linearised(base.with_vector(share * truth), FREE)[0]

    def slope(share: np.ndarray) -> np.ndarray:
        return model.linearised(base.with_vector(share * truth), FREE)[1] * truth

    return np.asarray(least_squares(value, np.array([0.92, 1.05, 1.08]), jac=slope, xtol=1e-8).x)


def test_dic_driven_parameters_equal_the_force_driven_ones(data: Measured, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    by_force = identified(study(tmp_path / "a", "force", "{du: {}}"), data)
    by_dic = identified(study(tmp_path / "b", "dic", "{force: {}, du: {}}"), data)
    assert by_force == pytest.approx(np.ones(3), abs=0.01)
    assert by_dic == pytest.approx(by_force, abs=0.01)


def test_the_reaction_is_that_of_the_load_cell(data: Measured, tmp_path: Path) -> None:
    case = study(tmp_path, "dic", "{force: {}}")
    base = Parameters.of({**TRUTH, "theta_air": 296.7, "theta_clamp": 296.7, "theta_ref": 296.7}).with_free(FREE)
    model = stage_model(case, data, case.stage("plastic"), base, SIZE, (0.0, 20.0, ""))
    error = model.errors(base)["force"][:, 0, 0]
    assert np.abs(error[4:]).max() < 0.01 * FORCE.max()
    stiff = model.errors(base.replace(E=1.1 * base["E"]))["force"][:, 0, 0]
    assert stiff[2] > 100.0


def test_a_record_without_elongation_names_the_command(data: Measured, tmp_path: Path) -> None:
    import dataclasses

    bare = {name: LoadSteps(TIME, FORCE) for name in data.steps}
    case = study(tmp_path, "dic", "{force: {}}")
    with pytest.raises(StudyError, match=r"run `thermofit interpolate study\.yaml` again"):
        identified(case, dataclasses.replace(data, steps=bare))
