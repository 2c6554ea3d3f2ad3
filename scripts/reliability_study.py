"""The small study that the reliability scripts disturb, and the command line as a user has it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

import fuzz  # noqa: E402  (damage to files)
import tiny  # noqa: E402  (the study of the tests)

__all__ = ["ROOT", "command", "environment", "fuzz", "small_study", "tiny"]


def small_study(folder: Path, **sections: Any) -> Path:
    """Study file on a virtual test of 24 elements, with its results in `folder`/run."""
    return tiny.write(folder, {**tiny.tree(folder / "run"), **sections})


def command(*words: str) -> list[str]:
    """A command of thermofit by the interpreter that runs this."""
    return [sys.executable, "-c", "from thermofit.cli import main; main()", *words]


def environment() -> dict[str, str]:
    """That of this process, with this tree first on the path."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}
