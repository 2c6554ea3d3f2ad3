"""The error of the mesh in what a run shows, by Richardson's extrapolation, and the data with that error in them.

On elements of size h a prediction is p_h = p_0 + C h^2 + o(h^2), so that a mesh finer by r tells its error:
p_h - p_0 = (p_h - p_(h/r)) / (1 - 1/r^2). It hardly depends on the parameters. A coarse model is therefore compared with the data plus
this error (a deferred correction, Stetter 1978, Numerische Mathematik 29, 425-443): it fits and is judged as the extrapolated one would
be, at the cost of the coarse one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters
from thermofit.core.study_section import MeshSize
from thermofit.fem.history import History
from thermofit.identify.force_error import with_force_error
from thermofit.identify.inputs import temperature_of
from thermofit.identify.joint import Joint
from thermofit.identify.prediction import Errors
from thermofit.measure.observation import FieldObservation

FINER = 1.5
"""Refinement r of the mesh that tells the error."""
REMAINS = 0.5
"""Part of the error that is not trusted to be gone: an order between 1 and infinity in place of 2 would leave or overdo about as much."""


@dataclass(frozen=True)
class Discretised:
    """A joint problem whose data hold the error of its mesh, that part of the error in the residual (n,) that may be left, and the run
    that told it, with its points."""

    joint: Joint
    left: np.ndarray
    history: History

    @property
    def largest_strain(self) -> float:
        """Largest Lambda of the run."""
        return max(float(p.accumulated.max()) for p in self.history.points)


def finer_mesh(size: MeshSize) -> MeshSize:
    """The mesh with FINER times as many elements along each axis, rounded up, along the load to an even number as dogbones need it."""
    n_x, n_z = (int(np.ceil(FINER * n)) for n in (size.n_x, size.n_z))
    return MeshSize(n_x=n_x, n_y=2 * int(np.ceil(0.5 * FINER * size.n_y)), n_z=n_z)


def discretised(joint: Joint, parameters: Parameters) -> Discretised:
    """The joint problem corrected by the error of its mesh at given parameters. NumericsError where a run fails."""
    history, coarse = joint.shown(parameters)
    fine = replace(joint, size=finer_mesh(joint.size)).shown(parameters)[1]
    error: Errors = {name: (coarse[name] - fine[name]) / (1.0 - FINER**-2) for name in coarse}
    data = joint.data

    def seen(observation: FieldObservation) -> FieldObservation:
        return replace(observation, value=observation.value + error[observation.name])

    with_error = replace(data, displacement=seen(data.displacement))
    if "theta" in error:
        with_error = replace(with_error, temperature=seen(temperature_of(data)))
    if "force" in error:
        with_error = replace(with_error, force=seen(data.force))
    model = joint.model
    left = model.assemble(coarse) - model.assemble({name: coarse[name] - REMAINS * error[name] for name in coarse})
    return Discretised(replace(joint, data=with_error), np.append(left, np.zeros(len(model.priors))), history)


def corrected(joint: Joint, parameters: Parameters) -> Discretised:
    """The joint problem that knows the errors of its mesh and of its prescribed force at given parameters; errors as `discretised`."""
    found = discretised(joint, parameters)
    return replace(found, joint=with_force_error(found.joint, found.history, parameters))
