"""What `diagnose` and `close-loop` leave behind: summaries for JSON and tables, parameters, datasets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thermofit.core.parameters import param
from thermofit.diagnose.before_after import before_after, channel_rms, error_datasets
from thermofit.diagnose.beside_source import BesideSource
from thermofit.diagnose.case import Case, nowhere
from thermofit.diagnose.loop import Closed, Round, RoundEnd, like_of, place_of, ranking_rows
from thermofit.diagnose.pose import not_asked_of_pose
from thermofit.diagnose.prepared import Prepared
from thermofit.diagnose.proof_other_tests import held_out_words
from thermofit.diagnose.refit import failed_in_words
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.trial import Trial
from thermofit.effects.catalogue import effect
from thermofit.experiment.channels import field_of
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.residuals import lag_ones
from thermofit.experiment.trust import ChannelLevel, above_floor, doubts, grade, level, undetermined
from thermofit.fit.result import FitResult
from thermofit.identify.solve import merged_counts
from thermofit.records.artefact import Dataset, ParameterResult
from thermofit.study.study import Study


def diagnosis_parameters(
    study: Study, case: Case, fit: FitResult, by_noise: np.ndarray | None = None, beside: BesideSource | None = None
) -> dict[str, ParameterResult]:
    """All parameters of the joint model: the fitted ones with standard error, and with that (n_p,) by the noise alone where it is known.
    Parameters that an unlisted heat has driven off have none where they are not told `beside` it either: that of the joint fit is not
    theirs."""
    results, off = {}, driven_off(fit.names, beside)
    for name in case.parameters.given():
        free = name in fit.names
        k = fit.names.index(name) if free else -1
        known = fit.converged and fit.sigma is not None and free and name not in off and np.isfinite(fit.sigma[k])
        sigma = float(fit.sigma[k]) if known else None  # type: ignore[index]
        low, high = study.bounds(name)
        value = case.parameters[name]
        noise = None if by_noise is None or sigma is None else float(by_noise[k])
        at_bound = bool(free and fit.at_bound[k])
        results[name] = ParameterResult(value, sigma, param(name).unit, free, at_bound, value, low, high, sigma_noise=noise)
    return results


def driven_off(names: Sequence[str], beside: BesideSource | None) -> tuple[str, ...]:
    """Fitted parameters that temperatures feel and that are not told beside an unlisted heat, where there is one."""
    return () if beside is None else tuple(n for n in acting_on_temperatures(names) if n not in beside.value)


def channels_of(here: Traced) -> dict[str, dict[str, Any]]:
    """Per channel: number, rms, unit, reduced chi-square, floor."""
    table = {}
    for k, c in enumerate(here.case.model.comparisons):
        part = here.columns.residual[here.rows.channel == k]
        floor = float(np.sqrt(np.mean(c.sigma**2)))
        chi2 = float(np.mean(part**2))
        table[c.channel] = {"n": len(part), "rms": floor * chi2**0.5, "unit": c.unit, "chi2_reduced": chi2, "floor_rms": floor}
    return table


def lack_of_fit(here: Traced) -> list[dict[str, Any]]:
    """Per channel and phase: reduced chi-square, what the error of mesh and steps may add to it, mean, and the correlation of whitened
    residuals of neighbouring times at a point, and of neighbouring points at a time (None where there is one point)."""
    rows, at, numerical = [], 0, _may_be_left(here)
    for k, comparison in enumerate(here.case.model.comparisons):
        own = np.arange(at, at + comparison.n)
        at += comparison.n
        for number, span in enumerate(here.case.spans):
            chosen = here.rows.phase[own] == number
            if chosen.any():
                part = own[chosen]
                r = here.columns.residual[part]
                in_time, in_space = _lags(here.case, k, chosen, r)
                rows.append(
                    {
                        "channel": comparison.channel,
                        "phase": span.name,
                        "t0_s": round(span.t0, 3),
                        "t1_s": round(span.t1, 3),
                        "n": len(part),
                        "chi2_reduced": float(np.mean(r**2)),
                        "numerical": float(np.mean(numerical[part] ** 2)),
                        "mean": float(r.mean()),
                        "lag_one_time": in_time,
                        "lag_one_space": in_space,
                    }
                )
    return rows


def _lags(case: Case, k: int, chosen: np.ndarray, residual: np.ndarray) -> tuple[float | None, float | None]:
    """`lag_ones` of the chosen rows (n,) of the k-th comparison."""
    comparison = case.model.comparisons[k]
    observation = case.model.observations[field_of(comparison)]
    place = comparison.rows[chosen]
    z = np.full((len(observation.time), len(observation.xy), int(place[:, 2].max()) + 1), np.nan)
    z[tuple(place.T)] = residual
    return lag_ones(z, observation.xy)


def _undecided(here: Traced) -> list[str]:
    """Families that this test cannot part, in words."""
    out = []
    for s in here.promising():
        if len(s.family) > 1:
            out.append(f"this test cannot distinguish {s.effect} from {', '.join(s.family[1:])}")
    return out


def diagnosis_summary(found: Prepared, here: Traced) -> dict[str, Any]:
    """Summary of `diagnose`."""
    promising = here.promising()
    if promising:
        names = "; ".join(f"{s.effect} (z {s.z:.1f}, held-out error {-100 * here.proofs[s.effect].gain:+.1f} %)" for s in promising[:3])
        line = f"the residual points to {names}"
    else:
        line = "no effect of the catalogue would lower the error on held-out data by more than its uncertainty"
    levels = _levels(here)
    against = doubts(
        levels,
        (here.case.model.priors, here.case.parameters),
        here.unjudged,
        ends=_ends(here, found.fit),
        unpredicted=here.unpredicted,
    )
    return {
        **_common(found, here, against),
        "verdict": _with_doubts(line, against),
        "grade": grade({s.effect: s.family[1:] for s in promising[:1]}, not promising and bool(above_floor(levels)), None),
        "could_show": could_show(here),
        "ranking": ranking_rows(here),
        "undecided": _undecided(here),
    }


def _ends(here: Traced, fit: FitResult) -> dict[str, str]:
    """What is at a bound, or without a standard error, at an optimum; nothing where the trace is not where the fit has ended."""
    same = fit.names == here.case.parameters.free and np.allclose(fit.x, here.case.parameters.vector(), rtol=1e-9)
    return undetermined(here.case.parameters, fit, here.case.bounds) if same else {}


def _may_be_left(here: Traced) -> np.ndarray:
    """Error (n,) of mesh and steps that may be left; zero where none is known."""
    error = here.problem.may_be_left
    return np.zeros(len(here.columns.residual)) if error is None else error


def _levels(here: Traced) -> list[ChannelLevel]:
    """Every channel over its floor, as a whole and in every phase."""
    whole, numerical = [], _may_be_left(here)
    for k, c in enumerate(here.case.model.comparisons):
        own = here.rows.channel == k
        square, error = (float(np.mean(v[own] ** 2)) for v in (here.columns.residual, numerical))
        places = np.flatnonzero(own)
        far = places[int(np.argmax(np.abs(here.columns.residual[places])))]
        farthest = float(here.rows.time[far]), float(abs(here.columns.residual[far]))
        whole.append(level(c.channel, square, error, c.n, largest=farthest))
    rows = lack_of_fit(here)
    return whole + [level(r["channel"], r["chi2_reduced"], r["numerical"], r["n"], r["phase"]) for r in rows]


def pose_of(here: Traced, fit: FitResult) -> dict[str, dict[str, Any]]:
    """The pose of the infrared camera as fitted, with its standard error, beside that of its landmarks; empty where it is as given."""
    declared = {prior.name: prior.sigma for prior in here.case.model.priors}
    known = fit.converged and fit.sigma is not None and fit.names == here.case.parameters.free
    sigma = dict(zip(fit.names, fit.sigma.tolist(), strict=True)) if known and fit.sigma is not None else {}
    return {
        n: {"value": here.case.parameters[n], "sigma": sigma.get(n), "landmarks": declared.get(n), "unit": param(n).unit}
        for n in sorted(here.case.pose)
    }


def _common(found: Prepared, here: Traced, against: Sequence[str], fit: FitResult | None = None) -> dict[str, Any]:
    """What both commands say; `against`: what speaks against the answer (`trust`); `fit`: the one that ends here, None: the joint fit."""
    size, counts, failures = found.size, merged_counts(found.fit), list(dict.fromkeys(found.refit.failures))
    settled = [] if found.fit.converged else ["the joint fit has not settled: traced from the optimum of the stages"]
    return {
        "trustworthy": found.fit.converged and not against,
        "doubts": [*settled, *against],
        "channels": channels_of(here),
        "lack_of_fit": lack_of_fit(here),
        "mesh": [size.n_x, size.n_y, size.n_z],
        "held_out": held_out_words(here),
        "threshold": here.ranking.threshold,
        "unfelt": list(here.ranking.unfelt),
        "not_asked": list(here.case.not_asked()),
        "evaluations": {**counts, "failed": counts["failed"] + len(failures)},
        "failed_starts": failures,
        "unjudged": dict(here.unjudged),
        "pose": pose_of(here, found.fit if fit is None else fit),
        "remarks": [*settled, *against, *found.remarks, *failed_in_words(failures)],
    }


def remark_of(trial: Trial, turn: Round) -> str:
    """Why a trial of a round was not added; empty where it was."""
    if trial.refused or trial.effects == turn.accepted:
        return trial.refused
    added, words = next((t for t in turn.trials if t.effects == turn.accepted), trial), " + ".join(turn.accepted)
    if trial.gain > added.gain:
        return f"better than {words} by no more than a standard error, with more fitted parameters"
    return f"less than {words}"


def _trial(trial: Trial, turn: Round) -> dict[str, Any]:
    estimate = {n: {"value": v, "sigma": trial.sigma.get(n), "unit": param(n).unit} for n, v in trial.estimate.items()}
    return {
        "effect": " + ".join(trial.effects),
        "effects": list(trial.effects),
        "family": list(trial.score.family),
        "z": trial.score.z,
        "predicted_drop": trial.score.predicted_drop,
        "achieved_drop": trial.achieved_drop,
        "estimate": estimate,
        "held_out_gain": None if trial.proof is None else trial.proof.gain,
        "held_out_sigma": None if trial.proof is None else trial.proof.sigma,
        "held_out_on": None if trial.proof is None else trial.proof.on or "rows of the fitted data",
        "accepted": trial.effects == turn.accepted,
        "unjudged": trial.unjudged,
        "remark": remark_of(trial, turn),
        "exponents": trial.exponents,
        "readings": trial.readings,
        "exponent_values": {n: {"value": v, "sigma": sigma, "unit": param(n).unit} for n, (v, sigma) in trial.ends.items()},
    }


def _place(place: RoundEnd) -> dict[str, Any]:
    """All that a run at a place needs: values in the units of the parameters, and which of them were fitted."""
    values = {name: place.parameters[name] for name in place.parameters.given()}
    return {"f": place.f, "free": list(place.parameters.free), "parameters": values}


def round_row(turn: Round) -> dict[str, Any]:
    """A round of the loop as plain types: ranking, trials, what was accepted."""
    return {
        "ranking": ranking_rows(turn.traced),
        "tried": [_trial(t, turn) for t in turn.trials],
        "accepted": " + ".join(turn.accepted) or None,
        "added": list(turn.accepted),
        "before": _place(place_of(turn.traced)),
        "after": None if turn.after is None else _place(turn.after),
    }


def loop_summary(found: Prepared, closed: Closed, study_file: Path) -> dict[str, Any]:
    """Summary of `close-loop`: rounds, ranking of the first round with what was accepted, error before and after."""
    table = before_after(closed.first, closed.last)
    here, unsettled = closed.last, "" if closed.fit.converged else closed.fit.message
    enough = not_asked_of_pose(here.case, closed.rounds[-1].trials if closed.rounds else ())
    against = doubts(
        _levels(here),
        (here.case.model.priors, here.case.parameters),
        closed.unjudged,
        unsettled,
        {name: words for name, words in _ends(here, closed.fit).items() if name not in enough},
        here.unpredicted,
        like_of(closed),
    )
    if closed.open_ones:
        against.append(f"{', '.join(closed.open_ones)} would be next, but --max-effects are in: allow more")
    common = _common(found, here, against, closed.fit)
    return {
        **common,
        "trustworthy": not against,
        "doubts": against,
        "remarks": [*common["remarks"], *closed.remarks, *enough.values(), *nowhere(here.case, closed.accepted)],
        "unjudged": dict(closed.unjudged),
        "verdict": _with_doubts(_verdict(closed, table), against),
        "ranking": ranking_rows(closed.first, closed.accepted),
        "grade": grade(like_of(closed), bool(above_floor(_levels(here))), None),
        "could_show": could_show(here),
        "accepted": list(closed.accepted),
        "stand_ins": {name: list(others) for name, others in like_of(closed).items()},
        "dropped": list(closed.dropped),
        "rounds": [round_row(r) for r in closed.rounds],
        "last": _place(place_of(closed.last)),
        **table,
        "study": str(study_file),
    }


def could_show(here: Traced) -> dict[str, dict[str, Any]]:
    """Of every dormant effect the smallest amplitude that this test names with even odds: what is absent is so down to these. None where
    nothing is felt of it."""
    shown = {s.effect: s.detectable for s in here.ranking.scores} | dict.fromkeys(here.ranking.unfelt)
    rows = {name: effect(name).amplitude for name in sorted(shown)}
    return {name: {"parameter": p.name, "detectable": shown[name], "unit": p.unit} for name, p in rows.items()}


def _with_doubts(line: str, against: Sequence[str]) -> str:
    """A verdict with what speaks most against it."""
    if not against:
        return line
    return f"{line}; not the whole answer: {against[0]}" + (f" (and {len(against) - 1} more, see remarks)" if len(against) > 1 else "")


def _verdict(closed: Closed, table: dict[str, Any]) -> str:
    errors = error_rows(table)
    if not closed.accepted:
        return f"nothing added: no effect lowers the held-out error by more than its uncertainty; {errors}"
    names = []
    for name, others in like_of(closed).items():
        names.append(f"{name} ({estimates_in_words(closed, name)})" + (f" or its like ({', '.join(others)})" if others else ""))
    return f"added {', '.join(names)}; {errors}"


def estimates_in_words(closed: Closed, name: str) -> str:
    """Amplitudes of an accepted effect at the last optimum, with their standard errors; which of them are held there, as those of a law
    beside a curve of any form."""
    parts, fit = [], closed.fit
    for p in effect(name).amplitudes:
        unit = "" if p.unit == "1" else f" {p.unit}"
        sigma = float(fit.sigma[fit.names.index(p.name)]) if fit.sigma is not None and p.name in fit.names else float("nan")
        said = f" +- {sigma:.2g}{unit}" if np.isfinite(sigma) else f"{unit}, {'no standard error' if p.name in fit.names else 'held'}"
        parts.append(f"{p.name.rpartition('.')[2]} {closed.last.case.parameters[p.name]:.4g}{said}")
    return ", ".join(parts)


def error_rows(table: dict[str, Any]) -> str:
    """Held-out errors before and after over the noise, in words."""
    parts = []
    for c in table["before"]["held_out"]:
        floor = table["before"]["floor"][c]
        before, after = (table[word]["held_out"][c] / floor for word in ("before", "after"))
        parts.append(f"held-out {c} {before:.3f} -> {after:.3f} times the noise")
    return ", ".join(parts)


def diagnosis_datasets(here: Traced) -> dict[str, Dataset]:
    """Residual of every row and where it is from, and the rms per channel with its standard error. The columns of fitted parameters and
    effects, of a size with all fields times parameters, are not kept: a run at the parameters of the record makes them again."""
    out = {
        "residual/value": Dataset(here.columns.residual, "1", ("row",)),
        "residual/channel": Dataset(here.rows.channel, "1", ("row",)),
        "residual/time": Dataset(here.rows.time, "s", ("row",)),
        "residual/xy": Dataset(here.rows.xy, "mm", ("row", "axis")),
        "residual/phase": Dataset(here.rows.phase, "1", ("row",)),
    }
    rms = channel_rms(here, here.columns.residual)
    out["rms/value"] = Dataset(np.array([value for value, _ in rms.values()]), "1", ("channel",))
    out["rms/sigma"] = Dataset(np.array([sigma for _, sigma in rms.values()]), "1", ("channel",))
    out["rms/channel"] = Dataset(np.array(list(rms)), "1", ("channel",))
    return out


def loop_datasets(closed: Closed) -> dict[str, Dataset]:
    """What the last model leaves, what the first one left in the same rows, and the error before and after."""
    first, last = closed.first, closed.last
    out = {**diagnosis_datasets(last), **error_datasets(before_after(first, last))}
    if np.array_equal(first.rows.channel, last.rows.channel) and np.array_equal(first.rows.time, last.rows.time):
        out["residual/before"] = Dataset(first.columns.residual, "1", ("row",))
    return out
