"""Experiments that no fit has seen: parameters that predict them, prediction beside data, proof of a change of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import AT, Parameters, bare_name
from thermofit.diagnose.case import Case, rows_of, slots_of
from thermofit.diagnose.elsewhere import Carried, Elsewhere
from thermofit.diagnose.experiments import stacked
from thermofit.diagnose.held_out import Proof, Rows, compared
from thermofit.effects.catalogue import Effect
from thermofit.experiment.discretisation import corrected
from thermofit.experiment.fields import start_parameters
from thermofit.experiment.joint import Joint, joint_settings, station_names
from thermofit.experiment.model import StageModel, needs_drive
from thermofit.experiment.residuals import Span, named_phases
from thermofit.experiment.several import Part, own_names, part_of
from thermofit.observe.stations import INFRARED
from thermofit.records.artefact import ParameterResult
from thermofit.study.section import MeshSize
from thermofit.study.study import Study

_OWN_TEMPERATURES = ("theta_air", "theta_clamp", "theta_ref")


@dataclass(frozen=True)
class Unseen:
    """A held-out experiment: its part, its joint stage (all channels, one coupled run), where its rows are from."""

    part: Part
    joint: Joint
    rows: Rows

    @property
    def model(self) -> StageModel:
        """StageModel of all channels."""
        return self.joint.model


def unseen(study: Study, size: MeshSize) -> tuple[Unseen, ...]:
    """The declared held-out experiments of a study. StudyError that names the command where one has not been interpolated."""
    found = []
    for name in study.held_out:
        part = part_of(study, name)
        needs_drive(part.study, joint_settings(part.study, (), part.data).channels)
        joint = Joint(part.study, part.data, joint_settings(part.study, (), part.data), size)
        found.append(Unseen(part, joint, rows_of(joint.model, named_phases(part.data.phases))))
    return tuple(found)


def predicting(study: Study, part: Part, found: Parameters, results: Mapping[str, ParameterResult]) -> tuple[Parameters, tuple[str, ...]]:
    """Parameters that predict a held-out experiment, and remarks on what they take from the fitted ones.

    The material is that of the fit, temperatures are those of its own thermocouples. Its own boundary and measurement parameters are those
    that the study gives for it, else what was identified on the fitted experiment, or its mean over several of them.
    """
    taken = taken_over(study, part.name, [name for name, r in results.items() if r.free])
    remarks = []
    for name, of in taken.items():
        how = "identified on the fitted experiment" if len(of) == 1 else f"the mean of {len(of)} fitted experiments"
        remarks.append(f"{part.name}: {name} = {np.mean([results[n].value for n in of]):.4g} is {how}")
    return predicted(study, part, found.replace(**{n: results[n].value for of in taken.values() for n in of}), taken), tuple(
        sorted(remarks)
    )


def taken_over(study: Study, experiment: str, identified: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Own parameters of a held-out experiment that are taken from the fitted ones, each with the identified names it is the mean of."""
    given, own = study.experiments[experiment].parameters, own_names(study)
    bare = dict.fromkeys(bare_name(name) for name in identified)
    return {
        name: tuple(n for n in identified if bare_name(n) == name)
        for name in bare
        if name in own and name not in given and name not in _OWN_TEMPERATURES
    }


def predicted(study: Study, part: Part, found: Parameters, taken: Mapping[str, tuple[str, ...]]) -> Parameters:
    """Parameters that predict a held-out experiment from fitted ones; `taken`: see `taken_over`."""
    here = start_parameters(part.study, part.data)
    values = {name: value for name, value in found.values.items() if AT not in name}
    for name in own_names(study) | frozenset(_OWN_TEMPERATURES):
        values[name] = float(np.mean([found[n] for n in taken[name]])) if name in taken else here[name]
    return Parameters.of(values)


def prediction_proof(others: Sequence[Unseen], before: Sequence[Parameters], after: Sequence[Parameters]) -> Proof:
    """How much better parameters `after` predict held-out experiments than `before`, both given one for each; NumericsError where a run
    fails. The two may be those of different models."""
    first = [o.model.residual(p) for o, p in zip(others, before, strict=True)]
    second = [o.model.residual(p) for o, p in zip(others, after, strict=True)]
    return compared(np.concatenate(first), np.concatenate(second), stacked([o.rows for o in others]), len(others))


def bodies_elsewhere(study: Study, size: MeshSize, identified: Sequence[str], base: Parameters) -> tuple[Elsewhere, ...]:
    """The declared held-out experiments for the loop; `identified` are the fitted parameters before any effect is added, at `base`.

    An effect of boundary or instruments that the loop adds belongs to the test that shows it: a held-out one is predicted without.
    """
    own = own_names(study)
    out = []
    for other in unseen(study, size):
        taken = taken_over(study, other.part.name, identified)
        joint = corrected(other.joint, predicted(study, other.part, base, taken)).joint
        out.append(_elsewhere(study, replace(other, joint=joint), taken, own))
    return tuple(out)


def _elsewhere(study: Study, other: Unseen, taken: Mapping[str, tuple[str, ...]], own: frozenset[str]) -> Elsewhere:
    part, spans = other.part, named_phases(other.part.data.phases)
    known = slots_of("body", INFRARED if part.data.temperature is not None else ())

    def case(parameters: Parameters) -> Case:
        here = predicted(study, part, parameters, taken)
        return Case(other.model, here, known, spans, station_names(), scored=other.joint.scored, placed=other.rows)

    def carried(free: Sequence[str]) -> Carried:
        names = tuple(dict.fromkeys(bare_name(n) for n in free if bare_name(n) in taken or not _stays(n, own)))
        weights = np.zeros((len(names), len(free)))
        for k, n in enumerate(free):
            if bare_name(n) in names:
                weights[names.index(bare_name(n)), k] = 1.0 / len(taken[bare_name(n)]) if bare_name(n) in taken else 1.0
        return names, weights

    judges = frozenset(e.name for e in known if e.amplitude.name not in own)
    return Elsewhere(f"experiment {part.name}", case, carried, judges, study.experiments[part.name].fit_own)


def _stays(name: str, own: frozenset[str]) -> bool:
    """True for a parameter that another test does not take from the fitted ones."""
    return bare_name(name) in own or bare_name(name) in _OWN_TEMPERATURES


def records_elsewhere(names: Sequence[str], model: StageModel, known: tuple[Effect, ...], spans: tuple[Span, ...]) -> Elsewhere:
    """Held-out records of coupons for the loop: `model` is theirs. Every record has its own air, all share everything else."""

    def case(parameters: Parameters) -> Case:
        return Case(model, parameters, known, spans, station_names(), cheap=True)

    def carried(free: Sequence[str]) -> Carried:
        there = tuple(n for n in free if n not in _OWN_TEMPERATURES)
        return there, np.array([[float(n == f) for f in free] for n in there]).reshape(len(there), len(free))

    word = "record" if len(names) == 1 else "records"
    return Elsewhere(f"{word} {', '.join(names)}", case, carried, frozenset(e.name for e in known))
