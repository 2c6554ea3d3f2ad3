"""The joint stage of several experiments: that of each as if it were alone, shared parameters common, one residual after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.parameters import AT, Parameters, bare_name
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.known_motion import Direction
from thermofit.experiment.model import StageModel
from thermofit.experiment.several import Several, free_in, joined, seen_by
from thermofit.study.section import MeshSize
from thermofit.study.study import Study


@dataclass(frozen=True)
class JointSeveral:
    """The joint stages of several experiments, by name of the experiment."""

    parts: Mapping[str, Joint]

    @cached_property
    def model(self) -> StageModel:
        """StageModel of all channels of all experiments."""
        return joined({name: part.model for name, part in self.parts.items()})

    @cached_property
    def mechanics(self) -> StageModel | None:
        """StageModel of displacements and forces alone; None where none are compared."""
        return _joined({name: part.mechanics for name, part in self.parts.items()})

    def heat(self, parameters: Parameters) -> StageModel | None:
        """StageModel of the temperatures alone, on the motions of runs with given parameters; None where none are compared."""
        return _joined({name: part.heat(seen_by(parameters, name)) for name, part in self.parts.items()})

    @property
    def knows_force_error(self) -> bool:
        """Whether the error of a prescribed force is known."""
        return any(part.knows_force_error for part in self.parts.values())

    def without_force_error(self) -> JointSeveral:
        """The same with forces that are taken as exact."""
        return JointSeveral({name: part.without_force_error() for name, part in self.parts.items()})

    def force_misfit(self, parameters: Parameters) -> float:
        """The largest one of all experiments, see `Joint`."""
        own = {name: tuple(free_in(parameters.free, name).values()) for name in self.parts}
        return max(part.force_misfit(seen_by(parameters, name).with_free(own[name])) for name, part in self.parts.items())

    def histories(self, parameters: Parameters) -> tuple[History, ...]:
        """The coupled runs, with their points kept."""
        return tuple(h for name, part in self.parts.items() for h in part.histories(seen_by(parameters, name)))

    def scored(
        self, parameters: Parameters, names: tuple[str, ...], directions: Sequence[Direction]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As that of `Joint`; a direction of one experiment is felt there alone, any other in all."""
        found: tuple[dict[str, np.ndarray], ...] = ({}, {}, {})
        for name, part in self.parts.items():
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
        counts = {name: sum(c.n for c in part.model.comparisons) for name, part in self.parts.items()}
        return np.concatenate([*(of[name][:n] for name, n in counts.items()), *(of[name][n:] for name, n in counts.items())])


def _joined(models: Mapping[str, StageModel | None]) -> StageModel | None:
    there = {name: model for name, model in models.items() if model is not None}
    return joined(there) if there else None


def _spread(columns: np.ndarray, at: Sequence[int], count: int) -> np.ndarray:
    """Columns (n, k) at their places among `count`, zeros elsewhere."""
    out = np.zeros((len(columns), count))
    out[:, list(at)] = columns
    return out


def joint_several(study: Study, data: Several, free: Sequence[str], size: MeshSize) -> JointSeveral:
    """The joint stages of all fitted experiments of a study on meshes of one size; `free` are names of the joint fit."""
    parts = {}
    for part in data.parts:
        own = part.study.model_copy(update={"hardening": study.hardening_law})
        parts[part.name] = Joint(own, part.data, joint_settings(own, tuple(free_in(free, part.name).values()), part.data), size)
    return JointSeveral(parts)


def known_in(data: Several, known_of: Callable[[bool], Sequence[Effect]]) -> tuple[Effect, ...]:
    """Effects of a joint fit: those of the material once, those of boundary and measurement for every experiment on its own.

    `known_of` gives the effects that a body knows, with an infrared camera (True) or without.
    """
    hot = {part.name: part.data.temperature is not None for part in data.parts}
    out: list[Effect] = []
    for e in known_of(any(hot.values())):
        if e.amplitude.name not in data.own:
            out.append(e)
            continue
        out += [effect(f"{e.name}{AT}{name}") for name, camera in hot.items() if any(e.name == k.name for k in known_of(camera))]
    return tuple(out)
