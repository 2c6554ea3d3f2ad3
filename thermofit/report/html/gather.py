"""From the artefacts of a run to what its report says; nothing is computed anew, and what is absent is named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit import __version__
from thermofit.core.errors import StudyError
from thermofit.effects.catalogue import effect, is_of_effect
from thermofit.records.artefact import ParameterResult, Record, other_sources
from thermofit.records.result import is_trustworthy
from thermofit.report.html.content import (
    FORMAT,
    Asked,
    Bars,
    Correlation,
    Level,
    PhaseRow,
    Profile,
    Remark,
    Report,
    Rung,
    Smallest,
    StageState,
    Value,
    Verdict,
)
from thermofit.report.html.run_folder import IDENTIFY, NEEDED, REFINE, RunFolder
from thermofit.report.local_words import steps_in_words, with_article
from thermofit.report.unlisted import of_the_catalogue, place_in_words
from thermofit.study.section import recorded_mesh
from thermofit.study.study import Study

LOOP, DIAGNOSE, VERIFY = "close-loop", "diagnose", "verify"
_NORMAL = 1.96
"""Half width of a 95 % interval in standard errors."""
_QUIET = 1.25
"""Times the noise up to which a channel counts as explained (docs/diagnosis.md, "When an answer is trusted")."""
PROMISING = "promising, not refused"
"""Of an effect that nothing speaks against, and that was not tried."""
_WORDS = {
    "u": "displacement",
    "du": "displacement",
    "du_x": "displacement across the load",
    "du_y": "displacement along the load",
    "strain": "strain",
    "theta": "temperature",
    "dtheta": "temperature rise",
    "force": "force",
    "stress": "stress",
    "lateral": "lateral strain",
}
_MESHES = {"full": "the fine mesh", "coarse": "the coarse mesh", "sheet": "the sheet"}


def channel_words(channel: str) -> str:
    """A channel in the field's words, with the experiment that it is of."""
    name, at, test = channel.partition("@")
    return _WORDS.get(name, name) + (f" of {test}" if at else "")


def report_of(run: RunFolder, study: Study | None = None, failure: str = "") -> Report:
    """The content of the report of a run; the study, where it is known, gives names of files and the truth of a virtual test; `failure`:
    the error that ended the run."""
    file = "STUDY.yaml" if study is None else study.source.name
    judged = next((run.records[stage] for stage in (LOOP, DIAGNOSE) if run.has(stage)), None)
    summary: Mapping[str, Any] = {} if judged is None else judged.summary
    bars = [_with_scatter(bar, run) for bar in _bars(run, judged)]
    ladder = _ladder(summary)
    added = {str(name): _family(str(name), summary) for name in summary.get("accepted", ())}
    return Report(
        format=FORMAT,
        name=run.path.name if study is None else study.name,
        made_with=f"thermofit {__version__}",
        verdict=_verdict(run, bars, ladder, added, file, failure),
        bars=bars,
        ladder=ladder,
        smallest=_smallest(summary),
        not_shown=_not_shown(summary),
        decide=[str(text) for text in summary.get("undecided", ())],
        unlisted=summary.get("unlisted"),
        local_balances=summary.get("local_balances"),
        drift=summary.get("drift"),
        facts=_facts(run),
        parameters=_parameters(run, study),
        phases=_phases(run, judged),
        correlations=list(_correlations(run)),
        profiles=list(_profiles(run)),
        stages=_stages(run, file),
        missing=_missing(run, file),
        remarks=[
            Remark(stage=s, text=str(text))
            for s in run.reached()
            for kind in ("remarks", "notes")
            for text in run.records[s].summary.get(kind, ())
        ],
    )


# The sentence.


def _verdict(
    run: RunFolder, bars: Sequence[Bars], ladder: Sequence[Rung], added: Mapping[str, Sequence[str]], file: str, failure: str
) -> Verdict:
    """The sentence of the first page by how far the run has come; `added`: effects in the model with what could stand for each."""
    last = next((stage for stage in (LOOP, DIAGNOSE, VERIFY) if run.has(stage)), "")
    open_ones = _open(run, last)
    trusted = bool(last) and is_trustworthy(run.records[last])
    asked: Asked
    if last == LOOP:
        asked, text, step = "loop", _loop_sentence(bars, added, trusted), ""
    elif last == DIAGNOSE:
        asked, step = "diagnosis", f"thermofit close-loop {file}"
        first = next((rung for rung in ladder if rung.gain is not None and rung.gain > 0.0 and rung.why == PROMISING), None)
        text = "The residual points to no listed effect"
        if first is not None:
            like = _like([name for name in first.family if name not in first.effects])
            gain = f"{100.0 * (first.gain or 0.0):.2g} %"
            text = f"The residual points to {_listed(first.effects)}{like}, which would lower the error on unseen data by {gain}"
        text += "; nothing has been added yet."
    elif last == VERIFY:
        asked, step = "verification", f"thermofit close-loop {file}"
        text = f"{_fit_sentence(bars)}; whether the model lacks an effect has not been asked."
    elif run.has("necking"):
        record = run.records["necking"]
        asked, step, trusted = "identification", "", is_trustworthy(record)
        text = f"Necking test: {record.summary.get('verdict', '')}."
    else:
        reached = run.reached()
        asked = "identification" if set(reached) & set(IDENTIFY) else "nothing"
        step = f"thermofit run {file}"
        where = f"after {reached[-1]}" if reached else "before its first stage"
        text = f"The run stopped {where}: there is no answer yet, and this page shows what there is."
    if failure:
        open_ones = [f"the last command ended with an error: {failure}", *open_ones]
    return Verdict(sentence=text, asked=asked, trustworthy=trusted and not failure, open=open_ones, next_step=step)


def _loop_sentence(bars: Sequence[Bars], added: Mapping[str, Sequence[str]], trusted: bool) -> str:
    if added:
        it = "it" if len(added) == 1 else "them"
        names = [name + _like(others) for name, others in added.items()]
        return f"The model lacks {_listed(names)}; with {it}, the error on unseen data falls {_falls(bars)}."
    worst = max((b for b in bars if b.held_out.after), key=lambda b: b.held_out.after or 0.0, default=None)
    level = "" if worst is None else f": the error on unseen data is {_number(worst.held_out.after)} times the noise ({worst.words})"
    if trusted:
        return f"Nothing is missing down to the amplitudes that this test can show{level}."
    return f"No listed effect explains what the model leaves{level}."


def _like(others: Sequence[str]) -> str:
    """Effects that this test cannot tell from one, in brackets."""
    return f" (or its like, {_listed(others, 'or')})" if others else ""


def _family(name: str, summary: Mapping[str, Any]) -> list[str]:
    """What this test cannot tell from an effect that was added: at the end of the loop; in older records of the search for a test that
    would, else of its own trial."""
    if name in (summary.get("stand_ins") or {}):
        return list(summary["stand_ins"][name])
    for found in summary.get("programmes") or ():
        if found.get("added") == name:
            return [other for other in found["family"] if other != name]
    for turn in summary.get("rounds", ()):
        for trial in turn["tried"]:
            if trial["accepted"] and trial["effects"] == [name]:
                return [other for other in trial["family"] if other != name]
    return []


def _falls(bars: Sequence[Bars]) -> str:
    """Error on unseen data before and after, of the channel in which it falls most."""
    known = [b for b in bars if b.held_out.before and b.held_out.after]
    if not known:
        return "by an amount that is not known"
    most = max(known, key=lambda b: (b.held_out.before or 0.0) / (b.held_out.after or 1.0))
    text = f"from {_number(most.held_out.before)} to {_number(most.held_out.after)} times the noise"
    return text + (f" ({most.words})" if len(known) > 1 or most.channel != "stress" else "")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if value >= 10.0 else f"{value:.2f}"


def _fit_sentence(bars: Sequence[Bars]) -> str:
    worst = max((b for b in bars if b.fit.after is not None), key=lambda b: b.fit.after or 0.0, default=None)
    if worst is None:
        return "The fitted model has been run against all data"
    level = f"{worst.words} is left at {_number(worst.fit.after)} times its noise"
    if (worst.fit.after or 0.0) <= _QUIET:
        return f"The fitted model explains its data: at worst {level}"
    return f"The fitted model does not explain its data: {level}"


def _listed(names: Sequence[str], word: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}" if names else "nothing"


def _open(run: RunFolder, last: str) -> list[str]:
    """What is still open: doubts of the stage that judges, an unlisted term, stale artefacts, effects that could not be told apart."""
    found: list[str] = []
    if last:
        summary = run.records[last].summary
        found += [str(text) for text in summary.get("doubts", ())]
        if (said := summary.get("unlisted")) is not None:
            found.append(unlisted_words(said))
        if last == VERIFY and not is_trustworthy(run.records[last]):
            found.append(str(summary.get("verdict", "")))
        found += [f"which of them it is: {str(text).partition(':')[0]}" for text in summary.get("undecided", ()) if " or " in str(text)]
    found += [f"{stage}: {reason}" for stage in run.reached() for reason in run.stale[stage]]
    return list(dict.fromkeys(text for text in found if text))


def unlisted_words(said: Mapping[str, Any]) -> str:
    """An unlisted term in one clause."""
    where, when = said.get("where"), said.get("when_s")
    share = f"{100 * float(said.get('excess_share') or 0.0):.3g} % of the misfit of the {channel_words(str(said.get('channel')))}"
    if where is None or when is None:
        return f"{share} is systematic, and {of_the_catalogue(said)}"
    # Artefacts of earlier versions hold no standard error of it.
    amount = said.get("amount") or {"value": said.get("mean_in_window") or 0.0, "sigma": None, "unit": said.get("unit")}
    doubt = "" if amount["sigma"] is None else f" +- {amount['sigma']:.1g}"
    size = f"{amount['value']:.3g}{doubt} {amount['unit']}"
    what = f"{with_article(str(said.get('kind')))} of {size} {place_in_words(where)} from {when[0]:.4g} to {when[1]:.4g} s"
    steps = f", in steps of {steps_in_words(said)}" if said.get("steps") else ""
    return f"{what}{steps} ({share}; {of_the_catalogue(said)})"


# Errors.


def _bars(run: RunFolder, judged: Record | None) -> list[Bars]:
    """Errors over the noise of every channel by which the model is judged."""
    if judged is not None and "before" in judged.summary and "after" in judged.summary:
        return _loop_bars(judged.summary)
    if judged is not None:
        return [_fit_bar(name, c, _floor(judged.summary, name)) for name, c in judged.summary.get("channels", {}).items()]
    for stage in (VERIFY, *reversed(IDENTIFY)):
        if run.has(stage):
            channels = run.records[stage].summary.get("channels", {})
            # Components of a channel say nothing that it does not say itself.
            used = {name: c for name, c in channels.items() if c.get("judged", True) and name not in ("du_x", "du_y")}
            return [_fit_bar(name, c, None) for name, c in used.items() if c.get("floor_rms")]
    return []


def _with_scatter(bar: Bars, run: RunFolder) -> Bars:
    """A bar of the stress of coupons with the mark of what repeated records scatter."""
    if bar.channel != "stress" or not run.has(VERIFY) or not bar.noise:
        return bar
    scatter = scatter_of_records(run.records[VERIFY], run.records.get("interpolate"))
    return bar if scatter is None else bar.model_copy(update={"scatter": scatter / bar.noise})


def _fit_bar(name: str, channel: Mapping[str, Any], floor: float | None) -> Bars:
    noise = float(channel["floor_rms"])
    fit = Level(after=float(channel["rms"]) / noise if noise else None)
    unit = str(channel["unit"])
    return Bars(channel=name, words=channel_words(name), unit=unit, noise=noise, fit=fit, held_out=Level(), floor=floor, scatter=None)


def _loop_bars(summary: Mapping[str, Any]) -> list[Bars]:
    before, after = summary["before"], summary["after"]
    channels = summary.get("channels", {})
    found = []
    for name, noise in after["floor"].items():
        if not noise:
            continue

        def level(kind: str, name: str = name, noise: float = noise) -> Level:
            values = [side.get(key, {}).get(name) for side in (before, after) for key in (kind, f"{kind}_sigma")]
            a, a_sigma, b, b_sigma = (None if v is None else float(v) / float(noise) for v in values)
            return Level(before=a, before_sigma=a_sigma, after=b, after_sigma=b_sigma)

        floor = after.get("numerical", {}).get(name)
        found.append(
            Bars(
                channel=name,
                words=channel_words(name),
                unit=str(channels.get(name, {}).get("unit", "")),
                noise=float(noise),
                fit=level("fit"),
                held_out=level("held_out"),
                floor=None if floor is None else float(floor) / float(noise),
                scatter=None,
            )
        )
    return found


def _floor(summary: Mapping[str, Any], channel: str) -> float | None:
    """Rms of the error of mesh and steps of a channel over its noise, from its phases."""
    rows = [r for r in summary.get("lack_of_fit", ()) if r["channel"] == channel and r.get("numerical") is not None]
    n = sum(r["n"] for r in rows)
    return float(np.sqrt(sum(r["n"] * r["numerical"] for r in rows) / n)) if n else None


# Candidate causes.


def _ladder(summary: Mapping[str, Any]) -> list[Rung]:
    """All candidate causes, what was added first, then by the gain on unseen data."""
    rounds: Sequence[Mapping[str, Any]] = summary.get("rounds", ())
    rungs: dict[str, Rung] = {}
    latest = {row["effect"]: row for turn in rounds[1:] for row in turn["ranking"]}
    for row in summary.get("ranking", ()):
        why, later = str(row["remark"]), latest.get(row["effect"])
        if later is not None and not row.get("accepted"):
            why = f"beside what was added: {later['remark'] or PROMISING}"
        outside = ", outside " in str(row["remark"])
        rungs[row["effect"]] = _rung(
            row, "beyond its bounds" if outside else "not tried", str(row["remark"]) if outside else why or PROMISING
        )
    for number, turn in enumerate(rounds, 1):
        for trial in turn["tried"]:
            added = bool(trial["accepted"])
            known = rungs.get(trial["effect"])
            if known is not None and known.state == "added":
                continue
            why = f"added in round {number}" if added else str(trial["remark"])
            rungs[trial["effect"]] = _rung(trial, "added" if added else "refused", why)
    dropped = set(summary.get("dropped", ()))
    for name in dropped & set(rungs):
        rungs[name] = rungs[name].model_copy(update={"state": "refused", "why": "added, then no longer needed beside the others"})
    for turn in rounds:
        for name in turn["added"] if len(turn["added"]) > 1 else ():
            others = _listed([other for other in turn["added"] if other != name])
            if name in rungs and rungs[name].state == "not tried":
                rungs[name] = rungs[name].model_copy(update={"state": "added", "why": f"added together with {others}"})

    def place(rung: Rung) -> tuple[int, float, float]:
        added = 0 if rung.state == "added" else 2 if rung.state == "beyond its bounds" else 1
        return added, -(rung.gain if rung.gain is not None else -1.0), -(rung.z or 0.0)

    return sorted(rungs.values(), key=place)


def _rung(row: Mapping[str, Any], state: Any, why: str) -> Rung:
    names = [str(name) for name in row.get("effects") or [row["effect"]]]
    gain, sigma, z = (None if row.get(key) is None else float(row[key]) for key in ("held_out_gain", "held_out_sigma", "z"))
    parts = [_estimate(name, e) for name, e in row.get("estimate", {}).items()]
    return Rung(
        effects=names,
        family=[str(name) for name in row.get("family", ())],
        formula="; ".join(formula for name in names if (formula := _formula(name))),
        gain=gain,
        gain_sigma=sigma,
        z=z,
        estimate=", ".join(parts),
        state=state,
        why=why,
    )


def _estimate(name: str, found: Mapping[str, Any]) -> str:
    sigma = "" if found.get("sigma") is None else f" \u00b1 {float(found['sigma']):.2g}"
    unit = "" if found.get("unit") in ("1", None) else f" {found['unit']}"
    value = "-" if found.get("value") is None else f"{float(found['value']):.4g}"
    return f"{name.rpartition('.')[2]} {value}{sigma}{unit}"


def _formula(name: str) -> str:
    """Formula of an effect; empty for one that is not in this installation (a user's own)."""
    try:
        return effect(name).formula
    except StudyError:
        return ""


def _smallest(summary: Mapping[str, Any]) -> list[Smallest]:
    """Smallest amplitudes beside everything that was added, the best told effect first."""
    rounds: Sequence[Mapping[str, Any]] = summary.get("rounds", ())
    ranking = rounds[-1]["ranking"] if rounds else summary.get("ranking", ())
    found = []
    for row in ranking:
        estimate = row.get("estimate", {})
        if row.get("detectable") is None or not estimate:
            continue
        parameter = next(iter(estimate))
        share = row.get("detectability")
        found.append(
            Smallest(
                effect=str(row["effect"]),
                parameter=parameter,
                amplitude=float(row["detectable"]),
                unit=str(estimate[parameter].get("unit", "1")),
                share_of_its_own=None if share is None else float(share),
            )
        )
    return sorted(found, key=lambda one: -(one.share_of_its_own or 0.0))


def _not_shown(summary: Mapping[str, Any]) -> list[str]:
    """Effects of which this test says nothing."""
    found = [f"{name}: this test does not respond to it" for name in summary.get("unfelt", ())]
    found += [f"{name}: could not be judged, {reason}" for name, reason in dict(summary.get("unjudged", {})).items()]
    if names := summary.get("not_asked"):
        found.append(f"not asked, because this test holds nothing on which they act: {', '.join(map(str, names))}")
    return found


# Numbers.


def _parameters(run: RunFolder, study: Study | None) -> list[Value]:
    """Every fitted parameter: of the last model of the loop, else of the verified one, else of each stage so far."""
    found: dict[str, tuple[ParameterResult, str]] = {}
    starts: dict[str, float] = {}
    for stage in (*IDENTIFY, REFINE, "necking", VERIFY, DIAGNOSE, LOOP):
        if run.has(stage):
            free = {name: (p, stage) for name, p in run.records[stage].parameters.items() if p.free}
            starts = {name: p.start for name, (p, _) in free.items()} | starts
            found |= free
    before: Mapping[str, Any] = {}
    if run.has(LOOP) and (rounds := run.records[LOOP].summary.get("rounds")):
        before = rounds[0]["before"]["parameters"]
    rows = []
    for name, (p, stage) in found.items():
        true = None if study is None else study.truth_of(name)
        # The record of the loop gives as start what it found.
        start = None if stage in (DIAGNOSE, LOOP) and starts[name] == p.value else starts[name]
        rows.append(_value(name, p, stage, start, before.get(name), true))
    return rows


def _value(name: str, p: ParameterResult, stage: str, start: float | None, before: float | None, true: float | None) -> Value:
    """A parameter: its start, its value before effects were added, its true value."""
    half = _NORMAL * p.sigma if p.sigma is not None and np.isfinite(p.sigma) else None
    return Value(
        name=name,
        unit=p.unit,
        value=p.value,
        sigma=None if half is None else p.sigma,
        low=None if half is None else p.value - half,
        high=None if half is None else p.value + half,
        start=start,
        lower=p.lower if np.isfinite(p.lower) else None,
        upper=p.upper if np.isfinite(p.upper) else None,
        at_bound=p.at_bound,
        of_effect=is_of_effect(name),
        before=before,
        true=true,
        stage=stage,
    )


def _phases(run: RunFolder, judged: Record | None) -> list[PhaseRow]:
    """Residual by channel and phase, of the verified model and of the last one."""
    rows: dict[tuple[str, str, int], dict[str, Any]] = {}
    count: dict[tuple[str, str, str], int] = {}

    def row(r: Mapping[str, Any], side: str) -> dict[str, Any]:
        # The same phase of both models: a record's time may start elsewhere, and phases of one name follow one another.
        channel, phase = str(r["channel"]), str(r["phase"]).replace(": ", " ")
        number = count[side, channel, phase] = count.get((side, channel, phase), 0) + 1
        new = {"channel": channel, "phase": phase, "t0_s": float(r["t0_s"]), "t1_s": float(r["t1_s"]), "n": int(r["n"])}
        return rows.setdefault((channel, phase, number), {**new, "verified": None, "last": None, "floor": None})

    for r in run.records[VERIFY].summary.get("phases", ()) if run.has(VERIFY) else ():
        if r["channel"] not in ("du_x", "du_y") and r.get("chi2_reduced") is not None:
            row(r, "verified")["verified"] = float(r["chi2_reduced"]) ** 0.5
    for r in () if judged is None else judged.summary.get("lack_of_fit", ()):
        row(r, "last").update(last=float(r["chi2_reduced"]) ** 0.5, floor=float(r["numerical"] or 0.0) ** 0.5)
    return [PhaseRow(**r) for r in rows.values()]


def _correlations(run: RunFolder) -> Iterator[Correlation]:
    for stage in (*IDENTIFY, REFINE, "identifiability"):
        record = run.records.get(stage)
        names = "names" if stage == "identifiability" else "evaluations/names"
        if record is None or not record.has("correlation") or not record.has(names):
            continue
        matrix, labels = record["correlation"].value, [str(n) for n in _texts(record[names].value)]
        if len(labels) == len(matrix) > 1:
            rows = [[float(v) if np.isfinite(v) else None for v in row] for row in matrix]
            yield Correlation(stage=stage, names=labels, matrix=rows)


def _texts(values: np.ndarray) -> list[str]:
    return [v.decode() if isinstance(v, bytes) else str(v) for v in values]


def _profiles(run: RunFolder) -> Iterator[Profile]:
    record = run.records.get("identifiability")
    for name in () if record is None else record.names:
        if record is None or not name.startswith("profile/"):
            continue
        value, rise = record[name].value.T[:2]
        own = name.removeprefix("profile/")
        unit = record.parameters[own].unit if own in record.parameters else "1"
        yield Profile(name=own, unit=unit, value=value.tolist(), rise=[float(v) if np.isfinite(v) else None for v in rise])


# Where it comes from.


def _facts(run: RunFolder) -> list[tuple[str, str]]:
    """What was measured, in rows of two."""
    rows: list[tuple[str, str]] = []
    for test, records in run.tests.items():
        record = records.get("interpolate")
        if record is None:
            continue
        s, lead = record.summary, f"{test}: " if test else ""
        say = _teller(rows, lead)
        if (own := s.get("specimen")) is not None:
            size = f"gauge {own['gauge_width']:g} mm x {own['thickness']:g} mm, parallel length {own['parallel_length']:g} mm"
            say("specimen", size)
        if (t := s.get("temperatures")) is not None and "theta_air" in t:
            say("air, jaws", f"{t['theta_air']:.2f} K, {t['theta_clamp']:.2f} K")
        if (u := s.get("displacement")) is not None and record.has("u/time"):
            noise = ", ".join(f"{1e3 * v:.2f}" for v in u["noise_mm"])
            say("displacements", f"{len(record['u/time'].value)} stages at {u.get('nodes', '?')} points; noise {noise} um in x, y")
        if (motion := s.get("motion")) is not None:
            say("displacements", f"none measured; the motion, up to {motion['largest_mm']:.3g} mm, is computed under the measured force")
        if (theta := s.get("temperature")) is not None and record.has("theta/time"):
            say("temperatures", f"{len(record['theta/time'].value)} frames; noise {1e3 * theta['noise_K']:.1f} mK")
        if (force := s.get("force")) is not None and force.get("noise_N") is not None:
            say("force", f"noise {force['noise_N']:.2f} N")
        for one in s.get("records", ()):
            say(f"record {one['record']}", f"{one['n']} samples in {one['duration_s']:.4g} s, strain {one['strain']}")
        say("repairs of the data", "; ".join(map(str, s.get("repairs", ()))))
    last = next((run.records[stage] for stage in (VERIFY, *reversed(IDENTIFY)) if run.has(stage)), None)
    if last is not None and "mesh" in last.config:
        mesh = last.config["mesh"]
        rows.append(("mesh", _MESHES[mesh] if isinstance(mesh, str) else recorded_mesh(mesh).words))
    return rows


def _teller(rows: list[tuple[str, str]], lead: str) -> Callable[[str, str], None]:
    def say(what: str, text: str) -> None:
        if text:
            rows.append((lead + what, text))

    return say


def _stages(run: RunFolder, file: str) -> list[StageState]:
    """Every stage that has run, those that could not be read, and those that are missing."""
    found = [_state(run.records[stage], run.stale[stage], file) for stage in run.reached()]
    blank: dict[str, Any] = {"created": "", "version": "", "source": "", "wall_s": None, "packages": {}, "inputs": {}}
    for stage, reason in run.unreadable.items():
        found.append(StageState(stage=stage, state="unreadable", says=reason, command=f"thermofit {stage} {file} --force", **blank))
    for stage in _absent(run):
        found.append(StageState(stage=stage, state="missing", says="has not run", command=f"thermofit {stage} {file}", **blank))
    return found


def _state(record: Record, reasons: Sequence[str], file: str) -> StageState:
    other = other_sources(record)
    state = "stale" if reasons else "done" if is_trustworthy(record) else "doubtful"
    a = record.attributes
    evaluations: Mapping[str, Any] = record.summary.get("evaluations", {})
    wall = evaluations.get("wall_s")
    says = "; ".join([str(record.summary.get("verdict", "")), *reasons, *([other] if other else [])])
    return StageState(
        stage=record.stage,
        state=state,
        says=says,
        command=f"thermofit {record.stage} {file}",
        created=str(a["created"]),
        version=str(a["thermofit_version"]),
        source=str(a["source_digest"]),
        wall_s=None if wall is None else float(wall),
        packages={str(k): str(v) for k, v in a["packages"].items()},
        inputs={str(k): str(v) for k, v in record.inputs.items()},
    )


def _absent(run: RunFolder) -> list[str]:
    """Stages that this kind of run needs and that are not there."""
    if run.has("necking"):
        return []
    here = {stage for records in run.tests.values() for stage in records} | set(run.records) | set(run.unreadable)
    needed = list(NEEDED)
    if any(records["interpolate"].has("theta/time") for records in run.tests.values() if "interpolate" in records):
        needed.insert(needed.index(VERIFY), IDENTIFY[2])
    return [stage for stage in needed if stage not in here]


def _missing(run: RunFolder, file: str) -> list[str]:
    """What the report cannot show, and the command that would make it."""
    shows = {
        "interpolate": "measured fields and everything after them",
        "identify-elastic": "elastic parameters and everything after them",
        "identify-plastic": "plastic parameters",
        "identify-thermal": "thermal parameters",
        "verify": "the model beside the data, residual maps and residuals by phase",
        "close-loop": "candidate causes, errors on unseen data and maps before and after",
    }
    found = [f"{shows[stage]}: `thermofit {stage} {file}`" for stage in _absent(run)]
    found += [f"{stage}: {reason}" for stage, reason in run.unreadable.items()]
    if not run.has("identifiability"):
        found.append(f"profiles and intervals beyond the noise: `thermofit identifiability {file} --profile`")
    return found


_SAME_RATE = 1.25
"""Factor between the strain rates of records that count as repeated."""
_SAME_TEMPERATURE = 3.0
"""K between their temperatures before the test."""
_FROM, _LEVELS = 0.2, 100
"""Share of the common strain from which records are compared, beyond where they find their grip, and the number of levels."""
_TURN = 0.02
"""Part of its largest strain by which a record must go back before its first loading ends."""
_LEAST = 10


@dataclass(frozen=True)
class FirstLoading:
    """First loading of a record: strain and stress in MPa (n,), its strain rate 1/s, its temperature before the test in K."""

    strain: np.ndarray
    stress: np.ndarray
    rate: float
    theta: float


def first_loading(time: np.ndarray, strain: np.ndarray, stress: np.ndarray, theta: float) -> FirstLoading | None:
    """The part of a record (n,) up to its first turn; None where that is too short. Strain and stress are counted in its sense."""
    moved = strain - strain[0]
    end = int(np.argmax(np.abs(moved)))
    sense = float(np.sign(moved[end]))
    most = np.maximum.accumulate(sense * moved)
    back = np.flatnonzero(most - sense * moved > _TURN * most[-1])
    end = int(np.argmax(most[: back[0]])) if len(back) else end
    if end < _LEAST or not time[end] > time[0]:
        return None
    keep = np.r_[True, np.diff(most[: end + 1]) > 0.0]
    rate = sense * float(moved[end]) / float(time[end] - time[0])
    return FirstLoading((sense * moved)[: end + 1][keep], sense * stress[: end + 1][keep], sense * rate, theta)


def scatter_of(loadings: Sequence[FirstLoading]) -> float | None:
    """Standard deviation in MPa between repeated records at the same strain, rms over the strain and over all groups; None where no test
    was repeated."""
    found = [_scatter(group) for group in _groups(loadings) if len(group) > 1]
    weight = sum(n for n, _ in found)
    return float(np.sqrt(sum(n * variance for n, variance in found) / weight)) if weight else None


def _groups(loadings: Sequence[FirstLoading]) -> Iterator[list[FirstLoading]]:
    """Records of one sense, rate and temperature; each belongs to the first one that it resembles."""
    left = list(loadings)
    while left:
        first = left[0]
        alike = [
            one
            for one in left
            if one.rate * first.rate > 0.0
            and 1.0 / _SAME_RATE <= one.rate / first.rate <= _SAME_RATE
            and abs(one.theta - first.theta) <= _SAME_TEMPERATURE
        ]
        left = [one for one in left if not any(one is other for other in alike)]
        yield alike


def _scatter(group: Sequence[FirstLoading]) -> tuple[int, float]:
    """Degrees of freedom and mean variance of the stress between records at the strains that all of them reach."""
    reach = min(float(one.strain[-1]) for one in group)
    level = np.linspace(_FROM * reach, reach, _LEVELS)
    stress = np.stack([np.interp(level, one.strain, one.stress) for one in group])
    return len(group) - 1, float(np.mean(np.var(stress, axis=0, ddof=1)))


def scatter_of_records(verify: Record, interpolate: Record | None) -> float | None:
    """The same of the records of a verified run of coupons. None without records, or where none was repeated."""
    rows = () if interpolate is None else interpolate.summary.get("tests", ())
    found = []
    for k, facts in enumerate(rows):
        names = [f"curves/{k}/{key}" for key in ("time", "measured_strain", "measured_stress")]
        if all(verify.has(name) for name in names):
            time, strain, stress = (verify[name].value for name in names)
            if (one := first_loading(time, strain, stress, float(facts["theta_start"]))) is not None:
                found.append(one)
    return scatter_of(found)
