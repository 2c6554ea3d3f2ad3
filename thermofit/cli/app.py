"""The typer application: one command per stage, and run, show, new."""

from __future__ import annotations

import contextlib
import importlib
import json as json_format
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermofit import __version__
from thermofit.cli import identifiability, judging, measured
from thermofit.cli.catalogue import (
    ABOUT,
    ASIDE,
    LOOK,
    MANUAL,
    NECKING_ORDER,
    ON_CHAIN,
    ORDER,
    REPORT,
    RUN_EXAMPLES,
    RUN_HELP,
    SPREAD,
    STAGES,
    START,
    Entry,
)
from thermofit.cli.failure import UNTRUSTWORTHY, reporting
from thermofit.cli.options import AsJson, Common, Jobs, MaxEffects, Scheduler, executor_of, on_study
from thermofit.core.errors import StudyError, ThermofitError

if TYPE_CHECKING:
    from thermofit.records.executor import Executor
    from thermofit.records.staging import Outcome
    from thermofit.study.study import Study

app = typer.Typer(
    name="thermofit",
    help=ABOUT,
    epilog=MANUAL,
    no_args_is_help=True,
    add_completion=False,
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


def stage_function(name: str) -> Callable[..., Outcome]:
    """`run` of a stage module, imported when it is needed: numba and scipy cost seconds that help and show must not pay."""
    module = importlib.import_module(f"thermofit.stages.{name.replace('-', '_')}")
    run: Callable[..., Outcome] = module.run
    return run


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

    if entry.name == REPORT and common.study.is_dir():
        _report_of_folder(common)
        return
    study = common.load()
    options: dict[str, Any] = {"where": executor_of(study, jobs, scheduler)} if entry.spread else {}
    _announce(entry.name, study, common.json)
    begin = time.perf_counter()
    with _quiet(common.json):
        _chain_before(entry.name, study, None if common.json else printing.step)
        outcome = stage_function(entry.name)(study, force=common.force, **options)
    result = result_of(outcome.record)
    if common.json:
        printing.as_json({**result, "fresh": outcome.fresh})
    else:
        printing.stage_result(result, outcome.fresh, time.perf_counter() - begin)
    if entry.name in ON_CHAIN:
        _page_so_far(study, common.json)
    _leave(is_trustworthy(outcome.record))


def _report_of_folder(common: Common) -> None:
    """The page of a run folder whose study is not named."""
    from thermofit.cli import printing
    from thermofit.stages.report import of_folder

    if common.settings or common.run_dir is not None:
        raise StudyError(
            f"report {common.study}: --set and --run-dir change a study, and this is a run folder; leave them out, or name a study"
        )
    result = of_folder(common.study)
    if common.json:
        printing.as_json(result)
    else:
        typer.echo(f"verdict   {result['verdict']}")
    _leave(result["trustworthy"])


def _page_so_far(study: Study, as_json: bool, failure: str = "") -> None:
    """`report.html` of what the run folder holds now, after a stage that is no link of the chain, or after an error."""
    from thermofit.stages.report import unfinished

    written = unfinished(study, failure)
    if written is not None and not as_json:
        typer.echo(f"report    {written.html}", err=bool(failure))


def _chain_before(name: str, study: Study, report: Callable[[dict[str, Any]], None] | None) -> None:
    """The chain up to the last identification, where a command rests on it; what is fresh is not run again."""
    if name in ON_CHAIN:
        from thermofit.records.executor import SERIAL
        from thermofit.stages.run import Link, Selection, chain

        chain(study, [Link(stage, _lazy(stage, SERIAL)) for stage in ORDER], Selection(last="identify-thermal"), report=report)


def _announce(command: str, study: Study, as_json: bool) -> None:
    """What begins, before numba is imported: the first result may be minutes away."""
    if not as_json:
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
    from thermofit.cli import printing
    from thermofit.stages.run import Link, Selection, chain, summary_of

    study = common.load()
    _announce("run", study, common.json)
    where = executor_of(study, jobs, scheduler)
    links = [Link(name, _lazy(name, where)) for name in (ORDER if study.necking is None else NECKING_ORDER)]
    with _quiet(common.json):
        try:
            steps = chain(study, links, Selection(first, last, everything), common.force, None if common.json else printing.step)
        except ThermofitError as error:
            _page_so_far(study, common.json, str(error))
            raise
    summary = summary_of(study, steps)
    if common.json:
        printing.as_json(summary)
    else:
        printing.chain_result(summary)
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


@app.command("show", rich_help_panel=LOOK, epilog="[bold]Example:[/] thermofit show runs/my-study/verify.h5 --json")
def show(
    artefact: Annotated[Path, typer.Argument(metavar="ARTEFACT", help="RUN_DIR/<stage>.h5", show_default=False)], json: AsJson = False
) -> None:
    """What is in a result: verdict, parameters, datasets."""
    with reporting(json):
        from thermofit.cli import printing
        from thermofit.records.artefact import open_record
        from thermofit.records.result import description_of

        if artefact.is_dir():
            raise StudyError(f"'{artefact}' is a folder: expected one artefact in it, such as {artefact / 'identify-elastic.h5'}")
        record = open_record(artefact)
        if json:
            printing.as_json(description_of(record))
        else:
            printing.artefact(description_of(record))
