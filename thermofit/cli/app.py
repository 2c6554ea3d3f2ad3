"""The typer application: one command per stage, and run, show, new."""

from __future__ import annotations

import contextlib
import json as json_format
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermofit import __version__
from thermofit.cli import exporting, identifiability, judging, looking, measured, watching
from thermofit.cli.catalogue import (
    ABOUT,
    ASIDE,
    DEMO_HELP,
    MANUAL,
    ON_CHAIN,
    RUN_EXAMPLES,
    RUN_HELP,
    SPREAD,
    STAGES,
    START,
    Entry,
)
from thermofit.cli.failure import UNTRUSTWORTHY, reporting
from thermofit.cli.options import AsJson, Common, Jobs, MaxEffects, Scheduler, executor_of, on_study
from thermofit.stages import CHAIN, NECKING_CHAIN, stage_function

if TYPE_CHECKING:
    from thermofit.records.executor import Executor
    from thermofit.records.staging import Outcome
    from thermofit.study.study import Study

app = typer.Typer(
    name="thermofit",
    help=ABOUT,
    epilog=MANUAL,
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"thermofit {__version__}")
        raise typer.Exit


@app.callback()
def _top(
    version: Annotated[bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)] = False,
) -> None:
    """What comes before a command."""


@app.command("new", rich_help_panel=START, epilog="[bold]Example:[/] thermofit new study.yaml --experiment lab/test-07")
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Study file to write.", show_default=False)],
    experiment: Annotated[
        str | None, typer.Option(metavar="FOLDER", help="Raw folder of the experiment, with experiment.yaml.", show_default=False)
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    json: AsJson = False,
) -> None:
    """Write a commented study file to start from."""
    with reporting(json):
        from thermofit.study.template import write_template

        said = write_template(file, experiment, overwrite=force, look=_looked)
        line = f"study written: {file}; {said}; set starts and bounds, then `thermofit run {file}`"
        typer.echo(json_format.dumps({"stage": "new", "verdict": line, "path": str(file)}) if json else line)


def _looked(folder: Path) -> tuple[float, float, float] | str:
    """What a raw folder says of its material; readers are imported when there is something to read."""
    from thermofit.read.first_look import first_look

    found = first_look(folder)
    return found if isinstance(found, str) else (found.modulus, found.stress, found.strain)


measured.register(app)


def _quiet(as_json: bool) -> contextlib.AbstractContextManager[Any]:
    """With --json nothing but the result reaches stdout, whatever a library prints."""
    return contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()


def _stage_command(entry: Entry) -> Callable[..., None]:
    def command(common: Common) -> None:
        _one_stage(entry, common)

    def spread_command(common: Common, jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
        _one_stage(entry, common, jobs, scheduler)

    def adding_command(common: Common, max_effects: MaxEffects = None) -> None:
        _one_stage(entry, common.setting("diagnosis.max_effects", max_effects))

    return spread_command if entry.spread else adding_command if entry.adds else command


def _one_stage(entry: Entry, common: Common, jobs: int = 1, scheduler: str | None = None) -> None:
    """Run a stage and print its result."""
    import time

    from thermofit.cli import printing
    from thermofit.records.result import is_trustworthy, result_of

    study = common.load()
    options: dict[str, Any] = {"where": executor_of(study, jobs, scheduler)} if entry.spread else {}
    _announce(entry.name, study, common.json or common.quiet)
    begin = time.perf_counter()
    with _quiet(common.json):
        _chain_before(entry.name, study, None if common.json or common.quiet else printing.step)
        outcome = stage_function(entry.name)(study, force=common.force, **options)
    result = result_of(outcome.record)
    if common.json:
        printing.as_json({**result, "fresh": outcome.fresh})
    else:
        printing.stage_result(result, outcome.fresh, time.perf_counter() - begin, quiet=common.quiet)
    _leave(is_trustworthy(outcome.record))


def _chain_before(name: str, study: Study, report: Callable[[dict[str, Any]], None] | None) -> None:
    """The chain up to the last identification, where a command rests on it; what is fresh is not run again."""
    if name in ON_CHAIN:
        from thermofit.records.executor import SERIAL
        from thermofit.stages.run import Link, Selection, chain

        chain(study, [Link(stage, _lazy(stage, SERIAL)) for stage in CHAIN], Selection(last="identify-thermal"), report=report)


def _announce(command: str, study: Study, silent: bool) -> None:
    """What begins, before numba is imported: the first result may be minutes away."""
    if not silent:
        typer.echo(f"{command}  study {study.source.name}, results in {study.run_dir}")


def _leave(trustworthy: bool) -> None:
    """Exit code 5 after the result has been printed."""
    if not trustworthy:
        raise typer.Exit(UNTRUSTWORTHY)


@app.command("run", help=RUN_HELP, rich_help_panel=START, epilog=RUN_EXAMPLES)
@on_study
def run(
    common: Common,
    first: Annotated[str | None, typer.Option("--from", metavar="STAGE", help="First stage to run.", show_default=False)] = None,
    last: Annotated[str | None, typer.Option("--until", metavar="STAGE", help="Last stage to run.", show_default=False)] = None,
    everything: Annotated[bool, typer.Option("--all", help="Also gridsearch and sensitivity, where the study lists them.")] = False,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """All stages: raw files in, parameters and figures out."""
    _run_chain(common, first, last, everything, jobs, scheduler)


@app.command("demo", help=DEMO_HELP, rich_help_panel=START, epilog="[bold]Example:[/] thermofit demo --until calibrate-ir")
def demo(
    to: Annotated[Path, typer.Option("--to", metavar="DIR", help="Folder for the study and its results.")] = Path("thermofit-demo"),
    last: Annotated[str | None, typer.Option("--until", metavar="STAGE", help="Last stage to run.", show_default=False)] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Set a key of the study.", show_default=False)
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Compute again even where nothing has changed.")] = False,
    json: AsJson = False,
) -> None:
    """The quickstart study, from a folder of its own."""
    with reporting(json):
        from thermofit.study.demo import demo_study

        study = demo_study(to)
        _run_chain(Common(study, tuple(settings or ()), to / "run", force, json), None, last)


def _run_chain(
    common: Common, first: str | None, last: str | None, everything: bool = False, jobs: int = 1, scheduler: str | None = None
) -> None:
    """Run the chain and print every stage as it is done."""
    from thermofit.cli import printing
    from thermofit.stages.run import Link, Selection, chain, summary_of

    study = common.load()
    _announce("run", study, common.json or common.quiet)
    where = executor_of(study, jobs, scheduler)
    links = [Link(name, _lazy(name, where)) for name in (CHAIN if study.necking is None else NECKING_CHAIN)]
    with _quiet(common.json):
        steps = chain(
            study, links, Selection(first, last, everything), common.force, None if common.json or common.quiet else printing.step
        )
    summary = summary_of(study, steps)
    if common.json:
        printing.as_json(summary)
    else:
        printing.chain_result(summary, quiet=common.quiet)
    _leave(summary["trustworthy"])


def _lazy(name: str, where: Executor) -> Callable[..., Outcome]:
    options: dict[str, Any] = {"where": where} if name in SPREAD else {}

    def call(study: Study, *, force: bool = False) -> Outcome:
        return stage_function(name)(study, force=force, **options)

    return call


for _entry in (*STAGES, *ASIDE):
    app.command(_entry.name, help=_entry.help, epilog=_entry.epilog, rich_help_panel=_entry.panel)(on_study(_stage_command(_entry)))
identifiability.register(app)


judging.register(app, stage_function, _announce)
exporting.register(app)
looking.register(app)
watching.register(app)
