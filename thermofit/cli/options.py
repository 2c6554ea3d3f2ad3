"""Options that all commands on a study share, declared once."""

from __future__ import annotations

import contextlib
import inspect
import json as json_format
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thermofit.cli.failure import reporting
from thermofit.core.errors import StudyError
from thermofit.records.progress import set_verbosity

if TYPE_CHECKING:
    from thermofit.records.executor import Executor
    from thermofit.study.study import Study

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout, and nothing else there.")]
Jobs = Annotated[int, typer.Option("--jobs", metavar="N", help="Local processes that work side by side.")]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="URL", help="Dask scheduler whose workers do it, such as tcp://host:8786.", show_default=False),
]
Refine = Annotated[bool, typer.Option("--refine", help="Errors of mesh and steps besides, by six further runs.")]
MaxEffects = Annotated[
    int | None,
    typer.Option("--max-effects", metavar="N", help="Most effects to add, instead of diagnosis.max_effects.", show_default=False),
]
Pick = Annotated[bool, typer.Option("--pick", help="Open a window and click the landmarks in a frame.")]
Also = Annotated[
    list[str] | None, typer.Option("--also", metavar="FORMAT", help="Figures also as pdf or svg; may be repeated.", show_default=False)
]
LengthMm = Annotated[
    float | None,
    typer.Option("--length-mm", metavar="MM", help="With --pick: distance of the first two points.", min=1e-3, show_default=False),
]


@dataclass(frozen=True)
class Common:
    """What every command on a study is told."""

    study: Path
    settings: tuple[str, ...]
    run_dir: Path | None
    force: bool
    json: bool
    verbose: bool = False
    quiet: bool = False

    def load(self) -> Study:
        """The study file with the settings of the command line."""
        from thermofit.study.study import load_study

        # A path is text whatever it looks like, and JSON's quotes are YAML's.
        folder = () if self.run_dir is None else (f"run_dir={json_format.dumps(str(self.run_dir))}",)
        return load_study(self.study, (*self.settings, *folder), check_effects)

    def setting(self, key: str, value: object) -> Common:
        """The same with a key of the study set by an option of its own, which counts more than --set; None: it is not given."""
        return self if value is None else replace(self, settings=(*self.settings, f"{key}={value}"))


def check_effects(files: Sequence[Path]) -> None:
    """Try the user's effects; imported only then, because kernels come with it."""
    from thermofit.identify.user_effects import check_effects

    check_effects(files)


def executor_of(study: Study, jobs: int, scheduler: str | None) -> Executor:
    """Where the independent problems of a stage are solved; processes share the threads that the study allows, a Dask worker has one."""
    from thermofit.records.executor import Executor

    return Executor(jobs, scheduler, 1 if scheduler is not None else max(1, study.numerics.threads // max(1, jobs)))


def quiet(as_json: bool) -> contextlib.AbstractContextManager[Any]:
    """With --json nothing but the result reaches stdout, whatever a library prints."""
    return contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext()


def _shared(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY.yaml", help="Study file; `thermofit new` writes a commented one.", show_default=False)
    ],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Set a key of the study, such as mesh=coarse; may be repeated.", show_default=False
        ),
    ] = None,
    run_dir: Annotated[
        Path | None,
        typer.Option(
            "--run-dir", metavar="DIR", help="Folder of artefacts and figures, instead of the study's run_dir.", show_default=False
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Compute again even where nothing has changed.")] = False,
    json: AsJson = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="A plain line per iteration on stderr, and notes that ask for nothing.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print the verdict alone, and no progress.")] = False,
) -> None:
    """Signature of the shared options."""


def on_study(command: Callable[..., None]) -> Callable[..., None]:
    """`command(common, *own options)` as a function that typer understands: STUDY.yaml, its own options, the shared ones.

    Errors of the command become one sentence and an exit code.
    """
    shared = list(inspect.signature(_shared, eval_str=True).parameters.values())
    own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]

    def parsed(**values: Any) -> None:
        given = {parameter.name: values.pop(parameter.name) for parameter in shared}
        common = Common(**{**given, "settings": tuple(given["settings"] or ())})
        with reporting(common.json):
            if common.verbose and common.quiet:
                raise StudyError("--verbose and --quiet are both given; expected one of them")
            set_verbosity(1 if common.verbose else -1 if common.quiet else 0)
            command(common, **values)

    places = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in (shared[0], *own, *shared[1:])]
    parsed.__signature__ = inspect.Signature(places)  # type: ignore[attr-defined]
    parsed.__doc__ = command.__doc__
    return parsed
