"""Where and when a channel is compared: windows that are kept, regions that are left out; mm in the resting specimen, s."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from thermofit.study.errors import content_error
from thermofit.study.section import Interval, Number, Positive, Section

Point = tuple[Number, Number]


class Region(Section):
    """A part of the measured face, some time or always, that is left out: a rectangle, a disc, a polygon, or a time alone."""

    x: Interval | None = None
    """mm"""
    y: Interval | None = None
    """mm"""
    centre: Point | None = None
    """mm, with `radius`: a disc."""
    radius: Positive | None = None
    polygon: Annotated[tuple[Point, ...], Field(min_length=3)] | None = None
    """Corners in mm, in order."""
    t: Interval | None = None
    """s; absent: always."""

    @model_validator(mode="after")
    def _one_shape(self) -> Region:
        if (self.centre is None) != (self.radius is None):
            given, other = ("centre", "radius") if self.radius is None else ("radius", "centre")
            raise content_error(f"is given without '{other}'; expected both for a disc", key=given)
        shapes = [self.x is not None or self.y is not None, self.centre is not None, self.polygon is not None]
        if sum(shapes) > 1:
            raise content_error("gives several shapes; expected one of x and y, centre and radius, or polygon, and another region for more")
        if not any(shapes) and self.t is None:
            raise content_error("is empty; expected x, y, centre and radius, polygon, or t")
        return self


class ChannelWindow(Section):
    """The part of the data that a channel compares; what is absent is not limited."""

    x: Interval | None = None
    """mm"""
    y: Interval | None = None
    """mm"""
    t: tuple[Interval, ...] = ()
    """Intervals of time in s; empty: the whole window of the stage."""


Mask = tuple[Region, ...]
