"""Quarter bars of a few elements, straight or narrower in the middle, and their march."""

from __future__ import annotations

import numpy as np
from small_bodies import ADIABATIC, bar_mesh

from thermofit.body.body import Body, tension_body
from thermofit.body.solve.march import History, Loading, MarchSettings, march

AREA = 4.0 * 1.0


def bar(control: str = "force") -> Body:
    """A distorted quarter bar of 8 x 30 x 2 mm in all, so that the stress is homogeneous but the equations are not."""
    return tension_body(bar_mesh((2, 5, 1), (4.0, 30.0, 1.0), air=("x1", "z1"), clamp=("y0", "y1")), control=control)


def necked(control: str = "force") -> Body:
    """A quarter bar whose middle is narrower: inhomogeneous stress."""
    mesh = bar_mesh((3, 6, 2), (4.0, 30.0, 1.0), air=("x1", "z1"), clamp=("y0", "y1"))
    mesh.nodes[:, 0] *= 1.0 - 0.15 * np.exp(-(((mesh.nodes[:, 1] - 15.0) / 5.0) ** 2))
    return tension_body(mesh, control=control)


def run(body: Body, marks: list[float], values: list[float], steps: int = 60, **settings: object) -> History:
    control = "force" if body.top >= 0 else "displacement"
    loading = Loading(np.array(marks), np.array(values), control)
    times = np.unique(np.concatenate([np.linspace(marks[0], marks[-1], steps + 1), marks]))
    return march(body, ADIABATIC, loading, times, MarchSettings(**settings))  # type: ignore[arg-type]
