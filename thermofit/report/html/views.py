"""Arrays that the viewer of a report draws: maps over time, curves at points and of records, frames of the infrared camera."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.body.mesh.mesh import boundary_facets
from thermofit.body.mesh.specimen import specimen_mesh
from thermofit.core.errors import ThermofitError
from thermofit.core.experiment import Specimen
from thermofit.observe.camera import CameraPose, specimen_to_pixel
from thermofit.observe.check_picture import specimen_outline
from thermofit.observe.stencils import planes
from thermofit.read.raw import read_experiment
from thermofit.records.artefact import Record
from thermofit.report.html.gather import LOOP, VERIFY
from thermofit.report.html.maps import BeforeAfter, pairs, raster
from thermofit.report.html.run_folder import IDENTIFY, Records, RunFolder
from thermofit.study.study import Study

BUDGET = 4_500_000
"""Most values in a page; at 16 bits each, as base64, they take 12 MB. Above it, every k-th time is kept."""
_FRAMES, _PIXELS = 8, 1_200_000
"""Most frames of a camera in a page, and most pixels of all of them."""
_RAW = 200_000_000
"""Bytes of displacement files above which the points of the correlation are not read again for the picture."""
_SAME = 1e-3
"""Relative difference up to which two noises are one."""


def views_of(run: RunFolder, study: Study | None, budget: int = BUDGET) -> dict[str, Any]:
    """Everything that is drawn: `tests` with maps and fields, `records`, `cameras`, and `thinned` in words (empty: nothing left out)."""
    drawn = [pair for pair in pairs(run) if len(pair.before.xy) > 2]
    sources = {test: _fields(records) for test, records in run.tests.items()}
    total = sum(p.before.value[..., 0].size * (1 if p.after is None else 2) for p in drawn)
    total += sum(2 * v["value"].size + 2 * v["value"][..., 0].size for fields in sources.values() for v in fields.values())
    stride = max(1, -(-total // budget))
    tests = []
    for test, records in run.tests.items():
        if not sources[test]:
            continue
        grids: list[np.ndarray] = []
        noise = _noises(run, test)
        maps = [_map(pair, stride, grids) | {"noise": noise.get(pair.channel)} for pair in drawn if pair.test == test]
        fields = {name: _field(v, records, stride, grids) for name, v in sources[test].items()}
        places = [{"xy": np.round(xy, 4).tolist(), "raster": raster(xy)} for xy in grids]
        tests.append({"name": test, "phases": _phases(records), "grids": places, "maps": maps, "fields": fields})
    said = f"every {stride}th time is drawn, to keep the file small" if stride > 1 else ""
    cameras = [made for test, records in run.tests.items() if (made := _camera(test, records, study)) is not None]
    return {"tests": tests, "records": list(_records(run)), "cameras": cameras, "thinned": said}


def _noises(run: RunFolder, test: str) -> dict[str, float]:
    """Noise of the channels of one test in their units, where the loop, if it has run, knows the same one."""
    channels = run.tests[test][VERIFY].summary.get("channels", {}) if VERIFY in run.tests[test] else {}
    own = {str(name): float(c["floor_rms"]) for name, c in channels.items() if c.get("floor_rms")}
    loop = run.records[LOOP].summary.get("channels", {}) if run.has(LOOP) else {}
    end = f"@{test}" if test else ""
    of_loop = {str(name).removesuffix(end): float(c["floor_rms"]) for name, c in loop.items() if str(name).endswith(end)}
    return {name: noise for name, noise in {**of_loop, **own}.items() if abs(of_loop.get(name, noise) - noise) <= _SAME * noise}


def _grid(xy: np.ndarray, grids: list[np.ndarray]) -> int:
    """Number of a set of points among those of a test; a new one is added."""
    for number, known in enumerate(grids):
        if known.shape == xy.shape and np.allclose(known, xy, atol=1e-5):
            return number
    grids.append(xy)
    return len(grids) - 1


def _map(pair: BeforeAfter, stride: int, grids: list[np.ndarray]) -> dict[str, Any]:
    before, after = pair.before, pair.after
    return {
        "label": pair.label,
        "channel": pair.channel,
        "time": _rounded(before.time[::stride]),
        "grid": _grid(before.xy, grids),
        "words": list(pair.words),
        "before": packed(_clipped(before.value[::stride, :, pair.component])),
        "after": None if after is None else packed(_clipped(_like(before.time, before.xy, after)[::stride, :, pair.component])),
    }


def _clipped(values: np.ndarray) -> np.ndarray:
    """Residuals within +-1000 times the noise: one wild value would cost all others their digits."""
    return np.clip(values, -1000.0, 1000.0)


def _like(time: np.ndarray, xy: np.ndarray, field: Any) -> np.ndarray:
    """A field at the times and points of another, NaN where it has none."""
    if np.array_equal(field.time, time) and field.xy.shape == xy.shape and np.allclose(field.xy, xy, atol=1e-5):
        return np.asarray(field.value)
    t = np.abs(field.time[None, :] - time[:, None])
    p = np.linalg.norm(field.xy[None, :, :] - xy[:, None, :], axis=2)
    value = np.asarray(field.value)[np.ix_(t.argmin(axis=1), p.argmin(axis=1))]
    value[t.min(axis=1) > 1e-3] = np.nan
    value[:, p.min(axis=1) > 1e-3] = np.nan
    return np.asarray(value)


def _fields(records: Records) -> dict[str, dict[str, np.ndarray]]:
    """Measured fields over place, beside what the last stage that ran a model predicts."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for name in ("u", "theta"):
        stages = [s for s in (VERIFY, *reversed(IDENTIFY)) if s in records and records[s].has(f"{name}/predicted")]
        # An elastic stage sees a few stages of the displacements only: the whole measured field says more than its prediction.
        stage = next((s for s in stages if s != IDENTIFY[0]), "interpolate")
        record = records.get(stage)
        if record is None or not record.has(f"{name}/value") or len(record[f"{name}/xy"].value) < 3:
            continue
        parts = ("time", "xy", "value", "sigma", *(("predicted",) if record.has(f"{name}/predicted") else ()))
        one = {part: record[f"{name}/{part}"].value for part in parts}
        lost = ~record[f"{name}/mask"].value.astype(bool)
        one["value"] = np.where(lost[..., None], np.nan, one["value"])
        found[name] = one
    return found


def _field(field: Mapping[str, np.ndarray], records: Records, stride: int, grids: list[np.ndarray]) -> dict[str, Any]:
    value, predicted, time = field["value"], field.get("predicted"), field["time"]
    sigma = float(np.nanmedian(field["sigma"]))
    start = float(records["interpolate"].summary.get("load_start_s") or 0.0) if "interpolate" in records else 0.0
    out = {
        "time": _rounded(time[::stride]),
        "grid": _grid(field["xy"], grids),
        "sigma": sigma,
        "model": "verified" if VERIFY in records else "fitted",
        "value": packed(value[::stride]),
        "predicted": None if predicted is None else packed(predicted[::stride]),
    }
    if value.shape[2] == 1:
        # Rises are counted from the mean of what was seen before loading, in both: the channel compares these.
        rest = time <= max(start, float(time[0]))
        known = np.isfinite(value[rest])
        count = np.maximum(known.sum(axis=0), 1)
        out["reference"] = _numbers(np.where(known, value[rest], 0.0).sum(axis=0)[:, 0] / count[:, 0])
        if predicted is not None:
            out["reference_model"] = _numbers(np.where(known, predicted[rest], 0.0).sum(axis=0)[:, 0] / count[:, 0])
    else:
        out |= _stretch(field, records, stride)
    return out


def _stretch(field: Mapping[str, np.ndarray], records: Records, stride: int) -> dict[str, Any]:
    """Stretch along the load at every point, 1 + du_y/dy of the plane through its neighbours, and force over initial area, MPa."""
    record = records.get("interpolate")
    own = None if record is None else record.summary.get("specimen")
    if record is None or own is None or not record.has("force/smooth"):
        return {}
    xy, value = field["xy"], field["value"]
    stencil = planes(xy, ("y,y",))
    if not len(stencil.point):
        return {}
    seen = stencil.measured(np.isfinite(value).all(axis=2))

    def stretch(u: np.ndarray) -> np.ndarray:
        out = np.full((len(u), len(xy)), np.nan)
        out[:, stencil.point] = np.where(seen, 1.0 + stencil.at(np.nan_to_num(u)), np.nan)
        return out[::stride]

    weight = stencil.matrix.multiply(stencil.matrix).sum(axis=1)
    sigma = float(np.sqrt(np.median(weight)) * np.nanmedian(field["sigma"]))
    force = np.interp(field["time"], record["force/time"].value, record["force/smooth"].value)
    predicted = field.get("predicted")
    return {
        "stress": _numbers(force[::stride] / (own["gauge_width"] * own["thickness"])),
        "stretch": packed(stretch(value)),
        "stretch_model": None if predicted is None else packed(stretch(predicted)),
        "stretch_sigma": sigma,
    }


def _phases(records: Records) -> list[dict[str, Any]]:
    record = records.get("interpolate")
    rows = () if record is None else record.summary.get("phases", ())
    return [{"label": str(r["label"]), "t0": float(r["t0"]), "t1": float(r["t1"])} for r in rows if "record" not in r]


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(v), 4) for v in values]


def _numbers(values: np.ndarray) -> list[float | None]:
    """Six digits each, null where there is none."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float).ravel()]


# Records without a field.


def _records(run: RunFolder) -> Iterator[dict[str, Any]]:
    """Every record without a field: curves as measured and as the verified model gives them, residual before and after."""
    for records in run.tests.values():
        record, source = records.get(VERIFY), records.get("interpolate")
        if record is None or not record.has("curves/0/time"):
            if source is not None and source.has("records/0/time"):
                yield from _measured_records(source)
            continue
        names = [str(r["record"]) for r in record.summary.get("records", ())]
        lengths = [len(record[f"curves/{k}/time"].value) for k in range(len(names))]
        starts = np.r_[0, np.cumsum(lengths)]
        residuals = list(_residuals(run, record, int(starts[-1])))
        for k, name in enumerate(names):
            curve = {key: record[f"curves/{k}/{key}"].value for key in _keys(record, k)}
            stride = max(1, len(curve["time"]) // 2000)
            own = slice(int(starts[k]), int(starts[k + 1]))
            parts = []
            for r in residuals:
                both = {key: None if r[key] is None else _numbers(r[key][own][::stride]) for key in ("before", "after", "sigma")}
                parts.append({**r, **both})
            curves = {key: _numbers(v[::stride]) for key, v in curve.items()}
            yield {"name": name, "curves": curves, "residuals": [p for p in parts if any(v is not None for v in p["before"])]}


def _keys(record: Record, k: int) -> list[str]:
    lead = f"curves/{k}/"
    return [name.removeprefix(lead) for name in record.names if name.startswith(lead)]


def _measured_records(source: Record) -> Iterator[dict[str, Any]]:
    for k, row in enumerate(source.summary.get("records", ())):
        lead = f"records/{k}/"
        own = {name.removeprefix(lead): source[name].value for name in source.names if name.startswith(lead)}
        if "time" not in own:
            continue
        stride = max(1, len(own["time"]) // 2000)
        curves = {("time" if key == "time" else f"measured_{key}"): _numbers(v[::stride]) for key, v in own.items()}
        yield {"name": str(row["record"]), "curves": curves, "residuals": []}


def _residuals(run: RunFolder, record: Record, n: int) -> Iterator[dict[str, Any]]:
    """Residuals over all records one after the other (n,), before and after."""
    for pair in pairs(run):
        if len(pair.before.xy) > 2:
            continue
        clock = next((record[f"{c}/time"].value for c in (pair.channel, pair.channel.removeprefix("d")) if record.has(f"{c}/time")), None)
        if clock is None or len(clock) != n:
            continue

        def spread(field: Any, clock: np.ndarray = clock, k: int = pair.component) -> np.ndarray:
            out = np.full(n, np.nan)
            at = np.clip(np.searchsorted(clock, field.time), 0, n - 1)
            near = np.abs(clock[at] - field.time) < 1e-6 * max(1.0, float(np.ptp(clock)))
            out[at[near]] = field.value[near, 0, k]
            return out

        before, after = spread(pair.before), None if pair.after is None else spread(pair.after)
        # With the noise of every sample the last model is what was measured plus its residual.
        known = pair.channel in _noises(run, pair.test) and record.has(f"{pair.channel}/sigma")
        sigma = record[f"{pair.channel}/sigma"].value[:, 0, 0] if known else None
        yield {"label": pair.label, "channel": pair.channel, "words": list(pair.words), "before": before, "after": after, "sigma": sigma}


# The camera.


def _camera(test: str, records: Records, study: Study | None) -> dict[str, Any] | None:
    """Frames of the infrared camera with everything that should lie on the specimen, in pixels as (column, row)."""
    record, data = records.get("calibrate-ir"), records.get("interpolate")
    if record is None or not record.has("frames"):
        return None
    s = record.summary
    seen = s["pose"]
    origin, axis_x, axis_y = (np.array(seen[key]) for key in ("origin_px", "axis_x", "axis_y"))
    pose = CameraPose(seen["scale_mm_per_px"], origin, axis_x, axis_y, seen["side"])
    frames, time = record["frames"].value, record["time"].value
    marks = s.get("landmarks")
    first = int(marks["frame"]) if marks else 0
    most = int(np.clip(_PIXELS // frames[0].size, 1, _FRAMES))
    chosen = np.unique(np.r_[first, np.linspace(0, len(frames) - 1, most).astype(int)])
    ranges = [tuple(float(v) for v in np.nanpercentile(frames[k], [0.5, 99.5])) for k in chosen]
    layers: list[dict[str, Any]] = []
    if data is not None and (own := data.summary.get("specimen")) is not None:
        specimen = Specimen(**own)
        layers.append(_layer("outline of the specimen", "line", [_pixels(pose, specimen_outline(specimen))]))
        if (edges := _mesh_edges(records, study, specimen)) is not None:
            layers.append(_layer("mesh of the model", "mesh", [_pixels(pose, line) for line in edges]))
    if (points := _dic_points(data)) is not None:
        layers.append(_layer("points of the image correlation", "dots", [_pixels(pose, points)]))
    if data is not None and data.has("theta/xy"):
        layers.append(_layer("points that are compared", "ring", [_pixels(pose, data["theta/xy"].value)]))
    if marks:
        for kind in ("length", "edges", "circle"):
            layers.append(_layer(f"landmarks: {kind}", "mark", [np.round(np.array(marks[kind])[:, ::-1], 2).tolist()]))
    rows, columns = frames.shape[1:]
    return {
        "name": test,
        "says": str(s.get("verdict", "")),
        "w": int(columns),
        "h": int(rows),
        "time": _rounded(time[chosen]),
        "range_K": [[low, high] for low, high in ranges],
        "start": int(np.flatnonzero(chosen == first)[0]),
        "frames": [levels(frames[k], low, high) for k, (low, high) in zip(chosen, ranges, strict=True)],
        "layers": layers,
        "landmarks": marks is not None,
    }


def _layer(label: str, kind: str, lines: list[Any]) -> dict[str, Any]:
    return {"label": label, "kind": kind, "lines": lines}


def _pixels(pose: CameraPose, xy: np.ndarray) -> list[list[float]]:
    pixels: list[list[float]] = np.round(specimen_to_pixel(pose, xy)[:, ::-1], 2).tolist()
    return pixels


def _mesh_edges(records: Records, study: Study | None, specimen: Specimen) -> list[np.ndarray] | None:
    """Edges (2, 2) mm of the elements on the face that the camera sees, with their mirror images; None where the mesh is not known."""
    if "mesh" in records and records["mesh"].has("hexes"):
        nodes, hexes, face = (records["mesh"][n].value for n in ("nodes", "hexes", "node_sets/face"))
    elif study is not None:
        try:
            # Several experiments have the geometry of the study, each with the lengths of its own specimen.
            mesh = specimen_mesh(study.geometry, specimen, study.mesh_size, study.mesh_file)
        except ThermofitError:
            return None
        nodes, hexes, face = mesh.nodes, mesh.hexes, mesh.node_sets["face"]
    else:
        return None
    facets = boundary_facets(hexes)
    facets = facets[np.isin(facets, face).all(axis=1)]
    edges = np.unique(np.sort(np.stack([facets, np.roll(facets, 1, axis=1)], axis=-1).reshape(-1, 2), axis=1), axis=0)
    lines = nodes[edges][:, :, :2]
    half = bool(nodes[:, 0].min() > -1e-6)
    return [*lines, *(lines * np.array([-1.0, 1.0]) if half else ())]


def _dic_points(data: Record | None) -> np.ndarray | None:
    """Points (n, 2) mm of the image correlation in the unloaded specimen; None where the raw folder is gone, or too large to be read."""
    folder = Path(str(data.attributes["input_paths"].get("experiment", ""))) if data is not None else Path()
    if folder == Path() or not folder.is_dir():
        return None
    try:
        if sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) > _RAW:
            return None
        dic = read_experiment(folder, ("dic",)).dic
    except (ThermofitError, OSError):
        return None
    return None if dic is None else np.asarray(dic.reference[:, :2])


_NONE = -32768
_MOST = 32767


def packed(values: np.ndarray) -> dict[str, Any]:
    """{"shape", "offset", "step", "data"}: values (any shape) to 1/65534 of their range; value = offset + step * integer."""
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    offset, step = 0.5 * (low + high), max(high - low, 1e-300) / (2 * _MOST)
    integers = np.full(values.shape, _NONE, dtype="<i2")
    integers[known] = np.rint((values[known] - offset) / step)
    return {"shape": list(values.shape), "offset": offset, "step": step, "data": base64.b64encode(integers.tobytes()).decode("ascii")}


def unpacked(what: dict[str, Any]) -> np.ndarray:
    """The values of `packed`."""
    integers = np.frombuffer(base64.b64decode(what["data"]), dtype="<i2").reshape(what["shape"])
    return np.asarray(np.where(integers == _NONE, np.nan, what["offset"] + what["step"] * integers.astype(float)))


def levels(picture: np.ndarray, low: float, high: float) -> str:
    """A picture (n_row, n_col) in 255 levels between two values, as base64 of bytes; 0 is not a number."""
    share = (np.asarray(picture, dtype=float) - low) / max(high - low, 1e-300)
    grey = np.where(np.isfinite(share), 1.0 + np.rint(254.0 * np.clip(np.nan_to_num(share), 0.0, 1.0)), 0.0).astype(np.uint8)
    return base64.b64encode(grey.tobytes()).decode("ascii")
