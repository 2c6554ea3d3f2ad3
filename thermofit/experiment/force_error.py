"""What the error of the smoothed force does to displacements and temperatures, and that of a prescribed elongation to force and
temperatures: noise of what is prescribed, no misfit of the model.

Where the material flows, a force that is wrong by dF moves the points by (du/dF) dF. Near the largest force the specimen is so soft that
half a newton makes more than the noise of the cameras, and the plastic work that goes with it warms it. The error is a sum of modes of unit
variance (`SmoothForce.error_modes`); the coupled run is differentiated along each of them, so that flow, heat and its conduction are those
of the model. On one layer of elements over half the thickness: there are fifty modes or more, each of them a direction of the run. What
they do to a specimen of 1.2 mm is that on two layers within 0.02 %, to one as if of 8 mm within 0.6 % (`scripts/layers.py`).

Where the motion of sections drives, every stage has noise of its own. Where the specimen is elastic a micrometre is tens of newtons, and
plasticity rectifies it: the largest value of a hold makes it flow, and all that follow are too small; what is wrong where it turns is wrong
until it flows again. So the force at one stage hangs together with that at others, as the run along these modes has it. So do the
temperatures: the stress cools what it stretches, by up to 2 mK for 0.75 um over 46 mm of aluminium, at all points of a frame alike. The
force tells these errors better than the sections where the specimen is elastic, and temperatures are told what it says. Displacements are
measured themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, load_modes
from thermofit.experiment.channels import field_of
from thermofit.experiment.joint import ForceModes, Joint
from thermofit.study.section import MeshSize

SHOWN = {"force": ("u", "theta"), "dic": ("force", "theta")}
"""Fields in which the error of what is prescribed is noise, by what drives."""
_TELLS = 1e-3
"""Part of the largest mode's effect below which a mode is left out."""


def estimated_error(joint: Joint, parameters: Parameters) -> np.ndarray | None:
    """Error of the prescribed force at all load steps, N (n_steps,), as all channels together tell it: the mean of its modes, given the
    residual. None where it is not known. NumericsError where the run fails."""
    whole = joint.data.steps["all"].error
    if joint.force_error is None or whole is None or joint.study.force.drives != "force":
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


def on_one_layer(size: MeshSize, slopes_on: Callable[[MeshSize], Mapping[str, np.ndarray]]) -> Mapping[str, np.ndarray]:
    """What modes of the force make of fields, on one layer of elements; on those of the mesh, which tell it as well, where one layer does
    not carry the force. NumericsError where these do not either."""
    layer = size.with_counts({"n_z": 1})
    try:
        return slopes_on(layer)
    except NumericsError:
        if layer == size:
            raise
        return slopes_on(size)


def along_modes(joint: Joint, parameters: Parameters) -> Mapping[str, np.ndarray]:
    """Derivatives (n_t, n_s, n_c, k) of every observed field by the k modes of the error of what is prescribed, which has to be known.
    NumericsError where the run of the parameters fails."""
    error = joint.steps.error
    assert error is not None, "the error of what is prescribed is known"
    names = load_modes(error.shape[1])
    return on_one_layer(joint.size, lambda size: replace(joint, size=size).prediction.linearise(parameters, names)[1])


def with_force_error(joint: Joint, parameters: Parameters) -> Joint:
    """The joint problem that takes the error of its prescribed force, or elongation, for noise; unchanged where that is not known.
    NumericsError where the run of the parameters fails."""
    shown = SHOWN.get(joint.study.force.drives, ())
    if joint.steps.error is None or not shown:
        return joint
    slopes = along_modes(joint, parameters)
    found = {name: _telling(slopes[name]) for name in shown if name in slopes}
    return replace(joint, force_error=found) if found else joint
