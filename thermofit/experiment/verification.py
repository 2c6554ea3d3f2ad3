"""All identified parameters in one coupled run against all data: residuals per channel and phase, coupling error, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from thermofit.body.body import Body
from thermofit.body.solve.march import History, Watch
from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param, physical_bounds
from thermofit.experiment.channels import reference_times
from thermofit.experiment.fields import INTERPOLATE, LoadSteps, Measured, read_field
from thermofit.experiment.forward import Run, march_settings, run_of, sampler
from thermofit.experiment.instruments import Instruments
from thermofit.experiment.residuals import ResidualField, Span, Statistics, residual_field, span_of, statistics
from thermofit.experiment.trust import above_floor, level
from thermofit.observe.comparison import plain, rigid_free, temperature_change
from thermofit.observe.observation import FieldObservation
from thermofit.records.artefact import ParameterResult, Record, open_record
from thermofit.records.key import drifted
from thermofit.records.progress import progress
from thermofit.records.staging import artefact_path
from thermofit.records.stale import other_sources
from thermofit.study.study import Study

IDENTIFY = ("identify-elastic", "identify-plastic", "identify-thermal")
"""The identification stages in their order."""
INFORMATION = ("u", "theta")
"""Channels that hold what no parameter of the law can explain (rigid-body motion, the camera's offset): shown, not judged."""
_SAME_TIME = 1e-6


@dataclass(frozen=True)
class Verification:
    """A coupled run beside the data: observed and predicted fields ("u", "theta", "force") and the residual of every channel."""

    body: Body
    steps: LoadSteps
    history: History
    observed: dict[str, FieldObservation]
    predicted: dict[str, np.ndarray]
    residuals: tuple[ResidualField, ...]

    def residual(self, channel: str) -> ResidualField | None:
        """The residual of a channel, None where the experiment does not have it."""
        return next((field for field in self.residuals if field.channel == channel), None)


def identified_stages(study: Study) -> tuple[str, ...]:
    """The identification stages whose result is there; the elastic one always, so that its absence names its command."""
    return tuple(name for name in IDENTIFY if name == IDENTIFY[0] or artefact_path(study.run_dir, name).exists())


def made_otherwise(study: Study, stages: Sequence[str]) -> list[str]:
    """Which artefacts of `interpolate` and the given stages were made with other settings than the study's now, or by other sources."""
    ones = [study.one_of(name) for name in study.fitted] or [study]
    out = []
    for one, stage in [*((one, INTERPOLATE) for one in ones), *((study, stage) for stage in stages)]:
        record = open_record(artefact_path(one.run_dir, stage))
        sources = other_sources(record)
        out += [*drifted(one, {stage: record}), *([f"{record.path.name}: {sources}"] if sources else [])]
    return out


def fitted_parameters(study: Study, parameters: Parameters, stages: Sequence[str]) -> dict[str, ParameterResult]:
    """All parameters of the verified model: those that a stage identified as it left them, the others as prescribed."""
    results = {}
    for name in parameters.given():
        value = parameters[name]
        results[name] = ParameterResult(value, None, param(name).unit, False, False, value, *physical_bounds(name))
    for stage in stages:
        record = open_record(artefact_path(study.run_dir, stage))
        results |= {name: result for name, result in record.parameters.items() if result.free}
    return results


def verification(study: Study, data: Measured, parameters: Parameters) -> Verification:
    """One coupled run through all load steps, compared at all observations. NumericsError where the specimen cannot carry the force."""
    steps = data.steps["all"]
    run = run_of(study, data, study.mesh_size, steps, march_settings(study, "full"))
    with progress("verify", len(steps.time) - 1) as advance:
        try:
            history = run(parameters, Watch(step=lambda _: advance()))
        except NumericsError as error:
            text = f"coupled run with the parameters identified so far: {error}; run the missing identification stages first"
            raise NumericsError(text) from error
    observed, predicted = _fields(study, data, run, history, parameters)
    return Verification(run.body, steps, history, observed, predicted, _residuals(study, data, observed, predicted))


def _fields(
    study: Study, data: Measured, run: Run, history: History, parameters: Parameters
) -> tuple[dict[str, FieldObservation], dict[str, np.ndarray]]:
    """Observed and predicted fields, as the instruments show them; the force is one of them where the crosshead drives."""
    steps = data.steps["all"]
    observed = {"u": data.displacement}
    if data.temperature is not None:
        observed["theta"] = data.temperature
    if study.force.drives != "force":
        observed["force"] = data.force
    samplers = {name: sampler(run.body, data.displacement if name == "force" else o, steps) for name, o in observed.items()}
    instruments = Instruments(run, samplers, observed, data.theta_air)
    return observed, {name: instruments.predicted(name, history, parameters) for name in observed}


def _residuals(
    study: Study, data: Measured, observed: dict[str, FieldObservation], predicted: dict[str, np.ndarray]
) -> tuple[ResidualField, ...]:
    errors = {name: predicted[name] - observed[name].value for name in observed}
    u, theta = observed["u"], observed.get("theta")
    du = residual_field(rigid_free(u), errors["u"], u)
    fields = [du, du.component(0), du.component(1)]
    if theta is not None:
        change = temperature_change(theta, reference_times(theta, study, data.load_start))
        fields.append(residual_field(change, errors["theta"], theta))
    fields += [residual_field(plain(observed[name]), errors[name], observed[name]) for name in ("force", "u", "theta") if name in observed]
    return tuple(fields)


def channel_table(residuals: Sequence[ResidualField]) -> dict[str, dict[str, Any]]:
    """Per channel its statistics; `judged` False where it is shown for information."""
    table = {}
    for field in residuals:
        numbers = statistics(field)
        if numbers is not None:
            table[field.channel] = {**asdict(numbers), "judged": field.channel not in INFORMATION}
    return table


def phase_table(residuals: Sequence[ResidualField], spans: Sequence[Span]) -> list[dict[str, Any]]:
    """One row per judged channel and phase in which it is compared: its statistics without the mean."""
    rows = []
    for field in residuals:
        if field.channel in INFORMATION:
            continue
        index = span_of(field.time, spans)
        for number, span in enumerate(spans):
            found = statistics(field.at(index == number))
            if found is not None:
                place = {"channel": field.channel, "phase": span.name, "t0_s": round(span.t0, 3), "t1_s": round(span.t1, 3)}
                rows.append({**place, **{key: value for key, value in asdict(found).items() if key != "mean"}})
    return rows


@dataclass(frozen=True)
class Judgement:
    """The verdict in one line, and the judged channels that are at their floor and those that are not."""

    line: str
    within: tuple[str, ...]
    outside: tuple[str, ...]


def judge(residuals: Sequence[ResidualField], rows: Sequence[dict[str, Any]], word: str = "verified") -> Judgement:
    """Which channels are explained by their noise, as a whole and in every phase (`rows` of `phase_table`), by the rule of `trust`.

    `word` is the verdict: "verified" on data that were fitted, "valid" on others.
    """
    found = [(f.channel, statistics(f)) for f in residuals if f.channel not in INFORMATION]
    sizes = {channel: s for channel, s in found if s is not None}
    levels = [level(channel, s.chi2_reduced, 0.0, s.n) for channel, s in sizes.items()]
    levels += [level(row["channel"], row["chi2_reduced"], 0.0, row["n"], row["phase"]) for row in rows]
    above = above_floor(levels)
    outside = tuple(channel for channel in sizes if channel in {one.channel for one in above})
    if not outside:
        line = f"{word}: " + ", ".join(f"{channel} {s.over_floor:.2f}" for channel, s in sizes.items()) + " times the noise"
    else:
        line = f"not {word}: " + "; ".join(_outlier(channel, sizes[channel], rows) for channel in outside)
    return Judgement(line, tuple(channel for channel in sizes if channel not in outside), outside)


def _outlier(channel: str, found: Statistics, rows: Sequence[dict[str, Any]]) -> str:
    worst = max((row for row in rows if row["channel"] == channel), key=lambda row: float(row["chi2_reduced"]))
    return (
        f"{channel} is {found.over_floor:.2g} times its noise (rms {found.rms:.3g} {found.unit}, noise {found.floor_rms:.3g}), "
        f"most in {worst['phase']} ({np.sqrt(worst['chi2_reduced']):.2g} times)"
    )


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
    difference = verified.predicted["theta"][index[same]] - thermal["theta/predicted"].value[same]
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
