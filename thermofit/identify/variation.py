"""A stage with another prescribed value, and how its optimum follows to first order.

At an optimum g(p, q) = J^T r = 0, r whitened. A change of the prescribed q moves it by dp/dq = -(J^T J)^-1 dg/dq. Where q is a parameter
of the model, dg/dq = J^T dr/dq with the model's own derivative (Gauss-Newton, as in the Hessian); else g is evaluated at q + h and q - h.
Parameters at a bound stay there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.parameters import is_known
from thermofit.experiment.held import thermal_names
from thermofit.experiment.model import StageModel
from thermofit.fit.linear_model import projection
from thermofit.identify.solve import ModelOn, Solved, model_on
from thermofit.identify.stage import Ready
from thermofit.observe.comparison import Comparison
from thermofit.study.search import CLOCK, THICKNESS, weight_of
from thermofit.study.section import MeshSize
from thermofit.study.stages import ComponentWeights, StageSettings
from thermofit.study.study import Study

Change = tuple[str, Mapping[str, float], float]
"""A prescribed quantity, its direction in named values per unit of it, and a step of it for differences."""


@dataclass(frozen=True)
class Varied:
    """A stage with the given values in it; `reach` is what they change: parameters, weights, or what was measured."""

    stage: Ready
    reach: str
    wrap: Callable[[ModelOn], ModelOn] = lambda plain: plain


def nominal(study: Study, stage: Ready, quantity: str) -> float:
    """The value that the study prescribes. StudyError where the quantity does not exist in it."""
    if is_known(quantity):
        return stage.base[quantity]
    key = f"{study.source.name}: key 'sensitivity.quantity' is {quantity}"
    if quantity in (THICKNESS, CLOCK):
        return stage.experiment.prescribed(quantity)
    channel, component = weight_of(quantity) or ("", None)
    channels = stage.settings.channels
    if channel not in channels:
        raise StudyError(f"{key}, but the stage compares {', '.join(channels)}; expected the weight of one of these")
    if component is None:
        if len(channels) == 1:
            raise StudyError(
                f"{key}, but the stage compares {channel} alone, where a factor moves nothing; name a component or another quantity"
            )
        return 1.0
    weight = channels[channel].weight
    if not isinstance(weight, ComponentWeights):
        raise StudyError(f"{key}, but the weight of {channel} is {weight}; expected manual weights {{x: ..., y: ...}} in the stage")
    return weight.x if component == "x" else weight.y


def varied(study: Study, stage: Ready, given: Mapping[str, float]) -> Varied:
    """The stage with the given values by name: parameters, and at most one other quantity."""
    parameters = {name: value for name, value in given.items() if is_known(name)}
    base = replace(stage, base=stage.base.replace(**stage.experiment.spread(parameters)))
    others = {name: value for name, value in given.items() if name not in parameters}
    if not others:
        return Varied(base, "parameters")
    ((quantity, value),) = others.items()
    if weight := weight_of(quantity):
        channel, component = weight
        if component is None:
            return Varied(base, "weights", lambda plain: _weighted(plain, channel, value))
        return Varied(replace(base, settings=_with_component(stage.settings, channel, component, value)), "data")
    return Varied(replace(base, experiment=stage.experiment.with_prescribed(quantity, value)), "data")


def _with_component(settings: StageSettings, channel: str, component: str, value: float) -> StageSettings:
    old = settings.channels[channel]  # type: ignore[index]
    assert isinstance(old.weight, ComponentWeights)
    new = old.model_copy(update={"weight": old.weight.model_copy(update={component: value})})
    return settings.model_copy(update={"channels": {**settings.channels, channel: new}})


def _weighted(plain: ModelOn, channel: str, factor: float) -> ModelOn:
    """Models whose residual of one channel is multiplied by the root of the factor."""

    def heavier(c: Comparison) -> Comparison:
        return c.scaled(factor) if c.channel == channel else c

    return lambda size, base: _with_comparisons(plain(size, base), heavier)


def _with_comparisons(model: StageModel, change: Callable[[Comparison], Comparison]) -> StageModel:
    return replace(model, comparisons=tuple(change(c) for c in model.comparisons))


def response(study: Study, stage: Ready, solved: Solved, models: ModelOn, change: Change) -> dict[str, float]:
    """dp/dq by name at the optimum of the nominal value; empty where that has no Jacobian. NumericsError where a run beside it fails."""
    quantity, direction, h = change
    jacobian, names = solved.fit.jacobian, solved.fit.names
    if jacobian is None:
        return {}
    exact = is_known(quantity) and solved.model.linearise is not None and not (_frozen(stage) and quantity not in thermal_names())
    if exact:
        _, slopes = solved.model.linearised(solved.parameters, tuple(direction))
        slope = jacobian.T @ (slopes @ np.array(list(direction.values())))
    else:
        begin = nominal(study, stage, quantity)
        ends = [_gradient(study, stage, solved, models, _shifted(stage, quantity, direction, begin + sign * h)) for sign in (-1.0, 1.0)]
        slope = (ends[1] - ends[0]) / (2.0 * h)
    inside = ~solved.fit.at_bound
    out = np.zeros(len(names))
    root = projection(jacobian[:, inside]).root()
    out[inside] = -root @ (root.T @ slope[inside])
    return dict(zip(names, out.tolist(), strict=True))


def _frozen(stage: Ready) -> bool:
    """True where the mechanics of the stage is solved beforehand, so that its model feels thermal parameters only."""
    return stage.settings.coupling == "one-way" and set(stage.settings.free) <= thermal_names()


def _shifted(stage: Ready, quantity: str, direction: Mapping[str, float], value: float) -> dict[str, float]:
    """Given values of a prescribed one; what follows it goes along by the same difference."""
    if not is_known(quantity):
        return {quantity: value}
    moved = value - stage.base[quantity]
    return {name: stage.base[name] + share * moved for name, share in direction.items()}


def _gradient(study: Study, stage: Ready, solved: Solved, models: ModelOn, given: Mapping[str, float]) -> np.ndarray:
    """g = J^T r (n_p,) of the stage with given values at the optimum of the nominal one."""
    other = varied(study, stage, given)
    makers = other.wrap(models) if other.reach == "weights" else model_on(other.stage.experiment, other.stage.settings)
    size: MeshSize = study.mesh_size
    at = other.stage.base.with_vector(solved.fit.x)
    model = makers(size, at)
    residual, jacobian = model.linearised(at, solved.fit.names)
    return jacobian.T @ residual
