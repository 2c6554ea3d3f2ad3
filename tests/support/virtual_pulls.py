"""Small virtual tension tests without files: a coarse body, a programme of force, cameras that look at known points."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from thermofit.body.solve.march import Loading
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.forward import MechanicalRun, march_settings, sampler, specimen_body
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.model import StageModel
from thermofit.observe.observation import FieldObservation
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study

SIZE = MeshSize(n_x=1, n_y=8, n_z=1)
SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
TRUTH = {
    "E": 68000.0, "nu": 0.33, "M_y0": 130.0, "M_yinf": 290.0, "H_exp": 11.0, "F": 0.4, "alpha_exp": 2e-5, "kappa": 130.0, "c0": 2.2,
    "beta": 0.8, "alpha_air": 15.0, "alpha_clamp": 240.0, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7,
}  # fmt: skip
TIME = np.array([0.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 23.0, 30.0, 33.0, 40.0])
FORCE = np.array([0.0, 0.0, 1500.0, 3000.0, 3900.0, 4400.0, 4600.0, 4800.0, 5000.0, 5200.0, 3000.0, 1000.0])
X, Y = np.meshgrid([-8.0, -3.0, 1.0, 5.0, 9.0], np.linspace(-15.0, 15.0, 6))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)
NUMERICS = "numerics: {threads: 1, newton_tolerance: 1.0e-9, coupling_tolerance: 1.0e-6}\n"


def study(extra: str = "", values: dict[str, float] | None = None, raw: str = "experiment: raw") -> Study:
    """A study on a folder that does not exist, all parameters at their truth."""
    starts = ", ".join(f"{name}: {value!r}" for name, value in (values or TRUTH).items())
    text = f"name: small\n{raw}\nmesh: {{n_x: 1, n_y: 8, n_z: 1}}\nparameters: {{{starts}}}\n{NUMERICS}{extra}"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(text, encoding="utf-8")
        return load_study(path, [f"run_dir={folder}"])


def pulled(
    values: dict[str, float] | None = None, force: np.ndarray = FORCE, noise: float = 1.0, seed: int = 5, beside: float = 0.0
) -> Measured:
    """A test with `noise` times 2 um, 20 mK and 4 N, observed at its own steps; the crosshead is the upper end. The infrared camera
    looks so many millimetres `beside` its points, along the load."""
    truth, rng = Parameters.of({**TRUTH, **(values or {})}), np.random.default_rng(seed)
    air, clamp = truth["theta_air"], truth["theta_clamp"]
    empty = Measured(SPECIMEN, air, clamp, None, None, None, {}, 2.0, ())  # type: ignore[arg-type]
    body = specimen_body(study(), empty, SIZE)
    history = MechanicalRun(body, Loading(TIME, force), march_settings(study(), "full"))(truth)
    steps = LoadSteps(TIME, force, history.u_top)
    shape = (len(TIME), len(XY))
    blank = FieldObservation("u", TIME, XY, np.zeros((*shape, 2)), np.full((*shape, 2), 0.002), np.ones(shape, dtype=bool), "mm")
    look = sampler(body, blank, steps)
    u = replace(blank, value=look.displacement(history) + 0.002 * noise * rng.normal(size=(*shape, 2)))
    theta = sampler(body, replace(blank, xy=XY + np.array([0.0, beside])), steps).temperature(history.theta)
    t = FieldObservation("theta", TIME, XY, theta + 0.02 * noise * rng.normal(size=theta.shape), np.full(theta.shape, 0.02), u.mask, "K")
    every = {"displacement": steps, "temperature": steps, "all": steps}
    phases = (
        TestPhase(0.0, 2.0, "rest"),
        TestPhase(2.0, 4.0, "elastic"),
        TestPhase(4.0, 30.0, "loading"),
        TestPhase(30.0, 40.0, "unloading"),
    )
    return Measured(SPECIMEN, air, clamp, u, t, force_observation(TIME, steps, 4.0), every, 2.0, phases)


@lru_cache(maxsize=1)
def data() -> Measured:
    """That test as it stands, made once."""
    return pulled()


def model(case: Study, free: tuple[str, ...] = ()) -> StageModel:
    """Joint model of that test."""
    return Joint(case, data(), joint_settings(case, free, data()), SIZE).model


def part(joint: StageModel, channel: str) -> slice:
    """Rows of a channel."""
    ends = np.cumsum([0, *(c.n for c in joint.comparisons)])
    k = [c.channel for c in joint.comparisons].index(channel)
    return slice(int(ends[k]), int(ends[k + 1]))
