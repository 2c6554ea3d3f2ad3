"""A full-field test of one load step: a made-up plate with rigid motion and noise gives E and nu back; its study and its file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tiny import stage_run

from thermofit.body.body import tension_body
from thermofit.body.mesh.quality import symmetry_of
from thermofit.body.mesh.shapes import plate_with_hole_mesh
from thermofit.body.solve.march import Loading, MarchSettings, march
from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import Specimen
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.observe.observation import face_operator
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study

TRUE_E, TRUE_NU, TRACTION, NOISE = 205000.0, 0.28, 100.0, 3e-4
PLATE = Specimen(20.0, 3.0, 80.0, 0.0, 20.0, 80.0, 0.0)
HEADER = "x-coordinate [mm],y-coordinate [mm],x-displacement [mm],y-displacement [mm]"


def tree(folder: Path) -> dict[str, Any]:
    return {
        "name": "plate",
        "experiment": str(folder),
        "run_dir": str(folder / "run"),
        "geometry": {"shape": "plate-with-hole", "hole_radius": 4.0},
        "specimen": {"gauge_width": 20.0, "thickness": 3.0, "total_length": 80.0},
        "mesh": {"n_x": 4, "n_y": 28, "n_z": 1},
        "evaluation": {"nodes": {"n_x": 8, "n_y": 48, "n_z": 1}},
        "static": {"field": "points.csv", "load_axis": "x", "centre": [40.0, 10.0], "traction": TRACTION},
        "parameters": {
            "E": {"start": 150000, "bounds": [50000, 400000]},
            "nu": {"start": 0.2, "bounds": [0.01, 0.49]},
            "M_y0": 5000,
            "M_yinf": 5001,
        },
        "stages": {"elastic": {"window": "all", "beside": ["u", "similarity"]}},
        "numerics": {"threads": 1},
    }


def study_in(folder: Path, **changes: Any) -> Study:
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump({**tree(folder), **changes}), encoding="utf-8")
    return load_study(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Raw folder of a plate of known moduli, seen in axes of the file: the load along x, the hole at (40, 10), moved and turned."""
    set_threads(1)
    mesh = plate_with_hole_mesh(PLATE, 4.0, MeshSize(n_x=6, n_y=40, n_z=1))
    body = tension_body(mesh, symmetry=symmetry_of(mesh))
    p = Parameters.of({"E": TRUE_E, "nu": TRUE_NU})
    time = np.array([0.0, 1.0])
    history = march(body, p, Loading(time, time * TRACTION * 60.0), time, MarchSettings(plastic=False))
    rng = np.random.default_rng(8)
    xy = rng.uniform([-10.3, -40.5], [10.3, 40.5], (2500, 2))
    on_plate = (np.abs(xy[:, 0]) < 10.0) & (np.abs(xy[:, 1]) < 40.0) & (np.hypot(*xy.T) > 4.1)
    u = np.zeros_like(xy)
    u[on_plate] = face_operator(mesh, xy[on_plate]).displacement(history.u[-1:])[0]
    u[~on_plate] = 0.03 * rng.normal(size=(int((~on_plate).sum()), 2))
    angle = 3e-4
    u += np.array([0.011, -0.023]) + angle * np.stack([-xy[:, 1], xy[:, 0]], axis=1) + NOISE * rng.normal(size=u.shape)
    file_xy = np.stack([xy[:, 1], -xy[:, 0]], axis=1) + np.array([40.0, 10.0])
    table = np.hstack([file_xy, np.stack([u[:, 1], -u[:, 0]], axis=1)])
    made = tmp_path_factory.mktemp("plate")
    np.savetxt(made / "points.csv", table, delimiter=",", header=HEADER, comments="", fmt="%.12f")
    return made


@pytest.fixture(scope="module")
def identified(folder: Path) -> Study:
    study = study_in(folder)
    for name in ("interpolate", "identify-elastic"):
        stage_run(name)(study)
    return study


def test_points_are_cropped_and_counted(identified: Study) -> None:
    record = stage_run("interpolate")(identified).record
    counts = record.summary["displacement"]["points"]
    assert counts["in_file"] == 2500 == counts["outside"] + counts["at_edge"] + counts["kept"]
    assert counts["outside"] > 20 and counts["at_edge"] > 100
    assert record["u/xy"].value.shape == (counts["kept"], 2)
    assert record.summary["displacement"]["noise_mm"] == pytest.approx([NOISE, NOISE], rel=0.1)
    assert record["steps/all/force"].value[-1] == pytest.approx(TRACTION * 60.0)


def test_moduli_come_back_with_relative_displacements(identified: Study) -> None:
    record = stage_run("identify-elastic")(identified).record
    found, nu = record.parameters["E"], record.parameters["nu"]
    assert found.sigma is not None and nu.sigma is not None
    assert abs(found.value - TRUE_E) < 3.0 * found.sigma + 0.002 * TRUE_E and found.sigma < 0.01 * TRUE_E
    assert abs(nu.value - TRUE_NU) < 3.0 * nu.sigma + 0.005 and nu.sigma < 0.02


def test_plain_displacements_are_worse_and_shown_beside(identified: Study) -> None:
    record = stage_run("identify-elastic")(identified).record
    rows = {row["measure"]: row for row in record.summary["side_by_side"]}
    assert set(rows) == {"rigid-body", "u", "similarity"}
    assert abs(rows["u"]["E"] / TRUE_E - 1.0) > 0.1 and rows["u"]["times noise"] > 10.0
    assert rows["rigid-body"]["times noise"] == pytest.approx(1.0, abs=0.1)
    assert rows["rigid-body"]["K GPa"] == pytest.approx(1e-3 * rows["rigid-body"]["E"] / 3.0 / (1.0 - 2.0 * rows["rigid-body"]["nu"]))
    assert rows["similarity"]["E +-"] > 2.0 * rows["rigid-body"]["E +-"]
    assert any(text.startswith("side by side:") for text in record.summary["remarks"])


def test_the_chain_goes_on_to_verify_and_report(identified: Study) -> None:
    verified = stage_run("verify")(identified).record
    assert verified.summary["channels"]["du"]["chi2_reduced"] == pytest.approx(1.0, abs=0.2)
    assert "verified" in stage_run("report")(identified).record.summary["verified"]
    picture = stage_run("mesh")(identified).record.summary["picture"]
    assert Path(picture).stat().st_size > 20_000


def test_the_loop_works_on_one_step_and_names_nothing_where_nothing_is_missing(identified: Study) -> None:
    """E and nu alone are fitted: one elastic step tells nothing of plasticity or heat."""
    found = stage_run("close-loop")(identified).record
    assert {name for name, one in found.parameters.items() if one.free} == {"E", "nu"}
    assert not found.summary["accepted"] and found.summary["unlisted"] is None and found.summary["grade"] == "complete"
    assert found.summary["trustworthy"], found.summary["doubts"]
    assert {"lamp", "stored_energy"} <= set(found.summary["not_asked"])


def test_a_tilt_of_the_plate_is_named_with_its_amount(folder: Path, tmp_path: Path) -> None:
    """Scale that changes by 2e-6 per mm along the plate: u gets 2e-6 y (x, y), even in y."""
    columns = np.loadtxt(folder / "points.csv", delimiter=",", skiprows=1)
    along = 2e-6
    place = columns[:, :2] - np.array([40.0, 10.0])
    columns[:, 2:] += along * place[:, :1] * place
    np.savetxt(tmp_path / "points.csv", columns, delimiter=",", header=HEADER, comments="", fmt="%.12f")
    study = study_in(tmp_path, experiment=str(tmp_path), run_dir=str(tmp_path / "run"))
    for name in ("interpolate", "identify-elastic"):
        stage_run(name)(study)
    found = stage_run("close-loop")(study).record
    assert found.summary["accepted"] == ["dic_tilt"]
    tilt = found.parameters["dic_tilt.along"]
    assert tilt.sigma is not None and abs(tilt.value - along) < 4.0 * tilt.sigma + 0.02 * along
    assert found.parameters["E"].value == pytest.approx(TRUE_E, rel=0.02)


@pytest.mark.parametrize(
    ("section", "error", "text"),
    [
        ({"static": {**tree(Path())["static"], "force": 6000.0}}, StudyError, r"static\.force' needs the load once"),
        ({"static": {**tree(Path())["static"], "field": "none.csv"}}, DataError, "does not exist; correct the key static.field"),
        ({"static": {**tree(Path())["static"], "centre": [400.0, 10.0]}}, DataError, "0 of 2500 points lie 1 mm inside the body"),
        ({"specimen": {"gauge_width": 20.0, "total_length": 80.0}}, StudyError, r"key 'specimen\.thickness' is missing"),
        ({"geometry": {"shape": "plate-with-hole"}}, StudyError, r"geometry\.hole_radius' is missing"),
        ({"geometry": {"shape": "bar", "hole_radius": 4.0}}, StudyError, r"geometry\.hole_radius' is given"),
        ({"geometry": {"shape": "file", "file": "a.inp"}}, StudyError, r"geometry\.unit' is missing"),
    ],
)
def test_what_is_wrong_in_the_study(folder: Path, tmp_path: Path, section: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        stage_run("interpolate")(study_in(folder, run_dir=str(tmp_path), **section))


def test_a_mesh_file_takes_the_place_of_the_built_in_shape(folder: Path, tmp_path: Path) -> None:
    """The same plate through a file in metres gives the same record."""
    import meshio

    mesh = plate_with_hole_mesh(PLATE, 4.0, MeshSize(n_x=8, n_y=48, n_z=1))
    path = tmp_path / "plate.vtk"
    meshio.write(path, meshio.Mesh(mesh.nodes * 1e-3, [("hexahedron", mesh.hexes)]))
    planes = {"x0": "x=0", "z0": "z=0", "bottom": "y=-40", "top": "y=40", "face": "z=1.5"}
    geometry = {"shape": "file", "file": str(path), "unit": "m", "sets": planes}
    built, read = (
        stage_run("interpolate")(study_in(folder, run_dir=str(tmp_path / k), **s)).record
        for k, s in (("a", {}), ("b", {"geometry": geometry}))
    )
    assert np.allclose(built["u/value"].value, read["u/value"].value)
    assert "no set air: all other free faces" in read.summary["repairs"]


def test_s235_plate_with_a_hole(tmp_path: Path) -> None:
    """The measured plate: relative displacements are left at 0.4 um, plain ones at 7 um and much softer."""
    data = os.environ.get("THERMOFIT_DATA")
    if not data or not (Path(data) / "real" / "s235-plate-hole-dic").is_dir():
        pytest.skip("THERMOFIT_DATA does not hold real/s235-plate-hole-dic")
    study = load_study(
        Path(__file__).parents[2] / "configs" / "real-s235.yaml",
        [f"run_dir={tmp_path}", "mesh={n_x: 4, n_y: 28, n_z: 1}", "numerics.threads=1"],
    )
    stage_run("interpolate")(study)
    record = stage_run("identify-elastic")(study).record
    rows = {row["measure"]: row for row in record.summary["side_by_side"]}
    assert record.parameters["E"].value == pytest.approx(220400.0, rel=0.01)
    assert record.parameters["nu"].value == pytest.approx(0.302, abs=0.01)
    assert rows["rigid-body"]["rms"] < 0.5e-3 < 5e-3 < rows["u"]["rms"]
    assert rows["u"]["E"] < 0.7 * rows["rigid-body"]["E"]


def test_elongation_is_in_the_record_where_dic_drives(study_of: Any) -> None:
    """A bar cut out of the dogbone between the DIC points near its ends: its elongation is the mean strain times its length."""
    study = study_of("force.drives=dic", "geometry.shape=bar", "specimen.total_length=40", "evaluation.nodes={n_x: 2, n_y: 8, n_z: 1}")
    record = stage_run("interpolate")(study).record
    elongation, xy, u, moments = (record[name].value for name in ("elongation/value", "u/xy", "u/value", "u/moments"))
    axis = np.abs(xy[:, 0]) < 5.0
    last = np.flatnonzero(np.isfinite(u[:, axis, 1]).all(axis=1))[-1]
    centre = xy[axis, 1] + moments[last, axis, 1]  # of the points of which u is the mean
    slope = np.polyfit(centre, u[last, axis, 1], 1)[0]
    assert elongation[last] == pytest.approx(40.0 * slope, rel=0.02) and elongation[last] > 0.1
    steps = record["steps/all/elongation"].value
    assert len(steps) == len(record["steps/all/time"].value) and steps[0] == pytest.approx(0.0, abs=1e-6)
