"""The pose of the infrared camera: an error of its landmarks in every fit, and a cause where they cannot explain it.

Landmarks are picked by hand. So the camera lies beside the specimen in any test, by some hundredths of a millimetre, and that is seen: its
pose is fitted with everything else, a datum with the standard error of its calibration, within bounds that such an error can reach
(`experiment.priors.pose_bounds`). Where a number of it ends at such a bound the camera may have been moved: the pose is then fitted without
these bounds, and judged as any effect is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.backward import Means
from thermofit.diagnose.case import Case, HeatFit, RefinedProblem, Refit, Scored, Sharper
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.rescored import EXPLAINED, OF_SOURCE, hidden, share_of_source
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import Accepted, Trial, judged_trial
from thermofit.effects.catalogue import effect, effect_of_param
from thermofit.experiment.missing import MissingTerm
from thermofit.experiment.model import Prior, StageModel
from thermofit.experiment.several import free_in
from thermofit.experiment.trust import at_bound, physical
from thermofit.fit.result import FitResult
from thermofit.identify.solve import within

Heated = Callable[[Parameters], HeatFit | None]
"""How the temperatures alone are fitted on the motion of given parameters."""


@dataclass(frozen=True)
class Released:
    """The trials of poses beyond the error of their landmarks, where the last of them ends if it is accepted, and how to fit from there
    on."""

    trials: tuple[Trial, ...]
    accepted: Accepted | None
    refit: Refit


def contradicting_landmarks(case: Case) -> tuple[str, ...]:
    """Effects of a fitted pose of which a number is at the end of what an error of the landmarks can reach."""
    ends = (n for n in sorted(case.pose & set(case.parameters.free)) if at_bound(case.parameters[n], case.bounds(n)))
    return tuple(dict.fromkeys(effect_of_param(n).name for n in ends))


def released(here: Traced, fit: FitResult, means: Means) -> Released:
    """Poses that are `contradicting_landmarks`, each fitted within its physical bounds and without the datum of its landmarks, which do not
    speak of a camera that was moved; judged against where it is, up to the first that is accepted. A pose is no name for heat that is
    missing, as no other effect is that leaves most of it (`rescored`). A trial whose runs fail says so. `fit`: the one that ends here."""
    trials: list[Trial] = []
    for name in contradicting_landmarks(here.case):
        own = tuple(p.name for p in effect(name).amplitudes)
        refit = wider(means.refit, here.case.parameters, own)
        score = hidden(name)
        try:
            end = refit(here.case.parameters, f"{name} beyond its landmarks")
            trial, found = judged_trial(replace(here, case=widened(here.case, own, refit)), fit, (score,), end, replace(means, refit=refit))
        except NumericsError as error:
            trial, found = Trial((score,), None, {}, {}, 0.0, f"a run that judges it failed: {error}", unjudged=True), None
        share = None if found is None else share_of_source(here, found[0])
        if share is not None and share < EXPLAINED:
            trial, found = replace(trial, refused=f"explains {100.0 * max(share, 0.0):.0f} % of {OF_SOURCE}"), None
        trials.append(trial)
        if found is not None:
            return Released(tuple(trials), found, refit)
    return Released(tuple(trials), None, means.refit)


def not_asked_of_pose(case: Case, trials: Sequence[Trial]) -> dict[str, str]:
    """Numbers of a fitted pose at the end of what an error of the landmarks can reach, each with a remark, where a trial beyond that has
    shown that held-out data do not ask for more: then the end is no doubt of the answer."""
    shown = {t.effects[0]: t.proof for t in trials if len(t.effects) == 1 and t.refused and not t.unjudged and t.proof is not None}
    out = {}
    for name in contradicting_landmarks(case):
        proof = shown.get(name)
        if proof is None or proof.convinces:
            continue
        for p in effect(name).amplitudes:
            if p.name in case.pose and at_bound(case.parameters[p.name], case.bounds(p.name)):
                out[p.name] = f"{p.name} is at the end of what an error of its landmarks reaches; beyond it, {proof.words}"
    return out


def wider(refit: Refit, parameters: Parameters, names: Sequence[str]) -> Refit:
    """A fit within the physical bounds of some parameters, without what was declared of them."""
    if not isinstance(refit, JointFit):
        return refit
    study, parts = within(refit.study, parameters, {n: physical(n) for n in names}), refit.parts
    if parts is not None:
        each = {test: replace(one, beside=_undeclared(one.beside, free_in(names, test).values())) for test, one in parts.each.items()}
        parts = parts.rebuilt(each)
    return replace(refit, study=study, model=_without_datum(refit.model, names), parts=parts)


def widened(case: Case, names: Sequence[str], wide: Refit) -> Case:
    """The case within the physical bounds of some parameters, without what was declared of them, in all of its fits; `wide` is one."""
    bounds = case.bounds
    return replace(
        case,
        model=_without_datum(case.model, names),
        bounds=lambda name: physical(name) if name in names else bounds(name),
        refined_at=_wider_again(case.refined_at, names),
        pose=case.pose - set(names),
        scored=_scored(wide, case.scored),
        heated=_heated(wide, case.heated),
    )


def _wider_again(sharper: Sharper | None, names: Sequence[str]) -> Sharper | None:
    """How errors are told anew in such a case, as often as that is asked."""
    if sharper is None:
        return None

    def sharp(parameters: Parameters, beside: MissingTerm | None = None) -> RefinedProblem | None:
        """The problem told at parameters, without these bounds and data in any of its fits; None where there is nothing to tell."""
        found = sharper(parameters) if beside is None else sharper(parameters, beside)
        if found is None:
            return None
        refit, nearby = (wider(f, parameters, names) for f in (found.refit, found.nearby))
        return replace(
            found,
            model=_without_datum(found.model, names),
            refit=refit,
            nearby=nearby,
            scored=_scored(refit, found.scored),
            heated=_heated(refit, found.heated),
            again=_wider_again(found.again, names),
        )

    return sharp


def _scored(wide: Refit, scored: Scored | None) -> Scored | None:
    """Scores by the problem of a wider fit; as they are where that has none."""
    parts = wide.parts if isinstance(wide, JointFit) else None
    return scored if scored is None or parts is None else parts.scored


def _heated(wide: Refit, heated: Heated | None) -> Heated | None:
    """How that fits the temperatures alone; as it is where it does not."""
    return wide.heated if heated is not None and isinstance(wide, JointFit) else heated


def _undeclared(priors: Sequence[Prior], names: Iterable[str]) -> tuple[Prior, ...]:
    """Priors of which those of some parameters say nothing; their rows stay."""
    gone = frozenset(names)
    return tuple(replace(p, sigma=np.inf) if p.name in gone else p for p in priors)


def _without_datum(model: StageModel, names: Sequence[str]) -> StageModel:
    """The model without what was declared of some parameters."""
    return replace(model, priors=_undeclared(model.priors, names))
