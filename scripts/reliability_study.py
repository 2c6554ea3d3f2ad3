"""The small study that the reliability scripts disturb, and the command line as a user has it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

import fuzz  # noqa: E402  (damage to files)
import pulled  # noqa: E402  (the coupon of the tests)
import tiny  # noqa: E402  (the study of the tests)

__all__ = ["ROOT", "command", "coupon_study", "environment", "fuzz", "small_study", "tiny"]


def small_study(folder: Path, **sections: Any) -> Path:
    """Study file on a virtual test of 24 elements, with its results in `folder`/run."""
    return tiny.write(folder, {**tiny.tree(folder / "run"), **sections})


def coupon_study(folder: Path) -> Path:
    """Study file on a virtual coupon whose model has no thermal expansion, with its results in `folder`/run."""
    return pulled.pulled_study(folder, (*pulled.HEAT, "theta_air"), alpha_exp=0.0)


def command(*words: str) -> list[str]:
    """A command of thermofit by the interpreter that runs this."""
    return [sys.executable, "-c", "from thermofit.cli import main; main()", *words]


def environment() -> dict[str, str]:
    """That of this process, with this tree first on the path."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}
