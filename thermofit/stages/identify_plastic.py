"""`identify-plastic`: yield limit, hardening and Hill's F from the displacements (thesis 5.1.1, step 2)."""

from __future__ import annotations

import numpy as np

from thermofit.experiment.forward import march_settings, run_of
from thermofit.experiment.protocol import FieldTest
from thermofit.experiment.window import window_times
from thermofit.identify.solve import Solved
from thermofit.identify.stage import StageKind, identify
from thermofit.records.staging import Outcome
from thermofit.study.study import Study


def _remarks(test: FieldTest, solved: Solved) -> tuple[str, ...]:
    """With the identified yield limit: was any point plastic within the elastic window?"""
    study, data = test.study, test.data
    _, t1, _ = window_times(study.stages.elastic.window, data, data.steps["displacement"])
    run = run_of(study, data, study.mesh_size, data.steps["displacement"].until(t1), march_settings(study, "one-way"))
    history = run(solved.parameters)
    plastic = int(history.plastic_points[-1])
    if not plastic:
        return ()
    total = 8 * run.body.mesh.n_elements
    first = float(history.time[int(np.argmax(history.plastic_points > 0))])
    return (
        f"elastic window up to {t1:.2f} s holds {plastic} plastic of {total} points, the first at {first:.2f} s (largest multiplier "
        f"{history.largest_multiplier[-1]:.1e}); shorten stages.elastic.window",
    )


KIND = StageKind("identify-plastic", "plastic", _remarks)
NAME = KIND.name


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record of the plastic stage; needs that of `identify-elastic`."""
    return identify(study, KIND, force=force)
