"""Run folders as stages leave them, made up without a model: fields or records, verified, with and without an added effect."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.records.artefact import Dataset, ParameterResult, RecordContent, write_record
from thermofit.records.staging import artefact_path

TIME = np.linspace(0.0, 90.0, 16)
X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 6), np.linspace(-20.0, 20.0, 9))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)
SIGMA = {"u": 2e-3, "theta": 0.02}
LOST = (5, 7)
"""Time and point at which nothing was measured."""
PHASES = (("rest", 0.0, 6.0), ("loading", 6.0, 60.0), ("cooling", 60.0, 90.0))
HOSTILE = '</script><script>window.taken = 1</script><!-- <script <img src=x onerror="window.taken = 1">&amp;\'`{{ 7 * 7 }}'
SIZES = {
    **{"gauge_width": 25.0, "thickness": 1.2, "parallel_length": 100.0, "shoulder_radius": 25.0},
    **{"grip_width": 35.0, "total_length": 150.0, "gripped_length": 10.0},
}
ESTIMATE = {"lamp.absorbed": {"value": 0.0118, "sigma": 1e-4, "unit": "mW/mm^2"}}


def write(folder: Path, *contents: RecordContent) -> Path:
    """Write records into a run folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for content in contents:
        write_record(artefact_path(folder, content.stage), content)
    return folder


def residuals(amount: float, seed: int) -> dict[str, np.ndarray]:
    """Residuals over the noise: white, and for the temperature a patch that grows with time."""
    rng = np.random.default_rng(seed)
    patch = amount * (TIME / TIME[-1])[:, None] * np.exp(-((X - 5.0) ** 2 + (Y - 8.0) ** 2) / 60.0).ravel()
    found = {"du": rng.normal(size=(len(TIME), len(XY), 2)), "dtheta": rng.normal(size=(len(TIME), len(XY), 1)) + patch[:, :, None]}
    for value in found.values():
        value[LOST] = np.nan
    return found


def fields() -> dict[str, np.ndarray]:
    """What a model predicts: stretch along y and a rise."""
    pull = 0.1 * np.clip((TIME - 6.0) / 54.0, 0.0, 1.0)[:, None]
    u = np.stack([-0.4 * pull * XY[:, 0], pull * XY[:, 1]], axis=2)
    return {"u": u, "theta": (297.0 + 40.0 * pull + 0.0 * XY[:, 0])[:, :, None]}


def field_data(name: str, measured: np.ndarray, predicted: np.ndarray | None = None) -> dict[str, Dataset]:
    """Datasets of a field as stages write them."""
    dims, unit = ("time", "point", "component"), {"u": "mm", "theta": "K"}[name]
    mask = np.isfinite(measured).all(axis=2)
    out = {
        f"{name}/time": Dataset(TIME, "s", ("time",)),
        f"{name}/xy": Dataset(XY, "mm", ("point", "axis")),
        f"{name}/value": Dataset(measured, unit, dims),
        f"{name}/sigma": Dataset(np.full(measured.shape, SIGMA[name]), unit, dims),
        f"{name}/mask": Dataset(mask, "1", dims[:2]),
    }
    return out if predicted is None else {**out, f"{name}/predicted": Dataset(predicted, unit, dims)}


def measured() -> dict[str, np.ndarray]:
    """Fields with noise, one point once lost."""
    left = residuals(8.0, 1)
    found = {name: value - SIGMA[name] * left[f"d{name}"] for name, value in fields().items()}
    return found


def interpolated(**summary: Any) -> RecordContent:
    """What `interpolate` leaves."""
    fine = np.linspace(0.0, TIME[-1], 200)
    force = np.interp(fine, [0.0, 6.0, 60.0, 70.0, 90.0], [0.0, 0.0, 5000.0, 0.0, 0.0])
    data = {key: one for name, value in measured().items() for key, one in field_data(name, value).items()}
    data |= {f"force/{name}": Dataset(v, unit, ("sample",)) for name, v, unit in (("time", fine, "s"), ("smooth", force, "N"))}
    said: dict[str, Any] = {
        "verdict": "made up",
        "specimen": {**SIZES},
        "temperatures": {"theta_air": 297.4, "theta_clamp": 296.7},
        "load_start_s": 6.0,
        "phases": [{"label": label, "t0": t0, "t1": t1} for label, t0, t1 in PHASES],
        "force": {"noise_N": 4.0},
        "displacement": {"noise_mm": [2e-3, 2e-3], "noise_method": "made up", "nodes": len(XY)},
        "temperature": {"noise_K": 0.02, "noise_method": "made up"},
        "repairs": [],
        "remarks": ["a remark"],
    }
    return RecordContent("interpolate", {}, {}, data, {}, {**said, **summary})


def calibrated(**summary: Any) -> RecordContent:
    """What `calibrate-ir` leaves: a warm strip, upright, 1 mm per pixel."""
    rows, columns = np.mgrid[0:60, 0:40]
    frame = np.where(np.abs(columns - 20) < 12.5, 300.0, 296.0) + 0.01 * rows
    frames = frame[None] + np.arange(4)[:, None, None]
    said: dict[str, Any] = {
        "verdict": "1 mm/px",
        "pose": {"scale_mm_per_px": 1.0, "origin_px": [30.0, 20.0], "axis_x": [0.0, 1.0], "axis_y": [-1.0, 0.0], "side": "front"},
        "landmarks": {"frame": 1, "length": [[10, 20], [50, 20]], "edges": [[10, 7], [50, 7], [30, 32]], "circle": [[30, 20]] * 3},
    }
    data = {"frames": Dataset(frames, "K", ("frame", "row", "column")), "time": Dataset(TIME[:4], "s", ("frame",))}
    return RecordContent("calibrate-ir", {}, {}, data, {}, {**said, **summary})


def identified(stage: str, *free: str) -> RecordContent:
    """What an identification stage leaves."""
    return RecordContent(
        stage, {"model": 2, "mesh": "coarse"}, {}, correlation(free), parameters(*free), {"verdict": f"{stage} is done", "remarks": []}
    )


def correlation(free: tuple[str, ...]) -> dict[str, Dataset]:
    """Correlation of so many parameters."""
    matrix = np.full((len(free), len(free)), -0.5) + 1.5 * np.eye(len(free))
    return {
        "correlation": Dataset(matrix, "1", ("parameter", "parameter")),
        "evaluations/names": Dataset(np.array(free), "1", ("parameter",)),
    }


def parameters(*free: str) -> dict[str, ParameterResult]:
    """Values between 0 and 10."""
    return {name: ParameterResult(4.0, 0.1, "MPa", True, False, 3.0, 0.0, 10.0) for name in free}


def verified(**summary: Any) -> RecordContent:
    """What `verify` leaves."""
    left, predicted = residuals(8.0, 1), fields()
    data = {key: one for name, value in measured().items() for key, one in field_data(name, value, predicted[name]).items()}
    data |= {f"residual/{c}": Dataset(v, "1", ("time", "point", "component")) for c, v in left.items()}
    table = {c: _channel(c, v) for c, v in left.items()}
    rows = [{"channel": c, "phase": p, "t0_s": a, "t1_s": b, "n": 9, "chi2_reduced": 4.0} for c in left for p, a, b in PHASES]
    said = {"verdict": "not verified: a patch", "trustworthy": False, "channels": table, "phases": rows, "remarks": []}
    return RecordContent("verify", {"model": 2, "mesh": "coarse"}, {}, data, parameters("E", "c0"), {**said, **summary})


def _channel(name: str, left: np.ndarray) -> dict[str, Any]:
    known = left[np.isfinite(left)]
    noise, unit = {"du": (2e-3, "mm"), "dtheta": (0.02, "K")}[name]
    chi2 = float(np.mean(known**2))
    return {"n": len(known), "rms": noise * chi2**0.5, "unit": unit, "floor_rms": noise, "chi2_reduced": chi2, "judged": True}


def row(effect: str, gain: float | None, remark: str, **changes: Any) -> dict[str, Any]:
    """A row of a ranking."""
    estimate = ESTIMATE if effect == "lamp" else {f"{effect}.size": {"value": 1.0, "sigma": 0.5, "unit": "1"}}
    base = {"effect": effect, "family": [effect], "z": 5.0, "estimate": estimate, "detectability": 0.1, "detectable": 0.002}
    return {**base, "held_out_gain": gain, "held_out_sigma": None if gain is None else 0.02, "accepted": False, "remark": remark, **changes}


def looped(*, before: bool = True, **summary: Any) -> RecordContent:
    """What `close-loop` leaves that has added a lamp."""
    first, last = residuals(8.0, 1), residuals(0.0, 1)
    rows = {key: [] for key in ("channel", "time", "xy", "value", "before")}  # type: ignore[var-annotated]
    for number, channel in enumerate(first):
        place = np.argwhere(np.isfinite(first[channel]))
        rows["channel"].append(np.full(len(place), number))
        rows["time"].append(TIME[place[:, 0]])
        rows["xy"].append(XY[place[:, 1]])
        rows["value"].append(last[channel][tuple(place.T)])
        rows["before"].append(first[channel][tuple(place.T)])
    whole = {key: np.concatenate(parts) for key, parts in rows.items()}
    data = {
        f"residual/{key}": Dataset(v, "1", ("row", "axis") if key == "xy" else ("row",))
        for key, v in whole.items()
        if before or key != "before"
    }
    data["rms/channel"] = Dataset(np.array(list(first)), "1", ("channel",))
    levels = {side: _errors(left) for side, left in (("before", first), ("after", last))}
    lack = [
        {"channel": c, "phase": p, "t0_s": a, "t1_s": b, "n": 9, "chi2_reduced": 1.0, "numerical": 0.01}
        for c in first
        for p, a, b in PHASES
    ]
    trial = {**row("lamp", 0.26, "", accepted=True, family=["lamp", "latent_heat"]), "effects": ["lamp"], "unjudged": False}
    refused = {**row("ir_drift", 0.1, "less than lamp"), "effects": ["ir_drift"], "unjudged": False}
    turns = [
        {"ranking": [], "tried": [trial, refused], "added": ["lamp"], "accepted": "lamp", "before": {"parameters": {"E": 3.5}}},
        {"ranking": [row("bending", None, "z 0.1 is below 2.8")], "tried": [], "added": [], "accepted": None, "before": {"parameters": {}}},
    ]
    said = {
        "verdict": "added lamp", "trustworthy": True, "doubts": [], "remarks": [], "unlisted": None, "accepted": ["lamp"], "dropped": [],
        "ranking": [
            row("lamp", 0.25, "", accepted=True), row("ir_drift", 0.2, ""), row("bending", 0.01, ""),
            row("radiation", None, "radiation.emissivity would be 39 1, outside 0 to 1"),
        ],
        "rounds": turns, "undecided": ["lamp (added) or latent_heat: a longer rest would decide"], "programmes": [], "unfelt": ["jaw_slip"],
        "not_asked": ["rate_power"], "unjudged": {}, "held_out": "25 blocks", "lack_of_fit": lack, **levels,
        "channels": {c: _channel(c, v) for c, v in last.items()},
    }  # fmt: skip
    results = {**parameters("E", "c0"), "lamp.absorbed": ParameterResult(0.0118, 1e-4, "mW/mm^2", True, False, 0.0118, -10.0, 10.0)}
    return RecordContent("close-loop", {"model": 2, "mesh": "coarse"}, {}, data, results, {**said, **summary})


def _errors(left: Mapping[str, np.ndarray]) -> dict[str, dict[str, float]]:
    noise = {"du": 2e-3, "dtheta": 0.02}
    rms = {c: noise[c] * float(np.sqrt(np.nanmean(v**2))) for c, v in left.items()}
    small = {c: 0.01 * noise[c] for c in rms}
    return {
        "fit": rms,
        "fit_sigma": small,
        "held_out": {c: 1.02 * v for c, v in rms.items()},
        "held_out_sigma": small,
        "floor": noise,
        "numerical": small,
    }


def whole_run(folder: Path, **loop: Any) -> Path:
    """A run to its end."""
    stages = (
        identified("identify-elastic", "E", "nu"),
        identified("identify-plastic", "M_y0", "F"),
        identified("identify-thermal", "c0", "beta"),
    )
    return write(folder, calibrated(), interpolated(), *stages, verified(), looped(**loop))


def records_run(folder: Path, name: str = "pull 1") -> Path:
    """A run of two records without a field."""
    time = np.linspace(0.0, 50.0, 80)
    strain, stress = 0.001 * time, 300.0 * (1.0 - np.exp(-time / 8.0))
    curves = {
        "time": (time, "s"),
        "measured_strain": (strain, "1"),
        "strain": (strain, "1"),
        "measured_stress": (stress + 1.0, "MPa"),
        "stress": (stress, "MPa"),
    }
    data = {f"curves/{k}/{key}": Dataset(v, unit, ("sample",)) for k in (0, 1) for key, (v, unit) in curves.items()}
    n = 2 * len(time)
    z, clock = np.linspace(-5.0, 5.0, n)[:, None, None], np.r_[time, time + 60.0]
    data |= {"residual/stress": Dataset(z, "1", ("time", "point", "component")), "stress/time": Dataset(clock, "s", ("time",))}
    data["stress/sigma"] = Dataset(np.full((n, 1, 1), 2.0), "MPa", ("time", "point", "component"))
    data["stress/xy"] = Dataset(np.zeros((1, 2)), "mm", ("point", "axis"))
    channels = {"stress": {"n": n, "rms": 3.0, "unit": "MPa", "floor_rms": 1.0, "judged": True}}
    names = [{"record": name}, {"record": "pull 2"}]
    said = {"verdict": "not verified", "trustworthy": False, "channels": channels, "phases": [], "records": names}
    looks = [{"record": r["record"], "n": 80, "duration_s": 50.0, "strain": "0 to 0.05"} for r in names]
    source = RecordContent("interpolate", {}, {}, {}, {}, {"verdict": "2 records", "records": looks, "phases": []})
    check = RecordContent("verify", {"model": 1, "coupon": {"records": []}}, {}, data, parameters("E"), said)
    return write(folder, source, identified("identify-elastic", "E"), identified("identify-plastic", "M_y0"), check)
