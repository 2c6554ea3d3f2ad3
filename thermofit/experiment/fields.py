"""What the identification reads: the record of `interpolate` as arrays, with specimen, load steps and phases of the test."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.observe.end_motion import Gauge
from thermofit.observe.observation import FieldObservation
from thermofit.records.artefact import Dataset, Record, read_current
from thermofit.records.staging import artefact_path
from thermofit.study.study import Study

INTERPOLATE = "interpolate"


@dataclass(frozen=True)
class LoadSteps:
    """Times s (n,) that the solver steps through, the smoothed force N (n,) and, where known, crosshead and DIC elongation mm (n,), and
    modes of the error of what drives, the smoothed force N or the elongation mm (n, k): its covariance is error error^T.

    `course`: times s (m,), all steps among them, and the smoothed force N (m,) there, straight between them; None: it is straight between
    the steps. A force that bends between two steps deforms the specimen earlier than its chord, and the heat of the step leaves earlier:
    steps that are divided would not tell that error of the whole ones if they went along the chord.
    """

    time: np.ndarray
    force: np.ndarray
    crosshead: np.ndarray | None = None
    elongation: np.ndarray | None = None
    error: np.ndarray | None = None
    course: tuple[np.ndarray, np.ndarray] | None = None

    def until(self, t_end: float) -> LoadSteps:
        """The steps up to t_end, which becomes the last one."""
        time = np.append(self.time[self.time < t_end - 1e-9], t_end)

        return self.at(time)

    def divided(self, parts: int) -> LoadSteps:
        """Every step in so many equal parts."""
        if parts == 1:
            return self
        return self.at(refined(self.time, parts))

    def at(self, time: np.ndarray) -> LoadSteps:
        """The same test at other times s (n,)."""

        def cut(value: np.ndarray | None) -> np.ndarray | None:
            return None if value is None else np.interp(time, self.time, value)

        error = None if self.error is None else np.stack([np.interp(time, self.time, mode) for mode in self.error.T], axis=1)
        force = np.interp(time, *(self.course or (self.time, self.force)))
        return LoadSteps(time, force, cut(self.crosshead), cut(self.elongation), error, self.course)


def refined(steps: np.ndarray, parts: int) -> np.ndarray:
    """Times (n,) with every interval cut into `parts` equal ones."""
    share = np.arange(parts) / parts
    return np.append((steps[:-1, None] + np.diff(steps)[:, None] * share).ravel(), steps[-1])


@dataclass(frozen=True)
class TestPhase:
    """One phase of the test: t0, t1 in s, label elastic, loading, unloading, hold or cooling."""

    __test__ = False
    t0: float
    t1: float
    label: str


@dataclass(frozen=True)
class Stretched:
    """Elongation mm (n,) at the DIC stages s (n,), what its noise makes of the force of a model that it drives, N (n,), and that `noise`,
    mm. `counted`: where a model is driven so, what of that error is counted as noise of the compared force, N (n_t,)."""

    time: np.ndarray
    elongation: np.ndarray
    force_error: np.ndarray
    noise: float = 0.0
    counted: np.ndarray | None = None


@dataclass(frozen=True)
class Measured:
    """One experiment as the identification sees it; times in s, temperatures in K."""

    specimen: Specimen
    theta_air: float
    theta_clamp: float
    displacement: FieldObservation | None
    """None: no DIC; the motion was computed, and is no datum."""
    temperature: FieldObservation | None
    force: FieldObservation
    steps: dict[str, LoadSteps]
    load_start: float
    phases: tuple[TestPhase, ...]
    correlation_length: float = 0.0
    """Distance in mm over which the noise of neighbouring points hangs together, the larger one of the two fields; 0: it is not known."""
    registration: Mapping[str, float] = field(default_factory=dict)
    """Standard errors of the pose of the infrared camera by Param of `ir_registration`; empty: they are not known."""
    gauge: Gauge | None = None
    """Sections inside the model between which the elongation was measured; None: it is that of the model's ends, or not known."""
    stretched: Stretched | None = None
    """The elongation as DIC saw it; None: not known."""


def field_datasets(observation: FieldObservation) -> dict[str, Dataset]:
    """Datasets of one field in an artefact."""
    name, dims = observation.name, ("time", "point", "component")
    moments = {} if observation.moments is None else {f"{name}/moments": Dataset(observation.moments, "mm", ("time", "point", "moment"))}
    return moments | {
        f"{name}/time": Dataset(observation.time, "s", ("time",)),
        f"{name}/xy": Dataset(observation.xy, "mm", ("point", "axis")),
        f"{name}/value": Dataset(observation.value, observation.unit, dims),
        f"{name}/sigma": Dataset(observation.sigma, observation.unit, dims),
        f"{name}/mask": Dataset(observation.mask, "1", dims[:2]),
    }


def read_field(record: Record, name: str) -> FieldObservation:
    """The field of that name in an artefact."""
    value = record[f"{name}/value"]
    return FieldObservation(
        name=name,
        time=record[f"{name}/time"].value,
        xy=record[f"{name}/xy"].value,
        value=value.value,
        sigma=record[f"{name}/sigma"].value,
        mask=record[f"{name}/mask"].value.astype(bool),
        unit=value.unit,
        moments=record[f"{name}/moments"].value if record.has(f"{name}/moments") else None,
    )


def measured(study: Study) -> Measured:
    """Measured of a study from `<run_dir>/interpolate.h5`; StudyError that names the command where it is missing or stale."""
    return measured_of(read_current(artefact_path(study.run_dir, INTERPOLATE), INTERPOLATE, study.source.name))


def measured_of(record: Record) -> Measured:
    """Measured from an open record of `interpolate`."""
    summary = record.summary
    steps = {name: _read_steps(record, f"steps/{name}") for name in ("displacement", "temperature", "all")}
    displacement, temperature = (read_field(record, name) if record.has(f"{name}/value") else None for name in ("u", "theta"))
    seen = displacement or temperature
    assert seen is not None
    return Measured(
        specimen=Specimen(**summary["specimen"]),
        theta_air=float(summary["temperatures"]["theta_air"]),
        theta_clamp=float(summary["temperatures"]["theta_clamp"]),
        displacement=displacement,
        temperature=temperature,
        force=force_observation(seen.time, steps["displacement"], float(summary["force"]["noise_N"])),
        steps=steps,
        load_start=float(summary["load_start_s"]),
        phases=tuple(TestPhase(float(p["t0"]), float(p["t1"]), str(p["label"])) for p in summary["phases"]),
        correlation_length=max(
            float(summary.get(name, {}).get("correlation_length_mm") or 0.0) for name in ("displacement", "temperature")
        ),
        registration={name: float(sigma) for name, sigma in summary.get("temperature", {}).get("registration", {}).items()},
        gauge=Gauge(record["elongation/xy"].value, record["elongation/weight"].value) if record.has("elongation/xy") else None,
        stretched=_stretched(record),
    )


def _stretched(record: Record) -> Stretched | None:
    """The elongation in an open record of `interpolate`."""
    if not record.has("elongation/force_error"):
        return None
    time, value, error = (record[f"elongation/{key}"].value for key in ("time", "value", "force_error"))
    return Stretched(time, value, error, float(record.summary["elongation"]["noise_mm"]))


def _read_steps(record: Record, name: str) -> LoadSteps:
    def known(key: str) -> np.ndarray | None:
        return record[f"{name}/{key}"].value if record.has(f"{name}/{key}") else None

    course = (record["course/time"].value, record["course/force"].value) if record.has("course/time") else None
    time, force = (record[f"{name}/{key}"].value for key in ("time", "force"))
    return LoadSteps(time, force, known("crosshead"), known("elongation"), known("force_error"), course)


def force_observation(time: np.ndarray, steps: LoadSteps, noise: float) -> FieldObservation:
    """The force at observation times as a field of one point; sigma is the noise of the load cell."""
    value = np.interp(time, steps.time, steps.force)[:, None, None]
    return FieldObservation("force", time, np.zeros((1, 2)), value, np.full(value.shape, noise), np.ones(value.shape[:2], dtype=bool), "N")


def temperature_of(data: Measured) -> FieldObservation:
    """The temperature field; DataError where the experiment has none."""
    if data.temperature is None:
        raise DataError(
            "experiment: no infrared frames were interpolated; add the ir section to experiment.yaml and run calibrate-ir and interpolate"
        )
    return data.temperature


def displacement_of(data: Measured) -> FieldObservation:
    """The displacement field; DataError where the experiment has none."""
    if data.displacement is None:
        raise DataError(
            "experiment: it has no displacements, and what is computed from the force is no datum; compare theta or dtheta, or add the dic "
            "section to experiment.yaml"
        )
    return data.displacement


class SurroundingTemperatures(Protocol):
    """What knows the temperatures around a specimen."""

    @property
    def theta_air(self) -> float:
        """Temperature of the air, K."""
        ...

    @property
    def theta_clamp(self) -> float:
        """Temperature of the jaws, K."""
        ...


def start_parameters(study: Study, data: SurroundingTemperatures) -> Parameters:
    """Start values of the study with the thermocouple temperatures of the experiment where the study gives none."""
    return study.start_parameters(_Thermocouples(data.theta_air, data.theta_clamp))  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Thermocouples:
    theta_air: float
    theta_clamp: float


def specimen_dict(specimen: Specimen) -> dict[str, Any]:
    """Specimen as plain numbers for a summary."""
    return dataclasses.asdict(specimen)


def with_identified(study: Study, parameters: Parameters, stages: tuple[str, ...]) -> tuple[Parameters, dict[str, Path]]:
    """Parameters with what the given earlier stages identified, and the artefacts of these; StudyError where one is missing or stale."""
    inputs: dict[str, Path] = {}
    for stage in stages:
        path = artefact_path(study.run_dir, stage)
        record = read_current(path, stage, study.source.name)
        parameters = parameters.replace(**{name: result.value for name, result in record.parameters.items() if result.free})
        inputs[stage] = path
    return parameters, inputs
