"""How two results differ, in words and numbers: parameters in their standard errors, errors of channels, settings, data, programmes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.jsonable import jsonable
from thermofit.records.artefact import ParameterResult, Record, layout, open_record
from thermofit.records.key import differences as other_settings

LARGE = 3.0
"""Combined standard errors from which a parameter is said to differ."""
_SAME = 1e-9
"""Relative difference up to which two numbers are called equal."""
_LITTLE = 0.01
"""Relative change of an error from which it is worth a word."""
Tree = dict[str, Any]


def compared(first: Path, second: Path) -> Tree:
    """The differences of two artefacts, or of all stages that two run folders share: `stages` by name, `verdict` in words.

    StudyError where one is a folder and the other is not, or where nothing can be compared.
    """
    if first.is_dir() != second.is_dir():
        raise StudyError(f"'{first}' and '{second}': expected two artefacts or two run folders, found one of each")
    pairs = _pairs(first, second) if first.is_dir() else {"": (open_record(first), open_record(second))}
    stages = {name or a.stage: differences(a, b) for name, (a, b) in pairs.items()}
    told = [f"{stage}: {text}" for stage, found in stages.items() for text in found["words"][:1] if not found["same"]]
    verdict = "; ".join(told) if told else f"no difference in {', '.join(stages)}"
    alone: Tree = {} if not first.is_dir() else {"only_in_first": _only(first, second), "only_in_second": _only(second, first)}
    result: Tree = jsonable({"stage": "diff", "verdict": verdict, "first": str(first), "second": str(second), "stages": stages, **alone})
    return result


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.h5"))


def _only(folder: Path, other: Path) -> list[str]:
    return [name for name in _names(folder) if not (other / name).exists()]


def _pairs(first: Path, second: Path) -> dict[str, tuple[Record, Record]]:
    shared = [name for name in _names(first) if (second / name).exists()]
    if not shared:
        raise StudyError(f"'{first}' and '{second}' have no artefact in common; expected two run folders of the same chain")
    return {Path(name).stem: (open_record(first / name), open_record(second / name)) for name in shared}


def differences(first: Record, second: Record) -> Tree:
    """What differs between two artefacts; `words` in sentences, the largest first, `same` where nothing does but when they were made."""
    parameters = _parameters(first.parameters, second.parameters)
    channels = _channels(first.summary.get("channels") or {}, second.summary.get("channels") or {})
    settings = list(other_settings(first.config, second.config))
    data = sorted(name for name in {*first.inputs, *second.inputs} if first.inputs.get(name) != second.inputs.get(name))
    datasets = _datasets(first, second)
    words = [*_stage_words(first, second), *_parameter_words(parameters), *_channel_words(channels)]
    words += [f"settings differ: {', '.join(settings)}"] if settings else []
    words += [f"made from other inputs: {', '.join(data)}"] if data else []
    words += _programme_words(first, second)
    words += [f"dataset {name}: {text}" for name, text in datasets.items()]
    same = not words
    return {
        "same": same,
        "words": words or ["nothing differs but when they were made"],
        "verdicts": [str(r.summary.get("verdict", "")) for r in (first, second)],
        "parameters": parameters,
        "channels": channels,
        "settings": settings,
        "inputs": data,
        "datasets": datasets,
    }


def _stage_words(first: Record, second: Record) -> list[str]:
    if first.stage != second.stage:
        return [f"they are of different stages, {first.stage} and {second.stage}"]
    trusted = [record.summary.get("trustworthy") is not False for record in (first, second)]
    if trusted[0] != trusted[1]:
        return ["only the first is trustworthy" if trusted[0] else "only the second is trustworthy"]
    return []


def _equal(a: float, b: float) -> bool:
    return a == b or abs(a - b) <= _SAME * max(abs(a), abs(b))


def _parameters(first: Mapping[str, ParameterResult], second: Mapping[str, ParameterResult]) -> list[Tree]:
    """A row for every parameter that differs in value, standard error or whether it was identified; z is the difference over the root of
    the sum of both variances, as if the two results were independent."""
    rows: list[Tree] = []
    for name in dict.fromkeys((*first, *second)):
        a, b = first.get(name), second.get(name)
        if a is None or b is None:
            held = a or b
            assert held is not None
            rows.append({"parameter": name, "unit": held.unit, "first": a and a.value, "second": b and b.value})
            continue
        sigmas = [p.sigma for p in (a, b) if p.sigma is not None]
        if _equal(a.value, b.value) and a.free == b.free and len({a.sigma, b.sigma}) == 1:
            continue
        size = math.sqrt(sum(s * s for s in sigmas)) if sigmas else 0.0
        rows.append(
            {
                "parameter": name,
                "unit": a.unit,
                "first": a.value,
                "second": b.value,
                "sigma_first": a.sigma,
                "sigma_second": b.sigma,
                "difference": b.value - a.value,
                "relative": b.value / a.value - 1.0 if a.value else None,
                "z": (b.value - a.value) / size if size else None,
                "free": [a.free, b.free],
            }
        )
    return rows


def _parameter_words(rows: list[Tree]) -> list[str]:
    told, little = [], []
    for row in sorted(rows, key=lambda r: -abs(r.get("z") or 0.0)):
        name, unit = row["parameter"], "" if row["unit"] == "1" else f" {row['unit']}"
        if row["first"] is None or row["second"] is None:
            told.append(f"{name} is only in the {'second' if row['first'] is None else 'first'}")
            continue
        values = f"{row['first']:.5g} to {row['second']:.5g}{unit}"
        if row["free"][0] != row["free"][1]:
            told.append(f"{name} was identified only in the {'first' if row['free'][0] else 'second'}: {values}")
        elif row["z"] is None:
            told.append(f"{name} differs, {values}; it has no standard error")
        elif abs(row["z"]) >= LARGE:
            told.append(f"{name} differs by {abs(row['z']):.1f} combined standard errors, {values}")
        elif not _equal(row["first"], row["second"]):
            little.append(f"{name} {row['z']:+.2f}")
    if little:
        told.append(f"within {LARGE:g} combined standard errors: {', '.join(little)}")
    return told


def _channels(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Tree]:
    rows = []
    for name in dict.fromkeys((*first, *second)):
        a, b = first.get(name, {}), second.get(name, {})
        if a != b:
            keys = ("rms", "floor_rms", "chi2_reduced", "n")
            unit = a.get("unit", b.get("unit", "1"))
            rows.append({"channel": name, "unit": unit, **{key: [a.get(key), b.get(key)] for key in keys}})
    return rows


def _channel_words(rows: list[Tree]) -> list[str]:
    told = []
    for row in rows:
        a, b = row["rms"]
        if a is None or b is None:
            told.append(f"channel {row['channel']} is only in the {'second' if a is None else 'first'}")
        elif a and abs(b / a - 1.0) >= _LITTLE:
            way = f"{'rises' if b > a else 'falls'} by {100.0 * abs(b / a - 1.0):.3g} %"
            told.append(f"error of {row['channel']} {way}, {a:.4g} to {b:.4g} {row['unit']}")
    return told


def _programme_words(first: Record, second: Record) -> list[str]:
    a, b = first.attributes, second.attributes
    told = []
    if a["thermofit_version"] != b["thermofit_version"]:
        told.append(f"made by thermofit {a['thermofit_version']} and {b['thermofit_version']}")
    elif a["source_digest"] != b["source_digest"]:
        told.append("made by other sources of thermofit or of effect files")
    packages = [
        f"{n} {a['packages'].get(n)} and {b['packages'].get(n)}" for n in a["packages"] if a["packages"].get(n) != b["packages"].get(n)
    ]
    return told + ([f"other packages: {', '.join(packages)}"] if packages else [])


_NOT_COMPARED = ("seconds",)
"""Last words of the names of datasets that differ from run to run."""


def _datasets(first: Record, second: Record) -> dict[str, str]:
    """In words, by name: missing, of another shape, or by how much the values differ at most."""
    found: dict[str, str] = {}
    a, b = layout(first), layout(second)
    for name in dict.fromkeys((*a, *b)):
        if name.rpartition("/")[2] in _NOT_COMPARED:
            continue
        if name not in a or name not in b:
            found[name] = f"only in the {'first' if name in a else 'second'}"
        elif a[name].shape != b[name].shape:
            shapes = [" x ".join(map(str, one[name].shape)) or "scalar" for one in (a, b)]
            found[name] = f"shape {shapes[0]} and {shapes[1]}"
        elif text := _values(first[name].value, second[name].value, a[name].unit):
            found[name] = text
    return found


def _values(a: np.ndarray, b: np.ndarray, unit: str) -> str:
    """The largest difference in words; empty where there is none to speak of."""
    if a.dtype.kind not in "iuf" or b.dtype.kind not in "iuf":
        count = int(np.sum(a != b))
        return f"{count} of {a.size} entries differ" if count else ""
    gone = np.isfinite(a) != np.isfinite(b)
    both = np.isfinite(a) & np.isfinite(b)
    largest = float(np.max(np.abs(np.where(both, b - a, 0.0)), initial=0.0))
    size = float(np.max(np.abs(np.where(both, a, 0.0)), initial=0.0))
    if largest <= _SAME * size and not gone.any():
        return ""
    told = f"differs by {largest:.3g}{'' if unit in ('1', 'mixed') else ' ' + unit} at most, of {size:.3g}"
    return told + (f"; {int(gone.sum())} values are missing in one" if gone.any() else "")
