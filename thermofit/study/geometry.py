"""Sections `geometry` and `static` of the study file: the shape of the body, and a full-field test of one load step."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from thermofit.study.errors import content_error
from thermofit.study.section import NonNegative, Number, Positive, Section

Shape = Literal["dogbone", "bar", "plate-with-hole", "cruciform-arm", "file"]
LengthUnit = Literal["m", "cm", "mm", "um", "in"]
STRAIGHT = ("dogbone", "bar")
"""Shapes with one width over their parallel length."""
SetName = Annotated[str, Field(pattern=r"^(x0|z0|bottom|top|face|(air|clamp)[A-Za-z0-9_]*)$")]
"""Node sets x0, z0 (held across), bottom, top (the ends), face (what the cameras see); facet sets air..., clamp... (the films)."""

_KEYS: dict[str, tuple[str, ...]] = {
    "dogbone": (),
    "bar": (),
    "plate-with-hole": ("hole_radius",),
    "cruciform-arm": ("fillet_radius",),
    "file": ("file", "unit"),
}
"""Keys that a shape needs; `part` and `sets` may be added to those that know them."""
_MAY: dict[str, tuple[str, ...]] = {"plate-with-hole": ("part",), "bar": ("part",), "file": ("sets",)}


class Geometry(Section):
    """Shape of the body; its lengths are those of `specimen` (gauge_width, thickness, total_length, gripped_length)."""

    shape: Shape = "dogbone"
    """`dogbone`, `bar`, `plate-with-hole`, `cruciform-arm`, or `file` (a mesh of hex8 elements)."""
    hole_radius: Positive | None = None
    """Radius of the hole in the middle of a plate-with-hole, mm."""
    fillet_radius: Positive | None = None
    """Radius between the arms of a cruciform, mm."""
    part: Literal["quarter", "full"] | None = None
    """Quarter model (default) or the whole body, of bar and plate-with-hole."""
    file: str | None = None
    """Mesh file (Abaqus .inp, Gmsh .msh, VTK), relative to the study file; may hold ${VARIABLES}."""
    unit: LengthUnit | None = None
    """Unit of the coordinates in the file."""
    sets: dict[SetName, str] = Field(default={})
    """Set of the model: name of a set in the file, or a plane such as "x=0" (mm)."""

    @model_validator(mode="after")
    def _keys_of_the_shape(self) -> Geometry:
        """Every key that the shape needs, and none that it does not know."""
        needed, known = _KEYS[self.shape], (*_KEYS[self.shape], *_MAY.get(self.shape, ()))
        for key in needed:
            if getattr(self, key) is None:
                raise content_error(f"is missing, but shape {self.shape} needs it: add it", key=key)
        for key in ("hole_radius", "fillet_radius", "part", "file", "unit", "sets"):
            if getattr(self, key) not in (None, {}) and key not in known:
                raise content_error(f"is given, but shape {self.shape} does not have it; leave it out or correct the shape", key=key)
        return self


class StaticTest(Section):
    """One elastic load step seen by a camera: a field of displacements and the force at which it was taken; no history."""

    field: str
    """File of the points with their displacements, in the folder `experiment`."""
    load_axis: Literal["x", "y"]
    """Axis of the file along which the force acts."""
    centre: tuple[Number, Number]
    """Centre of the unloaded specimen in the coordinates (x, y) of the file, mm."""
    force: Positive | None = None
    """Tensile force in N; or `traction`."""
    traction: Positive | None = None
    """Force over gauge_width times thickness, MPa."""
    edge_margin: NonNegative = 1.0
    """Points nearer than this to an edge of the body (mm) are left out: half a facet sees the background there."""
    temperature: Positive = 293.15
    """Temperature of specimen and surroundings, K."""

    @model_validator(mode="after")
    def _one_load(self) -> StaticTest:
        if (self.force is None) == (self.traction is None):
            raise content_error("needs the load once: give force in N or traction in MPa, and leave the other out", key="force")
        return self
