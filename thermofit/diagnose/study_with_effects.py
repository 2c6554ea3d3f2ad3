"""The study that the loop ends with: the same file with every identified value as start, and the accepted effects switched on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from thermofit.core.errors import StudyError
from thermofit.core.files import replacing
from thermofit.core.parameters import AT, param
from thermofit.core.yaml_text import parse_yaml
from thermofit.diagnose.loop import Closed
from thermofit.effects.catalogue import effect
from thermofit.experiment.several import own_names
from thermofit.study.study import Study, set_key

_FILES = (("experiment",), ("effects",), ("experiments", "*", "experiment"), ("geometry", "file"), ("necking", "file"))
_RECORDS = (
    ("coupon", "records", "*", "file"),
    ("coupon", "series", "*", "files"),
    *(
        ("coupon", kind, "*", channel, "file")
        for kind in ("records", "series")
        for channel in ("strain", "stress", "temperature", "lateral")
    ),
)
"""Keys that name files relative to the study."""


def study_text(study: Study, closed: Closed) -> str:
    """YAML of the study; an effect's Params stand fixed at what was found, so that every stage and `verify` run with it."""
    tree: dict[str, Any] = parse_yaml(study.source.read_text(encoding="utf-8"), str(study.source), StudyError)
    for text in study.overrides:
        set_key(tree, text)
    tree["name"] = f"{study.name}-with-effects"
    tree["run_dir"] = str(study.run_dir / "with-effects")
    for key in (*_FILES, *_RECORDS):
        _absolute(tree, key, study.source.parent)
    parameters = dict(tree.get("parameters") or {})
    found = closed.last.case.parameters
    # Exponents that were held are not free, and yet not those that the effect has by itself.
    held = (name for added in closed.accepted for name in effect(added).names if found[name] != param(name).neutral)
    # A hardening law that is held beside a curve is identified by the study, and stands elsewhere than where the study starts.
    identified = (name for name, given in parameters.items() if isinstance(given, dict))
    for name in dict.fromkeys((*found.free, *held, *identified)):
        value = float(found[name])
        if isinstance(parameters.get(name), dict):
            parameters[name] = {**parameters[name], "start": value}
        else:
            parameters[name] = value
    tree["parameters"] = parameters
    _predicted_without(tree, study, closed)
    lines = [f"# Made by close-loop from {study.source.name}. Effects added: {', '.join(closed.accepted) or 'none'}."]
    lines += [f"#   {name}: {effect(name).formula} ({effect(name).source})" for name in closed.accepted]
    return "\n".join(lines) + "\n" + yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)


def _absolute(tree: Any, key: tuple[str, ...], folder: Path) -> None:
    """Make the paths under a key (* for every entry) absolute; those with variables or ~ mean the same from anywhere."""
    first, rest = key[0], key[1:]
    entries = list(tree) if isinstance(tree, dict) else list(range(len(tree))) if isinstance(tree, list) else []
    for entry in entries if first == "*" else [e for e in entries if e == first]:
        value = tree[entry]
        if rest:
            _absolute(value, rest, folder)
        elif isinstance(value, list):
            tree[entry] = [_from(folder, text) for text in value]
        elif isinstance(value, str):
            tree[entry] = _from(folder, value)


def _from(folder: Path, text: str) -> str:
    return text if text.startswith(("~", "${")) else str(folder.absolute() / text)


def _predicted_without(tree: dict[str, Any], study: Study, closed: Closed) -> None:
    """Held-out tests without the effects of boundary and instruments that the loop added: it has predicted them so."""
    if not study.held_out:
        return
    own = own_names(study)
    added = [p for name in closed.accepted if AT not in name for p in effect(name).names if p in own]
    for held in study.held_out if added else ():
        given = tree["experiments"][held].setdefault("parameters", {})
        for name in added:
            given.setdefault(name, param(name).neutral)


def write_study(study: Study, closed: Closed, path: Path) -> None:
    """Write the study beside the records."""
    with replacing(path, durable=False) as temporary:
        temporary.write_text(study_text(study, closed), encoding="utf-8")
