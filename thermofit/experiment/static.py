"""A full-field test of one load step as a record of `interpolate`: displacements at the points of the camera, two load steps.

Points stay where they were measured: the model is interpolated to them, so that nothing is smoothed. Model axes: y along the load,
x across. Sigma is the scatter of every point about the plane through its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.body.mesh.specimen import imported, specimen_mesh
from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import Specimen
from thermofit.experiment.fields import field_datasets, specimen_dict
from thermofit.observe.face_quads import FaceQuads, distance_to_edge, face_quads
from thermofit.observe.noise import local_scatter
from thermofit.observe.observation import FieldObservation
from thermofit.observe.selection import masked
from thermofit.read.formats.contents import DicStage
from thermofit.read.formats.registry import read_native
from thermofit.records.artefact import Dataset
from thermofit.records.staging import Made
from thermofit.study.geometry import StaticTest
from thermofit.study.section import mesh_size
from thermofit.study.study import Study


@dataclass(frozen=True)
class StaticPoints:
    """`xy` (n, 2) and `u` (n, 2) mm, x across and y along the load; nan where not correlated. `remarks`: what the reader said."""

    xy: np.ndarray
    u: np.ndarray
    remarks: tuple[str, ...]


def static_points(path: Path, load_axis: str, centre: tuple[float, float]) -> StaticPoints:
    """The points of one stage, turned by 90 degrees where the load acts along the file's x. DataError for every defect."""
    if not path.is_file():
        raise DataError(f"{path}: the field of the static test does not exist; correct the key static.field or the folder experiment")
    content = read_native(path)
    if not isinstance(content, DicStage) or content.reference is None or content.displacement is None:
        raise DataError(f"{path}: {type(content).__name__} found, expected one DIC stage with coordinates and displacements of its points")
    if content.length_unit != "mm":
        raise DataError(f"{path}: coordinates in {content.length_unit or 'an unknown unit'}, expected mm; export the field in mm")
    xy, u = content.reference[:, :2] - np.asarray(centre), content.displacement[:, :2]
    if load_axis == "x":
        xy, u = turned(xy), turned(u)
    return StaticPoints(xy, u, content.traits.remarks)


def turned(vector: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) in axes turned by 90 degrees: what pointed along x points along y."""
    return np.stack([-vector[:, 1], vector[:, 0]], axis=1)


LOADED = 1.0
"""s; time of the load step; the specimen rests at 0."""


@dataclass(frozen=True)
class Cropped:
    """Points `xy` (n, 2) and displacements `u` (n, 2) mm in the axes of the model, and how many points were left out, and why."""

    xy: np.ndarray
    u: np.ndarray
    counts: dict[str, int]


def static_specimen(study: Study) -> Specimen:
    """The lengths of the specimen, all from the study. StudyError for one that is missing."""
    given = study.specimen
    for name in ("gauge_width", "thickness", "total_length"):
        if getattr(given, name) is None:
            raise StudyError(f"{study.source.name}: key 'specimen.{name}' is missing: a static test has no experiment.yaml, add it in mm")
    width, thickness, length = float(given.gauge_width or 0), float(given.thickness or 0), float(given.total_length or 0)
    return Specimen(
        gauge_width=width,
        thickness=thickness,
        parallel_length=length if given.parallel_length is None else given.parallel_length,
        shoulder_radius=0.0 if given.shoulder_radius is None else given.shoulder_radius,
        grip_width=width if given.grip_width is None else given.grip_width,
        total_length=length,
        gripped_length=0.0 if given.gripped_length is None else given.gripped_length,
    )


def crop(face: FaceQuads, xy: np.ndarray, u: np.ndarray, margin: float) -> Cropped:
    """Points on the face at least `margin` mm from its edges. DataError where fewer than ten are left."""
    known = np.isfinite(u).all(axis=1) & np.isfinite(xy).all(axis=1)
    distance = np.full(len(xy), -np.inf)
    distance[known] = distance_to_edge(face, xy[known])
    counts = {
        "in_file": len(xy),
        "not_correlated": int((~known).sum()),
        "outside": int((known & (distance < 0.0)).sum()),
        "at_edge": int((known & (distance >= 0.0) & (distance < margin)).sum()),
    }
    keep = known & (distance >= margin)
    if keep.sum() < 10:
        raise DataError(
            f"static: {int(keep.sum())} of {len(xy)} points lie {margin:g} mm inside the body ({counts['outside']} outside), at "
            "least 10 are needed; check static.centre, static.load_axis, static.edge_margin and the lengths of the specimen"
        )
    return Cropped(xy[keep], u[keep], {**counts, "kept": int(keep.sum())})


def static_record(study: Study) -> Made:
    """Record of `interpolate` of a static test. DataError, StudyError for what is wrong in the file or the study."""
    test = study.static
    assert test is not None
    specimen = static_specimen(study)
    mesh = specimen_mesh(study.geometry, specimen, mesh_size(study.evaluation.nodes), study.mesh_file)
    points = static_points(study.experiment / test.field, test.load_axis, test.centre)
    left = crop(face_quads(mesh), points.xy, points.u, test.edge_margin)
    scatter = local_scatter(left.xy, left.u)
    sigma = scatter if study.noise.displacement is None else np.full(2, study.noise.displacement)
    shape = (1, *left.u.shape)
    field = FieldObservation(
        "u",
        np.array([LOADED]),
        left.xy,
        left.u[None],
        np.broadcast_to(np.maximum(sigma, 1e-6), shape).copy(),
        np.ones(shape[:2], dtype=bool),
        "mm",
    )
    remarks = list(imported(study.geometry, study.mesh_file).remarks) if study.mesh_file is not None else []
    field = masked(field, study.evaluation.mask, "evaluation.mask")
    return Made(_datasets(field, _force(test, specimen)), _summary(test, specimen, left, sigma, (*points.remarks, *remarks)))


def _force(test: StaticTest, specimen: Specimen) -> float:
    if test.force is not None:
        return test.force
    assert test.traction is not None
    return test.traction * specimen.gauge_width * specimen.thickness


def _datasets(field: FieldObservation, force: float) -> dict[str, Dataset]:
    time, load = np.array([0.0, LOADED]), np.array([0.0, force])
    out = field_datasets(field)
    for name in ("displacement", "temperature", "all"):
        out[f"steps/{name}/time"] = Dataset(time, "s", ("step",))
        out[f"steps/{name}/force"] = Dataset(load, "N", ("step",))
    out["force/time"] = Dataset(time, "s", ("sample",))
    for name, value in (("raw", load), ("smooth", load), ("sigma", np.zeros(2))):
        out[f"force/{name}"] = Dataset(value, "N", ("sample",))
    return out


def _summary(test: StaticTest, specimen: Specimen, left: Cropped, sigma: np.ndarray, repairs: tuple[str, ...]) -> dict[str, Any]:
    c = left.counts
    dropped = f"{c['not_correlated']} not correlated, {c['outside']} outside, {c['at_edge']} nearer than {test.edge_margin:g} mm to an edge"
    scatter = f"scatter {1e3 * sigma[0]:.2f} um across, {1e3 * sigma[1]:.2f} um along"
    return {
        "specimen": specimen_dict(specimen),
        "temperatures": {"theta_air": test.temperature, "theta_clamp": test.temperature},
        "load_start_s": 0.0,
        "phases": [{"t0": 0.0, "t1": LOADED, "label": "elastic"}],
        "displacement": {
            "noise_mm": sigma.tolist(),
            "noise_method": "scatter of every point about the plane of its neighbours",
            "nodes": c["kept"],
            "masked": 0,
            "points": c,
        },
        "force": {"noise_N": 0.0, "residual_rms_N": 0.0, "force_N": _force(test, specimen)},
        "repairs": [*repairs, f"of {c['in_file']} points {c['kept']} kept: {dropped}"],
        "verdict": f"{c['kept']} of {c['in_file']} points ({dropped}); {scatter}",
    }
