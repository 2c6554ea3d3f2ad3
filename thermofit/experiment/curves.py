"""Curves of a verified run beside the data: stress over stretch, temperature over time, and the moments worth a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.experiment.fields import LoadSteps, Measured
from thermofit.experiment.forward import Sampler
from thermofit.experiment.residuals import ResidualField, Span
from thermofit.experiment.verification import Verification
from thermofit.experiment.window import axial_strain
from thermofit.observe.observation import FieldObservation, face_operator
from thermofit.records.artefact import Dataset


def stress_stretch(verified: Verification, data: Measured) -> dict[str, Dataset]:
    """Nominal stress P = F/(w t) in MPa over the mean axial stretch 1 + du_y/dy of the window, at the stages and at the load steps.

    The stretch is the slope of u_y over y by least squares, for the prediction as for the measurement.
    """
    area = data.specimen.gauge_width * data.specimen.thickness
    observation, steps = verified.observed["u"], verified.steps
    strain, error = axial_strain(observation)
    model, _ = axial_strain(replace(observation, value=verified.predicted["u"]))
    everywhere, _ = axial_strain(_at_steps(observation, verified))
    dims, at_steps = ("time",), ("step",)
    return {
        "curves/stress_stretch/time": Dataset(observation.time, "s", dims),
        "curves/stress_stretch/stress": Dataset(np.interp(observation.time, steps.time, steps.force) / area, "MPa", dims),
        "curves/stress_stretch/stretch": Dataset(1.0 + strain, "1", dims),
        "curves/stress_stretch/stretch_sigma": Dataset(error, "1", dims),
        "curves/stress_stretch/stretch_model": Dataset(1.0 + model, "1", dims),
        "curves/stress_stretch/step_time": Dataset(steps.time, "s", at_steps),
        "curves/stress_stretch/step_stress": Dataset(verified.history.force / area, "MPa", at_steps),
        "curves/stress_stretch/step_stretch": Dataset(1.0 + everywhere, "1", at_steps),
    }


def _steps_sampler(verified: Verification, xy: np.ndarray) -> Sampler:
    mesh = verified.body.mesh
    return Sampler(face_operator(mesh, xy), np.arange(len(verified.steps.time)), 0)


def _at_steps(observation: FieldObservation, verified: Verification) -> FieldObservation:
    """The predicted displacements at every load step, in the form of an observation of all points."""
    value = _steps_sampler(verified, observation.xy).displacement(verified.history)
    whole = np.ones(value.shape[:2], dtype=bool)
    return FieldObservation("u", verified.steps.time, observation.xy, value, np.ones_like(value), whole, "mm")


_NAMES = ("lower end", "centre", "upper end")
"""Where temperature is followed over time: on the axis at both ends of the window and in its middle."""


def temperature_curves(verified: Verification) -> dict[str, Dataset]:
    """Temperature change since the rest in K over time at three points: measured with sigma, predicted, and predicted at all load steps.

    The change is that of channel dtheta. `reference` and `reference_model` (K) are the temperatures that it refers to; their
    difference is the offset of the camera. Empty where the experiment has no temperatures.
    """
    change = verified.residual("dtheta")
    if change is None:
        return {}
    observation, predicted = verified.observed["theta"], verified.predicted["theta"]
    point = followed_points(observation.xy, np.isfinite(change.value[:, :, 0]).sum(axis=0))
    measured, model = observation.value[:, point, 0], predicted[:, point, 0]
    error, sigma = change.value[:, point, 0], change.sigma[:, point, 0]
    # error = (model - its reference) - (measured - its reference), hence the references differ by model - measured - error
    offset = np.array([np.nanmean(model[:, k] - measured[:, k] - error[:, k]) for k in range(len(point))])
    before = np.all(~np.isfinite(error), axis=1) & np.isfinite(measured).all(axis=1)
    reference = measured[before].mean(axis=0) if before.any() else measured[0]
    at_steps = _steps_sampler(verified, observation.xy[point]).temperature(verified.history.theta)[:, :, 0]
    where, dims = ("place",), ("time", "place")
    return {
        "curves/temperature/place": Dataset(np.array(_NAMES), "1", where),
        "curves/temperature/point": Dataset(point, "1", where),
        "curves/temperature/xy": Dataset(observation.xy[point], "mm", ("place", "axis")),
        "curves/temperature/time": Dataset(observation.time, "s", ("time",)),
        "curves/temperature/measured": Dataset(measured - reference, "K", dims),
        "curves/temperature/sigma": Dataset(sigma, "K", dims),
        "curves/temperature/model": Dataset(model - reference - offset, "K", dims),
        "curves/temperature/reference": Dataset(reference, "K", where),
        "curves/temperature/reference_model": Dataset(reference + offset, "K", where),
        "curves/temperature/step_time": Dataset(verified.steps.time, "s", ("step",)),
        "curves/temperature/step_model": Dataset(at_steps - reference - offset, "K", ("step", "place")),
    }


def followed_points(xy: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Indices (3,) of the points nearest to (0, lowest y), (0, middle y), (0, highest y) among those with nearly the most observations."""
    candidates = np.flatnonzero(count >= 0.9 * count.max())
    low, high = float(xy[:, 1].min()), float(xy[:, 1].max())
    targets = np.array([[0.0, low], [0.0, 0.5 * (low + high)], [0.0, high]])
    distance = np.linalg.norm(xy[candidates][None] - targets[:, None], axis=2)
    return np.asarray(candidates[np.argmin(distance, axis=1)])


@dataclass(frozen=True)
class Moment:
    """A named time s of the test."""

    name: str
    time: float


def moments(spans: Sequence[Span], steps: LoadSteps) -> tuple[Moment, ...]:
    """End of the elastic range, largest force, end of the last unloading, end of the test; in the order of time, each time once."""
    elastic = [Moment("end of elastic range", span.t1) for span in spans if span.name.startswith("elastic")][:1]
    unloading = [Moment("end of unloading", span.t1) for span in spans if span.name.startswith("unloading")][-1:]
    largest = Moment("largest force", float(steps.time[int(np.argmax(steps.force))]))
    found: list[Moment] = []
    for moment in (*elastic, largest, *unloading, Moment("end", float(steps.time[-1]))):
        if all(abs(moment.time - other.time) > 1e-6 for other in found):
            found.append(moment)
    return tuple(sorted(found, key=lambda moment: moment.time))


def snapshots(residuals: Sequence[ResidualField], chosen: Sequence[Moment]) -> dict[str, Dataset]:
    """Error fields of du and dtheta at the last compared observation up to each moment (the first one where none is before it)."""
    out = {
        "snapshots/name": Dataset(np.array([m.name for m in chosen]), "1", ("snapshot",)),
        "snapshots/time": Dataset(np.array([m.time for m in chosen]), "s", ("snapshot",)),
    }
    for field in residuals:
        if field.channel not in ("du", "dtheta"):
            continue
        compared = np.flatnonzero(np.isfinite(field.value).any(axis=(1, 2)))
        times = field.time[compared]
        at = compared[np.maximum(np.searchsorted(times, [m.time + 1e-6 for m in chosen]) - 1, 0)]
        out[f"snapshots/{field.channel}/time"] = Dataset(field.time[at], "s", ("snapshot",))
        out[f"snapshots/{field.channel}/error"] = Dataset(field.value[at], field.unit, ("snapshot", "point", "component"))
    return out
