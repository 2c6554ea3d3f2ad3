"""`identify-elastic`: E and nu from the displacements of the elastic range (thesis 5.1.1, step 1)."""

from __future__ import annotations

import numpy as np

from thermofit.experiment.protocol import FieldTest
from thermofit.experiment.window import window_times
from thermofit.identify.solve import Solved
from thermofit.identify.stage import StageKind, identify
from thermofit.law.page import along_tension, in_model_axes
from thermofit.records.staging import Outcome
from thermofit.study.study import Study


def _remarks(test: FieldTest, solved: Solved) -> tuple[str, ...]:
    """Does the window stay below the yield limit that the study starts from, and below the knee of the measured force?"""
    study, data = test.study, test.data
    _, t1, _ = window_times(study.stages.elastic.window, data, data.steps["displacement"])
    steps = data.steps["displacement"].until(t1)
    stress = float(np.max(np.abs(steps.force))) / (data.specimen.gauge_width * data.specimen.thickness)
    p = in_model_axes(solved.parameters, study.material_axes.angle, study.slots)
    limit = p["M_y0"] / along_tension(p, study.slots)[0]
    knee = next((phase.t1 for phase in data.phases if phase.label == "elastic"), t1)
    out = []
    if "M_y0" in study.parameters and stress > limit:
        out.append(f"elastic window holds {stress:.0f} MPa, above the start's yield limit {limit:.0f} MPa; shorten stages.elastic.window")
    if t1 > knee + 1e-9:
        bend = f"elastic window ends at {t1:.2f} s, after the force bends at {knee:.2f} s"
        out.append(f"{bend}: it holds plastic points; shorten stages.elastic.window")
    return tuple(out)


KIND = StageKind("identify-elastic", "elastic", _remarks)
NAME = KIND.name


def run(study: Study, *, force: bool = False) -> Outcome:
    """Record of the elastic stage."""
    return identify(study, KIND, force=force)
