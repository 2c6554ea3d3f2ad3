"""Section: the thesis's experiment 3 identified by the commands of thermofit; wall time, forward runs, memory, and Nelder-Mead beside it.

The virtual experiment and its interpolated data are made first and kept in the scratch folder, so that a run that was stopped goes on.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench_measure import ROOT, Child, Limits, Options, Part, Row, Target, at_least, at_most, run_child

STAGES = ("elastic", "plastic", "thermal")
NELDER_MEAD = "nelder-mead"
DONE, UNTRUSTWORTHY = 0, 5
_SMALL = (
    "mesh={n_x: 4, n_y: 28, n_z: 1}",
    "simulate.mesh={n_x: 4, n_y: 32, n_z: 2}",
    "simulate.dic={stages: 60}",
    "simulate.ir={frames: 70}",
)
"""Settings of a quick run."""
_TINY = ("mesh={n_x: 4, n_y: 28, n_z: 1}", "simulate.dic={stages: 40}", "simulate.ir={frames: 40}")
"""Settings of the quickstart where only start and compilation matter."""


@dataclass(frozen=True)
class StageRun:
    """One stage as a command: wall s, CPU s, peak bytes, counts of evaluations, whether it says that it converged, its verdict."""

    stage: str
    wall: float
    cpu: float
    peak: float
    counts: Mapping[str, int]
    trustworthy: bool
    verdict: str

    @property
    def forward(self) -> int:
        """Forward runs, failed ones too."""
        return int(self.counts.get("forward", 0))


@dataclass(frozen=True)
class Chain:
    """Where a study is run: its file, run folder, settings."""

    study: Path
    run_dir: Path
    settings: tuple[str, ...]

    def command(self, command: str, *more: str) -> list[str]:
        """A command line of thermofit on this study."""
        given = [part for setting in self.settings for part in ("--set", setting)]
        return [sys.executable, "-m", "thermofit.cli", command, str(self.study), "--run-dir", str(self.run_dir), *given, *more]

    def prepare(self) -> None:
        """Raw files and interpolated data of the virtual experiment; nothing where they are fresh."""
        checked(run_child(self.command("run", "--until", "interpolate", "--json"), cwd=ROOT), "run --until interpolate")

    def identify(self, stage: str, *, method: str = "", extra: Sequence[str] = ()) -> StageRun:
        """One stage computed anew; its artefact, written by it, is read through `thermofit show --json`."""
        chosen = (*((f"stages.{stage}.method={method}",) if method else ()), *extra)
        settings = [part for setting in chosen for part in ("--set", setting)]
        child = run_child(self.command(f"identify-{stage}", "--force", "--json", *settings), cwd=ROOT)
        checked(child, f"identify-{stage}")
        shown = run_child([sys.executable, "-m", "thermofit.cli", "show", str(self.run_dir / f"identify-{stage}.h5"), "--json"], cwd=ROOT)
        checked(shown, "show")
        return stage_run(stage, child, json.loads(shown.stdout))


def small_chain(folder: Path) -> Chain:
    """The quickstart on a tiny mesh."""
    return Chain(ROOT / "configs" / "quickstart.yaml", folder, _TINY)


def compiled(options: Options) -> None:
    """Kernels of all stages are compiled (by the quickstart, computed anew), so that the runs that are timed find them."""
    chain = small_chain(options.scratch / "compile")
    checked(run_child(chain.command("run", "--until", "identify-thermal", "--force", "--json"), cwd=ROOT), "run of the quickstart")


def stage_run(stage: str, child: Child, shown: Mapping[str, Any]) -> StageRun:
    """StageRun of a finished command and of what `thermofit show --json` says of its artefact."""
    return StageRun(stage, child.wall, child.cpu, child.peak, shown["evaluations"], bool(shown["trustworthy"]), str(shown["verdict"]))


def checked(child: Child, name: str) -> None:
    """RuntimeError with the command's own sentence where it failed; an answer that is not to be trusted is an answer."""
    if child.code not in (DONE, UNTRUSTWORTHY):
        said = (child.stderr.strip() or child.stdout.strip())[-500:]
        raise RuntimeError(f"thermofit {name} ended with exit code {child.code}: {said}")


def chain_of(options: Options, mesh: str) -> Chain:
    """Experiment 3 on a mesh, in a run folder of its own; small where the run is quick."""
    threads = f"numerics.threads={options.threads}"
    settings = (threads, *_SMALL) if options.quick else (threads, f"mesh={mesh}")
    name = "exp3-quick" if options.quick else f"exp3-{mesh}"
    return Chain(ROOT / "configs" / "exp3.yaml", options.scratch / name, settings)


def measure(options: Options, limits: Limits) -> Part:
    """Wall time and memory of the three stages on the full mesh from interpolated data."""
    chain = chain_of(options, "full")
    chain.prepare()
    compiled(options)
    runs = [chain.identify(stage) for stage in STAGES]
    rows = [Row(f"identify-{run.stage} (wall)", run.wall, stage_note(run)) for run in runs]
    wall, peak = sum(run.wall for run in runs), max(run.peak for run in runs)
    rows.append(Row("all three (wall)", wall, f"CPU {sum(run.cpu for run in runs):.1f} s"))
    targets = (
        at_most("identification of experiment 3 from interpolated data, wall", wall / 60.0, 8.0, "min"),
        at_most("peak memory of the identification", peak / 1e9, 1.5, "GB"),
    )
    mesh = "small mesh (quick)" if options.quick else "full mesh"
    verdicts = tuple(f"identify-{run.stage}: {run.verdict}." for run in runs)
    return Part(f"Identification of experiment 3, {mesh}", tuple(rows), targets, verdicts)


def measure_nelder_mead(options: Options, limits: Limits) -> Part:
    """Forward runs of Nelder-Mead and of least squares on one objective, on the coarse mesh, stage by stage.

    Nelder-Mead goes first in each stage, so that both start from the same results of the stages before.
    """
    chain = chain_of(options, "coarse")
    chain.prepare()
    rows, by_method = [], {NELDER_MEAD: [], "least-squares": []}
    for stage in STAGES:
        for method, runs in by_method.items():
            limit = ("stages." + stage + ".max_evaluations=200",) if options.quick and method == NELDER_MEAD else ()
            run = chain.identify(stage, method=method, extra=limit)
            runs.append(run)
            rows.append(Row(f"identify-{stage}, {method} (wall)", run.wall, stage_note(run)))
    simplex, squares = (sum(run.forward for run in runs) for runs in by_method.values())
    factors = [f"{stage} {a.forward / max(b.forward, 1):.1f}" for stage, a, b in zip(STAGES, *by_method.values(), strict=True)]
    unfinished = [run.stage for run in by_method[NELDER_MEAD] if not run.trustworthy]
    remarks = (
        f"Factor by stage: {', '.join(factors)}.",
        "Runs for differences and for standard errors are counted; a run with exact derivatives counts as one.",
        *((f"Nelder-Mead did not converge in: {', '.join(unfinished)}; its number of runs is a lower bound there.",) if unfinished else ()),
    )
    target: Target = at_least("forward runs of Nelder-Mead / least squares, same objective", simplex / max(squares, 1), 30.0)
    mesh = "small mesh (quick)" if options.quick else "coarse mesh"
    return Part(f"Nelder-Mead beside least squares, experiment 3, {mesh}", tuple(rows), (target,), remarks)


def measure_search(options: Options, limits: Limits) -> Part:
    """A grid search of ten starts of six thermal parameters in two processes beside one identification of them, on the coarse mesh."""
    chain = chain_of(options, "coarse")
    chain.prepare()
    for stage in STAGES[:-1]:
        checked(run_child(chain.command(f"identify-{stage}", "--json"), cwd=ROOT), f"identify-{stage}")
    one = chain.identify(STAGES[-1])
    search = run_child(chain.command("gridsearch", "--jobs", "2", "--force", "--json"), cwd=ROOT)
    checked(search, "gridsearch")
    found = json.loads(search.stdout)
    starts, counts = len(found["starts"]), found["evaluations"]
    note = f"CPU {search.cpu:.1f} s, {search.cpu / one.cpu:.2f} identifications; {counts['forward']} forward runs"
    rows = (
        Row("identify-thermal (wall)", one.wall, stage_note(one)),
        Row(f"gridsearch of {starts} starts, two processes (wall)", search.wall, note),
    )
    targets = (
        at_most("gridsearch on two cores, in identifications, wall", search.wall / one.wall, 4.0, ""),
        at_most("gridsearch on two cores, in identifications, half its CPU time", 0.5 * search.cpu / one.cpu, 4.0, ""),
    )
    mesh = "small mesh (quick)" if options.quick else "coarse mesh"
    return Part(f"Grid search of experiment 3, {mesh}", rows, targets, (f"gridsearch: {found['verdict']}.",))


def stage_note(run: StageRun) -> str:
    """What a stage cost besides wall time, in one line."""
    counts = ", ".join(f"{value:.4g} {name}" for name, value in run.counts.items())
    return f"CPU {run.cpu:.1f} s, {run.peak / 1e6:.0f} MB; evaluations: {counts}"
