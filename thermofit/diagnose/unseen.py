"""Experiments that no fit has seen: parameters that predict them, prediction beside data, proof of a change of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermofit.core.artefact import ParameterResult
from thermofit.core.parameters import AT, Parameters, bare_name
from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.diagnose.case import rows_of
from thermofit.diagnose.held_out import Proof, Rows, compared
from thermofit.diagnose.structure import named_phases
from thermofit.identify.inputs import start_parameters
from thermofit.identify.joint import joint_model, joint_settings
from thermofit.identify.model import StageModel
from thermofit.identify.several import Part, own_names, part_of

_OWN_TEMPERATURES = ("theta_air", "theta_clamp", "theta_ref")


@dataclass(frozen=True)
class Unseen:
    """A held-out experiment: its part, its joint model (all channels, one coupled run), where its rows are from."""

    part: Part
    model: StageModel
    rows: Rows


def unseen(study: Study, size: MeshSize) -> tuple[Unseen, ...]:
    """The declared held-out experiments of a study. StudyError that names the command where one has not been interpolated."""
    found = []
    for name in study.held_out:
        part = part_of(study, name)
        model = joint_model(part.study, part.data, joint_settings(part.study, (), part.data), size)
        found.append(Unseen(part, model, rows_of(model, named_phases(part.data.phases))))
    return tuple(found)


def predicting(study: Study, part: Part, found: Parameters, results: Mapping[str, ParameterResult]) -> tuple[Parameters, tuple[str, ...]]:
    """Parameters that predict a held-out experiment, and remarks on what they take from the fitted ones.

    The material is that of the fit, temperatures are those of its own thermocouples. Its own boundary and measurement parameters are those
    that the study gives for it, else what was identified on the fitted experiment, or its mean over several of them.
    """
    here = start_parameters(part.study, part.data)
    given = study.experiments[part.name].parameters
    values = {name: value for name, value in found.values.items() if AT not in name}
    remarks = []
    for name in own_names(study) | frozenset(_OWN_TEMPERATURES):
        fitted = [r.value for other, r in results.items() if r.free and bare_name(other) == name]
        if name in given or name in _OWN_TEMPERATURES or not fitted:
            values[name] = here[name]
        else:
            values[name] = float(np.mean(fitted))
            how = "identified on the fitted experiment" if len(fitted) == 1 else f"the mean of {len(fitted)} fitted experiments"
            remarks.append(f"{part.name}: {name} = {values[name]:.4g} is {how}")
    return Parameters.of(values), tuple(sorted(remarks))


def prediction_proof(others: Sequence[Unseen], before: Sequence[Parameters], after: Sequence[Parameters]) -> Proof:
    """How much better parameters `after` predict held-out experiments than `before`, both given one for each; NumericsError where a run
    fails. The two may be those of different models."""
    first = [o.model.residual(p) for o, p in zip(others, before, strict=True)]
    second = [o.model.residual(p) for o, p in zip(others, after, strict=True)]
    return compared(np.concatenate(first), np.concatenate(second), stacked([o.rows for o in others]), len(others))


def stacked(rows: Sequence[Rows]) -> Rows:
    """Rows of several experiments, one after the other in time, so that their groups stay apart."""
    time, at = [], 0.0
    for one in rows:
        time.append(one.time - one.time.min() + at)
        at = float(time[-1].max()) + 1.0
    return Rows(
        np.concatenate([one.channel for one in rows]),
        np.concatenate(time),
        np.concatenate([one.xy for one in rows]),
        np.concatenate([one.phase for one in rows]),
    )
