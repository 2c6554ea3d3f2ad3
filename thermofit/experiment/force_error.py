"""What the error of the smoothed force does to displacements and temperatures: noise of what is prescribed, no misfit of the model.

Where the material flows, a force that is wrong by dF moves the points by (du/dF) dF. Near the largest force the specimen is so soft that
half a newton makes more than the noise of the cameras, and the plastic work that goes with it warms it. The error is a sum of modes of unit
variance (`SmoothForce.error_modes`); the coupled run is differentiated along each of them, so that flow, heat and its conduction are those
of the model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermofit.core.parameters import Parameters, load_modes
from thermofit.experiment.channels import field_of
from thermofit.experiment.joint import ForceModes, Joint

_TELLS = 1e-3
"""Part of the largest mode's effect below which a mode is left out."""


def estimated_error(joint: Joint, parameters: Parameters) -> np.ndarray | None:
    """Error of the prescribed force at all load steps, N (n_steps,), as all channels together tell it: the mean of its modes, given the
    residual. None where it is not known. NumericsError where the run fails."""
    whole = joint.data.steps["all"].error
    if joint.force_error is None or whole is None:
        return None
    model = joint.model
    errors = model.errors(parameters)
    parts = dict(enumerate(c.residual(errors[field_of(c)]) for c in model.comparisons))
    return np.asarray(sum(whole @ common.told(parts) for common in model.common))


def _telling(slopes: np.ndarray) -> ForceModes:
    """What modes make (n_t, n_s, n_c, k), turned so that the first tell most, without those that tell next to nothing."""
    columns = slopes.reshape(-1, slopes.shape[3])
    size, turned = np.linalg.eigh(columns.T @ columns)
    kept = turned[:, size > _TELLS**2 * max(float(size[-1]), np.finfo(float).tiny)][:, ::-1]
    return ForceModes(slopes @ kept, kept)


def with_force_error(joint: Joint, parameters: Parameters) -> Joint:
    """The joint problem that takes the error of its prescribed force for noise; unchanged where that is not known, or no force prescribed.
    NumericsError where the run of the parameters fails."""
    steps = joint.steps
    if steps.error is None or joint.study.force.drives != "force":
        return joint
    _, slopes = joint.prediction.linearise(parameters, load_modes(steps.error.shape[1]))
    return replace(joint, force_error={name: _telling(slopes[name]) for name in ("u", "theta") if name in slopes})
