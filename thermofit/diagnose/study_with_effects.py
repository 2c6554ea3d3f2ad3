"""The study that the loop ends with: the same file with every identified value as start, and the accepted effects switched on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from thermofit.core.study import Study
from thermofit.diagnose.loop import Closed
from thermofit.effects.catalogue import effect


def study_text(study: Study, closed: Closed) -> str:
    """YAML of the study; an effect's Params stand fixed at what was found, so that every stage and `verify` run with it."""
    tree: dict[str, Any] = yaml.safe_load(study.source.read_text(encoding="utf-8"))
    tree["name"] = f"{study.name}-with-effects"
    tree.pop("run_dir", None)
    if tree.get("experiment"):
        tree["experiment"] = str(study.experiment)
    parameters = dict(tree.get("parameters") or {})
    found = closed.last.case.parameters
    for name in found.free:
        value = float(found[name])
        if isinstance(parameters.get(name), dict):
            parameters[name] = {**parameters[name], "start": value}
        else:
            parameters[name] = value
    tree["parameters"] = parameters
    lines = [f"# Made by close-loop from {study.source.name}. Effects added: {', '.join(closed.accepted) or 'none'}."]
    lines += [f"#   {name}: {effect(name).formula} ({effect(name).source})" for name in closed.accepted]
    return "\n".join(lines) + "\n" + yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)


def write_study(study: Study, closed: Closed, path: Path) -> None:
    """Write the study beside the records."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(study_text(study, closed), encoding="utf-8")
