"""Tables of `diagnose` and `close-loop` on a terminal: the ranked effects, what was tried, error before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from thermofit.cli.numbers import number
from thermofit.report.local_words import balance_lines, drift_line

_SHOWN = 12


def show(console: Console, result: Mapping[str, Any]) -> None:
    """Ranking of the first round, trials of all rounds, before and after; what could not be asked or decided."""
    _ranking(console, result["ranking"])
    _trials(console, result.get("rounds") or ())
    if "before" in result and "after" in result:
        _before_after(console, result["before"], result["after"])
    if result.get("not_asked"):
        console.print(
            f"not asked  {', '.join(result['not_asked'])}: this driver, its channels or its records do not tell them", soft_wrap=True
        )
    for text in result.get("undecided") or ():
        console.print(f"undecided  {text}", soft_wrap=True)
    if result.get("unlisted"):
        unlisted_lines(console, result["unlisted"])
    if result.get("local_balances"):
        for text in balance_lines(result["local_balances"]):
            console.print(f"balance   {text}", soft_wrap=True)
    for row in (result.get("drift") or {}).get("found", ()):
        console.print(f"drift     {drift_line(row)}", soft_wrap=True)
    if result.get("pose"):
        console.print(f"pose      {_pose(result['pose'])}", soft_wrap=True)
    if result.get("could_show"):
        console.print(f"could show {_could_show(result['could_show'])}", soft_wrap=True)
    if result.get("grade"):
        console.print(f"grade     {result['grade']}")
    if result.get("study"):
        console.print(f"study     {result['study']}", soft_wrap=True)


def _could_show(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The smallest amplitude of every effect that this test names with even odds; what is not felt at all comes last."""
    shown, unfelt = [], []
    for name, row in rows.items():
        if row["detectable"] is None:
            unfelt.append(name)
        else:
            unit = "" if row["unit"] == "1" else f" {row['unit']}"
            shown.append(f"{row['parameter']} from {number(row['detectable'], 2)}{unit}")
    return ", ".join(shown) + (f"; nothing of {', '.join(unfelt)}" if unfelt else "")


def _pose(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The pose of the infrared camera as fitted, beside the error of its landmarks."""
    said = []
    for name, row in rows.items():
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        sigma = "" if row["sigma"] is None else f" +- {number(row['sigma'], 2)}"
        by = "" if row["landmarks"] is None else f" (landmarks +- {number(row['landmarks'], 2)})"
        said.append(f"{name} {number(row['value'], 2)}{sigma}{unit}{by}")
    return ", ".join(said)


def _table(title: str, columns: tuple[str, ...]) -> Table:
    out = Table(title=title, title_justify="left")
    for k, column in enumerate(columns):
        out.add_column(column, justify="left" if k == 0 else "right", no_wrap=k == 0, overflow="fold")
    return out


def _estimate(row: Mapping[str, Any]) -> str:
    parts = []
    for name, e in row["estimate"].items():
        unit = "" if e["unit"] == "1" else f" {e['unit']}"
        sigma = "" if e["sigma"] is None else f" +- {number(e['sigma'], 2)}"
        parts.append(f"{name.partition('.')[2] or name} {number(e['value'], 4)}{sigma}{unit}")
    return "\n".join(parts)


def _gain(row: Mapping[str, Any]) -> str:
    if row["held_out_gain"] is None:
        return "-"
    if row["held_out_gain"] < -1.0:
        return "worse"
    return f"{100 * row['held_out_gain']:.2f} +- {100 * row['held_out_sigma']:.2f}"


def _ranking(console: Console, rows: list[Mapping[str, Any]]) -> None:
    columns = ("effect", "also", "z", "chi2 drop", "one-step estimate", "held-out gain %", "detectable", "remark")
    out = _table("effects, the strongest first", columns)
    for row in rows[:_SHOWN]:
        mark = "added" if row["accepted"] else row["remark"]
        also = ", ".join(row["family"][1:])
        drop = number(row["predicted_drop"], 3)
        out.add_row(row["effect"], also, f"{row['z']:.2f}", drop, _estimate(row), _gain(row), number(row["detectable"], 3), mark)
    console.print(out)
    if len(rows) > _SHOWN:
        console.print(f"and {len(rows) - _SHOWN} weaker ones, see --json")


def _trials(console: Console, rounds: Any) -> None:
    tried = [(n, t) for n, r in enumerate(rounds, start=1) for t in r["tried"]]
    if not tried:
        return
    out = _table("tried by a refit", ("round", "effect", "estimate", "held-out gain %", "result"))
    for n, t in tried:
        said = [t["remark"] or "added", *([f"exponents: {t['exponents']}"] if t["exponents"] else []), *filter(None, [t.get("readings")])]
        out.add_row(str(n), t["effect"], _estimate(t), _gain(t), "; ".join(said))
    console.print(out)


def _before_after(console: Console, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    """Errors with their standard errors, beside what the noise and what the error of mesh and steps alone would give."""
    floors = ("noise", "mesh and steps")
    out = _table("rms error", ("channel", *floors, "fit before", "fit after", "held out before", "held out after"))
    for channel, floor in after["floor"].items():
        errors = (_error(error, kind, channel) for kind in ("fit", "held_out") for error in (before, after))
        out.add_row(channel, number(floor, 4), number(after["numerical"].get(channel), 2), *errors)
    console.print(out)


def _error(table: Mapping[str, Any], kind: str, channel: str) -> str:
    """An error with one digit of its standard error."""
    value, sigma = table[kind].get(channel), table[f"{kind}_sigma"].get(channel)
    return number(value, 4) if sigma is None else f"{value:.4g} +- {sigma:.1g}"


def unlisted_lines(console: Console, said: Mapping[str, Any]) -> None:
    """What no effect of the catalogue explains: place, window, strength, error with the reconstructed term, hints, files."""
    listed = said["best_listed"]
    explained = "no listed effect explains any of it"
    if listed is not None:
        explained = f"{listed['effect']} explains {100 * listed['explains']:.0f} % of it"
    if said["where"] is None:
        law = said["over_state"]
        what = "" if law is None else f"a yield stress over {law['variable']}, up to {number(law['largest_MPa'])} MPa, "
        console.print(f"unlisted  {what}in {said['channel']}; {explained}", soft_wrap=True)
        _more(console, said)
        return
    out = _table(f"unlisted: a {said['kind']} in {said['channel']}; {explained}", ("", "value"))
    for key, value in said["where"].items():
        out.add_row(key, value if isinstance(value, str) else str(value) if isinstance(value, bool) else number(value))
    out.add_row("from, to in s", ", ".join(number(t) for t in said["when_s"]))
    out.add_row("phases", ", ".join(said["phases"]))
    amount = said["amount"]
    out.add_row(f"mean in that window, {said['unit']}", f"{number(amount['value'])} +- {amount['sigma']:.1g}")
    for channel, before in said["before"]["held_out"].items():
        out.add_row(f"held-out {channel} without, with", f"{before:.4g}, {said['after']['held_out'][channel]:.4g}")
    for hint in said["hints"][:3]:
        out.add_row("goes with (hint)", f"{hint['variable']}, chosen in {100 * hint['frequency']:.0f} % of the halves")
    console.print(out)
    _parameters(console, said.get("parameters"))
    _more(console, said)


def _parameters(console: Console, beside: Mapping[str, Any] | None) -> None:
    """The base model's parameters beside an unlisted heat, which has driven those of the joint fit off."""
    if beside is None:
        return
    if beside["failed"]:
        console.print(f"! {beside['failed']}", soft_wrap=True)
        return
    table = _table("parameters beside the unlisted heat, which drives those of the joint fit off", ("", "beside it", "joint fit", "unit"))
    for name, row in beside["values"].items():
        table.add_row(name, f"{number(row['value'], 4)} +- {row['sigma']:.1g}", number(row["joint_fit"], 4), row["unit"])
    console.print(table)


def _more(console: Console, said: Mapping[str, Any]) -> None:
    """Effects that only resembled an unlisted one, or are accepted beside it, and files."""
    if said["resembles"]:
        console.print(f"taken back  {', '.join(said['resembles'])}: only resembled it", soft_wrap=True)
    if said["beside"]:
        console.print(f"beside    {', '.join(said['beside'])}: a part of the answer, or only like what is missing", soft_wrap=True)
    for word in ("effect_file", "figure"):
        if said.get(word):
            console.print(f"{word.replace('_', ' '):<11} {said[word]}", soft_wrap=True)
