"""One specimen under cameras with given parameters: one coupled run beside all data, residuals per channel and phase, coupling error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermofit.body.body import Body
from thermofit.body.solve.march import Balance, History, Watch
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.experiment.channels import reference_times
from thermofit.experiment.fields import LoadSteps, Measured, displacement_of, field_datasets, read_field
from thermofit.experiment.forward import MechanicalRun, Sampler, march_settings, run_of, sampler
from thermofit.experiment.instruments import Instruments
from thermofit.experiment.residuals import ResidualField, Span, named_phases, node_rms, residual_field, time_rms
from thermofit.experiment.verification import INFORMATION, Checked, KnownErrors, Summary, channel_table, judge, phase_table
from thermofit.experiment.window import axial_strain
from thermofit.observe.comparison import plain, rigid_free, temperature_change
from thermofit.observe.observation import FieldObservation, face_operator
from thermofit.records.artefact import Dataset, Record
from thermofit.records.progress import progress
from thermofit.records.staging import Note, sorted_out
from thermofit.study.study import Study

_SAME_TIME = 1e-6
_NOTICED = 0.1
"""Rms of the error of a sheet over the noise from which it is said as a remark; below, noise drowns it."""


@dataclass(frozen=True)
class Verification:
    """A coupled run beside the data: observed and predicted fields ("u", "theta", "force") and the residual of every channel."""

    body: Body
    steps: LoadSteps
    history: History
    observed: dict[str, FieldObservation]
    predicted: dict[str, np.ndarray]
    residuals: tuple[ResidualField, ...]
    on_sheet: dict[str, np.ndarray] | None = None
    """The fields that the sheet predicts on which the parameters were identified, where `predicted` are those of its body."""
    sheet_error: Mapping[str, Mapping[str, Any]] | None = None
    """By field the largest and rms difference of the sheet from its body, and the rms over the noise."""

    def residual(self, channel: str) -> ResidualField | None:
        """The residual of a channel, None where the experiment does not have it."""
        return next((field for field in self.residuals if field.channel == channel), None)


def checked(
    study: Study,
    data: Measured,
    parameters: Parameters,
    thermal: Record | None,
    word: str = "verified",
    known: KnownErrors | None = None,
) -> Checked:
    """One coupled run with given parameters beside all data of an experiment; `known`: what is known to be wrong with it, which is taken
    off. NumericsError where the specimen cannot carry the force."""
    verified = verification(study, data, parameters, known or KnownErrors({}))
    spans = named_phases(data.phases)
    summary = {
        **_summary(verified, spans, thermal, word, _sheet_remark(study, verified)),
        "evaluations": {"forward": 1 if verified.on_sheet is None else 2, "failed": 0},
    }
    if known is not None:
        errors = {name: error for name, error in known.fields.items() if name in verified.observed}
        sizes = [f"{np.sqrt(np.nanmean(error**2)):.2g} {verified.observed[name].unit} in {name}" for name, error in errors.items()]
        if sizes:
            summary["remarks"].append(f"errors of mesh and time steps are taken off the prediction, rms {', '.join(sizes)}")
        if known.force is not None:
            summary["remarks"].append(
                f"the smoothed force is corrected by what all channels tell of its error, rms {np.sqrt(np.mean(known.force**2)):.2g} N, "
                f"at most {np.abs(known.force).max():.2g} N"
            )
    return Checked(summary, _datasets(verified, data, spans))


def verification(study: Study, data: Measured, parameters: Parameters, known: KnownErrors) -> Verification:
    """One coupled run through all load steps, compared at all observations; where the study has a sheet, on its body, and one on the sheet
    beside it. NumericsError where the specimen cannot carry the force."""
    steps = data.steps["all"]
    if known.force is not None:
        steps = replace(steps, force=steps.force - known.force)
    sizes = dict.fromkeys((study.mesh_size.body, study.mesh_size))
    runs = [run_of(study, data, size, steps, march_settings(study, "full")) for size in sizes]
    with progress("verify", len(runs) * (len(steps.time) - 1)) as advance:
        try:
            histories = [run(parameters, Watch(step=lambda _: advance())) for run in runs]
        except NumericsError as error:
            text = f"coupled run with the parameters identified so far: {error}; run the missing identification stages first"
            raise NumericsError(text) from error
    run, history = runs[0], histories[0]
    observed, shown = _fields(study, data, run, history, parameters)
    predicted = {name: field - known.fields.get(name, 0.0) for name, field in shown.items()}
    found = Verification(run.body, steps, history, observed, predicted, _residuals(study, data, observed, predicted))
    if len(runs) == 1:
        return found
    flat = _fields(study, data, runs[1], histories[1], parameters)[1]
    return replace(found, on_sheet=flat, sheet_error={name: _sizes(flat[name] - shown[name], o) for name, o in observed.items()})


def _sizes(error: np.ndarray, observation: FieldObservation) -> dict[str, Any]:
    """Largest value and rms of an error (n_t, n_s, n_c) where there are data, in their unit, and its rms over their noise."""
    seen = np.isfinite(error) & observation.mask[..., None]
    if not seen.any():
        return {"max": 0.0, "rms": 0.0, "over_noise": 0.0, "unit": observation.unit}
    size, over = np.abs(error[seen]), error[seen] / np.broadcast_to(observation.sigma, error.shape)[seen]
    rms = {"rms": float(np.sqrt(np.mean(size**2))), "over_noise": float(np.sqrt(np.mean(over**2)))}
    return {"max": float(size.max()), **rms, "unit": observation.unit}


def _sheet_remark(study: Study, verified: Verification) -> tuple[str, ...]:
    """On which mesh the check was made where the study has a sheet, and by how much the sheet differs from it."""
    if verified.sheet_error is None:
        return ()
    fields = [f"{name} {e['max']:.2g} {e['unit']} (rms {e['rms']:.2g})" for name, e in verified.sheet_error.items()]
    size = study.mesh_size
    text = (
        f"identified on the {size.words}, checked on the body {size.body.words}; the sheet differs from it by at most {', '.join(fields)}"
    )
    large = any(e["over_noise"] > _NOTICED for e in verified.sheet_error.values())
    return (f"{text}: more than a tenth of the noise, which the budget of the parameters holds",) if large else (Note(text),)


def _fields(
    study: Study, data: Measured, run: MechanicalRun, history: History, parameters: Parameters
) -> tuple[dict[str, FieldObservation], dict[str, np.ndarray]]:
    """Observed and predicted fields, as the instruments show them; the force is one of them where the crosshead drives."""
    steps = data.steps["all"]
    observed = {} if data.displacement is None else {"u": data.displacement}
    if data.temperature is not None:
        observed["theta"] = data.temperature
    if study.force.drives != "force":
        observed["force"] = data.force
    samplers = {name: sampler(run.body, displacement_of(data) if name == "force" else o, steps) for name, o in observed.items()}
    instruments = Instruments(run, samplers, observed, data.theta_air)
    return observed, {name: instruments.predicted(name, history, parameters) for name in observed}


def _residuals(
    study: Study, data: Measured, observed: dict[str, FieldObservation], predicted: dict[str, np.ndarray]
) -> tuple[ResidualField, ...]:
    errors = {name: predicted[name] - observed[name].value for name in observed}
    u, theta = observed.get("u"), observed.get("theta")
    fields = []
    if u is not None:
        du = residual_field(rigid_free(u), errors["u"], u)
        fields += [du, du.component(0), du.component(1)]
    if theta is not None:
        change = temperature_change(theta, reference_times(theta, study, data.load_start))
        fields.append(residual_field(change, errors["theta"], theta))
    fields += [residual_field(plain(observed[name]), errors[name], observed[name]) for name in ("force", "u", "theta") if name in observed]
    return tuple(fields)


def coupling_error(verified: Verification, thermal: Record | None) -> dict[str, Any] | None:
    """Coupled minus one-way temperature at the observations, max and rms in K; None where no one-way prediction was stored.

    The one-way prediction is that of `identify-thermal`, which steps through times of its own: their effect is included.
    """
    if thermal is None or not thermal.has("theta/predicted") or "theta" not in verified.predicted:
        return None
    settings = thermal.config.get("stages.thermal", {})
    stored = read_field(thermal, "theta")
    if settings.get("coupling") != "one-way" or stored.value.shape[1] != verified.predicted["theta"].shape[1]:
        return None
    time = verified.observed["theta"].time
    index = np.minimum(np.searchsorted(time, stored.time - _SAME_TIME), len(time) - 1)
    same = np.abs(time[index] - stored.time) <= _SAME_TIME
    coupled = verified.predicted["theta"] if verified.on_sheet is None else verified.on_sheet["theta"]
    difference = coupled[index[same]] - thermal["theta/predicted"].value[same]
    used = np.isfinite(difference)
    if not used.any():
        return None
    worst = np.max(np.where(used, np.abs(difference), 0.0), axis=(1, 2))
    size = difference[used]
    return {
        "max_K": float(np.abs(size).max()),
        "rms_K": float(np.sqrt(np.mean(size**2))),
        "at_s": float(stored.time[same][int(np.argmax(worst))]),
        "n": int(used.sum()),
    }


def _summary(verified: Verification, spans: tuple[Span, ...], thermal: Record | None, word: str, said: tuple[str, ...]) -> Summary:
    channels = channel_table(verified.residuals)
    rows = phase_table(verified.residuals, spans)
    found = judge(verified.residuals, rows, word)
    energy, coupling = energy_totals(verified.history), coupling_error(verified, thermal)
    remarks: list[str] = [*said]
    shown = " and ".join(name for name in INFORMATION if name in channels)
    held = "rigid-body motion and the camera's offset" if "u" in channels else "the camera's offset"
    remarks.append(Note(f"rows {shown} are not fitted; they contain {held}"))
    if coupling is not None:
        remarks.append(Note(f"error of one-way coupling: {1e3 * coupling['max_K']:.2g} mK at most, {1e3 * coupling['rms_K']:.2g} mK rms"))
    if energy["smallest_dissipation"] < 0.0:
        remarks.append(f"dissipation falls to {energy['smallest_dissipation']:.2g} mJ/mm^3: against the second law, check beta")
    return {
        "verdict": found.line,
        "trustworthy": not found.outside,
        "channels": channels,
        "phases": rows,
        "coupling_error": coupling,
        "sheet_error": verified.sheet_error,
        "energy_mJ": {name: value for name, value in energy.items() if name != "smallest_dissipation"},
        "smallest_dissipation_mJ_mm3": energy["smallest_dissipation"],
        "solver": verified.history.counts,
        **sorted_out(remarks),
    }


def _datasets(verified: Verification, data: Measured, spans: tuple[Span, ...]) -> dict[str, Dataset]:
    dims = ("time", "point", "component")
    out: dict[str, Dataset] = {}
    for name, observation in verified.observed.items():
        out.update(field_datasets(observation))
        out[f"{name}/predicted"] = Dataset(verified.predicted[name], observation.unit, dims)
    for field in verified.residuals:
        channel = field.channel
        if channel in ("du", "dtheta"):
            out[f"residual/{channel}"] = Dataset(field.normalised, "1", dims)
            out[f"maps/{channel}"] = Dataset(node_rms(field), "1", dims[1:])
        if channel not in INFORMATION:
            out[f"over_time/{channel}"] = Dataset(time_rms(field), "1", dims[:1])
    out |= snapshots(verified.residuals, moments(spans, verified.steps))
    out |= stress_stretch(verified, data)
    out |= temperature_curves(verified)
    out |= energy_curves(verified.history)
    return out


def stress_stretch(verified: Verification, data: Measured) -> dict[str, Dataset]:
    """Nominal stress P = F/(w t) in MPa over the mean axial stretch 1 + du_y/dy of the window, at the stages and at the load steps.

    The stretch is the slope of u_y over y by least squares, for the prediction as for the measurement. Without displacements it is that of
    the prediction alone, at the load steps and the points whose temperature is compared.
    """
    area = data.specimen.gauge_width * data.specimen.thickness
    observation, steps = verified.observed.get("u"), verified.steps
    if observation is None:
        return _of_steps(verified, verified.observed["theta"].xy, area)
    strain, error = axial_strain(observation)
    model, _ = axial_strain(replace(observation, value=verified.predicted["u"]))
    dims = ("time",)
    return {
        "curves/stress_stretch/time": Dataset(observation.time, "s", dims),
        "curves/stress_stretch/stress": Dataset(np.interp(observation.time, steps.time, steps.force) / area, "MPa", dims),
        "curves/stress_stretch/stretch": Dataset(1.0 + strain, "1", dims),
        "curves/stress_stretch/stretch_sigma": Dataset(error, "1", dims),
        "curves/stress_stretch/stretch_model": Dataset(1.0 + model, "1", dims),
        **_of_steps(verified, observation.xy, area),
    }


def _of_steps(verified: Verification, xy: np.ndarray, area: float) -> dict[str, Dataset]:
    """The predicted curve at the load steps, of points xy (n_s, 2) mm and a cross-section of `area` mm^2."""
    everywhere, _ = axial_strain(_at_steps(xy, verified))
    at_steps = ("step",)
    return {
        "curves/stress_stretch/step_time": Dataset(verified.steps.time, "s", at_steps),
        "curves/stress_stretch/step_stress": Dataset(verified.history.force / area, "MPa", at_steps),
        "curves/stress_stretch/step_stretch": Dataset(1.0 + everywhere, "1", at_steps),
    }


def _steps_sampler(verified: Verification, xy: np.ndarray) -> Sampler:
    mesh = verified.body.mesh
    return Sampler(face_operator(mesh, xy), np.arange(len(verified.steps.time)), 0)


def _at_steps(xy: np.ndarray, verified: Verification) -> FieldObservation:
    """The predicted displacements at every load step, in the form of an observation at all points xy (n_s, 2) mm themselves."""
    value = _steps_sampler(verified, xy).displacement(verified.history)
    whole = np.ones(value.shape[:2], dtype=bool)
    return FieldObservation("u", verified.steps.time, xy, value, np.ones_like(value), whole, "mm")


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
    everywhere = _steps_sampler(verified, observation.xy).temperature(verified.history.theta)[:, :, 0]
    at_steps = observation.averaged_at(verified.steps.time, everywhere)[:, point]
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
class NamedTime:
    """A named time s of the test."""

    name: str
    time: float


def moments(spans: Sequence[Span], steps: LoadSteps) -> tuple[NamedTime, ...]:
    """End of the elastic range, largest force, end of the last unloading, end of the test; in the order of time, each time once."""
    elastic = [NamedTime("end of elastic range", span.t1) for span in spans if span.name.startswith("elastic")][:1]
    unloading = [NamedTime("end of unloading", span.t1) for span in spans if span.name.startswith("unloading")][-1:]
    largest = NamedTime("largest force", float(steps.time[int(np.argmax(steps.force))]))
    found: list[NamedTime] = []
    for moment in (*elastic, largest, *unloading, NamedTime("end", float(steps.time[-1]))):
        if all(abs(moment.time - other.time) > 1e-6 for other in found):
            found.append(moment)
    return tuple(sorted(found, key=lambda moment: moment.time))


def snapshots(residuals: Sequence[ResidualField], chosen: Sequence[NamedTime]) -> dict[str, Dataset]:
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


def energy_totals(history: History) -> dict[str, float]:
    """Energies of the whole run and specimen in mJ: work of the load, dissipated, thermoelastic, outflow per surface, stored heat.

    `heat_defect` is stored - (dissipated + thermoelastic - outflow): zero up to the solver. `smallest_dissipation` (mJ/mm^3) is
    the smallest of all points and steps; negative violates the second law.
    """
    surfaces = history.balance[0].outflow if history.balance else {}
    return {
        "work": history.total("work"),
        "dissipated": history.total("dissipated"),
        "thermoelastic": history.total("thermoelastic"),
        **{f"outflow_{name}": sum(step.outflow[name] for step in history.balance) for name in surfaces},
        "stored": history.total("stored"),
        "heat_defect": history.total("heat_defect"),
        "smallest_dissipation": min((step.smallest_dissipation for step in history.balance), default=0.0),
    }


def energy_curves(history: History) -> dict[str, Dataset]:
    """The energies accumulated since the start, mJ (n_steps,), as datasets of an artefact; `time` s is that of their steps."""
    surfaces = history.balance[0].outflow if history.balance else {}
    series = {name: _summed(history.balance, name) for name in ("work", "dissipated", "thermoelastic", "stored")}
    series |= {f"outflow_{name}": _running([step.outflow[name] for step in history.balance]) for name in surfaces}
    return {
        "energy/time": Dataset(history.time, "s", ("step",)),
        **{f"energy/{name}": Dataset(values, "mJ", ("step",)) for name, values in series.items()},
    }


def _summed(balance: tuple[Balance, ...], name: str) -> np.ndarray:
    return _running([float(getattr(step, name)) for step in balance])


def _running(values: list[float]) -> np.ndarray:
    """Running sum from zero at the first time."""
    return np.concatenate([[0.0], np.cumsum(values)])
