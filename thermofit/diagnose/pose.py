"""The pose of the infrared camera: an error of its landmarks in every fit, and a cause where they cannot explain it.

Landmarks are picked by hand. So the camera lies beside the specimen in any test, by some hundredths of a millimetre, and that is seen: its
pose is fitted with everything else, a datum with the standard error of its calibration, within bounds that such an error can reach
(`experiment.priors.pose_bounds`). Where a number of it ends at such a bound the camera may have been moved: the pose is then fitted without
these bounds, and judged as any effect is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose.backward import Means, Refit
from thermofit.diagnose.case import Case, Sharper
from thermofit.diagnose.refit import JointFit
from thermofit.diagnose.retraced import hidden
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import Accepted, Trial, judged_trial
from thermofit.effects.catalogue import effect, effect_of_param
from thermofit.experiment.trust import at_bound, physical
from thermofit.fit.result import FitResult
from thermofit.identify.solve import within


@dataclass(frozen=True)
class Released:
    """The trial of a pose beyond the error of its landmarks, where it ends if it is accepted, and how to fit from there on."""

    trial: Trial
    accepted: Accepted | None
    refit: Refit


def beyond_landmarks(case: Case) -> tuple[str, ...]:
    """Effects of a fitted pose of which a number is at the end of what an error of the landmarks can reach."""
    ends = (n for n in sorted(case.pose & set(case.parameters.free)) if at_bound(case.parameters[n], case.bounds(n)))
    return tuple(dict.fromkeys(effect_of_param(n).name for n in ends))


def released(here: Traced, fit: FitResult, means: Means) -> Released | None:
    """The first pose that is `beyond_landmarks`, fitted within its physical bounds and judged against where it is; None: there is none.
    A trial whose runs fail says so. `fit`: the one that ends here."""
    for name in beyond_landmarks(here.case):
        own = tuple(p.name for p in effect(name).amplitudes)
        refit = wider(means.refit, here.case.parameters, own)
        wide = replace(here, case=widened(here.case, own, refit))
        score = hidden(name)
        try:
            end = refit(here.case.parameters, f"{name} beyond its landmarks")
            trial, found = judged_trial(wide, fit, (score,), end, replace(means, refit=refit))
        except NumericsError as error:
            trial, found = Trial((score,), None, {}, {}, 0.0, f"a run that judges it failed: {error}", unjudged=True), None
        return Released(trial, found, refit)
    return None


def wider(refit: Refit, parameters: Parameters, names: Sequence[str]) -> Refit:
    """A fit within the physical bounds of some parameters."""
    if not isinstance(refit, JointFit):
        return refit
    return replace(refit, study=within(refit.study, parameters, {n: physical(n) for n in names}))


def widened(case: Case, names: Sequence[str], wide: Refit) -> Case:
    """The case within the physical bounds of some parameters, in all of its fits; `wide` is one."""
    bounds, sharper = case.bounds, case.sharper

    def sharp(parameters: Parameters) -> Sharper | None:
        found = None if sharper is None else sharper(parameters)
        if found is None:
            return None
        refit, nearby = (wider(f, parameters, names) for f in (found.refit, found.nearby))
        return replace(found, refit=refit, nearby=nearby, heated=refit.heated if isinstance(refit, JointFit) else found.heated)

    return replace(
        case,
        bounds=lambda name: physical(name) if name in names else bounds(name),
        sharper=None if sharper is None else sharp,
        heated=wide.heated if case.heated is not None and isinstance(wide, JointFit) else case.heated,
        pose=case.pose - set(names),
    )
