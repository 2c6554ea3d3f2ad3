"""The commands that look at results: `show` at one, `diff` at two."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from thermofit.cli.catalogue import LOOK
from thermofit.cli.failure import reporting
from thermofit.cli.options import AsJson
from thermofit.core.errors import StudyError

SHOW_HELP = (
    "What is in a result: verdict, parameters, datasets.\n\n"
    "Of an artefact: its parameters, channels, datasets as a tree with units and axes, what it was made from and whether that has changed. "
    "Of a run folder: its artefacts with their verdicts. --budget shows what the uncertainties are "
    "made of, --dataset shows the values of one, --plot draws them into RUN_DIR/figures."
)
SHOW_EXAMPLES = "\n".join(
    (
        "[bold]Examples:[/]",
        "  thermofit show runs/my-study",
        "  thermofit show runs/my-study/verify.h5 --json",
        "  thermofit show runs/my-study/refine.h5 --budget",
        "  thermofit show runs/my-study/verify.h5 --dataset over_time/du --plot",
    )
)
DIFF_HELP = (
    "What differs between two results, in words and numbers.\n\n"
    "Parameters in their combined standard errors, errors of channels, settings, inputs, versions and datasets of two artefacts, or of all "
    "stages that two run folders share."
)


def _show(
    artefact: Annotated[Path, typer.Argument(metavar="ARTEFACT", help="RUN_DIR/<stage>.h5, or a run folder.", show_default=False)],
    dataset: Annotated[
        str | None, typer.Option("--dataset", metavar="NAME", help="One dataset and its values.", show_default=False)
    ] = None,
    plot: Annotated[bool, typer.Option("--plot", help="Draw it into RUN_DIR/figures.")] = False,
    budget: Annotated[bool, typer.Option("--budget", help="Causes of the uncertainty of every parameter, largest first.")] = False,
    json: AsJson = False,
) -> None:
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.records.artefact import open_record
        from thermofit.records.result import budget_of, dataset_of, description_of, listing_of

        if artefact.is_dir():
            if plot or dataset:
                raise StudyError(
                    f"'{artefact}' is a folder: --plot and --dataset need one artefact in it, such as {artefact / 'verify.h5'}"
                )
            listed = listing_of(artefact)
            if json:
                printing.as_json(listed)
            else:
                rows = [[s["stage"], s["created"], "" if s["trustworthy"] else "not trusted", s["verdict"]] for s in listed["artefacts"]]
                printing.make_console().print(printing.table("", ("stage", "made", "", "verdict"), rows, 4))
            return
        record = open_record(artefact)
        if budget:
            told = budget_of(record)
            if json:
                printing.as_json(told)
            else:
                _print_budget(printing.make_console(), told)
            return
        picture = _drawn(record, dataset) if plot else None
        described = description_of(record) if dataset is None else dataset_of(record, dataset)
        if picture is not None:
            described["picture"] = str(picture)
        if json:
            printing.as_json(described)
            return
        if dataset is None:
            printing.artefact(described)
        else:
            _print_values(printing.make_console(), dataset, described)
        if picture is not None:
            typer.echo(f"picture   {picture}")


def _print_budget(console: Console, told: Mapping[str, Any]) -> None:
    """A row for every parameter and cause."""
    from thermofit.cli.printing import number, table
    from thermofit.records.result import exact_words

    rows = []
    for name, found in told["budget"].items():
        p = told["parameters"][name]
        for k, one in enumerate(found):
            lead = [name, number(p["value"], 6), number(p["sigma"], 2), p["unit"]] if k == 0 else ["", "", "", ""]
            rows.append([*lead, one["cause"], number(one["sigma"], 2), f"{100.0 * one['share']:.1f} %"])
    console.print(table("", ("parameter", "value", "+-", "unit", "cause", "its part", "of the variance"), rows, 1))
    console.print(told["verdict"], soft_wrap=True)
    if told["exact"]:
        console.print(exact_words(told["exact"]), soft_wrap=True)


def _print_values(console: Console, name: str, described: Mapping[str, Any]) -> None:
    """The range of a dataset, and its values as numpy shortens them."""
    import numpy as np

    from thermofit.cli.printing import number

    value = np.array(described["values"], dtype=object)
    try:
        value = value.astype(float)
        good = value[np.isfinite(value)]
        extent = (
            f"{number(float(good.min()))} to {number(float(good.max()))}, mean {number(float(good.mean()))}" if good.size else "no value"
        )
        missing = f", {value.size - good.size} missing" if good.size < value.size else ""
    except (TypeError, ValueError):
        extent, missing = "texts", ""
    axes = " x ".join(f"{dim} {size}" for dim, size in zip(described["dims"], value.shape, strict=True)) or "one number"
    console.print(f"{name}  in {described['unit']}  ({axes})", style="bold")
    console.print(f"{extent}{missing}")
    with np.printoptions(precision=6, threshold=200, edgeitems=4, linewidth=120):
        console.print(str(value), soft_wrap=True)


def _drawn(record: Any, dataset: str | None) -> Path:
    import matplotlib

    from thermofit.report.figures import STYLE, save_figures
    from thermofit.report.figures_datasets import picture_of

    with matplotlib.rc_context(STYLE):
        name = f"show-{record.stage}" + (f"-{dataset.replace('/', '-')}" if dataset else "")
        return save_figures(record.path.parent / "figures", {name: picture_of(record, dataset)})[0]


def _diff(
    first: Annotated[Path, typer.Argument(metavar="A", help="An artefact or a run folder.", show_default=False)],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another one.", show_default=False)],
    json: AsJson = False,
) -> None:
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.report.differences import compared

        result = compared(first, second)
        if json:
            printing.as_json(result)
            return
        console = printing.make_console()
        for stage, found in result["stages"].items():
            console.print(f"{stage}  {'the same' if found['same'] else 'differs'}", style="bold")
            if not found["same"]:
                _print_differences(console, found)
        for key, words in (("only_in_first", "only in the first"), ("only_in_second", "only in the second")):
            if result.get(key):
                console.print(f"{words}: {', '.join(result[key])}", soft_wrap=True)
        printing.print_verdict(console, result)


def _print_differences(console: Console, found: Mapping[str, Any]) -> None:
    from thermofit.cli.printing import number, table

    rows = []
    for p in found["parameters"]:
        share = "-" if p.get("relative") is None else f"{100.0 * p['relative']:+.3g} %"
        z = "-" if p.get("z") is None else f"{p['z']:+.2f}"
        rows.append([p["parameter"], p["unit"], number(p["first"], 6), number(p["second"], 6), share, z])
    if rows:
        console.print(table("", ("parameter", "unit", "first", "second", "change", "in standard errors"), rows, 2))
    rows = [[c["channel"], c["unit"], *(number(v, 4) for key in ("rms", "chi2_reduced") for v in c[key])] for c in found["channels"]]
    if rows:
        console.print(table("", ("channel", "unit", "rms first", "rms second", "chi2/n first", "chi2/n second"), rows, 2))
    for text in found["words"]:
        console.print(f"  {text}", soft_wrap=True)


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.command("show", help=SHOW_HELP, rich_help_panel=LOOK, epilog=SHOW_EXAMPLES)(_show)
    app.command("diff", help=DIFF_HELP, rich_help_panel=LOOK, epilog="[bold]Example:[/] thermofit diff runs/coarse runs/fine")(_diff)
