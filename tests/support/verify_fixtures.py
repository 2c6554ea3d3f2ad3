"""Records of a made-up test: a coupled run of a tiny mesh with known parameters, seen through known noise, as `interpolate` leaves it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from thermofit.body.body import tension_body
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import NAMES, Parameters, param
from thermofit.experiment.fields import field_datasets, specimen_dict
from thermofit.observe.observation import FieldObservation, face_operator
from thermofit.records.artefact import Dataset, ParameterResult, RecordContent, write_record
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study, load_study

MESH = (2, 12, 1)
SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
VALUES = {
    **{"E": 68000.0, "nu": 0.34, "M_y0": 129.0, "M_yinf": 293.0, "H_exp": 10.9, "F": 0.35, "alpha_exp": 20.2e-6, "kappa": 133.0},
    **{"c0": 2.22, "beta": 0.79, "alpha_air": 14.7, "alpha_clamp": 236.0, "theta_air": 297.4, "theta_clamp": 296.7},
}
TRUTH = Parameters.of({**VALUES, "theta_ref": VALUES["theta_clamp"]})
FREE = {
    "identify-elastic": ("E", "nu"),
    "identify-plastic": ("M_y0", "M_yinf", "H_exp", "F"),
    "identify-thermal": ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp"),
}
SIGMA_U, SIGMA_THETA = 1.5e-3, 0.02
OFFSET = 0.5
"""Of the camera, K."""
TIME = np.array([0.0, 1.5, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0, 13.0, 18.0, 24.0, 30.0, 31.0, 32.0, 33.5, 36.0, 42.0, 50.0, 60.0])
FORCE = np.interp(TIME, [0.0, 3.0, 7.0, 30.0, 33.5, 60.0], [0.0, 0.0, 3800.0, 4700.0, 0.0, 0.0])
PHASES = (
    ("rest", 0.0, 3.0), ("elastic", 3.0, 7.0), ("loading", 7.0, 20.0), ("loading", 20.0, 30.0), ("unloading", 30.0, 33.5),
    ("cooling", 33.5, 60.0),
)  # fmt: skip
X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 5), np.linspace(-20.0, 20.0, 7))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)


def coupled_run(parameters: Parameters = TRUTH) -> History:
    """The test with given parameters on the tiny mesh."""
    body = tension_body(dogbone_mesh(SPECIMEN, *MESH))
    return march(body, parameters, Loading(TIME, FORCE), TIME, MarchSettings())


def seen(history: History) -> tuple[np.ndarray, np.ndarray]:
    """Displacements mm (n_t, n_s, 2) and temperatures K (n_t, n_s, 1) of a run at the observed points, without noise."""
    mesh = dogbone_mesh(SPECIMEN, *MESH)
    operator = face_operator(mesh, XY)
    return operator.displacement(history.u), operator.temperature(history.theta)


def observations(history: History, seed: int = 4) -> tuple[FieldObservation, FieldObservation]:
    """Displacements with a rigid motion, temperatures with an offset, both with white noise of known sigma; one point once lost."""
    rng = np.random.default_rng(seed)
    u, theta = seen(history)
    u = u - u[0]
    moved = 1e-4 * TIME[:, None] * (u[:, :, ::-1] + XY[None, :, ::-1]).transpose(2, 0, 1) * np.array([-1.0, 1.0])[:, None, None]
    u = u + moved.transpose(1, 2, 0) + 0.01 * TIME[:, None, None] + SIGMA_U * rng.normal(size=u.shape)
    theta = theta + OFFSET + SIGMA_THETA * rng.normal(size=theta.shape)
    mask = np.ones(u.shape[:2], dtype=bool)
    mask[8, 11] = False
    return _field("u", u, SIGMA_U, mask, "mm"), _field("theta", theta, SIGMA_THETA, mask, "K")


def _field(name: str, value: np.ndarray, sigma: float, mask: np.ndarray, unit: str) -> FieldObservation:
    value, spread = value.copy(), np.full(value.shape, sigma)
    value[~mask], spread[~mask] = np.nan, np.nan
    return FieldObservation(name, TIME, XY, value, spread, mask, unit)


def interpolated(history: History, *, infrared: bool = True) -> RecordContent:
    """What `interpolate` leaves of the test."""
    u, theta = observations(history)
    datasets = {**field_datasets(u), **(field_datasets(theta) if infrared else {})}
    for name in ("displacement", "temperature", "all"):
        datasets[f"steps/{name}/time"] = Dataset(TIME, "s", ("step",))
        datasets[f"steps/{name}/force"] = Dataset(FORCE, "N", ("step",))
        datasets[f"steps/{name}/crosshead"] = Dataset(history.u_top, "mm", ("step",))
    fine = np.linspace(0.0, TIME[-1], 300)
    smooth = np.interp(fine, TIME, FORCE)
    noisy = smooth + 4.0 * np.random.default_rng(2).normal(size=fine.shape)
    for name, value, unit in (("time", fine, "s"), ("raw", noisy, "N"), ("smooth", smooth, "N"), ("sigma", np.ones_like(fine), "N")):
        datasets[f"force/{name}"] = Dataset(value, unit, ("sample",))
    summary: dict[str, Any] = {
        "verdict": "made up",
        "specimen": specimen_dict(SPECIMEN),
        "temperatures": {"theta_air": VALUES["theta_air"], "theta_clamp": VALUES["theta_clamp"]},
        "load_start_s": 3.0,
        "phases": [{"label": label, "t0": t0, "t1": t1} for label, t0, t1 in PHASES],
        "force": {"noise_N": 4.0, "residual_rms_N": 4.0},
        "displacement": {"noise_mm": [2e-3, 2e-3], "noise_method": "made up", "nodes": len(XY), "masked": 1},
        "repairs": ["dic: 3 of 9 rows missing | one file"],
    }
    if infrared:
        summary["temperature"] = {"noise_K": 0.025, "noise_method": "made up", "masked": 1}
    return RecordContent("interpolate", {}, {}, datasets, {}, summary)


def identified(stage: str, parameters: Parameters, **changes: Dataset) -> RecordContent:
    """What an identification stage leaves that found the given parameters."""
    free = FREE[stage]
    results = {}
    for name in NAMES:
        value = parameters[name]
        results[name] = ParameterResult(value, 0.01 * abs(value), param(name).unit, name in free, False, 1.1 * value, 0.0, 1e9)
    n = len(free)
    f = np.array([900.0, 400.0, np.nan, 120.0, 110.0])
    names = ("evaluation",)
    datasets = {
        "evaluations/x": Dataset(np.ones((5, n)), "1", ("evaluation", "parameter")),
        "evaluations/f": Dataset(f, "1", names),
        "evaluations/failed": Dataset(~np.isfinite(f), "1", names),
        "evaluations/seconds": Dataset(np.ones(5), "s", names),
        "evaluations/purpose": Dataset(np.array(["step", "jacobian", "step", "step", "step"]), "1", names),
        "evaluations/names": Dataset(np.array(free), "1", ("parameter",)),
        "correlation": Dataset(np.eye(n), "1", ("parameter", "parameter")),
        **changes,
    }
    summary = {"verdict": "made up", "trustworthy": True, "channels": {"du": {"n": 100}}, "remarks": [f"remark of {stage}"]}
    config = {f"stages.{stage.removeprefix('identify-')}": {"coupling": "one-way" if stage == "identify-thermal" else "full"}}
    return RecordContent(stage, config, {}, datasets, results, summary)


def study_in(folder: Path, **changes: Any) -> Study:
    """The study of the made-up test; its run folder is `folder/run`."""
    tree = {
        "name": "made-up",
        "run_dir": str(folder / "run"),
        "experiment": "raw",
        "mesh": dict(zip(("n_x", "n_y", "n_z"), MESH, strict=True)),
        "numerics": {"threads": 1},
        "parameters": {name: 1.05 * value for name, value in VALUES.items() if not name.startswith("theta")},
        **changes,
    }
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in tree.items() if v is not None}, sort_keys=False), encoding="utf-8")
    return load_study(path)


def write_all(study: Study, *contents: RecordContent) -> None:
    """Write records into the run folder of a study."""
    study.run_dir.mkdir(parents=True, exist_ok=True)
    for content in contents:
        write_record(artefact_path(study.run_dir, content.stage), content)
