"""The command `identifiability`: its options, and how its result is printed."""

from __future__ import annotations

import contextlib
import inspect
import sys
from typing import Annotated, Any

import typer

from thermofit.cli.catalogue import IDENTIFIABILITY_EXAMPLES, IDENTIFIABILITY_HELP, TRUST
from thermofit.cli.failure import UNTRUSTWORTHY
from thermofit.cli.options import Common, Jobs, Scheduler, executor_of, on_study
from thermofit.core.errors import StudyError

_STAGE = "elastic, plastic or thermal; absent: thermal, of coupons plastic."


def _subject(
    programmes: Annotated[
        list[str] | None,
        typer.Argument(metavar="[PROGRAMME]...", help="With --compare: which; all where none is named.", show_default=False),
    ] = None,
    stage: Annotated[str | None, typer.Option("--stage", metavar="STAGE", help=_STAGE, show_default=False)] = None,
    before: Annotated[bool, typer.Option("--a-priori", help="Before any data: the planned test of section simulate.")] = False,
    programme: Annotated[
        str, typer.Option("--programme", metavar="NAME", help="With --a-priori: another programme than the study's.")
    ] = "own",
    compare: Annotated[bool, typer.Option("--compare", help="Rank test programmes by the intervals that they would give.")] = False,
) -> None:
    """Signature of the options that say what is looked at."""


def _ways(
    repeats: Annotated[int, typer.Option("--bootstrap", metavar="N", min=0, help="Block bootstrap with N repeats.")] = 0,
    refit: Annotated[bool, typer.Option("--refit", help="Fit every repeat of the bootstrap anew instead of by the Jacobian.")] = False,
    profile: Annotated[bool, typer.Option("--profile", help="Profile likelihood of every parameter.")] = False,
    mcmc: Annotated[bool, typer.Option("--mcmc", help="Markov chain on the linearised model (needs emcee).")] = False,
    full_model: Annotated[bool, typer.Option("--full-model", help="With --mcmc: a chain of forward runs, for small problems.")] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Of bootstrap and chain.")] = 1,
) -> None:
    """Signature of the options that say how intervals are found."""


def _where(jobs: Jobs = 1, scheduler: Scheduler = None) -> None:
    """Signature of the options that say where it runs."""


def identifiability(common: Common, **asked: Any) -> None:
    """Do the data determine the parameters?"""
    import time

    from thermofit.cli import printing
    from thermofit.records.result import is_trustworthy, result_of

    programmes, compare = asked.pop("programmes") or (), asked.pop("compare")
    jobs, scheduler = asked.pop("jobs"), asked.pop("scheduler")
    if programmes and not compare:
        raise StudyError(
            f"'{programmes[0]}' is given without --compare: programmes by name are compared, or one is taken by --programme NAME"
        )
    study = common.load()
    if not (common.json or common.quiet):
        typer.echo(f"identifiability  study {study.source.name}, results in {study.run_dir}")
    begin = time.perf_counter()
    with contextlib.redirect_stdout(sys.stderr) if common.json else contextlib.nullcontext():
        from thermofit.stages.identifiability import Options, run

        chosen = Options(compare=tuple(programmes) if compare else None, **asked)
        outcome = run(study, chosen, force=common.force, where=executor_of(study, jobs, scheduler))
    result: dict[str, Any] = result_of(outcome.record)
    if common.json:
        printing.as_json({**result, "fresh": outcome.fresh})
    else:
        printing.stage_result(result, outcome.fresh, time.perf_counter() - begin, quiet=common.quiet)
    if not is_trustworthy(outcome.record):
        raise typer.Exit(UNTRUSTWORTHY)


def _signature() -> inspect.Signature:
    """`common`, then the options of all groups."""
    first = next(iter(inspect.signature(identifiability, eval_str=True).parameters.values()))
    groups = (_subject, _ways, _where)
    options = [p for group in groups for p in inspect.signature(group, eval_str=True).parameters.values()]
    return inspect.Signature([first, *options])


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    identifiability.__signature__ = _signature()  # type: ignore[attr-defined]
    command = app.command("identifiability", help=IDENTIFIABILITY_HELP, rich_help_panel=TRUST, epilog=IDENTIFIABILITY_EXAMPLES)
    command(on_study(identifiability))
