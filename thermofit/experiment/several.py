"""Several experiments in one fit: which parameters each has for itself, called <param>@<test>, and the models of all as one, one residual
after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.parameters import AT, Parameters, acting, bare_name
from thermofit.effects.catalogue import KINEMATICS, LOAD, MEASUREMENT, ON_FACETS, effects
from thermofit.experiment.channels import field_of
from thermofit.experiment.joint import Joint, Known
from thermofit.experiment.known_motion import Direction
from thermofit.experiment.model import StageModel
from thermofit.experiment.prediction import Errors
from thermofit.records.staging import as_one, named
from thermofit.study.study import Study

BOUNDARY = acting("film", "reference")
"""Parameters of the base law that belong to a test and not to the material."""
_SLOTS = (*ON_FACETS, "initial_temperature", *LOAD, *KINEMATICS, *MEASUREMENT)


def own_names(study: Study) -> frozenset[str]:
    """Names of the parameters that every experiment has for itself: boundary and measurement, but for those that the study shares."""
    of_effects = {name for effect in effects(_SLOTS) for name in effect.names}
    return frozenset({*BOUNDARY, *of_effects} - set(study.shared))


def seen_by(parameters: Parameters, part: str) -> Parameters:
    """The parameters as they read for one experiment, without names of any."""
    plain = {name: value for name, value in parameters.values.items() if AT not in name}
    own = {bare_name(name): value for name, value in parameters.values.items() if name.endswith(f"{AT}{part}")}
    return Parameters.of({**plain, **own})


def free_in(names: Sequence[str], part: str) -> dict[str, str]:
    """Which of the names act in an experiment, by what they are called there; a bare name acts in all."""
    own = {bare_name(name) for name in names if name.endswith(f"{AT}{part}")}
    return {name: bare_name(name) for name in names if name.endswith(f"{AT}{part}") or (AT not in name and name not in own)}


def joined(models: dict[str, StageModel]) -> StageModel:
    """Models of several experiments as one, by name of the experiment."""
    exact = all(model.linearise is not None for model in models.values())
    remarks = [named(name, model.remark) for name, model in models.items() if model.remark]
    places = np.cumsum([0, *(len(model.comparisons) for model in models.values())])[:-1].tolist()
    return StageModel(
        errors=lambda parameters: _errors(models, parameters),
        comparisons=tuple(
            replace(c, channel=f"{c.channel}{AT}{name}", field=f"{field_of(c)}{AT}{name}")
            for name, model in models.items()
            for c in model.comparisons
        ),
        observations={
            f"{field}{AT}{name}": replace(o, name=f"{field}{AT}{name}")
            for name, model in models.items()
            for field, o in model.observations.items()
        },
        remark=as_one(remarks),
        one_way=any(model.one_way for model in models.values()),
        linearise=(lambda parameters, names: _linearise(models, parameters, names)) if exact else None,
        priors=tuple(replace(p, name=f"{p.name}{AT}{name}") for name, model in models.items() for p in model.priors),
        cheap=all(model.cheap for model in models.values()),
        common=tuple(one.moved(before) for before, model in zip(places, models.values(), strict=True) for one in model.common),
    )


def _errors(models: dict[str, StageModel], parameters: Parameters) -> Errors:
    out: Errors = {}
    for name, model in models.items():
        out |= {f"{field}{AT}{name}": error for field, error in model.errors(seen_by(parameters, name)).items()}
    return out


def _linearise(models: dict[str, StageModel], parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
    """Error fields and derivatives; a parameter of another experiment has no influence."""
    errors: Errors = {}
    slopes: dict[str, np.ndarray] = {}
    for name, model in models.items():
        assert model.linearise is not None
        acting = free_in(names, name)
        column = [k for k, n in enumerate(names) if n in acting]
        found, rates = model.linearise(seen_by(parameters, name), tuple(acting[names[k]] for k in column))
        for field, error in found.items():
            errors[f"{field}{AT}{name}"] = error
            full = np.zeros((*error.shape, len(names)))
            full[..., column] = rates[field]
            slopes[f"{field}{AT}{name}"] = full
    return errors, slopes


@dataclass(frozen=True)
class JointSeveral:
    """The joint stages of several experiments, by name of the experiment."""

    each: Mapping[str, Joint]

    def rebuilt(self, each: Mapping[str, Joint]) -> JointSeveral:
        """Other joint stages of the experiments."""
        return JointSeveral(each)

    def seen_by(self, parameters: Parameters, test: str) -> Parameters:
        """Parameters as they read for one experiment, with the free ones that act in it."""
        return seen_by(parameters, test).with_free(tuple(free_in(parameters.free, test).values()))

    @cached_property
    def model(self) -> StageModel:
        """StageModel of all channels of all experiments."""
        return joined({name: part.model for name, part in self.each.items()})

    @cached_property
    def mechanics(self) -> StageModel | None:
        """StageModel of displacements and forces alone; None where none are compared."""
        return _joined({name: part.mechanics for name, part in self.each.items()})

    def heat(self, parameters: Parameters) -> StageModel | None:
        """StageModel of the temperatures alone, on the motions of runs with given parameters; None where none are compared."""
        return _joined({name: part.heat(seen_by(parameters, name)) for name, part in self.each.items()})

    @property
    def knows_force_error(self) -> bool:
        """Whether the error of a prescribed force is known."""
        return any(part.knows_force_error for part in self.each.values())

    def without_force_error(self) -> JointSeveral:
        """The same with forces that are taken as exact."""
        return JointSeveral({name: part.without_force_error() for name, part in self.each.items()})

    def force_misfit(self, parameters: Parameters, known: Mapping[str, Known] | None = None) -> float:
        """The largest one of all experiments, see `Joint`."""
        here = {name: self.seen_by(parameters, name) for name in self.each}
        return max(part.force_misfit(here[name], None if known is None else {"": known[name]}) for name, part in self.each.items())

    def histories(self, parameters: Parameters) -> tuple[History, ...]:
        """The coupled runs, with their points kept."""
        return tuple(h for name, part in self.each.items() for h in part.histories(seen_by(parameters, name)))

    def scored(
        self, parameters: Parameters, names: tuple[str, ...], directions: Sequence[Direction]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As that of `Joint`; a direction of one experiment is felt there alone, any other in all."""
        found: tuple[dict[str, np.ndarray], ...] = ({}, {}, {})
        for name, part in self.each.items():
            acting = free_in(names, name)
            felt = [k for k, (along, _) in enumerate(directions) if name == along.partition(AT)[2] or AT not in along]
            own = [(bare_name(directions[k][0]), {bare_name(n): v for n, v in directions[k][1].items()}) for k in felt]
            residual, jacobian, heated = part.scored(seen_by(parameters, name), tuple(acting.values()), own)
            found[0][name] = residual
            found[1][name] = _spread(jacobian, [names.index(n) for n in acting], len(names))
            found[2][name] = _spread(heated, felt, len(directions))
        return self.stacked(found[0]), self.stacked(found[1]), self.stacked(found[2])

    def stacked(self, of: Mapping[str, np.ndarray]) -> np.ndarray:
        """Rows (n, ...) of the residual of all experiments from those of each: all data first, then all priors."""
        counts = {name: sum(c.n for c in part.model.comparisons) for name, part in self.each.items()}
        return np.concatenate([*(of[name][:n] for name, n in counts.items()), *(of[name][n:] for name, n in counts.items())])


def _joined(models: Mapping[str, StageModel | None]) -> StageModel | None:
    there = {name: model for name, model in models.items() if model is not None}
    return joined(there) if there else None


def _spread(columns: np.ndarray, at: Sequence[int], count: int) -> np.ndarray:
    """Columns (n, k) at their places among `count`, zeros elsewhere."""
    out = np.zeros((len(columns), count))
    out[:, list(at)] = columns
    return out
