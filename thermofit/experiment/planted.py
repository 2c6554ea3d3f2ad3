"""An effect planted into measured fields: what a model predicts with it less what it predicts without it is added to the data.

The fields keep their noise, and all else that they hold and no model knows. Both runs are made on the same mesh with the same steps, so
that of the error of these the difference holds only the part that is due to the effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import LoadSteps, Measured
from thermofit.experiment.forward import nodal_gauge
from thermofit.experiment.joint import Joint, diagnosis_mesh
from thermofit.observe.observation import FieldObservation
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study


def planted(study: Study, data: Measured, settings: StageSettings, before: Parameters, after: Parameters) -> Measured:
    """Measured fields with the difference of two predictions added: displacements mm, temperatures K, the force N where it does not drive
    the model, and the elongation mm of the sections where it does. NumericsError where a run fails."""
    joint = Joint(study, data, settings, diagnosis_mesh(study))
    new, old = (joint.run(parameters) for parameters in (after, before))
    shown = [joint.prediction.of(history, parameters) for history, parameters in ((new, after), (old, before))]

    def changed(observation: FieldObservation) -> FieldObservation:
        return replace(observation, value=observation.value + (shown[0][observation.name] - shown[1][observation.name]))

    out = replace(data, displacement=changed(data.displacement))
    if data.temperature is not None:
        out = replace(out, temperature=changed(data.temperature))
    if "force" in shown[0]:
        out = replace(out, force=changed(data.force))
    return _stretched(out, joint, new, old) if study.force.drives == "force" else out


def _stretched(data: Measured, joint: Joint, new: History, old: History) -> Measured:
    """The data with the elongation that DIC saw changed as two runs under the same force say: should the sections drive the model later."""
    mesh = joint.run.body.mesh
    if data.gauge is not None:
        weights = nodal_gauge(mesh, data.gauge)
    else:
        y = mesh.nodes[:, 1]
        ends = [np.isclose(y, end).astype(float) for end in (y.max(), y.min())]
        weights = ends[0] / ends[0].sum() - ends[1] / ends[1].sum()
    longer = (new.u[:, :, 1] - old.u[:, :, 1]) @ weights
    longer -= longer[0]

    def at(time: np.ndarray) -> np.ndarray:
        return np.interp(time, new.time, longer)

    def stepped(steps: LoadSteps) -> LoadSteps:
        return steps if steps.elongation is None else replace(steps, elongation=steps.elongation + at(steps.time))

    seen = data.stretched
    moved = None if seen is None else replace(seen, elongation=seen.elongation + at(seen.time))
    return replace(data, stretched=moved, steps={name: stepped(steps) for name, steps in data.steps.items()})
