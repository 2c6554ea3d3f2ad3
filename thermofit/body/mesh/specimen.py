"""The mesh that a study describes: one of the built-in shapes in the lengths of the specimen, or a file."""

from __future__ import annotations

from pathlib import Path

from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.mesh.imported import Imported, import_mesh
from thermofit.body.mesh.mesh import Mesh
from thermofit.body.mesh.shapes import bar_mesh, cruciform_arm_mesh, plate_with_hole_mesh
from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.study.geometry import Geometry
from thermofit.study.section import MeshSize


def specimen_mesh(shape: Geometry, specimen: Specimen, size: MeshSize, file: Path | None = None) -> Mesh:
    """Mesh of a shape; `file` is the path of the mesh file where the shape is one. StudyError, DataError as the makers raise them."""
    full = shape.part == "full"
    if shape.shape == "file":
        return imported(shape, file).mesh
    if shape.shape == "bar":
        return bar_mesh(specimen, size, full=full)
    if shape.shape == "plate-with-hole" and shape.hole_radius is not None:
        return plate_with_hole_mesh(specimen, shape.hole_radius, size, full=full)
    if shape.shape == "cruciform-arm" and shape.fillet_radius is not None:
        return cruciform_arm_mesh(specimen, shape.fillet_radius, size)
    return dogbone_mesh(specimen, size.n_x, size.n_y, size.n_z)


def imported(shape: Geometry, file: Path | None) -> Imported:
    """The mesh of the file that a study names, with its remarks."""
    if file is None or shape.unit is None:
        raise StudyError("geometry: shape file needs the keys file and unit; add them")
    return import_mesh(file, shape.unit, shape.sets)
