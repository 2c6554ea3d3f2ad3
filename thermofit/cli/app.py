"""The typer application: one command per stage, those with options of their own, and run, show, new."""

from __future__ import annotations

import inspect
import json as json_format
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermofit import __version__
from thermofit.cli import exporting, looking, measured, watching
from thermofit.cli.catalogue import (
    ABOUT,
    ASIDE,
    COMPARE,
    DEMO_HELP,
    IDENTIFIABILITY_EXAMPLES,
    IDENTIFIABILITY_HELP,
    INJECT,
    LOOP,
    MANUAL,
    ON_CHAIN,
    REPORT,
    RUN_EXAMPLES,
    RUN_HELP,
    SPREAD,
    STAGES,
    START,
    TRUST,
    VALIDATE,
    Entry,
)
from thermofit.cli.failure import UNTRUSTWORTHY, reporting
from thermofit.cli.options import Also, AsJson, Common, Jobs, LengthMm, MaxEffects, Pick, Refine, Scheduler, executor_of, on_study, quiet
from thermofit.core.errors import StudyError, ThermofitError
from thermofit.stages import CHAIN, NECKING_CHAIN, stage_function

if TYPE_CHECKING:
    from thermofit.read.describe import Described
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


@app.command("new", rich_help_panel=START, epilog="[bold]Example:[/] thermofit new study.yaml --raw lab/test-07")
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Study file to write.", show_default=False)],
    experiment: Annotated[
        str | None, typer.Option(metavar="FOLDER", help="Raw folder of the experiment, with experiment.yaml.", show_default=False)
    ] = None,
    raw: Annotated[
        Path | None,
        typer.Option(
            "--raw",
            metavar="FOLDER",
            help="Folder of measured files; its experiment.yaml is written where there is none, with what is missing marked.",
            show_default=False,
        ),
    ] = None,
    material: Annotated[
        str | None,
        typer.Option(
            metavar="CLASS", help="steel, aluminium, ...: its starts and bounds; else by the notes of the test.", show_default=False
        ),
    ] = None,
    law: Annotated[
        str | None, typer.Option("--hardening", metavar="NAME", help="Hardening law, such as swift; else model2.", show_default=False)
    ] = None,
    yields: Annotated[
        str, typer.Option("--yield-surface", metavar="NAME", help="Yield surface: hill, von_mises, hosford or yld2004.")
    ] = "hill",
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    json: AsJson = False,
) -> None:
    """Write a commented study file to start from."""
    with reporting(json):
        from thermofit.study.template import write_template

        described = None
        if raw is not None:
            if experiment is not None:
                raise StudyError("--raw and --experiment are both given; --raw is enough, it keeps an experiment.yaml that is there")
            experiment, described = str(raw), _described(raw)
        chosen = _material(experiment) if material is None else material
        said = write_template(file, experiment, overwrite=force, look=_looked, law=law, material=chosen, yields=yields)
        missing = () if described is None else described.missing
        line = f"study written: {file}; {said}; "
        if described is not None and missing:
            line += (
                f"next: fill in {len(missing)} values in {described.file} ({', '.join(missing)}), then "
                f"`thermofit new {file} --raw {raw} --force`, which takes bounds from the data, and `thermofit run {file}`"
            )
        else:
            line += f"next: look at starts and bounds in it, then `thermofit run {file}`"
        if json:
            more = {} if described is None else {"found": described.found, "missing": missing, "experiment": str(described.file)}
            typer.echo(json_format.dumps({"stage": "new", "verdict": line, "path": str(file), **more}))
            return
        if described is not None:
            typer.echo(f"{described.file} written: {'; '.join(described.found)}")
        typer.echo(line)


def _described(raw: Path) -> Described | None:
    """A first experiment.yaml of a folder that has none."""
    from thermofit.read.describe import describe
    from thermofit.read.raw_description import DESCRIPTION

    return None if (raw / DESCRIPTION).is_file() else describe(raw)


def _material(experiment: str | None) -> str:
    """The class of metals that the notes of a raw folder name."""
    if experiment is None or "${" in experiment:
        return ""
    from thermofit.read.describe import material_of

    return material_of(Path(experiment).expanduser())


def _looked(folder: Path) -> tuple[float, float, float] | str:
    """What a raw folder says of its material; readers are imported when there is something to read. DataError where it makes no sense."""
    from thermofit.read.plausible import first_look

    found, remarks = first_look(folder)
    for remark in remarks:
        typer.echo(f"! {remark}", err=True)
    return found if isinstance(found, str) else (found.modulus, found.stress, found.strain)


measured.register(app)


def _stage_command(entry: Entry) -> Callable[..., None]:
    def command(common: Common) -> None:
        _one_stage(entry, common)

    def spread_command(common: Common, jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
        _one_stage(entry, common, jobs, scheduler)

    def adding_command(common: Common, max_effects: MaxEffects = None) -> None:
        _one_stage(entry, common.setting("diagnosis.max_effects", max_effects))

    def refining_command(common: Common, refine: Refine = False) -> None:
        _one_stage(entry, common, refine=refine)

    def picking_command(common: Common, pick: Pick = False, length_mm: LengthMm = None) -> None:
        _one_stage(entry, _picked(common, length_mm) if pick else common)

    def drawing_command(common: Common, also: Also = None) -> None:
        _one_stage(entry, common, also=tuple(also or ()))

    if entry.refines:
        return refining_command
    if entry.picks:
        return picking_command
    if entry.draws:
        return drawing_command
    return spread_command if entry.spread else adding_command if entry.adds else command


def _picked(common: Common, length_mm: float | None) -> Common:
    """The command with landmarks that are clicked now, and the lines that keep them."""
    from thermofit.stages.calibrate_ir import pick

    if length_mm is None:
        raise StudyError("--pick needs --length-mm: the distance in mm between the first two points that are clicked")
    text = json_format.dumps(pick(common.load(), length_mm))
    typer.echo(f"to keep these landmarks, put this into {common.study}:\nir: {{landmarks: {text}}}", err=common.json)
    return common.setting("ir.landmarks", text)


def _one_stage(entry: Entry, common: Common, jobs: int = 1, scheduler: str | None = None, **more: Any) -> None:
    """Run a stage, behind what it rests on, and print its result."""
    if entry.name == REPORT and common.study.is_dir():
        if more.get("also"):
            raise StudyError(f"--also: {common.study} is a run folder, and the figures are drawn by its study; name the study file")
        _report_of_folder(common)
        return
    study = common.load()
    options: dict[str, Any] = (
        {"where": executor_of(study, jobs, scheduler)} if entry.spread else {key: value for key, value in more.items() if value}
    )

    def call() -> Outcome:
        from thermofit.cli import printing

        _chain_before(entry.name, study, None if common.json or common.quiet else partial(printing.step, verbose=common.verbose))
        return stage_function(entry.name)(study, force=common.force, **options)

    _show(entry.name, common, study, call)


def _show(name: str, common: Common, study: Study, call: Callable[[], Outcome]) -> None:
    """Say what begins, run it, print its result; exit code 5 where that is not to be trusted."""
    from thermofit.cli import printing
    from thermofit.records.result import is_trustworthy, result_of

    _announce(name, study, common.json or common.quiet)
    begin = time.perf_counter()
    with quiet(common.json):
        outcome = call()
    result = result_of(outcome.record)
    if common.json:
        printing.as_json({**result, "fresh": outcome.fresh})
    else:
        wall = time.perf_counter() - begin
        then = _next(name, common.study, study) if name != LOOP_STAGE or result.get("added") else ""
        printing.stage_result(result, outcome.fresh, wall, quiet=common.quiet, verbose=common.verbose, then=then)
    if name in ON_CHAIN:
        _page_so_far(study, common.json)
    _leave(is_trustworthy(outcome.record))


LOOP_STAGE = "close-loop"


def _next(stage: str, file: Path, study: Study) -> str:
    """The command that comes after a stage, with what it answers; "" where none does. `file`: the study as it was named."""
    added = study.run_dir / "with-effects.yaml"
    following = {
        "verify": f"thermofit close-loop {file}    asks whether the model lacks an effect",
        "diagnose": f"thermofit close-loop {file}    adds what is missing, and proves it",
        LOOP_STAGE: f"thermofit run {added} --until verify    identifies with what was added",
    }
    return following.get(stage, "")


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
    """The chain up to the last identification, where a command rests on it; what is fresh is not run again.

    A joint fit that is there rests on stages that may be made anew: then it is made anew as well, else it would be refused as stale.
    """
    if name in ON_CHAIN:
        from thermofit.records.executor import SERIAL
        from thermofit.records.staging import artefact_path
        from thermofit.stages.run import REFINE, Link, Selection, chain

        last = REFINE if artefact_path(study.run_dir, REFINE).exists() else "identify-thermal"
        chain(study, [Link(stage, _lazy(stage, SERIAL)) for stage in CHAIN], Selection(last=last), report=report)


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
        from thermofit.study.paths import demo_study

        study = demo_study(to)
        _run_chain(Common(study, tuple(settings or ()), to / "run", force, json), None, last)


def _run_chain(
    common: Common, first: str | None, last: str | None, everything: bool = False, jobs: int = 1, scheduler: str | None = None
) -> None:
    """Run the chain and print every stage as it is done."""
    study = common.load()  # before the kernels: effect files of a user are compiled into them
    from thermofit.cli import printing
    from thermofit.stages.run import Link, Selection, chain, summary_of

    silent = common.json or common.quiet
    _announce("run", study, silent)
    where = executor_of(study, jobs, scheduler)
    links = [Link(name, _lazy(name, where)) for name in (CHAIN if study.necking is None else NECKING_CHAIN)]
    with quiet(common.json):
        try:
            told = None if silent else partial(printing.step, verbose=common.verbose)
            steps = chain(study, links, Selection(first, last, everything), common.force, told)
        except ThermofitError as error:
            _page_so_far(study, common.json, str(error))
            raise
    summary = summary_of(study, steps)
    if common.json:
        printing.as_json(summary)
    else:
        done = {step.name for step in steps if step.outcome is not None}
        printing.chain_result(summary, quiet=common.quiet, then=_next("verify", common.study, study) if "verify" in done else "")
    _leave(summary["trustworthy"])


def _lazy(name: str, where: Executor) -> Callable[..., Outcome]:
    options: dict[str, Any] = {"where": where} if name in SPREAD else {}

    def call(study: Study, *, force: bool = False) -> Outcome:
        return stage_function(name)(study, force=force, **options)

    return call


for _entry in sorted((*STAGES, *ASIDE), key=lambda entry: entry.panel != LOOP):
    app.command(_entry.name, help=_entry.help, epilog=_entry.epilog, rich_help_panel=_entry.panel)(on_study(_stage_command(_entry)))


_STAGE_HELP = "elastic, plastic or thermal; absent: thermal, of coupons plastic."


def _subject(
    programmes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[PROGRAMME]...", help="With --compare: which; all where none is named.", show_default=False),
    ] = None,
    stage: Annotated[str | None, typer.Option("--stage", metavar="STAGE", help=_STAGE_HELP, show_default=False)] = None,
    before: Annotated[bool, typer.Option("--a-priori", help="Before any data: the planned test of section simulate.")] = False,
    programme: Annotated[
        str, typer.Option("--programme", metavar="NAME", help="With --a-priori: another programme than the study's.")
    ] = "own",
    compare: Annotated[bool, typer.Option("--compare", help="Rank test programmes by the intervals that they would give.")] = False,
) -> None:
    """Options of `identifiability` that say what is looked at."""


def _ways(
    repeats: Annotated[int, typer.Option("--bootstrap", metavar="N", min=0, help="Block bootstrap with N repeats.")] = 0,
    refit: Annotated[bool, typer.Option("--refit", help="Fit every repeat of the bootstrap anew instead of by the Jacobian.")] = False,
    profile: Annotated[bool, typer.Option("--profile", help="Profile likelihood of every parameter.")] = False,
    mcmc: Annotated[bool, typer.Option("--mcmc", help="Markov chain on the linearised model (needs emcee).")] = False,
    full_model: Annotated[bool, typer.Option("--full-model", help="With --mcmc: a chain of forward runs, for small problems.")] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of bootstrap and chain.")] = 1,
) -> None:
    """Those that say how intervals are found."""


def _where(jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
    """Those that say where it runs."""


def identifiability(common: Common, **asked: Any) -> None:
    """Do the data determine the parameters? `asked`: the options of `_subject`, `_ways` and `_where`."""
    programmes, compare = asked.pop("programmes") or (), asked.pop("compare")
    jobs, scheduler = asked.pop("jobs"), asked.pop("scheduler")
    if programmes and not compare:
        raise StudyError(
            f"'{programmes[0]}' is given without --compare: programmes by name are compared, or one is taken by --programme NAME"
        )
    study = common.load()

    def call() -> Outcome:
        from thermofit.stages.identifiability import IdentifiabilityOptions, run

        chosen = IdentifiabilityOptions(compare=tuple(programmes) if compare else None, **asked)
        return run(study, chosen, force=common.force, where=executor_of(study, jobs, scheduler))

    _show("identifiability", common, study, call)


def _signature() -> inspect.Signature:
    """`common`, then the options of all groups."""
    first = next(iter(inspect.signature(identifiability, eval_str=True).parameters.values()))
    groups = (_subject, _ways, _where)
    options = [p for group in groups for p in inspect.signature(group, eval_str=True).parameters.values()]
    return inspect.Signature([first, *options])


identifiability.__signature__ = _signature()  # type: ignore[attr-defined]
app.command("identifiability", help=IDENTIFIABILITY_HELP, rich_help_panel=TRUST, epilog=IDENTIFIABILITY_EXAMPLES)(on_study(identifiability))


RAW = ("simulate", "calibrate-ir", "interpolate")
"""Stages that make the record of a held-out experiment, in their order."""


def _held_out(folders: list[Path]) -> tuple[str, ...]:
    """Settings of the study that declare raw folders as held-out experiments."""
    entry = {"held_out": True}
    return tuple(f"experiments.{folder.name}={json_format.dumps({**entry, 'experiment': str(folder.absolute())})}" for folder in folders)


def validate(
    common: Common,
    experiment: Annotated[
        list[Path] | None,
        typer.Option("--experiment", metavar="FOLDER", help="Raw folder to predict; may be repeated.", show_default=False),
    ] = None,
) -> None:
    """Predict experiments that no fit has seen: those held out in the study, and the raw folders given by options."""
    study = replace(common, settings=(*common.settings, *_held_out(experiment or []))).load()

    def prepare(one: Study) -> None:
        """The record of a held-out experiment: simulated where it is virtual, its camera calibrated where it has frames."""
        needed = {"simulate": one.virtual, "calibrate-ir": (one.experiment / "ir").is_dir()}
        for name in RAW:
            if needed.get(name, True):
                stage_function(name)(one)

    _show("validate", common, study, lambda: stage_function("validate")(study, force=common.force, prepare=prepare))


def compare(
    common: Common,
    others: Annotated[
        list[Path] | None, typer.Argument(metavar="[OTHER.yaml]...", help="Further studies of the same data.", show_default=False)
    ] = None,
) -> None:
    """Models side by side on the same data: the candidates of the study, and further studies."""
    study = common.load()
    further = [replace(common, study=path, run_dir=None).load() for path in others or ()]
    _show("compare", common, study, lambda: stage_function("compare")(study, force=common.force, others=further))


def inject(
    common: Common,
    effect: Annotated[str, typer.Option("--effect", metavar="NAME", help="Effect of the catalogue, or of a file of the study.")],
    amplitude: Annotated[float, typer.Option("--amplitude", metavar="A", help="Value of its first parameter, in its unit.")],
    count: Annotated[int, typer.Option("--count", metavar="N", min=1, help="How many different ways to plant it.")] = 1,
    secondary: Annotated[
        list[str] | None,
        typer.Option("--secondary", metavar="NAME=VALUE", help="A parameter that is not drawn, such as place=10.", show_default=False),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of the draws.")] = 1,
    predict_only: Annotated[bool, typer.Option("--predict-only", help="Only predict, do not run the loop.")] = False,
    jobs: Jobs = 1,
) -> None:
    """Plant an effect into the measured data, and count how often the loop finds it."""
    study = common.load()
    held = dict(_value_of(text) for text in secondary or ())

    def call() -> Outcome:
        from thermofit.stages.inject import InjectOptions, run

        options = InjectOptions(effect, amplitude, count, held, seed, predict_only)
        return run(study, options, force=common.force, where=executor_of(study, jobs, None))

    _show("inject", common, study, call)


def _value_of(text: str) -> tuple[str, float]:
    """NAME=VALUE of an option. StudyError where it is none."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise StudyError(f"--secondary {text}: expected NAME=VALUE with a number, such as place=10") from None


for _entry, _command in ((VALIDATE, validate), (COMPARE, compare), (INJECT, inject)):
    app.command(_entry.name, help=_entry.help, epilog=_entry.epilog, rich_help_panel=_entry.panel)(on_study(_command))


exporting.register(app)
looking.register(app)
watching.register(app)
