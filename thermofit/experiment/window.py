"""Which observations a stage uses: the elastic window found from the data, the thesis's load steps, everything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.experiment.fields import LoadSteps, Measured, displacement_of
from thermofit.observe.observation import FieldObservation
from thermofit.records.staging import Note

_FORCE_SHARE = 0.9
"""The elastic window ends at this share of the force at which the strain leaves the straight line."""
_DEVIATION = 0.02
"""Relative deviation of the strain from the elastic line that counts as plastic, on top of three standard errors."""
_NONE = "stages.elastic.window: no stage lies in the elastic range of the first loading; give the window as [t0, t1] in s"


@dataclass(frozen=True)
class ElasticWindow:
    """Window t0, t1 in s, its largest force N, the number of loaded stages inside, and a remark for the user."""

    t0: float
    t1: float
    force: float
    loaded_stages: int
    remark: str


def axial_strain(observation: FieldObservation) -> tuple[np.ndarray, np.ndarray]:
    """Mean du_y/dy over the window and its standard error at every time, each (n_t,): least squares of u_y over y."""
    place = observation.place
    strain, error = np.full(len(observation.time), np.nan), np.full(len(observation.time), np.nan)
    for n in range(len(observation.time)):
        used = observation.mask[n]
        if used.sum() < 3:
            continue
        y = place[n, used, 1]
        y = y - y.mean()
        spread = float(y @ y)
        strain[n] = y @ observation.value[n, used, 1] / spread
        error[n] = np.sqrt((y * observation.sigma[n, used, 1]) @ (y * observation.sigma[n, used, 1])) / spread
    return strain, error


def elastic_window(data: Measured) -> ElasticWindow:
    """First loading up to the point where the mean axial strain leaves its straight line over the force.

    DataError where no stage lies in the elastic range: then the window must be given.
    """
    observation, steps = displacement_of(data), data.steps["displacement"]
    strain, error = axial_strain(observation)
    force = np.interp(observation.time, steps.time, steps.force)
    first = int(np.searchsorted(observation.time, data.load_start + 1e-9))
    if not np.isfinite(strain).all():
        raise DataError("stages.elastic.window: auto needs three measured points at every stage; give the window as [t0, t1] in s")
    if first == len(strain):
        raise DataError(_NONE)
    rest = float(strain[:first].mean()) if first else 0.0
    last, limit = first, None
    for n in range(first, len(strain)):
        if n > first and force[n] <= force[n - 1]:
            limit = force[n - 1]
            break
        loaded = np.arange(first, n)
        if len(loaded):
            slope = float(force[loaded] @ (strain[loaded] - rest)) / float(force[loaded] @ force[loaded])
            tolerance = _DEVIATION * slope * force[n] + 3.0 * float(
                np.hypot(error[n], error[loaded].mean() * force[n] / force[loaded].max())
            )
            if strain[n] - rest - slope * force[n] > tolerance:
                limit = force[n]
                break
        last = n
    if limit is None:
        limit = force[last]
    inside = [n for n in range(first, last + 1) if force[n] <= _FORCE_SHARE * limit or n == first]
    if not inside or force[inside[-1]] <= 0.0:
        raise DataError(_NONE)
    n = inside[-1]
    remark = Note(
        f"elastic window found: up to {observation.time[n]:.2f} s and {force[n]:.0f} N ({len(inside)} loaded stages; the strain leaves the "
        f"elastic line at {limit:.0f} N)"
    )
    return ElasticWindow(float(observation.time[0]), float(observation.time[n]), float(force[n]), len(inside), remark)


def elastic_slope(data: Measured) -> tuple[float, float] | None:
    """Nominal stress over mean axial strain of the elastic window, in MPa, and its standard error; None where there is no such window."""
    try:
        window = elastic_window(data)
    except DataError:
        return None
    observation, steps = displacement_of(data), data.steps["displacement"]
    inside = observation.time <= window.t1 + 1e-9
    strain, error = (value[inside] for value in axial_strain(observation))
    stress = np.interp(observation.time[inside], steps.time, steps.force) / (data.specimen.gauge_width * data.specimen.thickness)
    strain, stress = strain - strain.mean(), stress - stress.mean()
    compliance = float(stress @ strain) / float(stress @ stress)
    doubt = float(np.sqrt(np.sum((stress * error) ** 2))) / float(stress @ stress)
    return (1.0 / compliance, doubt / compliance**2) if compliance > 3.0 * doubt else None


def window_times(window: str | tuple[float, float], data: Measured, steps: LoadSteps) -> tuple[float, float, str]:
    """t0, t1 in s of a stage's window and a remark; "all" is the whole test, "auto" the elastic range."""
    if window == "auto":
        found = elastic_window(data)
        return found.t0, found.t1, found.remark
    if window == "all":
        return float(steps.time[0]), float(steps.time[-1]), ""
    if isinstance(window, str):
        raise StudyError(f"window '{window}' is not known; expected auto, all or [t0, t1] in s")
    return float(window[0]), float(window[1]), ""
