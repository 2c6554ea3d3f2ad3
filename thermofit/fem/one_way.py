"""One-way heat run: the heat equation on a mechanical history that is known.

The matrices of every step depend on the deformation only; they are formed once and serve every set of thermal parameters. The
sources follow from the stored point histories through the same functions as in the coupled march.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import Parameters
from thermofit.fem.body import Body, ThermalGeometry, thermal_geometry
from thermofit.fem.conduction import at_constant_stress, heat_conditions, heat_step, steady_temperature
from thermofit.fem.heat import PointHistory, heat_of_increment
from thermofit.fem.march import History, MarchSettings
from thermofit.material.law import law_of


@dataclass(frozen=True)
class HeatProblem:
    """A mechanical history prepared for many heat runs; `geometry[n]` is that of the step from time n to n + 1."""

    body: Body
    time: np.ndarray
    points: tuple[PointHistory, ...]
    rest: ThermalGeometry
    geometry: tuple[ThermalGeometry, ...]
    settings: MarchSettings


def heat_problem(body: Body, history: History, settings: MarchSettings) -> HeatProblem:
    """HeatProblem of a march that kept its points, with its settings; StudyError where it did not."""
    if len(history.points) != len(history.time):
        raise StudyError("one-way heat run: the mechanical history holds no point histories; run the march with keep_points")
    at_times = [thermal_geometry(body, u) for u in history.u]
    means = tuple(before.mean_with(after) for before, after in pairwise(at_times))
    rest = thermal_geometry(body, np.zeros_like(history.u[0]))
    return HeatProblem(body, history.time, history.points, rest, means, settings)


def heat_run(problem: HeatProblem, parameters: Parameters) -> np.ndarray:
    """Temperature K (n_t, n_np) at all times of the history for given parameters; the mechanics stays as it was.

    The thermoelastic term takes the temperature at the start of the step, extrapolated to its middle.
    """
    body, settings = problem.body, problem.settings
    law = law_of(parameters, settings.model, closed_form=settings.closed_form, plastic=settings.plastic)
    conditions = heat_conditions(parameters)
    if settings.coupling == "one-way":
        conditions = at_constant_stress(conditions, law)
    theta = np.empty((len(problem.time), body.mesh.n_nodes))
    theta[0] = steady_temperature(body, problem.rest, conditions)
    before = theta[0]
    for n, geometry in enumerate(problem.geometry):
        dt = float(problem.time[n + 1] - problem.time[n])
        last = float(problem.time[n] - problem.time[n - 1]) if n else dt
        middle = theta[n] + 0.5 * dt / last * (theta[n] - before)
        heat = np.zeros(body.mesh.n_nodes)
        heat_of_increment(body.data, problem.points[n], problem.points[n + 1], middle, law, heat)
        before = theta[n]
        theta[n + 1] = heat_step(body, geometry, conditions, theta[n], heat, (dt, settings.heat_scheme)).theta
    return theta
