"""What a stage reads of its study: the key by which its record is fresh.

A key holds what the result depends on, and nothing else: of the parameters that a stage frees start, bounds and scale, of all others the
value alone; of several experiments those that are fitted; never the number of threads, on which no result depends (measured: bit-equal).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from thermofit.core.parameters import AT, bare_name
from thermofit.records.artefact import Record
from thermofit.study.models import bounds_of, start_of
from thermofit.study.reading import reading
from thermofit.study.section import ParameterStart
from thermofit.study.study import Study

SOLVED = (
    *(
        "model",
        "hardening",
        "yield_surface",
        "material_axes",
        "mesh",
        "geometry",
        "static",
        "parameters",
        "evaluation",
        "force",
        "numerics",
        "coupon",
    ),
    *("diagnosis.priors", "uncertainty"),
)
"""Sections that whatever runs the model reads."""
BESIDES = {"plastic": ("stages.elastic.window",)}
"""What an identification stage reads besides its own section: was any point plastic within the elastic window?"""
TOLD_AGAIN = {"lateral": ("nu",)}
"""Parameters of the stage before that a stage which compares a channel may fit again (`Experiment.earlier_estimates`), by channel."""

_THREADS = "threads"
_ALONE = "parameters."
"""Before the name of one parameter that is read where the study prescribes it."""


def read_of(study: Study, *keys: str, free: Collection[str] | None = None) -> dict[str, Any]:
    """The named sections ('mesh', 'stages.elastic') with defaults filled in, ready for JSON, without the number of threads.

    `free`: names of the parameters that the stage frees; None: it may free any, and reads the bounds of all.
    """
    with reading(None):  # a key may be asked for while a record is made by another
        return _read_of(study, keys, free)


def _read_of(study: Study, keys: Collection[str], free: Collection[str] | None) -> dict[str, Any]:
    """`read_of`, whatever may be read."""
    config = study.config_of(*(key for key in keys if not key.startswith(_ALONE)))
    for key in (key for key in keys if key.startswith(_ALONE)):
        setting = study.parameters.get(key.removeprefix(_ALONE))
        config[key] = setting if isinstance(setting, float) else None
    if "numerics" in config:
        config["numerics"] = {key: value for key, value in config["numerics"].items() if key != _THREADS}
    if free is None:
        return config
    if "parameters" in config:
        config["parameters"] = _read(study.parameters, free)
    if "experiments" in config:
        config["experiments"] = {name: _own(study, name, config["experiments"][name], free) for name in study.fitted}
    return config


def key_of(study: Study, stage: str) -> dict[str, Any]:
    """The key of a stage of the chain by its command: `interpolate`, `identify-...`, `refine` or `verify`.

    StudyError where a parameter that the stage frees has no start.
    """
    if stage == "interpolate":
        with reading(None):
            return read_of(study, *study.measured_in, free=())
    if stage == "verify":
        return read_of(study, *SOLVED, "literature", *(("experiments", "shared") if study.fitted else ()), free=())
    if stage == "refine":
        return read_of(
            study, *SOLVED, "stages.plastic", "diagnosis.channels", "diagnosis.mesh", *(("experiments", "shared") if study.fitted else ())
        )
    return stage_key(study, stage.removeprefix("identify-"))


def stage_key(study: Study, key: str) -> dict[str, Any]:
    """The key of the identification stage of that name under `stages`. StudyError where a free parameter has no start."""
    several = ("experiments", "shared") if study.fitted else ()
    with reading(None):
        stage = study.stage(key)
        free = (*stage.free, *(name for channel in stage.channels for name in TOLD_AGAIN.get(channel, ())))
        return read_of(study, *SOLVED, *several, f"stages.{key}", *BESIDES.get(key, ()), free=free)


def differences(config: Mapping[str, Any], now: Mapping[str, Any], lead: str = "") -> tuple[str, ...]:
    """Dotted keys at which two configurations differ; keys that only one of them has at all are another version's and no difference."""
    found: list[str] = []
    for key in [key for key in now if key in config] if not lead else sorted({*config, *now}):
        before, after = config.get(key), now.get(key)
        if before == after:
            continue
        if isinstance(before, Mapping) and isinstance(after, Mapping):
            found += differences(before, after, f"{lead}{key}.")
        else:
            found.append(f"{lead}{key}")
    return tuple(found)


def drifted(study: Study, records: Mapping[str, Record]) -> tuple[str, ...]:
    """Which settings of the study differ from those by which its artefacts, by stage, were made, in words; empty where none do."""
    found = []
    for stage, record in records.items():
        if keys := differences(record.config, key_of(study, stage)):
            found.append(f"{record.path.name} was made with other settings: {', '.join(keys)}")
    return tuple(found)


def _own(study: Study, name: str, section: Mapping[str, Any], free: Collection[str]) -> dict[str, Any]:
    """What is read of one of several experiments."""
    freed = {bare_name(n) for n in free if n.partition(AT)[2] in ("", name)}
    return {**section, "parameters": _read(study.experiments[name].parameters, freed)}


def _read(settings: Mapping[str, float | ParameterStart], free: Collection[str]) -> dict[str, Any]:
    """Of a freed parameter start, bounds and scale, of any other the value."""
    freed = {*free, *(bare_name(name) for name in free)}
    out: dict[str, Any] = {}
    for name, setting in settings.items():
        value = start_of(setting)
        if name in freed or bare_name(name) in free:
            scale = setting.scale if isinstance(setting, ParameterStart) else None
            given = "start" if isinstance(setting, ParameterStart) else "value"  # of coupons a plain number is prescribed
            out[name] = {given: value, "bounds": list(bounds_of(name, setting)), "scale": scale}
        else:
            out[name] = value
    return out
