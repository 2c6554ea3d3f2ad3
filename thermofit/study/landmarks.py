"""Landmarks of an infrared frame, with the same keys in the study file (`ir.landmarks`) and in `experiment.yaml`."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from thermofit.core.experiment import Landmarks
from thermofit.study.section import Number, Positive, Section, expected

Pixel = Annotated[tuple[Number, Number], expected("a pixel [row, col]")]


class EdgeMark(Section):
    """One pixel on an edge."""

    p1: Pixel
    note: str = ""


class EdgeMarks(EdgeMark):
    """Two pixels on one edge."""

    p2: Pixel


class LengthMark(EdgeMarks):
    """Two pixels [row, col] that lie `length_mm` apart."""

    length_mm: Positive


class CircleMarks(EdgeMarks):
    """Three pixels on a circle around the specimen's centre."""

    p3: Pixel


class PickedLandmarks(Section):
    """Landmarks of one frame; all four are needed."""

    length: LengthMark
    edge_left: EdgeMarks
    edge_right: EdgeMark
    circle: CircleMarks
    note: str = ""

    def of_frame(self, frame: int) -> Landmarks:
        """The same as arrays, picked in the frame of this number."""
        length, left, circle = self.length, self.edge_left, self.circle
        return Landmarks(
            frame=frame,
            length=np.array([length.p1, length.p2]),
            length_mm=length.length_mm,
            edge_left=np.array([left.p1, left.p2]),
            edge_right=np.array(self.edge_right.p1),
            circle=np.array([circle.p1, circle.p2, circle.p3]),
        )
