"""The error of the mesh in what a run shows, by Richardson's extrapolation, and the data with that error in them.

On elements of size h a prediction is p_h = p_0 + C h^2 + o(h^2), so that a mesh finer by r tells its error:
p_h - p_0 = (p_h - p_(h/r)) / (1 - 1/r^2). It hardly depends on the parameters. A coarse model is therefore compared with the data plus
this error (a deferred correction, Stetter 1978, Numerische Mathematik 29, 425-443): it fits and is judged as the extrapolated one would
be, at the cost of the coarse one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import Measured, temperature_of
from thermofit.experiment.force_error import with_force_error
from thermofit.experiment.joint import Joint
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.fit.linear_model import LinearModel
from thermofit.observe.observation import FieldObservation
from thermofit.study.section import MeshSize

FINER = 1.5
"""Refinement r of the mesh that tells the error."""
REMAINS = 0.5
"""Part of the error that is not trusted to be gone: an order between 1 and infinity in place of 2 would leave or overdo about as much."""


_PLAIN = 3.0
"""Length of the error in the residual, in units of the noise, below which the data cannot say whether they hold it."""


@dataclass(frozen=True)
class Discretised:
    """A joint problem whose data hold the error of its mesh, that part of the error in the residual (n,) that may be left, the same where
    the force is taken as exact, the share of it that the data show (0 to 1), and the run that told it, with its points."""

    joint: Joint
    left: np.ndarray
    left_exact: np.ndarray
    share: float
    history: History

    @property
    def largest_strain(self) -> float:
        """Largest Lambda of the run."""
        return max(float(p.accumulated.max()) for p in self.history.points)


def finer_mesh(size: MeshSize) -> MeshSize:
    """The mesh with FINER times as many elements along each axis, rounded up, along the load to an even number as dogbones need it."""
    n_x, n_z = (int(np.ceil(FINER * n)) for n in (size.n_x, size.n_z))
    return MeshSize(n_x=n_x, n_y=2 * int(np.ceil(0.5 * FINER * size.n_y)), n_z=n_z)


def corrected(joint: Joint, parameters: Parameters) -> Discretised:
    """The joint problem that knows the errors of its mesh and of its prescribed force at given parameters. NumericsError where a run fails.

    Data of a specimen hold all of the mesh's error, those of a virtual test on the same mesh nothing of it: the share is the one that
    the residual shows beyond what the fitted parameters could take up.
    """
    history, coarse = joint.shown(parameters)
    joint = with_force_error(joint, history, parameters)
    fine = replace(joint, size=finer_mesh(joint.size)).shown(parameters)[1]
    error: Errors = {name: (coarse[name] - fine[name]) / (1.0 - FINER**-2) for name in coarse}
    exact = joint.without_force_error().model

    def told(model: StageModel) -> np.ndarray:
        rows = model.assemble(coarse) - model.assemble({name: coarse[name] - error[name] for name in coarse})
        return np.append(rows, np.zeros(len(model.priors)))

    share = _share(told(joint.model), *joint.model.linearised(parameters, parameters.free or joint.settings.free))
    holding = replace(joint, data=_holding(joint.data, error, share))
    return Discretised(holding, REMAINS * told(joint.model), REMAINS * told(exact), share, history)


def _share(told: np.ndarray, residual: np.ndarray, fitted: np.ndarray) -> float:
    """Share of an error (n,) that a residual (n,) shows beyond the columns (n, p) of the fitted parameters, 0 to 1."""
    own = LinearModel(told, fitted).left
    length = float(own @ own)
    return 1.0 if length <= _PLAIN**2 else float(np.clip(own @ residual / length, 0.0, 1.0))


def _holding(data: Measured, error: Errors, share: float) -> Measured:
    """Data with a share of the error of a mesh in them."""

    def seen(observation: FieldObservation) -> FieldObservation:
        return replace(observation, value=observation.value + share * error[observation.name])

    held = replace(data, displacement=seen(data.displacement))
    if "theta" in error:
        held = replace(held, temperature=seen(temperature_of(data)))
    return replace(held, force=seen(data.force)) if "force" in error else held
