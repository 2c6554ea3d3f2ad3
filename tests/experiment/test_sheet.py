"""A sheet is one layer of the verified elements: what it shows beside a body, what tells its error, and who reckons with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, SIZE, bar_and_point, corners
from virtual_pulls import FORCE, SPECIMEN, TRUTH, data, study

from thermofit.body.element.stress import cauchy_stress, deformation_gradients
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.body.solve.march import Watch
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.body_check import checked
from thermofit.experiment.discretisation import (
    MESH,
    SHEET,
    STEPS,
    THEIRS,
    WITHIN,
    finer_mesh,
    left_by,
    numerical_errors,
    on_mesh,
)
from thermofit.experiment.fields import Measured
from thermofit.experiment.forward import march_settings, run_of
from thermofit.experiment.joint import Joint, coarse_mesh, diagnosis_mesh, joint_settings
from thermofit.experiment.joint_errors import told
from thermofit.experiment.refinement import coarser_mesh, spacing
from thermofit.experiment.stage_errors import stage_errors
from thermofit.fit.linear_model import LinearModel
from thermofit.law.composition import law_effects
from thermofit.law.page import law_of
from thermofit.study.geometry import Geometry
from thermofit.study.section import PRESETS, MeshSize, SheetSize
from thermofit.study.stages import ChannelSettings, PlasticStage

SMALL = SheetSize(n_x=3, n_y=20)
PARAMETERS = Parameters.of(TRUTH, ("E", "M_y0", "c0"))
THICK = replace(
    data(),
    specimen=replace(SPECIMEN, thickness=12.0),
    steps={name: replace(s, force=10.0 * s.force) for name, s in data().steps.items()},
    displacement=replace(data().displacement, sigma=0.01 * data().displacement.sigma),
)
"""The same fields as if they were those of a thick specimen under ten times the force, where one layer misses something, with cameras that
see it."""


def joint(size: MeshSize, measured: Measured = THICK) -> Joint:
    """The joint problem of the pulled test on a mesh."""
    return Joint(study(), measured, joint_settings(study(), PARAMETERS.free, measured), size)


def test_it_is_one_layer_of_the_body() -> None:
    """Whatever is verified on one layer of elements is verified on a sheet: derivatives, energies, films, effects."""
    sheet, layer = specimen_mesh(Geometry(), SPECIMEN, SMALL), dogbone_mesh(SPECIMEN, 3, 20, 1)
    assert np.array_equal(sheet.nodes, layer.nodes) and np.array_equal(sheet.hexes, layer.hexes)
    assert all(np.array_equal(sheet.facets[name], facets) for name, facets in layer.facets.items())


@pytest.mark.parametrize("control", ["displacement", "force"])
def test_a_homogeneous_sheet_is_the_point(control: str) -> None:
    """With the probes of all effects of the law at once, loaded, unloaded and reversed, to 1e-8."""
    bar = Specimen(2.0 * SIZE[0], 2.0 * SIZE[2], SIZE[1], 1.0, 2.0 * SIZE[0], SIZE[1], 1.0)
    mesh = specimen_mesh(Geometry(shape="bar"), bar, SheetSize(n_x=2, n_y=3))
    on = {p.name: 0.3 * p.probe for e in law_effects() for p in e.params if p.probe is not None}
    changes = {**on, **({"H_lin": 900.0} if control == "force" else {})}
    bar_and_point(LOSSY.replace(**changes), *corners(*CYCLES, steps=4), 2, control, mesh=mesh)


def test_a_thin_sheet_is_free_of_stress_across_and_near_its_body() -> None:
    """Displacements within 0.3 um and temperatures within 0.3 mK of a body with four layers; a body with two lies at a quarter of that, as
    h^2 wants it. The mean stress across is nothing beside that along."""
    one, two, four = (joint(size, data()).shown(PARAMETERS)[1] for size in (SMALL, SMALL.body, MeshSize(n_x=3, n_y=20, n_z=4)))
    for name, near in (("u", 3e-4), ("theta", 3e-4)):
        assert np.abs(one[name] - four[name]).max() < near, name
        assert np.linalg.norm(one[name] - two[name]) == pytest.approx(4.0 * np.linalg.norm(two[name] - four[name]), rel=0.15), name
    run, states = run_of(study(), data(), SMALL, data().steps["all"], march_settings(study(), "full")), []
    run(PARAMETERS, Watch(state=lambda _, state: states.append(state)))
    element, last = run.body.data, states[int(np.argmax(FORCE))]
    f = deformation_gradients(element, last.u, last.dilatation)
    stress = cauchy_stress(element, f, last.theta, last.points, last.dilatation, law_of(PARAMETERS, run.settings.model))
    weight = element.volume / element.volume.sum(axis=1, keepdims=True)
    mean = np.einsum("eq,eqij->eij", weight, stress)
    gauge = np.abs(run.body.mesh.nodes[run.body.mesh.hexes, 1]).max(axis=1) < 40.0
    assert mean[gauge, 1, 1].min() > 150.0 and np.abs(mean[gauge, 2, 2]).max() < 2e-3 * mean[gauge, 1, 1].min()


def test_a_body_tells_the_error_of_a_sheet() -> None:
    """In a thick specimen, where it can be seen: that of a body with many layers, to a tenth; and the mesh error is one in the plane."""
    here = joint(SMALL)
    history, coarse = here.shown(PARAMETERS)
    found = numerical_errors(here, PARAMETERS, history, coarse)
    assert set(found) == {MESH, WITHIN, THEIRS, STEPS, SHEET}
    many = joint(MeshSize(n_x=3, n_y=20, n_z=6)).shown(PARAMETERS)[1]
    finer = joint(SheetSize(n_x=5, n_y=30))
    smooth, fine = here.smoothed(history, PARAMETERS), finer.smoothed(finer.shown(PARAMETERS)[0], PARAMETERS)
    for name in ("u", "theta"):
        exact = (coarse[name] - many[name]) / (1.0 - 1.0 / 36.0)
        assert np.linalg.norm(found[SHEET][name] - exact) < 0.1 * np.linalg.norm(exact), name
        assert np.allclose(found[MESH][name], (smooth[name] - fine[name]) / (1.0 - left_by(SMALL, SheetSize(n_x=5, n_y=30)))), name
    body = joint(MeshSize(n_x=3, n_y=20, n_z=1))
    assert SHEET not in numerical_errors(body, PARAMETERS, *body.shown(PARAMETERS)), "a body with one layer is refined"


def test_the_joint_fit_sees_a_sheet_as_its_body() -> None:
    """Data of a body with many layers: the corrected sheet misses them by a small part of what the sheet alone does."""
    truth = joint(MeshSize(n_x=3, n_y=20, n_z=6)).shown(PARAMETERS)[1]
    assert THICK.temperature is not None
    seen = {o.name: replace(o, value=o.value + truth[o.name]) for o in (THICK.displacement, THICK.temperature)}
    here = joint(SMALL, replace(THICK, displacement=seen["u"], temperature=seen["theta"]))
    found = told(here, PARAMETERS)
    assert set(found.causes) == {MESH, WITHIN, THEIRS, STEPS, SHEET}, "each has its place in the budget"
    assert np.linalg.norm(found.causes[SHEET]) > 1.0
    held = found.fields[""][SHEET]
    for name in ("u", "theta"):
        whole = here.shown(PARAMETERS)[1][name]
        assert np.linalg.norm(whole - held[name]) < 0.2 * np.linalg.norm(whole), name
    residual, columns = found.parts.model.linearised(PARAMETERS, PARAMETERS.free)
    corrected, plain = (LinearModel(r, columns).free_step for r in (residual, here.model.residual(PARAMETERS)))
    assert (np.abs(corrected) < 0.25 * np.abs(plain)).all(), "the step of the fit leads to the optimum of the body"


def test_a_stage_reckons_with_its_sheet() -> None:
    case = study().model_copy(update={"mesh": SMALL})
    experiment = BodyExperiment(case, given=THICK)
    settings = PlasticStage(free=("M_y0",), channels={"du": ChannelSettings()}, window=(0.0, 40.0))
    free = PARAMETERS.with_free(settings.free)
    found = stage_errors(
        case, THICK, settings, free, (), {}, lambda of, own, base, size: replace(experiment, given=of).model(own, base, size)
    )
    here, body = (experiment.model(settings, free, size).residual(free) for size in (SMALL, SMALL.body))
    assert set(found.causes) == {MESH, SHEET}
    assert np.allclose(found.causes[SHEET][:, 0], (here - body) / (1.0 - 0.25))


def test_meshes_made_from_a_sheet_are_sheets() -> None:
    big, body = SheetSize(n_x=12, n_y=80), PRESETS["full"]
    assert finer_mesh(big) == SheetSize(n_x=18, n_y=120) and coarser_mesh(big) == SheetSize(n_x=8, n_y=52)
    assert spacing(SheetSize(n_x=24, n_y=160)) == pytest.approx(0.5 * spacing(big))
    assert left_by(SheetSize(n_x=6, n_y=40), big) == pytest.approx(0.25) == pytest.approx(left_by(SheetSize(n_x=6, n_y=40), body))
    assert left_by(PRESETS["coarse"], body) == pytest.approx(0.25)
    case = study().model_copy(update={"mesh": "sheet"})
    assert coarse_mesh(case) == diagnosis_mesh(case, SPECIMEN) == big.coarse == SheetSize(n_x=6, n_y=40)
    fields = {MESH: {"u": np.ones(1)}, STEPS: {"u": np.full(1, 10.0)}, SHEET: {"u": np.full(1, 160.0)}, WITHIN: {"u": np.full(1, 1e3)}}
    assert on_mesh(fields, big.coarse, big)["u"] == pytest.approx(0.25 + 10.0 + 160.0)
    assert on_mesh(fields, big.coarse, body)["u"] == pytest.approx(0.25 + 10.0 + 10.0), "four layers leave a sixteenth"
    assert on_mesh(fields, big, body)["u"] == pytest.approx(1.0 + 10.0 + 10.0 + 1e3), "a body has the elements of its sheet in the plane"


def test_a_check_is_made_on_the_body() -> None:
    """The same numbers as a study with the body has, the difference of the sheet beside them, said where it is not drowned by noise."""
    sheet, body = (study().model_copy(update={"mesh": size}) for size in (SMALL, SMALL.body))
    for measured, quiet in ((data(), True), (THICK, False)):
        on_sheet, on_body = (checked(case, measured, PARAMETERS, None) for case in (sheet, body))
        assert np.array_equal(on_sheet.datasets["u/predicted"].value, on_body.datasets["u/predicted"].value)
        assert on_sheet.summary["evaluations"]["forward"] == 2 and on_body.summary["sheet_error"] is None
        error = joint(SMALL, measured).shown(PARAMETERS)[1]["u"] - joint(SMALL.body, measured).shown(PARAMETERS)[1]["u"]
        told_u = on_sheet.summary["sheet_error"]["u"]
        assert told_u["max"] == pytest.approx(np.abs(error).max(), rel=1e-3)
        said = on_sheet.summary["notes" if quiet else "remarks"]
        assert any(text.startswith("identified on the sheet 3 x 20, checked on the body 3 x 20 x 2; the sheet differs") for text in said)
