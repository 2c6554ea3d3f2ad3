"""Commands that judge models: `validate` with an experiment of its own option, `compare` with further studies."""

from __future__ import annotations

import contextlib
import json as json_format
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermofit.cli.catalogue import COMPARE, VALIDATE
from thermofit.cli.failure import UNTRUSTWORTHY
from thermofit.cli.options import Common, on_study

if TYPE_CHECKING:
    from thermofit.records.staging import Outcome
    from thermofit.study.study import Study

RAW = ("simulate", "calibrate-ir", "interpolate")
"""Stages that make the record of a held-out experiment, in their order."""
StageFunction = Callable[[str], Callable[..., Any]]


def _show(name: str, common: Common, call: Callable[[], Outcome]) -> None:
    """Run one stage and print its result, as every command does."""
    from thermofit.cli import printing
    from thermofit.records.result import is_trustworthy, result_of

    begin = time.perf_counter()
    with contextlib.redirect_stdout(sys.stderr) if common.json else contextlib.nullcontext():
        outcome = call()
    result = result_of(outcome.record)
    if common.json:
        printing.as_json({**result, "fresh": outcome.fresh})
    else:
        printing.stage_result(result, outcome.fresh, time.perf_counter() - begin, quiet=common.quiet)
    if not is_trustworthy(outcome.record):
        raise typer.Exit(UNTRUSTWORTHY)


def _held_out(folders: list[Path]) -> tuple[str, ...]:
    """Settings of the study that declare raw folders as held-out experiments."""
    entry = {"held_out": True}
    return tuple(f"experiments.{folder.name}={json_format.dumps({**entry, 'experiment': str(folder.absolute())})}" for folder in folders)


def register(app: typer.Typer, stage_function: StageFunction, announce: Callable[[str, Study, bool], None]) -> None:
    """Add these commands to the application."""

    def validate(
        common: Common,
        experiment: Annotated[
            list[Path] | None,
            typer.Option("--experiment", metavar="FOLDER", help="Raw folder to predict; may be repeated.", show_default=False),
        ] = None,
    ) -> None:
        from thermofit.study.links import make_record

        study = replace(common, settings=(*common.settings, *_held_out(experiment or []))).load()
        announce("validate", study, common.json or common.quiet)

        def prepare(one: Study) -> None:
            make_record(one, [(name, stage_function(name)) for name in RAW])

        _show("validate", common, lambda: stage_function("validate")(study, force=common.force, prepare=prepare))

    def compare(
        common: Common,
        others: Annotated[
            list[Path] | None, typer.Argument(metavar="[OTHER.yaml]...", help="Further studies of the same data.", show_default=False)
        ] = None,
    ) -> None:
        study = common.load()
        further = [replace(common, study=path, run_dir=None).load() for path in others or ()]
        announce("compare", study, common.json or common.quiet)
        _show("compare", common, lambda: stage_function("compare")(study, force=common.force, others=further))

    for entry, command in ((VALIDATE, validate), (COMPARE, compare)):
        app.command(entry.name, help=entry.help, epilog=entry.epilog, rich_help_panel=entry.panel)(on_study(command))
