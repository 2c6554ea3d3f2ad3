"""The command `watch`: what a run that works in another terminal is doing, read from the logs beside its artefacts."""

from __future__ import annotations

import json as json_format
import time
from pathlib import Path
from typing import Annotated

import typer

from thermofit.cli.catalogue import LOOK
from thermofit.cli.failure import reporting
from thermofit.core.errors import StudyError

HELP = (
    "What a run is doing, from another terminal.\n\n"
    "Follows the logs beside the artefacts of a run folder, RUN_DIR/<stage>.log.jsonl: stage, iteration, error over the noise, parameters "
    "that move. Ends when the process that writes them has ended. RUN is a run folder or the study file."
)
_LOOK_S = 0.5


def watch(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder, or its study file.", show_default=False)],
    once: Annotated[bool, typer.Option("--once", help="Print what is there and end.")] = False,
    last: Annotated[int, typer.Option("--last", metavar="N", min=0, help="Begin with the last N lines of every stage.")] = 3,
    wait: Annotated[float, typer.Option("--wait", metavar="S", help="Seconds to wait for the next stage before it ends.")] = 5.0,
    json: Annotated[bool, typer.Option("--json", help="Print the events as JSON lines.")] = False,
) -> None:
    """Follow a run."""
    with reporting(json):
        from thermofit.records.log import ENDING, alive, events_of, line_of

        folder = _folder(run)
        shown: dict[Path, int] = {}
        quiet_since = time.monotonic()
        while True:
            logs = sorted((*folder.glob(f"*{ENDING}"), *folder.glob(f"*/*{ENDING}")), key=lambda path: path.stat().st_mtime)
            if not logs and once:
                raise StudyError(f"'{folder}' holds no log; a stage that runs writes RUN_DIR/<stage>{ENDING}")
            at_work = False
            for path in logs:
                events = events_of(path)
                stage = path.relative_to(folder).as_posix().removesuffix(ENDING)
                if shown.get(path, 0) > len(events):
                    shown[path] = 0  # begun anew
                begin = shown.get(path, max(len(events) - last, 0) if last else len(events))
                for event in events[begin:]:
                    typer.echo(json_format.dumps({"stage": stage, **event}) if json else line_of(stage, event))
                shown[path] = len(events)
                at_work = at_work or alive(events)
                if once and events and events[-1]["event"] == "step" and not alive(events):
                    typer.echo(f"{stage}: its process has ended without a word; the same command resumes", err=True)
            now = time.monotonic()
            quiet_since = now if at_work else quiet_since
            if once or now - quiet_since > wait:
                return
            time.sleep(_LOOK_S)


def _folder(run: Path) -> Path:
    """The run folder. StudyError where there is none yet."""
    if run.suffix in (".yaml", ".yml"):
        from thermofit.study.study import load_study

        run = load_study(run).run_dir
    if not run.is_dir():
        raise StudyError(f"'{run}' is no folder; expected the folder of a run, which `thermofit run` makes as it begins")
    return run


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("watch", help=HELP, rich_help_panel=LOOK, epilog="[bold]Example:[/] thermofit watch runs/my-study")(watch)
