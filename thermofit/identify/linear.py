"""One stage linearised where it is to be judged: at its optimum, or before any data at the assumed material of a planned test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from thermofit.core.parameters import Parameters, param
from thermofit.experiment.channels import field_of
from thermofit.experiment.joint import THERMOCOUPLE
from thermofit.experiment.model import StageModel
from thermofit.fit.covariance import Covariance, NoiseOperator
from thermofit.fit.evaluate import Evaluations
from thermofit.fit.information import Information, information
from thermofit.fit.jacobian import jacobian_at
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import ON_BOUND
from thermofit.fit.settings import Settings
from thermofit.identify.blocks import residual_blocks
from thermofit.identify.solve import DIFFERENCE_STEP, noise_of, stage_problem
from thermofit.records.checkpoint import Checkpoint
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

PRESCRIBED = ("theta_clamp", "theta_air")
"""Temperatures that a body's stage prescribes and a thermocouple reads."""
MOTION = "rigid-body motion"


@dataclass(frozen=True)
class Shift:
    """What an error of something prescribed does to the residual: `column` dr (n,), and in words of which error."""

    column: np.ndarray
    words: str


@dataclass(frozen=True)
class Linear:
    """A stage at parameters: residual (n,), dr/dx (n, n_p) of `names` at `x`, with bounds and sizes of a relative change.

    `before`: nothing is measured yet, the noise is the declared one and its variance is one. `shifts` by the name of what is prescribed.
    """

    model: StageModel
    base: Parameters
    names: tuple[str, ...]
    x: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    size: np.ndarray
    scale: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    before: bool
    shifts: Mapping[str, Shift] = field(default_factory=dict)

    @property
    def at_bound(self) -> np.ndarray:
        """True (n_p,) for parameters on a bound, which are held there. Before a test nothing is at a bound."""
        near = np.minimum(self.x - self.lower, self.upper - self.x) <= ON_BOUND * self.scale
        return np.zeros_like(near) if self.before else np.asarray(near)

    @property
    def noise(self) -> NoiseOperator | None:
        """Correlation of the noise of the residual, None where it is white."""
        if self.before:
            return self.model.noise if any(c.noise is not None for c in self.model.comparisons) else None
        return noise_of(self.model, self.error)

    @property
    def inside(self) -> LinearModel:
        """The least-squares problem of the parameters that are not at a bound."""
        k = np.flatnonzero(~self.at_bound)
        return LinearModel(self.residual, self.jacobian[:, k], bounds=(self.lower[k] - self.x[k], self.upper[k] - self.x[k]))

    @property
    def error(self) -> np.ndarray:
        """What shows the memory of records (n,): the residual of each block against the fit to all others. In that of the fit itself the
        slow errors are missing that the parameters could follow."""
        if self.before or self.model.segments is None:
            return self.residual
        return self.inside.outside(residual_blocks(self.model, self.residual).label)

    def covariance(self) -> Covariance:
        """Covariance with the correlation of the noise; before a test take `sigma_unit`. UntrustworthyError for too few data."""
        return LinearModel(self.residual, self.jacobian, self.noise).covariance(self.names, self.at_bound, 1e-9)

    def information(self, s2: float) -> Information:
        """Information on the parameters that are not at a bound; `s2` is the variance of the residual."""
        kept = np.flatnonzero(~self.at_bound)
        names = tuple(self.names[i] for i in kept)
        return information(self.jacobian[:, kept], names, self.x[kept], self.size[kept], self.noise, s2)


def relative_sizes(study: Study, names: tuple[str, ...], x: np.ndarray) -> np.ndarray:
    """Size (n_p,) of a relative change: |x|, but the usual size of a temperature, of what may be negative and of what is zero."""
    sizes = []
    for name, value in zip(names, x, strict=True):
        counts_from_zero = param(name).lower >= 0.0 and not name.startswith("theta_") and value != 0.0
        sizes.append(abs(value) if counts_from_zero else study.scale(name))
    return np.array(sizes)


def linear_of(
    study: Study, settings: StageSettings, model: StageModel, base: Parameters, before: bool, store: Checkpoint | None = None
) -> Linear:
    """Linear of a stage's model at `base`, whose free names are those of the stage; one forward run, kept in `store`.

    NumericsError where the run fails.
    """
    names = settings.free
    body = model.segments is None
    asked = tuple(name for name in PRESCRIBED if body and "theta" in model.observations and name not in names)
    residual, slopes = _linearised(study, settings, model, base, asked, store)
    x = base.vector()
    bounds = np.array([study.bounds(name) for name in names])
    shifts = {
        name: Shift(THERMOCOUPLE * slopes[:, len(names) + k], f"{THERMOCOUPLE:g} K of {name}") for k, name in enumerate(asked)
    }  # fmt: skip
    return Linear(
        model=model,
        base=base,
        names=names,
        x=x,
        lower=bounds[:, 0],
        upper=bounds[:, 1],
        size=relative_sizes(study, names, x),
        scale=np.array([study.scale(name) for name in names]),
        residual=residual,
        jacobian=np.ascontiguousarray(slopes[:, : len(names)]),
        before=before,
        shifts=shifts,
    )


def _linearised(
    study: Study, settings: StageSettings, model: StageModel, base: Parameters, asked: tuple[str, ...], store: Checkpoint | None
) -> tuple[np.ndarray, np.ndarray]:
    """Residual (n,) and slopes (n, n_p + asked): exact where the model has derivatives, else by differences without the asked ones."""
    key = base.vector()
    kept = None if store is None else store.get(key)
    if kept is not None:
        return kept["residual"], kept["slopes"]
    if model.linearise is not None:
        residual, slopes = model.linearised(base, (*settings.free, *asked))
    else:
        problem, change = stage_problem(study, settings, base, model)
        evaluations = Evaluations(problem)
        y = change.variables(key)
        by_variables = jacobian_at(evaluations, y, Settings(difference_step=DIFFERENCE_STEP))
        residual = evaluations.residual(y)
        slopes = np.concatenate([by_variables * change.slope(key), np.zeros((len(residual), len(asked)))], axis=1)
    if store is not None:
        store.put(key, residual=residual, slopes=slopes)
    return residual, slopes


def motion_shift(model: StageModel, time: np.ndarray, motion: np.ndarray) -> Shift | None:
    """What a rigid-body motion (n_t, n_s, 2) mm at `time` (n_t,) s of a planned test does to the residual; None where no u is compared."""
    if "u" not in model.observations:
        return None
    inside = motion[np.searchsorted(time, model.observations["u"].time - 1e-9)]
    parts = [-c.residual(inside) if field_of(c.channel) == "u" else np.zeros(c.n) for c in model.comparisons]
    return Shift(np.concatenate(parts), "the rigid-body motion of the assumed machine")


def moved(linear: Linear, shift: Shift) -> np.ndarray:
    """Relative change (n_p,) of the optimum under a shift: -(J^T J)^-1 J^T dr over size; zero for parameters at a bound."""
    kept = np.flatnonzero(~linear.at_bound)
    out = np.zeros(len(linear.names))
    out[kept] = LinearModel(shift.column, linear.jacobian[:, kept]).free_step / linear.size[kept]
    return out
