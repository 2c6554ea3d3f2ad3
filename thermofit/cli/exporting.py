"""The command `export`: results for other programs."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thermofit.cli.catalogue import LOOK
from thermofit.cli.failure import reporting
from thermofit.cli.options import AsJson, check_effects

if TYPE_CHECKING:
    from thermofit.study.study import Study

HELP = (
    "Results for other programs: fields, tables, cards.\n\n"
    "Writes RUN_DIR/export: results.json with every covariance, and tables as CSV, Markdown and LaTeX. Writes material cards for Abaqus, "
    "CalculiX, LS-DYNA, MFront and plain YAML, with the range that the test visited and the effects of the model. Writes fields over time "
    "for ParaView (open fields/model.pvd), which need one more run of the model. RUN is a run folder or the study file."
)
EXAMPLES = """[bold]Examples:[/]
thermofit export runs/my-study
thermofit export study.yaml cards --density 7850 --to cards-of-my-steel"""


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder, or the study file that was run.", show_default=False)],
    kinds: Annotated[
        list[str] | None, typer.Argument(metavar="[KIND]...", help="results, tables, cards, fields; all where none is named.")
    ] = None,
    to: Annotated[
        Path | None, typer.Option("--to", metavar="DIR", help="Folder to write to, instead of RUN_DIR/export.", show_default=False)
    ] = None,
    density: Annotated[
        float | None, typer.Option("--density", metavar="KG_M3", help="Density in kg/m^3 for the cards.", show_default=False)
    ] = None,
    json: AsJson = False,
) -> None:
    """Write what other programmes read."""
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.stages.export import run as write

        with contextlib.redirect_stdout(sys.stderr) if json else contextlib.nullcontext():
            result = write(run, _load, kinds or (), to, density)
        if json:
            printing.as_json(result)
            return
        out = printing.make_console()
        rows = [[kind, str(len(files)), files[0]] for kind, files in result["files"].items()]
        out.print(printing.table("", ("kind", "files", "the first"), rows, 3))
        printing.print_remarks(out, [f"{kind} left out: {why}" for kind, why in result["left_out"].items()])
        printing.print_verdict(out, result)


def _load(path: Path) -> Study:
    from thermofit.study.study import load_study

    return load_study(path, (), check_effects)


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("export", help=HELP, rich_help_panel=LOOK, epilog=EXAMPLES)(export)
