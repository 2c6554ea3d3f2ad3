"""Which stages an experiment needs before it can be compared with a model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from thermofit.study.study import Study

Stage = tuple[str, Callable[..., Any]]


def make_record(study: Study, stages: Sequence[Stage]) -> None:
    """Run the given stages of one experiment in their order: `simulate` where it is virtual, `calibrate-ir` where it has frames."""
    for name, run in stages:
        needed = {"simulate": study.virtual, "calibrate-ir": (study.experiment / "ir").is_dir()}
        if needed.get(name, True):
            run(study)
