"""Close the loop: find, trace, add, prove, round after round, and the check that what was added is still needed (design section 8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.case import Case, scans
from thermofit.diagnose.held_out import Proof, Room, compared, held_out_residual
from thermofit.diagnose.refit import EXPONENTS
from thermofit.diagnose.score import Score, ranked
from thermofit.diagnose.trace import PRACTICAL, SURE, Traced, best_scan, room_of, traced
from thermofit.effects.catalogue import effect
from thermofit.fit.result import FitResult

Refit = Callable[[Parameters, str], tuple[Parameters, FitResult]]
"""Minimise the joint objective from given parameters (`free` names the fitted ones); the text names the fit."""
TRIED_PER_ROUND = 2
WORTH_AN_EXPONENT = 10.0
"""Fall of the objective, in units of the noise, for which exponents that were scanned are fitted."""
AWAY = 2.0
"""Standard errors by which an accepted amplitude differs from neutral."""


@dataclass(frozen=True)
class Trial:
    """One effect added and refitted: its score before, the proof by the refit, sigma of its Params, why it was refused (empty: kept), and
    what became of its exponents."""

    score: Score
    proof: Proof | None
    estimate: Mapping[str, float]
    sigma: Mapping[str, float]
    achieved_drop: float
    refused: str
    exponents: str = ""


@dataclass(frozen=True)
class Round:
    """One turn of the loop: what was traced before, what was tried, and what was accepted (None: nothing)."""

    traced: Traced
    trials: tuple[Trial, ...]
    accepted: str | None


@dataclass(frozen=True)
class Closed:
    """Result of the loop: the rounds, the traces at the first and at the last optimum, the accepted effects, those dropped again."""

    rounds: tuple[Round, ...]
    first: Traced
    last: Traced
    fit: FitResult
    accepted: tuple[str, ...]
    dropped: tuple[str, ...]


def close_loop(case: Case, fit: FitResult, refit: Refit, max_effects: int, numerical: np.ndarray | None, how: str = "auto") -> Closed:
    """Rounds until nothing is accepted, at most `max_effects` effects; `case` is at its optimum `fit`."""
    rounds: list[Round] = []
    accepted: list[str] = []
    here = first = traced(case, numerical, how)
    while True:
        trials: list[Trial] = []
        winner: tuple[Traced, FitResult, str] | None = None
        if len(accepted) < max_effects:
            for score in here.promising()[:TRIED_PER_ROUND]:
                trial, found = _tried(here, fit, score, refit, numerical, how)
                trials.append(trial)
                if found is not None:
                    winner = (*found, score.effect)
                    break
        rounds.append(Round(here, tuple(trials), None if winner is None else winner[2]))
        if winner is None:
            break
        here, fit, name = winner
        accepted.append(name)
    dropped = []
    for name in accepted[:-1]:
        if not _still_needed(here, name):
            here, fit = _without(here, name, refit, numerical, how)
            dropped.append(name)
    return Closed(tuple(rounds), first, here, fit, tuple(n for n in accepted if n not in dropped), tuple(dropped))


def with_effect(parameters: Parameters, name: str, estimate: Mapping[str, float]) -> Parameters:
    """Parameters with an effect switched on at a first estimate inside its bounds; its Params are free but for scanned ones."""
    added = effect(name)
    start = {}
    for p in added.params:
        value = estimate.get(p.name, p.neutral)
        inside = 1e-6 * (p.upper - p.lower)
        start[p.name] = float(np.clip(value, p.lower + inside, p.upper - inside))
    free = (p.name for p in added.params if not p.scan)
    return parameters.replace(**start).with_free((*parameters.free, *free))


def _tried(
    here: Traced, fit: FitResult, score: Score, refit: Refit, numerical: np.ndarray | None, how: str
) -> tuple[Trial, tuple[Traced, FitResult] | None]:
    """Refit with one effect; accepted where the held-out error falls and the amplitude stands off neutral and off its bounds."""
    chosen = here.settings.get(score.effect)
    if chosen is None and len(scans(effect(score.effect), here.case.spans)) > 1:
        chosen, block = best_scan(here.case, here.problem, effect(score.effect))
        alone = replace(here.problem, dormant={score.effect: (here.problem.dormant[score.effect][0], block)})
        score = replace(ranked(alone).scores[0], family=score.family)
    start = with_effect(here.case.parameters, score.effect, {**score.estimate, **(chosen or {})})
    try:
        parameters, after = refit(start, score.effect)
    except NumericsError as error:
        return Trial(score, None, score.estimate, {}, 0.0, f"the refit failed: {error}"), None
    parameters, after, exponents = _refined(parameters, after, score.effect, refit)
    names = tuple(p.name for p in effect(score.effect).params if not p.scan)
    there = traced(replace(here.case, parameters=parameters), numerical, how, here.split)
    proof = compared(held_out_of(here), held_out_of(there), here.rows, len(here.split.held_out), here.problem.noise)
    sigma = {n: float(after.sigma[after.names.index(n)]) if after.sigma is not None else float("inf") for n in names}
    estimate = {n: parameters[n] for n in names}
    refused = _refusal(score.effect, estimate, sigma, proof, after)
    trial = Trial(score, proof, estimate, sigma, fit.f - after.f, refused, exponents)
    return trial, None if refused else (there, after)


def _refined(parameters: Parameters, fit: FitResult, name: str, refit: Refit) -> tuple[Parameters, FitResult, str]:
    """A second refit with the scanned Params of an effect free as well; kept where it converges and the objective falls, and said."""
    scanned = [p.name for p in effect(name).params if len(p.scan) > 1]
    if not scanned:
        return parameters, fit, ""
    held = "held at " + ", ".join(f"{n} = {parameters[n]:.3g}" for n in scanned)
    try:
        free, after = refit(parameters.with_free((*parameters.free, *scanned)), f"{name}{EXPONENTS}")
    except NumericsError as error:
        return parameters, fit, f"{held}: the refit with them free failed ({error})"
    if fit.f - after.f <= WORTH_AN_EXPONENT:
        return parameters, fit, f"{held}: freeing them gains nothing"
    return free, after, "fitted" if after.converged else "fitted, but not settled"


def held_out_of(here: Traced) -> np.ndarray:
    """Whitened residual (n,) of every row as predicted from the folds that do not hold it; nan in rows that are never held out."""
    return held_out_residual(here.columns.residual, here.columns.fitted, here.split, _room(here))


def _room(here: Traced) -> Room:
    return room_of(here.case.parameters, here.case.parameters.free)


def _refusal(name: str, estimate: Mapping[str, float], sigma: Mapping[str, float], proof: Proof, fit: FitResult) -> str:
    """Why a refitted effect is not accepted, empty where it is."""
    if fit.sigma is None:
        return "the refit has no standard errors: the data do not determine all of its parameters"
    if proof.gain <= max(SURE * proof.sigma, PRACTICAL):
        return f"held-out error falls by {100 * proof.gain:.2f} % +- {100 * proof.sigma:.2f} % only"
    amplitude = effect(name).amplitude
    own = [p for p in effect(name).params if not p.scan]
    if all(abs(estimate[p.name] - p.neutral) <= AWAY * sigma[p.name] for p in own):
        return f"{amplitude.name} = {estimate[amplitude.name]:.3g} is not away from {amplitude.neutral:g}"
    if fit.at_bound[fit.names.index(amplitude.name)]:
        return f"{amplitude.name} ends at its bound {estimate[amplitude.name]:.3g} {amplitude.unit}"
    return ""


def _without_columns(here: Traced, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Residual and fitted columns if the effect of that name were back at neutral, to first order."""
    free = here.case.parameters.free
    own = [k for k, n in enumerate(free) if n in effect(name).names]
    amplitudes = [k for k in own if not param(free[k]).scan]
    back = np.array([param(free[k]).neutral - here.case.parameters[free[k]] for k in amplitudes])
    residual = here.columns.residual + here.columns.fitted[:, amplitudes] @ back
    return residual, np.delete(here.columns.fitted, own, axis=1)


def _still_needed(here: Traced, name: str) -> bool:
    """Whether the held-out error rises when an accepted effect is taken away again."""
    residual, fitted = _without_columns(here, name)
    own = [k for k, n in enumerate(here.case.parameters.free) if n in effect(name).names]
    low, high = _room(here)
    room = (np.delete(low, own), np.delete(high, own))
    found = compared(
        held_out_residual(residual, fitted, here.split, room), held_out_of(here), here.rows, len(here.split.held_out), here.problem.noise
    )
    return found.gain > max(SURE * found.sigma, PRACTICAL)


def _without(here: Traced, name: str, refit: Refit, numerical: np.ndarray | None, how: str) -> tuple[Traced, FitResult]:
    """The loop's state after an effect was dropped and everything else refitted."""
    neutral = {n: param(n).neutral for n in effect(name).names}
    free = tuple(n for n in here.case.parameters.free if n not in neutral)
    parameters, fit = refit(here.case.parameters.replace(**neutral).with_free(free), f"without {name}")
    return traced(replace(here.case, parameters=parameters), numerical, how, here.split), fit


def channel_rms(here: Traced, residual: np.ndarray) -> dict[str, float]:
    """Rms of whitened rows per channel, in units of the noise; nan rows (never held out) are left aside."""
    out = {}
    for k, channel in enumerate(here.case.channels):
        part = residual[(here.rows.channel == k) & np.isfinite(residual)]
        out[channel] = float(np.sqrt(np.mean(part**2)))
    return out


def before_after(first: Traced, last: Traced) -> dict[str, dict[str, dict[str, float]]]:
    """Error of fit and held-out data per channel before and after, in the unit of the channel: rms = (rms / noise) x noise floor."""
    floors = {c.channel: float(np.sqrt(np.mean(c.sigma**2))) for c in first.case.model.comparisons}
    table: dict[str, dict[str, dict[str, float]]] = {}
    for word, here in (("before", first), ("after", last)):
        fit, held = channel_rms(here, here.columns.residual), channel_rms(here, held_out_of(here))
        table[word] = {
            "fit": {c: v * floors[c] for c, v in fit.items()},
            "held_out": {c: v * floors[c] for c, v in held.items()},
            "floor": floors,
        }
    return table


def ranking_rows(here: Traced, accepted: Sequence[str] = ()) -> list[dict[str, Any]]:
    """The ranking as plain rows for JSON and tables."""
    rows = []
    for s in here.ranking.scores:
        proved = here.proofs.get(s.effect)
        rows.append(
            {
                "effect": s.effect,
                "family": list(s.family),
                "z": s.z,
                "predicted_drop": s.predicted_drop,
                "numerical_drop": s.numerical_drop,
                "estimate": {name: {"value": v, "sigma": s.sigma[name], "unit": param(name).unit} for name, v in s.estimate.items()},
                "detectability": s.detectability,
                "detectable": s.detectable,
                "held_out_gain": None if proved is None else proved.gain,
                "held_out_sigma": None if proved is None else proved.sigma,
                "accepted": s.effect in accepted,
                "remark": here.why_not(s),
            }
        )
    return rows
