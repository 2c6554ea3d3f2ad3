"""The small study that the reliability scripts disturb, and the command line as a user has it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

import tiny  # noqa: E402  (the study of the tests)


def small_study(folder: Path, **sections: Any) -> Path:
    """Study file on a virtual test of 24 elements, with its results in `folder`/run."""
    return tiny.write(folder, {**tiny.tree(folder / "run"), **sections})


def command(*words: str) -> list[str]:
    """A command of thermofit by the interpreter that runs this."""
    return [sys.executable, "-c", "from thermofit.cli import main; main()", *words]


def environment() -> dict[str, str]:
    """That of this process, with this tree first on the path."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def written(path: Path, tree: dict[str, Any]) -> Path:
    """A study file of a tree of keys."""
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return path
