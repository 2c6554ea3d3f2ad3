"""Effects that a study names: the files of its key `effects`, and Params called <effect>.<param>; known before the study is validated."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

from thermofit.core.digest import EFFECTS_VARIABLE
from thermofit.core.errors import StudyError
from thermofit.study.paths import path_from

CATALOGUE = "thermofit.effects.catalogue"
"""The module that declares the Params of all effects when it is imported."""
_COMPILED = "thermofit.law.composition"
_CHECK = "thermofit.identify.user_effects"


def declare_effects(tree: dict[str, Any], source: Path) -> None:
    """Make the effects known that a study tree speaks of; a study without any costs nothing.

    Files of a user are compiled into the kernels: they are named by the environment before these are loaded. StudyError for a file that
    is not there or does not do what its slot asks, and where kernels without it are loaded already.
    """
    files = _files(tree, source)
    if files:
        given = os.pathsep.join(str(path) for path in files)
        if os.environ.get(EFFECTS_VARIABLE, "") != given:
            if _COMPILED in sys.modules:
                raise StudyError(f"{source}: key 'effects': the kernels are loaded already without these files; start a new process for it")
            os.environ[EFFECTS_VARIABLE] = given
    if files or "." in "".join(_names(tree)):
        importlib.import_module(CATALOGUE)
    if files:
        importlib.import_module(_CHECK).check_effects(files)


def _files(tree: dict[str, Any], source: Path) -> list[Path]:
    value = tree.get("effects") or []
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise StudyError(f"{source}: key 'effects' is {value!r}; expected a list of effect files, [my_effect.py]")
    paths = []
    for name in value:
        path = path_from(source.parent, name, f"{source}: key 'effects'").resolve()
        if not path.is_file():
            raise StudyError(f"{source}: key 'effects': no file {path} found; put it there or correct the path")
        paths.append(path)
    return paths


def _names(tree: dict[str, Any]) -> list[str]:
    """Names of parameters that the tree mentions."""
    parameters, out = tree.get("parameters"), []
    if isinstance(parameters, dict):
        out += [str(name) for name in parameters]
    for key in ("stages", "diagnosis", "gridsearch", "sensitivity", "simulate", "experiments", "shared", "compare", "literature"):
        out += _texts(tree.get(key))
    return [name for name in out if "/" not in name and not name.replace(".", "").isdigit()]


def _texts(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [str(k) for k in value] + [t for v in value.values() for t in _texts(v)]
    if isinstance(value, list):
        return [t for v in value for t in _texts(v)]
    return [value] if isinstance(value, str) else []
