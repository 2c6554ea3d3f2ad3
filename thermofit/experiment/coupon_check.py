"""Records of coupons with given parameters: residual per channel, phase and record, what the misfit is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_model import HISTORY, comparison, coupon_run, observations, offsets, segments
from thermofit.experiment.coupon_records import UNITS, CouponData
from thermofit.experiment.fields import field_datasets
from thermofit.experiment.residuals import ResidualField, Span, named_phases, residual_field, statistics
from thermofit.experiment.verification import Checked, channel_table, judge, phase_table
from thermofit.fit.memory import memories
from thermofit.observe.observation import FieldObservation
from thermofit.point.driver import PointHistory
from thermofit.records.artefact import Dataset
from thermofit.study.study import Study

_CURVES = (("strain", "1"), ("stress", "MPa"), ("theta", "K"), ("theta_sensor", "K"), ("lateral_x", "1"), ("accumulated", "1"))


def checked_records(study: Study, data: CouponData, parameters: Parameters, word: str = "verified") -> Checked:
    """Every record by the point driver beside its data; `word` is the verdict. NumericsError names the record that the model cannot
    follow."""
    run = coupon_run(study, data)
    histories = [run.history(parameters, test) for test in data.tests]
    measured = "stress" if data.control == "strain" else "strain"
    held = {"lateral": [t.lateral for t in data.tests], "theta": [t.theta for t in data.tests]}
    names = [measured, *(name for name, values in held.items() if any(value is not None for value in values))]
    windows = [(float(t.time[0]), float(t.time[-1])) for t in data.tests]
    seen = observations(data, names, windows, parameters["E"])
    fields = []
    worth: dict[str, float] = {}
    for name, observation in seen.items():
        channel = "dtheta" if name == "theta" else name
        error = _stacked(histories, name) - observation.value
        compared = comparison(channel, observation, "sigma")
        fields.append(replace(residual_field(compared, error, observation), shared=np.where(observation.mask[:, :, None], 0.0, np.nan)))
        found = memories(compared.residual(error), segments([compared], data))
        worth[channel] = sum(m.independent for m in found)
    summary = {**_summary(fields, record_spans(data, ": "), worth, word), "records": _record_rows(data, fields)}
    steps = sum(h.counts["steps"] for h in histories)
    return Checked(
        {**summary, "evaluations": {"forward": len(histories), "failed": 0, "steps": steps}}, _datasets(data, seen, fields, histories)
    )


def _stacked(histories: Sequence[PointHistory], name: str) -> np.ndarray:
    """A field of all records one after another, (n_t, 1, 1)."""
    return np.concatenate([getattr(h, HISTORY[name]) for h in histories])[:, None, None]


def record_spans(data: CouponData, mark: str = " ") -> tuple[Span, ...]:
    """Phases of all records on their common time axis; with several records each bears the name of its own, `mark` between them."""
    out = []
    for test, offset in zip(data.tests, offsets(data.tests), strict=True):
        prefix = f"{test.name}{mark}" if len(data.tests) > 1 else ""
        out += [Span(f"{prefix}{s.name}", s.t0 + offset, s.t1 + offset, record=test.name) for s in named_phases(test.phases)]
    return tuple(out)


def _summary(fields: Sequence[ResidualField], spans: Sequence[Span], worth: dict[str, float], word: str) -> dict[str, Any]:
    channels = channel_table(fields)
    for name, count in worth.items():
        channels[name]["n_independent"] = count
    rows = phase_table(fields, spans)
    found = judge(fields, rows, word)
    remarks = []
    for field in fields:
        row = channels[field.channel]
        if field.channel in found.outside:
            values = f"{row['n']} values are worth {worth[field.channel]:.3g} independent ones"
            remarks.append(
                f"{field.channel}: the misfit is that of the model, not of the sensor: {values}; standard errors count that, but not "
                "what a missing effect does to the parameters"
            )
    return {"verdict": found.line, "trustworthy": not found.outside, "channels": channels, "phases": rows, "remarks": remarks}


def _record_rows(data: CouponData, fields: Sequence[ResidualField]) -> list[dict[str, Any]]:
    """Rms and size over the noise of every channel, record by record."""
    rows, at = [], 0
    for test in data.tests:
        here = slice(at, at + len(test.time))
        at = here.stop
        row: dict[str, Any] = {"record": test.name}
        for field in fields:
            index = np.zeros(len(field.time), dtype=bool)
            index[here] = True
            found = statistics(field.at(index))
            if found is not None:
                row |= {f"{field.channel}_rms": found.rms, f"{field.channel}_over_noise": found.over_floor}
        rows.append(row)
    return rows


def _datasets(
    data: CouponData, seen: dict[str, FieldObservation], fields: Sequence[ResidualField], histories: Sequence[PointHistory]
) -> dict[str, Dataset]:
    out: dict[str, Dataset] = {}
    dims = ("time", "point", "component")
    for name, observation in seen.items():
        out |= field_datasets(observation)
        out[f"{name}/predicted"] = Dataset(_stacked(histories, name), observation.unit, dims)
    for field in fields:
        out[f"residual/{field.channel}"] = Dataset(field.normalised, "1", dims)
    for number, (test, history) in enumerate(zip(data.tests, histories, strict=True)):
        out[f"curves/{number}/time"] = Dataset(history.time, "s", ("sample",))
        for name, unit in _CURVES:
            out[f"curves/{number}/{name}"] = Dataset(getattr(history, name), unit, ("sample",))
        for name, unit in UNITS.items():
            value = getattr(test, name)
            if value is not None:
                out[f"curves/{number}/measured_{name}"] = Dataset(value, unit, ("sample",))
    return out
