"""Commands on measured data before there is a study: `data list`, `data fetch`, `inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thermofit.cli.catalogue import DATA, DATA_HELP, INSPECT_HELP
from thermofit.cli.failure import reporting
from thermofit.cli.options import AsJson, quiet
from thermofit.core.errors import DataError

data_app = typer.Typer(name="data", help=DATA_HELP, no_args_is_help=True, rich_markup_mode="rich")


@data_app.command("list", epilog="[bold]Example:[/] thermofit data list --json")
def data_list(json: AsJson = False) -> None:
    """Name, files, size, licence of every public set, and whether it is here."""
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.stages.data import listing

        result = listing()
        if json:
            printing.as_json(result)
        else:
            printing.listing(result)


@data_app.command("fetch", epilog="[bold]Example:[/] thermofit data fetch s235-plate-hole-dic --to measured")
def data_fetch(
    names: Annotated[list[str] | None, typer.Argument(metavar="[NAME]...", help="Sets to fetch; all where none is named.")] = None,
    to: Annotated[
        Path | None, typer.Option("--to", metavar="DIR", help="Folder to put them in, instead of the user's cache.", show_default=False)
    ] = None,
    json: AsJson = False,
) -> None:
    """Take sets from the local mirror, else download them, and check every file by its SHA-256."""
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.stages.data import fetch

        with quiet(json):
            result = fetch(names or (), to, tell=lambda line: typer.echo(line, err=True))
        if json:
            printing.as_json(result)
        else:
            printing.fetched(result)


def inspect(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A file, or a folder of files.", show_default=False)],
    json: AsJson = False,
) -> None:
    """What is this file or folder: format, units, points, gaps, noise, suspicions, study lines."""
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.stages.inspect import inspect as look

        with quiet(json):
            result = look(path)
        if json:
            printing.as_json(result)
        else:
            printing.inspected(result)
        if result.get("trustworthy") is False:
            raise typer.Exit(DataError.exit_code)


def register(app: typer.Typer) -> None:
    """Add these commands to the application."""
    app.add_typer(data_app, rich_help_panel=DATA)
    app.command("inspect", help=INSPECT_HELP, rich_help_panel=DATA, epilog="[bold]Example:[/] thermofit inspect lab/test-07.csv")(inspect)
