"""Layers of elements over half the thickness in the joint model: how many, and what errors of its mesh are on another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from virtual_pulls import study

from thermofit.core.experiment import Specimen
from thermofit.experiment.discretisation import MESH, THEIRS, WITHIN, on_mesh
from thermofit.experiment.joint import coarse_mesh, diagnosis_mesh
from thermofit.study.section import PRESETS, MeshSize, SheetSize

ONE = MeshSize(n_x=6, n_y=40, n_z=1)
THIN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("full", ONE),
        ("coarse", ONE),
        (MeshSize(n_x=12, n_y=60, n_z=3), ONE),
        (MeshSize(n_x=4, n_y=28, n_z=2), MeshSize(n_x=4, n_y=28, n_z=2)),
        (MeshSize(n_x=12, n_y=40, n_z=1), MeshSize(n_x=12, n_y=40, n_z=1)),
        ("sheet", SheetSize(n_x=6, n_y=40)),
    ],
)
def test_the_joint_model_has_one_layer_of_the_coarse_mesh(given: str | MeshSize, expected: MeshSize) -> None:
    """A mesh that the study gives, and that is not finer, is that of the joint model."""
    case = study().model_copy(update={"mesh": given})
    assert diagnosis_mesh(case, THIN) == expected


@pytest.mark.parametrize(("thickness", "layers"), [(4.1, 1), (4.2, 2), (8.0, 2), (20.0, 2)])
def test_elements_are_no_thicker_than_they_are_wide(thickness: float, layers: int) -> None:
    """Six elements over 12.5 mm are 2.08 mm wide. There are no more layers than the preset has; the thickest of several tests decides."""
    case = study().model_copy(update={"mesh": "full"})
    one = replace(THIN, thickness=thickness)
    assert diagnosis_mesh(case, one).n_z == layers
    assert diagnosis_mesh(case, THIN, one) == diagnosis_mesh(case, one, THIN) == ONE.with_counts({"n_z": layers})


def test_the_stages_and_the_section_keep_their_layers() -> None:
    case = study().model_copy(update={"mesh": "full"})
    assert coarse_mesh(case) == PRESETS["coarse"]
    two = case.model_copy(update={"diagnosis": case.diagnosis.model_copy(update={"mesh": "coarse"})})
    assert diagnosis_mesh(two, THIN) == PRESETS["coarse"]


def test_errors_of_a_mesh_are_those_of_its_elements_in_the_plane() -> None:
    """On more layers of the same elements they are as they are; on the full mesh a fourth, and the arcs of elements are others."""
    fields = {part: {"u": np.array([k])} for part, k in ((MESH, 8.0), (WITHIN, 100.0), (THEIRS, 1000.0))}
    assert np.allclose(on_mesh(fields, ONE, PRESETS["coarse"])["u"], 1108.0)
    assert np.allclose(on_mesh(fields, ONE, PRESETS["full"])["u"], 1002.0)
