"""What a human reads on stdout. Everything is printed from the JSON of a result, so that both say the same."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text
from rich.tree import Tree

from thermofit.report.local_words import (
    balance_lines,
    drift_line,
    held_in_words,
    second_in_words,
    steps_in_words,
    travel_in_words,
    with_article,
)


def number(value: Any, digits: int = 5) -> str:
    """A number with so many digits; yes or no; a dash where there is none."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value) if isinstance(value, int | str) else f"{value:.{digits}g}"


def with_error(value: float, sigma: float | None) -> tuple[str, str]:
    """Value and standard error with the digits that the error warrants: two of the error, the value to the same place."""
    if sigma is None or not math.isfinite(sigma) or sigma <= 0.0:
        return number(value, 6), "-"
    place = math.floor(math.log10(sigma)) - 1
    size = math.floor(math.log10(abs(value))) if value else 0
    if -4 < size < 7:
        decimals = min(max(-place, 0), 12)
        return f"{value:.{decimals}f}", f"{sigma:.{decimals}f}"
    return f"{value:.{min(max(size - place, 0), 12)}e}", f"{sigma:.1e}"


def bounds(lower: float, upper: float) -> str:
    """Lower and upper bound."""
    return f"{number(lower, 6)} .. {number(upper, 6)}"


def percent(share: float | None) -> str:
    """A relative deviation in per cent, with sign."""
    return "-" if share is None else f"{100.0 * share:+.2f} %"


def seconds(wall: float) -> str:
    """A wall time."""
    if wall < 60.0:
        return f"{wall:.1f} s"
    return f"{int(wall // 60)} min {int(wall % 60):02d} s"


_WIDTH = 140
"""Columns where stdout is no terminal."""
_NONE = number(None)
_LONG = 8
"""A list of more plain values than this is described, not printed."""
_HEAD = (
    "stage",
    "verdict",
    "trustworthy",
    "parameters",
    "channels",
    "evaluations",
    "remarks",
    "notes",
    "artefact",
    "fresh",
    "wall_s",
    "stale",
)

Result = Mapping[str, Any]


def as_json(result: Result) -> None:
    """The result as JSON, alone on stdout."""
    typer.echo(json.dumps(result, allow_nan=False, indent=2))


def make_console() -> Console:
    """A console as wide as the terminal, or of a fixed width."""
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = _WIDTH
    return console


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], text_columns: int = 1) -> Table:
    """A table; the first `text_columns` columns are left-justified, the others hold numbers."""
    made = Table(title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        made.add_column(column, justify="left" if index < text_columns else "right", no_wrap=index == 0, overflow="fold")
    for row in rows:
        made.add_row(*(Text(cell) for cell in row))
    return made


def stage_result(result: Result, fresh: bool, wall: float, *, quiet: bool = False, verbose: bool = False, then: str = "") -> None:
    """Tables of one stage, its warnings, the path of its artefact, what to do next (`then`), and last its verdict. Where `quiet` it is
    the verdict alone, where `verbose` the notes as well, which ask for nothing."""
    console = make_console()
    if quiet:
        print_verdict(console, result)
        return
    console.print(f"{result['stage']}  {'fresh: nothing has changed' if fresh else 'done in ' + seconds(wall)}", style="bold")
    _parameters(console, result["parameters"], only_free=True)
    _channels(console, result["channels"])
    _lists(console, result)
    if "ranking" in result:
        show_loop(console, result)
    _evaluations(console, result["evaluations"])
    print_remarks(console, result.get("remarks") or ())
    if verbose:
        print_notes(console, result.get("notes") or ())
    for figure in _figures(result):
        console.print(f"figure    {figure}", soft_wrap=True)
    console.print(f"artefact  {result['artefact']}", soft_wrap=True)
    _then(console, then)
    print_verdict(console, result)


def step(result: Result, *, verbose: bool = False) -> None:
    """One line of the chain, with the warnings of the stage below; where `verbose` also the notes."""
    console = make_console()
    if "skipped" in result:
        console.print(_wrapped(console, f"{result['stage']:<17} {'left out':>11}  ", result["skipped"]), style="dim")
        return
    when = "fresh" if result["fresh"] else seconds(result["wall_s"])
    style = "" if result["trustworthy"] else "red"
    console.print(_wrapped(console, f"{result['stage']:<17} {when:>11}  ", result["verdict"]), style=style)
    for remark in result.get("remarks") or ():
        console.print(_wrapped(console, " " * 31 + "! ", remark), style="yellow")
    for note in (result.get("notes") or ()) if verbose else ():
        console.print(_wrapped(console, " " * 31 + "- ", note), style="dim")


def _then(console: Console, command: str) -> None:
    """The command that comes next, where there is one."""
    if command:
        console.print(f"next      {command}", soft_wrap=True)


def chain_result(result: Result, *, quiet: bool = False, then: str = "") -> None:
    """The final table of the chain, the figures, what to do next (`then`), and the verdict; where `quiet` the verdict alone."""
    console = make_console()
    if quiet:
        print_verdict(console, result)
        return
    console.print()
    rows = result["table"]
    if rows:
        known = any(row["true"] is not None for row in rows)
        columns = ["parameter", "unit", *(["true"] if known else []), "start", "identified", "+-", *(["deviation"] if known else []), ""]
        console.print(table("", columns, (_final_row(row, known) for row in rows), 2))
    _channels(console, result["channels"])
    for figure in result["figures"]:
        console.print(f"figure    {figure}", soft_wrap=True)
    if (page := result.get("page")) is not None:
        console.print(f"report    {page}", soft_wrap=True)
    console.print(f"results   {result['run_dir']}", soft_wrap=True)
    _then(console, then)
    print_verdict(console, result)


def _final_row(row: Result, known: bool) -> list[str]:
    value, sigma = with_error(row["value"], row["sigma"])
    true = [number(row["true"], 6)] if known else []
    deviation = [percent(row["deviation"])] if known else []
    return [row["name"], row["unit"], *true, number(row["start"], 6), value, sigma, *deviation, "at bound" if row["at_bound"] else ""]


def artefact(description: Result) -> None:
    """Everything about an artefact but the values of its fields."""
    console = make_console()
    attributes = description["attributes"]
    console.print(f"{description['stage']}  made {attributes['created']} by thermofit {attributes['thermofit_version']}", style="bold")
    _parameters(console, description["parameters"], only_free=False)
    _channels(console, description["channels"])
    _lists(console, description)
    _evaluations(console, description["evaluations"])
    print_pairs(console, "summary", _plain(description))
    print_remarks(console, description.get("remarks") or ())
    print_notes(console, description.get("notes") or ())
    if description["datasets"]:
        console.print(dataset_tree(description["datasets"]))
        console.print()
    print_pairs(console, "provenance", _provenance(attributes, description["inputs"]))
    print_pairs(console, "config (what is not shown is null)", {k: v for k, v in _flat(description["config"]).items() if v != _NONE})
    for reason in description["stale"]:
        console.print(_wrapped(console, "stale     ", reason), style="red")
    console.print(f"artefact  {description['artefact']}", soft_wrap=True)
    print_verdict(console, description)


def _parameters(console: Console, parameters: Mapping[str, Result], only_free: bool) -> None:
    shown = {name: p for name, p in parameters.items() if p["free"] or not only_free}
    if not shown:
        return
    rows = []
    for name, p in shown.items():
        value, sigma = with_error(p["value"], p["sigma"])
        flag = "at bound" if p["at_bound"] else "" if p["free"] else "fixed"
        rows.append([name, p["unit"], value, sigma, number(p["start"], 6), bounds(p["lower"], p["upper"]), flag])
    console.print(table("", ("parameter", "unit", "value", "+-", "start", "bounds", ""), rows, 2))


def _channels(console: Console, channels: Mapping[str, Result]) -> None:
    if not channels:
        return
    keys = ("n", "rms", "floor_rms", "chi2_reduced")
    rows = ([name, str(c.get("unit", "")), *(number(c.get(key), 4) for key in keys)] for name, c in channels.items())
    console.print(table("", ("channel", "unit", "n", "rms error", "noise", "chi2/n"), rows, 2))


def _lists(console: Console, result: Result) -> None:
    """Every list of flat objects in a summary (phases, starts, values) as a table."""
    for key, value in result.items():
        if key in _HEAD or not _is_rows(value):
            continue
        columns = list(dict.fromkeys(name for row in value for name in row))
        first = [c for c in columns if any(isinstance(row.get(c), str) for row in value)]
        columns = [*first, *(c for c in columns if c not in first)]
        console.print(table(key, columns, ([number(row.get(c)) for c in columns] for row in value), len(first)))


def _is_rows(value: Any) -> bool:
    flat = isinstance(value, list) and value and all(isinstance(row, dict) for row in value)
    return bool(flat) and not any(isinstance(cell, dict | list) for row in value for cell in row.values())


def _evaluations(console: Console, counts: Result) -> None:
    if not counts:
        return
    wall = {key: value for key, value in counts.items() if key != "wall_s"}
    text = ", ".join(f"{number(value)} {key}" for key, value in wall.items() if value)
    console.print(f"evaluations: {text or 'none'}" + (f"; {seconds(counts['wall_s'])}" if counts.get("wall_s") is not None else ""))


def print_remarks(console: Console, remarks: Iterable[str]) -> None:
    """One line for each remark."""
    for remark in remarks:
        console.print(_wrapped(console, "! ", str(remark)), style="yellow")


def print_notes(console: Console, notes: Iterable[str]) -> None:
    """One line for each note."""
    for note in notes:
        console.print(_wrapped(console, "- ", str(note)), style="dim")


def _figures(result: Result) -> list[str]:
    figures = result.get("figures") or ()
    paths = list(figures.values()) if isinstance(figures, Mapping) else list(figures)
    return [str(path) for path in ([result["picture"]] if result.get("picture") else []) + paths]


def print_verdict(console: Console, result: Result) -> None:
    """The last line: green, or red where the result is not to be trusted or stale."""
    style = "bold green" if result.get("trustworthy", True) and not result.get("stale") else "bold red"
    console.print(f"verdict   {result['verdict']}", style=style, soft_wrap=True)


def _wrapped(console: Console, lead: str, text: str) -> str:
    """Text behind a lead, its further lines indented to the end of the lead."""
    return textwrap.fill(
        text, max(console.width, len(lead) + 30), initial_indent=lead, subsequent_indent=" " * len(lead), break_on_hyphens=False
    )


def print_pairs(console: Console, title: str, pairs: Mapping[str, str]) -> None:
    """A table of two columns, nothing where there are no pairs."""
    if pairs:
        console.print(table(title, ("key", "value"), pairs.items(), 2))


def _plain(description: Result) -> dict[str, str]:
    """What the summary holds besides the common keys and the tables."""
    own = ("attributes", "inputs", "config", "datasets", "stale")
    return _flat({k: v for k, v in description.items() if k not in (*_HEAD, *own) and not _is_rows(v)})


def _provenance(attributes: Result, inputs: Mapping[str, str]) -> dict[str, str]:
    paths = attributes.get("input_paths", {})
    packages = ", ".join(f"{name} {version}" for name, version in attributes["packages"].items())
    seed = {} if attributes.get("seed") is None else {"seed": str(attributes["seed"])}
    made_from = {f"input {name}": f"{paths.get(name, '')}  sha256 {digest[:16]}" for name, digest in inputs.items()}
    return {"source digest": attributes["source_digest"][:16], "packages": packages, **seed, **made_from}


def _flat(tree: Any, lead: str = "") -> dict[str, str]:
    """Nested objects as dotted keys; long lists are described by their length."""
    if isinstance(tree, Mapping) and tree:
        flat: dict[str, str] = {}
        for key, value in tree.items():
            flat |= _flat(value, f"{lead}.{key}" if lead else str(key))
        return flat
    if isinstance(tree, list):
        short = len(tree) <= _LONG and not any(isinstance(item, dict | list) for item in tree)
        return {lead: "[" + ", ".join(number(item) for item in tree) + "]" if short else f"{len(tree)} entries"}
    return {lead: "{}" if isinstance(tree, Mapping) else number(tree)}


def listing(result: Result) -> None:
    """One row for each set, then what each is good for and how to cite it."""
    out = make_console()
    rows = [[s["name"], ", ".join(s["licences"]), s["present"], str(s["files"]), _size(s["bytes"])] for s in result["sets"]]
    out.print(table("", ("set", "licence", "present", "files", "size"), rows, 3))
    for entry in result["sets"]:
        out.print(f"{entry['name']}: {entry['title']}", style="bold")
        out.print(f"  use     {entry['use']}", soft_wrap=True)
        origins = ", ".join(f"{o['project']} at {o['commit'][:7]}" for o in entry["origins"])
        out.print(f"  origin  {origins}", soft_wrap=True)
        out.print(f"  cite    {entry['citation']}", soft_wrap=True)
        print_remarks(out, [f"{path} is derived, only in a local mirror" for path in entry["local_only"]])
    print_verdict(out, result)


def fetched(result: Result) -> None:
    """Where each set lies, and how THERMOFIT_DATA is to be set."""
    out = make_console()
    for entry in result["sets"]:
        counts = ", ".join(f"{n} {_HOW[how]}" for how, n in entry["counts"].items() if n)
        out.print(f"{entry['name']}: {counts}", style="bold")
        for folder in entry["folders"]:
            out.print(f"  in    {folder}", soft_wrap=True)
        out.print(f"  cite  {entry['citation']}", soft_wrap=True)
        print_remarks(out, entry["remarks"])
    print_verdict(out, result)


_HOW = {"mirror": "from the mirror", "there": "there already", "downloaded": "downloaded", "not public": "not public"}


def inspected(result: Result) -> None:
    """Everything about a file, or one line for each group of files of a folder."""
    out = make_console()
    out.print(f"{result['path']}  {result['what']}", style="bold", soft_wrap=True)
    if "groups" in result:
        rows = [[g["files"], g["format"], str(g["count"]), g["summary"]] for g in result["groups"]]
        out.print(table("", ("files", "format", "count", "what they hold"), rows, 4))
    print_pairs(out, "", {**result.get("written", {}), **result.get("header", {})})
    for part in result.get("parts", ()):
        _part(out, part)
    print_remarks(out, result["remarks"])
    if result["suggestion"]:
        out.print("lines to start from:", style="bold")
        out.print(result["suggestion"], soft_wrap=True)
    print_verdict(out, result)


def _part(out: Console, part: Result) -> None:
    """A file, or one test of it."""
    print_pairs(out, part["name"], {key: number(value) if isinstance(value, float) else str(value) for key, value in part["facts"].items()})
    if part["columns"]:
        unread = [column["name"] for column in part["columns"] if column["missing"] is None and not column["meaning"]]
        columns = ("column", "meaning", "unit", "unit from", "range", "missing", "noise")
        out.print(table("", columns, (_column_row(column) for column in part["columns"] if column["name"] not in unread), 4))
        if unread:
            out.print(f"not used: {', '.join(unread)}", soft_wrap=True)


def _column_row(column: Result) -> list[str]:
    span = "" if column["low"] is None else f"{number(column['low'], 5)} .. {number(column['high'], 5)} {column['fixed_unit']}".rstrip()
    missing = "" if column["missing"] is None else str(column["missing"])
    noise = "" if column["noise"] is None else f"{number(column['noise'], 3)} {column['fixed_unit']}".rstrip()
    source = column["unit_from"] if column["unit"] or span else ""
    return [column["name"], column["meaning"], column["unit"], source, span, missing, noise]


def _size(n: int) -> str:
    return f"{n / 1e6:.1f} MB" if n >= 1e5 else f"{n / 1e3:.1f} kB"


def dataset_tree(datasets: Mapping[str, Mapping[str, Any]]) -> Tree:
    """Datasets by their folders, each with unit, axes and type."""
    root = Tree("datasets", style="", guide_style="dim")
    branches: dict[str, Tree] = {"": root}

    def branch(folder: str) -> Tree:
        if folder not in branches:
            above, _, own = folder.rpartition("/")
            branches[folder] = branch(above).add(Text(f"{own}/", style="bold"))
        return branches[folder]

    for name, data in datasets.items():
        folder, _, own = name.rpartition("/")
        axes = " x ".join(f"{dim} {size}" for dim, size in zip(data["dims"], data["shape"], strict=True)) or "scalar"
        unit = ", ".join(data.get("units", ())) or data["unit"]
        branch(folder).add(Text(f"{own}  [{unit}]  {axes}  {data['dtype']}"))
    return root


_SHOWN = 12


def show_loop(console: Console, result: Mapping[str, Any]) -> None:
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
    out = _table(f"unlisted: {with_article(said['kind'])} in {said['channel']}; {explained}", ("", "value"))
    for key, value in said["where"].items():
        out.add_row(key, value if isinstance(value, str) else str(value) if isinstance(value, bool) else number(value))
    out.add_row("from, to in s", ", ".join(number(t) for t in said["when_s"]))
    out.add_row("phases", ", ".join(said["phases"]))
    amount = said["amount"]
    out.add_row(f"mean in that window, {said['unit']}", f"{number(amount['value'])} +- {amount['sigma']:.1g}")
    if said.get("steps"):
        out.add_row("steps", steps_in_words(said))
    for channel, before in said["before"]["held_out"].items():
        out.add_row(f"held-out {channel} without, with", f"{before:.4g}, {said['after']['held_out'][channel]:.4g}")
    for hint in said["hints"][:3]:
        out.add_row("goes with (hint)", f"{hint['variable']}, chosen in {100 * hint['frequency']:.0f} % of the halves")
    console.print(out)
    _effect_parameters(console, said.get("parameters"))
    _more(console, said)


def _effect_parameters(console: Console, beside: Mapping[str, Any] | None) -> None:
    """The base model's parameters beside an unlisted heat or offset, which has driven those of the joint fit off."""
    if beside is None:
        return
    if beside["failed"]:
        console.print(f"! {beside['failed']}; those that act on temperatures have no standard errors", soft_wrap=True)
        return
    table = _table("parameters beside the unlisted term, which drives those of the joint fit off", ("", "beside it", "joint fit", "unit"))
    for name, row in beside["values"].items():
        table.add_row(name, f"{number(row['value'], 4)} +- {row['sigma']:.1g}", number(row["joint_fit"], 4), row["unit"])
    console.print(table)
    said = (travel_in_words(beside.get("spot")), second_in_words(beside["second"]), held_in_words(beside["held"]), *beside["untold"])
    for words in filter(None, said):
        console.print(words, soft_wrap=True)


def _more(console: Console, said: Mapping[str, Any]) -> None:
    """Effects that only resembled an unlisted one, or are accepted beside it, and files."""
    if said["resembles"]:
        console.print(f"taken back  {', '.join(said['resembles'])}: only resembled it", soft_wrap=True)
    if said["beside"]:
        console.print(f"beside    {', '.join(said['beside'])}: a part of the answer, or only like what is missing", soft_wrap=True)
    for word in ("effect_file", "figure"):
        if said.get(word):
            console.print(f"{word.replace('_', ' '):<11} {said[word]}", soft_wrap=True)
