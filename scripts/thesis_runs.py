"""The runs behind docs/reproduction: which study, with which settings, after which other run; carried out two at a time, resumable.

A run that takes over the work of another one (the raw folder and the first stages) gets copies of its artefacts: the stages find them
fresh, or make them anew where a setting concerns them.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thermofit.core.digest import file_digest
from thermofit.core.errors import DataError, NumericsError, StudyError, ThermofitError
from thermofit.core.files import replacing
from thermofit.records.artefact import Record, open_record
from thermofit.records.staging import artefact_path

ROOT = Path(__file__).resolve().parents[1]
LOG, COST, TOTAL = "log.txt", "cost.json", "total.json"
"""Beside the artefacts of a run: output, time of every command; beside the runs: time of every call of the script."""
_DONE = (0, 5)
"""Exit codes after which a run goes on: 5 says that an answer is not trustworthy, which is what some runs are to show."""
_WHOLE = (("run", "--all", "--until", "verify"),)
_SHARED = ("calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal")
_THERMAL = ("alpha_exp", "kappa", "c0", "beta")


@dataclass(frozen=True)
class Run:
    """One run folder: its section of the thesis, study, settings, commands, and the run whose raw folder and artefacts it takes over."""

    name: str
    section: str
    study: str
    settings: tuple[str, ...] = ()
    after: str = ""
    commands: tuple[tuple[str, ...], ...] = _WHOLE
    only: str = ""
    """The one mesh of `MESHES` for which it is carried out; empty: all."""


def _fixed(**values: float) -> tuple[str, ...]:
    return tuple(f"parameters.{name}={value!r}" for name, value in values.items())


AIR = (296.70, 296.80, 297.00, 297.20, 297.30, 297.50, 297.60, 297.80)
"""Air temperatures of Table 5.20 in K, without the measured one of 297.40."""
_MODEL_1 = ("model=1", "parameters.beta={start: 1.0, bounds: [0.0, 50.0]}")
"""The bounds (4.25) of beta are those of model 2."""
_MODEL_2 = ("model=2", "parameters.beta={start: 1.0, bounds: [0.0, 6.92]}")
_COUPLED = ("mesh={n_x: 3, n_y: 20, n_z: 1}", "stages.thermal.coupling=full")
"""Every evaluation is a coupled run: on a rough mesh."""
_FOUR = (
    "{alpha_exp: 23.0e-6, kappa: 200.0, c0: 2.43, beta: 1.0}",
    "{alpha_exp: 23.0e-6, kappa: 200.0, c0: 2.43, beta: 0.1}",
    "{alpha_exp: 23.0e-6, kappa: 200.0, c0: 2.43, beta: 0.5}",
    "{alpha_exp: 12.0e-6, kappa: 400.0, c0: 1.22, beta: 0.5}",
)
_WIDE = (
    "parameters.alpha_exp={start: 23.0e-6, bounds: [1.0e-6, 1.0e-3]}",
    "parameters.kappa={start: 200.0, bounds: [10.0, 1.0e4]}",
    "parameters.c0={start: 2.43, bounds: [0.01, 30.0]}",
    "parameters.beta={start: 1.0, bounds: [0.0, 50.0]}",
)
"""The bounds of experiment 2: model 1 ends far from the material."""
_KNOWN_FILMS = (
    "model=1",
    *_WIDE,
    *_fixed(alpha_air=14.72, alpha_clamp=236.30),
    f"stages.thermal.free=[{', '.join(_THERMAL)}]",
    f"gridsearch.starts=[{', '.join(_FOUR)}]",
)
"""Model 1 with the film coefficients of Table 5.19 and the starts of Table 5.9."""
_SEARCH = (("identify-thermal",), ("gridsearch",))
_THERMAL_ONLY = (("identify-thermal",), ("verify",))
_REFINED = (("run", "--until", "refine"),)
_OF_THREE = ("evaluation.interpolation=three-point",)
THREE_POINT = "-three-point"
"""Behind the name of a run: the same with nodal values from the three nearest points and pixels (algorithms 2 and 3)."""
INTERPOLATED = {"exp3": "5.5", "exp2": "5.4", "exp1": "5.3"}
"""Runs that are carried out with both interpolations, and their sections."""
_BEFORE = (("identifiability", "--a-priori"),)


def _assumed(**values: float) -> str:
    """The material that an analysis before the test assumes; what the studies add for their virtual material is not foreseen."""
    return "simulate.truth={" + ", ".join(f"{name}: {value!r}" for name, value in values.items()) + "}"


_ISOTHERMAL = {"alpha_air": 0.0, "alpha_clamp": 1.0e8}
_ONE = _assumed(
    E=67913.0, nu=0.35, M_y0=131.13, M_yinf=297.97, H_exp=10.62, F=0.37, alpha_exp=23.0e-6, kappa=200.0, c0=2.43, beta=0.8,
    theta_air=297.40, theta_clamp=296.25, **_ISOTHERMAL,
)  # fmt: skip
_TWO = _assumed(
    E=67026.0, nu=0.36, M_y0=129.28, M_yinf=293.36, H_exp=10.97, F=0.37, alpha_exp=23.0e-6, kappa=200.0, c0=2.43, beta=0.8,
    theta_air=297.65, theta_clamp=296.95, **_ISOTHERMAL,
)  # fmt: skip
"""Literature values of the alloy, and a share of the plastic work of about 0.8."""


@dataclass(frozen=True)
class _Plan:
    """An analysis before a test: the run that it speaks of, its study and settings."""

    of: str
    section: str
    study: str
    settings: tuple[str, ...] = ()
    stage: str = "thermal"

    @property
    def run(self) -> Run:
        """As a run of its own, on a rough mesh: a plan needs no other."""
        name = f"before-{self.of}" + ("" if self.stage == "thermal" else f"-{self.stage}")
        command = (*_BEFORE[0], "--stage", self.stage)
        return Run(name, self.section, self.study, ("mesh={n_x: 3, n_y: 20, n_z: 1}", *self.settings), "", (command,))


PLANS = (
    _Plan("exp1", "5.3", "exp1.yaml", ("stages.elastic.channels={u: {}}",), "elastic"),
    _Plan("exp1", "5.3", "exp1.yaml"),
    _Plan("exp1-models", "5.4", "exp1-models.yaml", (_ONE,)),
    _Plan("exp1-model-2", "5.4", "exp1-models.yaml", (*_MODEL_2, _ONE)),
    _Plan("exp2-model-1", "5.4", "exp2.yaml", (*_MODEL_1, _TWO)),
    _Plan("exp2-model-1-coupled", "5.4", "exp2.yaml", (*_MODEL_1, *_COUPLED, _TWO)),
    _Plan("exp2", "5.4", "exp2.yaml", (_TWO,)),
    _Plan("exp3-model-1", "5.4", "exp3.yaml", ("model=1", f"stages.thermal.free=[{', '.join(_THERMAL)}]")),
    _Plan("exp3", "5.5", "exp3.yaml"),
)
RUNS = (
    Run("exp3", "5.5", "exp3.yaml"),
    Run("exp1-models", "5.4", "exp1-models.yaml"),
    Run("exp2", "5.4", "exp2.yaml"),
    Run("exp1", "5.3", "exp1.yaml"),
    Run("exp2-model-1", "5.4", "exp2.yaml", _MODEL_1, "exp2"),
    Run("exp1-model-2", "5.4", "exp1-models.yaml", _MODEL_2, "exp1-models"),
    Run("exp3-air", "5.5", "exp3.yaml", ("sensitivity.quantity=theta_air", f"sensitivity.values={list(AIR)}"), "exp3", (("sensitivity",),)),
    Run("exp2-model-1-coupled", "5.4", "exp2.yaml", (*_MODEL_1, *_COUPLED), "exp2-model-1", (("gridsearch", "--jobs", "1"),), "full"),
    Run(
        "exp3-isothermal", "5.5", "exp3.yaml",
        (*_fixed(alpha_air=0.0, alpha_clamp=1.0e8), f"stages.thermal.free=[{', '.join(_THERMAL)}]"), "exp3", _THERMAL_ONLY,
    ),
    Run(
        "exp3-literature", "5.5", "exp3.yaml",
        (*_fixed(alpha_exp=23.0e-6, kappa=200.0, c0=2.43), "stages.thermal.free=[beta, alpha_air, alpha_clamp]"), "exp3", _THERMAL_ONLY,
    ),
    Run("exp3-model-1", "5.4", "exp3.yaml", _KNOWN_FILMS, "exp3", _SEARCH),
    *(Run(f"{name}{THREE_POINT}", section, f"{name}.yaml", _OF_THREE, name, _REFINED) for name, section in INTERPOLATED.items()),
    *(plan.run for plan in PLANS),
)  # fmt: skip
"""In the order in which they begin: the longest first, and every run behind the one that it takes over."""
MESHES = {
    "quick": (
        "mesh={n_x: 2, n_y: 16, n_z: 1}",
        "simulate.mesh={n_x: 2, n_y: 16, n_z: 1}",
        "simulate.dic={stages: 60, spacing: 2.0}",
        "simulate.ir={frames: 50, image_shape: [150, 90]}",
        "numerics.max_time_step=10.0",
    ),
    "coarse": ("mesh=coarse",),
    "full": ("mesh=full",),
}
"""Settings of all runs by the name of the mesh; `quick` shows that everything runs, its numbers mean little."""
SECTIONS = {"exp1": "5.3", "exp2": "5.4", "exp3": "5.5"}
"""Section of the thesis by the target of the Makefile."""


@dataclass(frozen=True)
class Place:
    """Where the runs of one mesh lie."""

    folder: Path
    mesh: str

    def dir_of(self, name: str) -> Path:
        """Folder of a run."""
        return self.folder / name

    def has(self, name: str, stage: str) -> bool:
        """Whether a run has left the artefact of a stage."""
        return artefact_path(self.dir_of(name), stage).exists()

    def record(self, name: str, stage: str) -> Record:
        """Artefact of a stage of a run; StudyError that names what makes it where it is missing."""
        path = artefact_path(self.dir_of(name), stage)
        if not path.exists():
            raise StudyError(f"artefact '{path}' is missing: run `make thesis MESH={self.mesh}` first")
        return open_record(path)


def place_of(runs: Path, mesh: str) -> Place:
    """The place of a mesh below a folder of runs."""
    return Place(runs.absolute() / f"thesis-{mesh}", mesh)


def chosen(sections: Sequence[str], mesh: str = "full") -> tuple[Run, ...]:
    """The runs of the named sections on a mesh, and those that they take over."""
    names = {other.name for run in RUNS if run.section in sections for other in (run, base_of(run))}
    return tuple(run for run in RUNS if run.name in names and run.only in ("", mesh))


def execute(runs: Sequence[Run], place: Place, jobs: int, say: Callable[[str], None]) -> None:
    """Carry out the runs, `jobs` at a time; `say` hears a line for every one. The error of the first run that fails, after the others."""
    with ThreadPoolExecutor(jobs) as pool:
        waiting: dict[str, Future[None]] = {}
        for run in runs:
            waiting[run.name] = pool.submit(_carry_out, run, place, waiting.get(run.after), say)
    for future in waiting.values():
        future.result()


def _carry_out(run: Run, place: Place, before: Future[None] | None, say: Callable[[str], None]) -> None:
    if before is not None:
        before.result()
    folder = place.dir_of(run.name)
    folder.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    if run.after:
        take_over(place.dir_of(run.after), folder)
    with open(folder / LOG, "w", encoding="utf-8") as log:
        for command in run.commands:
            _call(run, place, command, log)
    say(f"{run.name:<22} {time.perf_counter() - begin:6.0f} s  {verdict_of(run, place)}")


def take_over(source: Path, target: Path) -> None:
    """Copy the artefacts of the shared stages that differ; an artefact of the target that its settings made anew is copied over as well."""
    for stage in _SHARED:
        theirs, ours = artefact_path(source, stage), artefact_path(target, stage)
        mark = ours.with_suffix(".taken")
        if not theirs.exists():
            continue
        digest = file_digest(theirs)
        if not mark.exists() or mark.read_text(encoding="ascii") != digest:
            shutil.copyfile(theirs, ours)
            mark.write_text(digest, encoding="ascii")


def _call(run: Run, place: Place, command: Sequence[str], log: object) -> None:
    settings = [*MESHES[place.mesh], "numerics.threads=1", *run.settings]
    if run.after:
        settings.append(f"experiment={place.dir_of(base_of(run).name) / 'raw'}")
    name, *options = command
    line = [sys.executable, "-m", "thermofit.cli", name, str(ROOT / "configs" / run.study), "--run-dir", str(place.dir_of(run.name))]
    line += [part for setting in settings for part in ("--set", setting)] + options
    begin = time.perf_counter()
    process = subprocess.Popen(line, stdout=log, stderr=subprocess.STDOUT)  # type: ignore[call-overload]
    # Of this child alone: the sum over all children would hold those that run beside it.
    _, code, spent = os.wait4(process.pid, 0)
    status = process.returncode = os.waitstatus_to_exitcode(code)
    _note(place.dir_of(run.name) / COST, {"command": name, "wall_s": time.perf_counter() - begin, "cpu_s": spent.ru_utime + spent.ru_stime})
    if status not in _DONE:
        path = place.dir_of(run.name) / LOG
        lines = path.read_text(encoding="utf-8").strip().splitlines() or ["no output"]
        kind: dict[int, type[ThermofitError]] = {2: StudyError, 3: DataError}
        raise kind.get(status, NumericsError)(f"run '{run.name}', {name}: {lines[-1].removeprefix('error: ')}; see {path}")


def _note(path: Path, entry: dict[str, float | str | bool]) -> None:
    """Add an entry to a list on disk."""
    known = noted(path)
    with replacing(path, durable=False) as temporary:
        temporary.write_text(json.dumps([*known, entry], indent=1), encoding="utf-8")


def noted(path: Path) -> list[dict[str, Any]]:
    """The entries of a list on disk; empty where there is none."""
    entries: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    return entries


def cpu_of(runs: Sequence[Run], place: Place) -> float:
    """CPU time in s that the commands of the runs have taken so far, those that were stopped included."""
    return sum(float(entry["cpu_s"]) for run in runs for entry in noted(place.dir_of(run.name) / COST))


def note_total(place: Place, entry: dict[str, float | str | bool]) -> None:
    """Keep how long a whole call took."""
    _note(place.folder / TOTAL, entry)


def base_of(run: Run) -> Run:
    """The run that made the raw folder."""
    while run.after:
        run = next(other for other in RUNS if other.name == run.after)
    return run


def verdict_of(run: Run, place: Place) -> str:
    """Verdict of the last stage of a run that judges something."""
    for stage in ("sensitivity", "gridsearch", "verify"):
        if artefact_path(place.dir_of(run.name), stage).exists():
            return f"{stage}: {place.record(run.name, stage).summary['verdict']}"
    return "done"
