"""thermofit in notebooks and scripts: load a study, run it, take its results as arrays.

import thermofit

study = thermofit.load_study("study.yaml", mesh="coarse")
result = thermofit.run(study)
result.parameters["F"].value, result.field("u").predicted
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.records.artefact import ParameterResult, Record, layout, open_record
from thermofit.records.result import is_trustworthy, result_of
from thermofit.stages import CHAIN, NECKING_CHAIN, stage_function
from thermofit.study.paths import demo_study
from thermofit.study.study import Study
from thermofit.study.study import load_study as read_study

if TYPE_CHECKING:
    import xarray

__all__ = ["Field", "Matrix", "Result", "demo_study", "load_study", "open_record", "open_run", "run", "run_stage"]

Tell = Callable[[dict[str, Any]], None]
"""Told of every stage as soon as it is done: its JSON, with `fresh` and `wall_s`."""
_LAST = "identify-thermal"
_ON_CHAIN = ("diagnose", "close-loop")
"""Stages that need all identifications first."""


def load_study(path: str | Path, /, run_dir: str | Path | None = None, **settings: Any) -> Study:
    """Read a study file; StudyError says in a sentence what is wrong in it.

    `run_dir` is the folder of its results. Keys of the study are set by keywords, those of sections with two underscores:
    `load_study("study.yaml", mesh="coarse", stages__thermal__free=["beta", "c0"])`.
    """
    folder = {} if run_dir is None else {"run_dir": str(run_dir)}
    given = {**{key.replace("__", "."): value for key, value in settings.items()}, **folder}
    return read_study(path, [f"{key}={json.dumps(value)}" for key, value in given.items()], _check_effects)


def _check_effects(files: Sequence[Path]) -> None:
    from thermofit.identify.user_effects import check_effects

    check_effects(files)


def run(
    study: Study,
    *,
    first: str | None = None,
    until: str | None = None,
    everything: bool = False,
    force: bool = False,
    tell: Tell | None = None,
) -> Result:
    """Run the chain of a study, as the command `run` does: what is fresh is not computed again.

    `first` and `until` name stages, `everything` adds gridsearch and sensitivity, `tell` hears of every stage. StudyError, DataError and
    NumericsError say in a sentence what is wrong; an answer that is not to be trusted is no error, see `Result.trustworthy`.
    """
    from thermofit.stages.run import Link, Selection, chain

    names = CHAIN if study.necking is None else NECKING_CHAIN
    links = [Link(name, _when_called(name)) for name in names]
    chain(study, links, Selection(first, until, everything), force, tell)
    return Result(study.run_dir)


def _when_called(name: str) -> Callable[..., Any]:
    def call(study: Study, *, force: bool = False) -> Any:
        return stage_function(name)(study, force=force)

    return call


def run_stage(study: Study, name: str, *, force: bool = False) -> Record:
    """Run one stage by its command, such as "diagnose"; before a diagnosis the chain up to the last identification. Errors as `run`."""
    if name in _ON_CHAIN:
        run(study, until=_LAST)
    try:
        function = stage_function(name)
    except ModuleNotFoundError:
        raise StudyError(f"stage '{name}' is not known; expected one of {', '.join((*CHAIN, *_ON_CHAIN, 'validate', 'compare'))}") from None
    record: Record = function(study, force=force).record
    return record


def open_run(folder: str | Path) -> Result:
    """The results in a run folder. StudyError where there is none."""
    return Result(Path(folder))


@dataclass(frozen=True)
class Field:
    """One field at points and times: time s (n_t,), xy mm (n_s, 2), and value, predicted, sigma (n_t, n_s, n_c) in `unit`; `mask`
    (n_t, n_s) is True where there is a measurement. `predicted` is None before any model has run."""

    name: str
    unit: str
    time: np.ndarray
    xy: np.ndarray
    value: np.ndarray
    sigma: np.ndarray
    mask: np.ndarray
    predicted: np.ndarray | None

    @property
    def error(self) -> np.ndarray:
        """predicted - value (n_t, n_s, n_c), nan where nothing was measured. DataError where no model has run."""
        if self.predicted is None:
            raise DataError(f"field {self.name}: no model has predicted it yet; run the study until 'identify-elastic' or 'verify'")
        return np.where(self.mask[..., None], self.predicted - self.value, np.nan)

    def to_xarray(self) -> xarray.Dataset:
        """The same as an xarray.Dataset with named axes. StudyError where xarray is not installed."""
        try:
            import xarray
        except ImportError:
            raise StudyError("Field.to_xarray needs xarray, which is not installed: pip install 'thermofit[notebook]'") from None
        dims = ("time", "point", "component")
        data: dict[str, Any] = {"value": (dims, self.value), "sigma": (dims, self.sigma), "mask": (dims[:2], self.mask)}
        if self.predicted is not None:
            data["predicted"] = (dims, self.predicted)
        places = {"time": self.time, "x": ("point", self.xy[:, 0]), "y": ("point", self.xy[:, 1])}
        return xarray.Dataset(data, coords=places, attrs={"name": self.name, "unit": self.unit})


@dataclass(frozen=True)
class Matrix:
    """Covariance (n, n) of named parameters; the unit of an entry is the product of those of its parameters."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: np.ndarray

    @property
    def correlation(self) -> np.ndarray:
        """Correlation (n, n)."""
        sigma = np.sqrt(np.diag(self.value))
        return np.asarray(self.value / np.outer(sigma, sigma))


class Result:
    """The results in a run folder, read when they are asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not folder.is_dir():
            raise StudyError(f"'{folder}' is no folder; expected a run folder, such as runs/my-study")

    def __repr__(self) -> str:
        return f"Result('{self.folder}': {', '.join(self.stages) or 'empty'})"

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages that have left an artefact, those of the chain in their order first."""
        there = {path.stem for path in self.folder.glob("*.h5")}
        return (*(name for name in CHAIN if name in there), *sorted(there - set(CHAIN)))

    def record(self, stage: str) -> Record:
        """The artefact of a stage: `record["u/value"].value` is an array. StudyError where the stage has not run."""
        path = self.folder / f"{stage}.h5"
        if not path.exists():
            raise StudyError(f"stage '{stage}' has not run in '{self.folder}'; there are {', '.join(self.stages) or 'no artefacts'}")
        return open_record(path)

    def json(self, stage: str) -> dict[str, Any]:
        """What the command prints of a stage with --json."""
        return result_of(self.record(stage))

    @property
    def _identified(self) -> Iterator[Record]:
        return (self.record(name) for name in self.stages if name.startswith("identify-") or name in ("refine", "necking"))

    @property
    def parameters(self) -> dict[str, ParameterResult]:
        """Every identified parameter by name: value, sigma (its combined standard uncertainty), sigma_noise, unit, at_bound, start, lower,
        upper; those of the joint fit where that has run."""
        return {name: p for record in self._identified for name, p in record.parameters.items() if p.free}

    @property
    def verdict(self) -> str:
        """The verdict of `verify`, else of the last stage that has one."""
        told = [name for name in self.stages if name != "report" and name in CHAIN] or list(self.stages)
        name = "verify" if "verify" in told else told[-1] if told else ""
        return str(self.record(name).summary.get("verdict", ""))

    @property
    def trustworthy(self) -> bool:
        """False where any stage says that its answer is not to be trusted."""
        return all(is_trustworthy(self.record(name)) for name in self.stages)

    @property
    def channels(self) -> dict[str, dict[str, Any]]:
        """Per channel n, rms, floor_rms (what noise alone would give), chi2_reduced, unit; by `verify`, else by the last identification."""
        with_channels = [self.record(name) for name in self.stages if name.startswith("identify-") or name == "verify"]
        return dict(with_channels[-1].summary.get("channels") or {}) if with_channels else {}

    def covariance(self, stage: str) -> Matrix:
        """Covariance of what a stage identified. DataError where it has none."""
        record = self.record(stage)
        stored = record["covariance"]
        return Matrix(tuple(map(str, record["evaluations/names"].value)), stored.units, stored.value)

    def field(self, name: str, stage: str | None = None) -> Field:
        """The field "u" (mm) or "theta" (K) of a stage; None: of the last one that has it."""
        with_field = [n for n in self.stages if self.record(n).has(f"{name}/value")]
        if stage is None and not with_field:
            raise DataError(f"'{self.folder}' holds no field '{name}'; `thermofit.run` of a study makes the fields u and theta")
        record = self.record(stage or with_field[-1])
        value = record[f"{name}/value"]
        time, xy, sigma, mask = (record[f"{name}/{key}"].value for key in ("time", "xy", "sigma", "mask"))
        predicted = record[f"{name}/predicted"].value if record.has(f"{name}/predicted") else None
        return Field(name, value.unit, time, xy, value.value, sigma, mask.astype(bool), predicted)

    def curves(self, folder: str, stage: str = "verify") -> dict[str, np.ndarray]:
        """All arrays below a folder of an artefact, such as "curves/stress_stretch" or "energy", by their last name."""
        record = self.record(stage)
        found = {name: record[name].value for name in layout(record) if name.startswith(f"{folder}/")}
        if not found:
            folders = sorted({name.rpartition("/")[0] for name in record.names if "/" in name})
            raise DataError(f"{record.path}: nothing lies below '{folder}'; there are {', '.join(folders)}")
        return {name.removeprefix(f"{folder}/"): value for name, value in found.items()}
