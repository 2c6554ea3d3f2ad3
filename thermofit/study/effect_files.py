"""Effects that a study names: the files of its key `effects`, and Params called <effect>.<param>; known before the study is validated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from thermofit.core.digest import use_effect_files
from thermofit.core.errors import StudyError
from thermofit.study.paths import path_from

Check = Callable[[Sequence[Path]], None]
"""Raises StudyError where an effect file does not do what its slot asks."""


def declare_effects(tree: dict[str, Any], source: Path, check: Check | None = None) -> None:
    """Make the effects known that a study tree speaks of, and `check` those of the user; a study without any costs nothing.

    Files of a user are compiled into the kernels: they are named before these are loaded. StudyError for a file that is not there, and
    where kernels without it are loaded already.
    """
    files = _files(tree, source)
    if files and not use_effect_files(files):
        raise StudyError(f"{source}: key 'effects': the kernels are loaded already without these files; start a new process for it")
    if files or "." in "".join(_names(tree)):
        import thermofit.effects.catalogue  # noqa: F401  (it declares the Params of all effects, and loads numba)
    if files and check is not None:
        check(files)


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
