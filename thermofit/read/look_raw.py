"""What `inspect` finds in a raw experiment folder, thermofit's own format: records, fields and their noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS, Experiment
from thermofit.observe.noise import displacement_noise, temperature_noise
from thermofit.observe.phases import force_noise
from thermofit.read.findings import ColumnFinding, Fact, Part
from thermofit.read.look_record import clock_facts
from thermofit.read.raw import read_experiment

_T = TypeVar("_T")


def look_at_raw(folder: Path) -> tuple[Part, ...]:
    """Force record, DIC stages, infrared frames. DataError for every defect of the folder."""
    experiment = read_experiment(folder)
    parts = [_force(experiment)]
    if experiment.dic is not None:
        parts.append(_dic(experiment))
    if experiment.ir is not None:
        parts.append(_ir(experiment))
    return tuple(parts)


def _clock(time: np.ndarray) -> dict[str, Fact]:
    return {key: value for key, value in clock_facts(time)[0].items() if key not in ("repeated times", "backward times")}


def _force(experiment: Experiment) -> Part:
    record = experiment.force
    facts: dict[str, Fact] = {"rows": len(record.time), **_clock(record.time)}
    facts |= {"air degC": experiment.theta_air - CELSIUS, "jaws degC": experiment.theta_clamp - CELSIUS}
    columns = [_column("force", "N", record.force, _or_none(lambda: force_noise(record)))]
    if record.crosshead is not None:
        columns.append(_column("crosshead", "mm", record.crosshead, None))
    return Part("force", "record", len(record.time), 0, facts, tuple(columns), experiment.repairs)


def _dic(experiment: Experiment) -> Part:
    dic = experiment.dic
    assert dic is not None
    lost = int(np.isnan(dic.displacement[:, :, 0]).sum())
    facts: dict[str, Fact] = {
        "stages": len(dic.time),
        "points": len(dic.point_id),
        "without value": lost,
        **_clock(dic.time),
        "side": dic.side,
    }
    noise = _or_none(lambda: displacement_noise(dic))
    columns = []
    for k, name in enumerate(("u", "v", "w")):
        found = noise[k] if noise else None
        columns.append(_column(name, "mm", dic.displacement[:, :, k], found.sigma if found else None))
    return Part("dic", "DIC sequence", dic.displacement[:, :, 0].size, lost, facts, tuple(columns))


def _ir(experiment: Experiment) -> Part:
    ir = experiment.ir
    assert ir is not None
    n, rows, columns = ir.frames.shape
    facts: dict[str, Fact] = {"frames": n, "rows": rows, "columns": columns, **_clock(ir.time), "side": ir.side}
    facts["landmarks"] = "given" if experiment.landmarks else "absent"
    noise = _or_none(lambda: temperature_noise(ir))
    return Part(
        "ir", "infrared frames", ir.frames.size, 0, facts, (_column("temperature", "K", ir.frames, noise.sigma if noise else None),)
    )


def _or_none(estimate: Callable[[], _T]) -> _T | None:
    """An estimate of noise, None where the data are too few for it."""
    try:
        return estimate()
    except DataError:
        return None


def _column(name: str, unit: str, values: np.ndarray, noise: float | None) -> ColumnFinding:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (None, None)
    return ColumnFinding(name, name, unit, "format", unit, low, high, int(values.size - known.size), noise)
