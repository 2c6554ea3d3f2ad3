"""Section `necking` of the study file: a necking test seen by a camera, without force, time or scale."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from thermofit.study.errors import content_error
from thermofit.study.section import Number, Positive, Section, Whole

Index = Annotated[Whole, Field(ge=0)]


class Necking(Section):
    """Equal force through every cross-section identifies the shape of the hardening curve (see docs/real-necking.md)."""

    file: str
    """Displacements of a grid of points at every frame, relative to the study file; may hold ${VARIABLES}."""
    load_axis: Literal["x", "y"]
    """Axis of the file along which the force acts."""
    hardening_rate: Annotated[Number, Field(gt=1)]
    """d ln(stress) / d(log. strain) in the necking section at the first frame: prescribed, because kinematics fix the law only up to it."""
    fit_frames: tuple[Index, Index]
    """First and last frame compared, counted from 0; the strain counts from the first one, later frames test the prediction."""
    rows: tuple[Index, Index] | None = None
    """First and last row of the grid that are used, counted from 0 along the load; null: all. Leave out fillets."""
    rows_per_section: Annotated[Whole, Field(ge=1)] = 4
    """Rows of the grid whose strain is averaged to that of one cross-section."""
    noise: Positive | None = None
    """Standard deviation of the strain of a section; null: estimated from its jumps from frame to frame."""

    @model_validator(mode="after")
    def _ranges_increase(self) -> Necking:
        for key, least in (("fit_frames", 4), ("rows", 2)):
            given = getattr(self, key)
            if given is not None and given[1] - given[0] < least:
                raise content_error(
                    f"is [{given[0]}, {given[1]}]; expected the first and the last one, at least {least} apart, counted from 0", key=key
                )
        return self
