"""What a stage leaves behind: one self-describing HDF5 file, written whole or not at all.

Layout, schema version 1. Root attributes: `schema`, `schema_version`, `stage`, `thermofit_version`, `source_digest`, `created` (UTC),
`packages` (JSON), `identity` (unlike for each writing), `seed` (absent where nothing was drawn), `config` (JSON),
`inputs` (JSON: name -> sha256), `input_paths` (JSON), `summary` (JSON), `sealed` (true: a line with the checksum of the content follows
its end, `core.files`). Every dataset has the text attributes `unit` ("1" where it has
none) and `dims` (names of its axes, separated by blanks). Where the entries along the axes called `parameter` have units of their own,
`unit` is "mixed" and `units` (JSON) lists them; the unit of an entry is the product of those of its places. `parameters/NAME` is a scalar
dataset with the attributes of ParameterResult. Only this module writes HDF5; files of other programmes are read by `foreign_hdf5`.

A run folder may be copied or moved: paths in it are written relative to the artefact, in texts of the summary as `${HERE}/...`, and read
as they lie now.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from thermofit import __version__
from thermofit.core.digest import file_digest, path_digest, source_digest
from thermofit.core.errors import DataError, NumericsError, StudyError, ThermofitError
from thermofit.core.files import check_regular, remove_partial, replacing, seal, seal_holds
from thermofit.core.jsonable import json_text, jsonable
from thermofit.records.foreign_hdf5 import own, refuse_elsewhere

SCHEMA = "thermofit"
SCHEMA_VERSION = 1
_HDF5 = b"\x89HDF\r\n\x1a\n"
PARAMETERS = "parameters"
"""Group of the parameters; no dataset may be called so."""

_PACKAGES = ("numpy", "scipy", "numba", "h5py", "nlopt")
_TEXTS = ("stage", "thermofit_version", "source_digest", "created", "packages", "identity", "config", "inputs", "input_paths", "summary")
MIXED = "mixed"
"""Unit of a dataset whose entries have the units of its parameters."""
_SEALED = "sealed"
"""Attribute of an artefact that has to end with a seal; earlier versions wrote none."""
_HERE = "${HERE}"
"""In texts of the summary: the folder of the artefact, wherever it lies."""
_NAME = re.compile(r"[A-Za-z0-9_.+@-]+(/[A-Za-z0-9_.+@-]+)*")
_DIM = re.compile(r"\S+")
_COMPRESS_FROM = 1 << 20
"""Size in bytes from which compression pays (fields of floats); small arrays stay contiguous."""


@dataclass(frozen=True)
class Dataset:
    """An array with its unit ("1" where it has none) and one name per axis; `units` of the entries along the axes called `parameter`, where
    `unit` is MIXED."""

    value: np.ndarray
    unit: str
    dims: tuple[str, ...]
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class DatasetLayout:
    """What a dataset is without its values: unit, names of the axes, shape, type, and units along the axes called `parameter`."""

    unit: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str
    units: tuple[str, ...] = ()


def of_parameters(value: np.ndarray, dims: tuple[str, ...], units: tuple[str, ...]) -> Dataset:
    """A dataset whose entries have the units of parameters, one for each place along the axes called `parameter`."""
    return Dataset(value, MIXED, dims, units)


@dataclass(frozen=True)
class ParameterResult:
    """One parameter of a result in its unit; `sigma` is its combined standard uncertainty, None where it was not determined, `sigma_noise`
    the part of it that the noise of the data makes, None where it is not told apart."""

    value: float
    sigma: float | None
    unit: str
    free: bool
    at_bound: bool
    start: float
    lower: float
    upper: float
    sigma_noise: float | None = None


@dataclass(frozen=True)
class RecordContent:
    """What a stage hands over to be written; `config` and `summary` become JSON, in which nan and inf are null."""

    stage: str
    config: Mapping[str, Any]
    inputs: Mapping[str, Path]
    datasets: Mapping[str, Dataset]
    parameters: Mapping[str, ParameterResult] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None


@dataclass(frozen=True)
class Record:
    """An artefact on disk: provenance is in memory, datasets are read when asked for."""

    stage: str
    path: Path
    attributes: Mapping[str, Any]
    config: Mapping[str, Any]
    inputs: Mapping[str, str]
    parameters: Mapping[str, ParameterResult]
    summary: Mapping[str, Any]
    names: tuple[str, ...]

    def has(self, name: str) -> bool:
        """Whether there is a dataset of that name."""
        return name in self.names

    def __getitem__(self, name: str) -> Dataset:
        """Read one dataset; DataError where there is none or where the artefact has been replaced meanwhile."""
        if name not in self.names:
            known = ", ".join(self.names) or "none"
            raise DataError(f"{self.path}: no dataset '{name}' in this artefact of '{self.stage}'; it holds {known}")
        with _reading(self.path) as file:
            if _attribute(file, "identity", self.path) != self.attributes["identity"]:
                raise DataError(f"{self.path} was written anew while it was in use: run the command again, one at a time per run folder")
            return _dataset(file[name], self.path)


def write_record(path: Path, content: RecordContent) -> Record:
    """Write an artefact atomically and return it as read back from its header.

    A process killed at any moment leaves the old artefact or none. Raises StudyError where the folder cannot be written, DataError
    where an input cannot be read, NumericsError for a parameter that is not finite.
    """
    path = Path(path)
    _check(content)
    inputs = {name: path_digest(Path(source), without=path.parent) for name, source in content.inputs.items()}
    try:
        remove_partial(path.parent, path.name)
        with replacing(path) as temporary:
            with h5py.File(temporary, "w", locking=False) as file:
                _write(file, content, inputs, path.absolute().parent)
            seal(temporary)
    except (OSError, RuntimeError) as error:
        raise StudyError(
            f"artefact '{path}' cannot be written ({error}): expected a writable folder with free space; free it or take another"
        ) from error
    return _record(path)


def read_record(path: Path, expected_stage: str, made_by: str) -> Record:
    """Open the artefact of a stage; `made_by` is the whole command that makes it, such as `thermofit interpolate study.yaml`.

    StudyError where it is missing; DataError where it is truncated, no artefact, of another schema version or another stage.
    """
    path = Path(path)
    if not path.exists():
        raise StudyError(f"artefact '{path}' of '{expected_stage}' is missing: run `{made_by}` first")
    record = _record(path, f"run `{made_by}` again")
    if record.stage != expected_stage:
        raise DataError(f"{path}: artefact of stage '{record.stage}', expected '{expected_stage}': run `{made_by}` again")
    return record


def open_record(path: Path) -> Record:
    """Open an artefact of any stage (for `thermofit show`). Errors as in read_record."""
    path = Path(path)
    if not path.exists():
        raise StudyError(f"artefact '{path}' is missing: expected the path of a file <run folder>/<stage>.h5")
    if path.suffix != ".h5" and path.is_file() and not _is_hdf5(path):
        known = path.suffix in (".yaml", ".yml")
        mend = f"`thermofit run {path}` makes the artefacts of a study" if known else f"`thermofit inspect {path}` says what it is"
        raise StudyError(f"'{path}' is no artefact: expected the path of a file <run folder>/<stage>.h5; {mend}")
    return _record(path)


def _is_hdf5(path: Path) -> bool:
    """Whether a file begins as HDF5 does."""
    with open(path, "rb") as stream:
        return stream.read(len(_HDF5)) == _HDF5


def layout(record: Record) -> dict[str, DatasetLayout]:
    """Unit, dims, shape and type of every dataset, without reading the values (fields may be large)."""
    with _reading(record.path) as file:
        stored = ((name, file[name]) for name in record.names)
        return {
            name: DatasetLayout(*_labels(data, record.path), data.shape, _type_name(data), _units(data, record.path))
            for name, data in stored
        }


def _type_name(stored: h5py.Dataset) -> str:
    return "text" if h5py.check_string_dtype(stored.dtype) is not None else str(stored.dtype)


def fresh(path: Path, stage: str, config: Mapping[str, Any], inputs: Mapping[str, Path]) -> bool:
    """Whether a readable artefact of this stage exists that was made by the same config, inputs and source."""
    try:
        record = _record(Path(path))
        return (
            record.stage == stage
            and record.attributes["source_digest"] == source_digest()
            and record.config == json.loads(json_text(config))
            and record.inputs == {name: path_digest(Path(source), without=Path(path).parent) for name, source in inputs.items()}
        )
    except ThermofitError:
        return False


def _check(content: RecordContent) -> None:
    """Reject what a reader could not trust: mistakes of a stage (ValueError) and numbers that are none (NumericsError)."""
    for name, data in content.datasets.items():
        if not _NAME.fullmatch(name) or name.split("/")[0] == PARAMETERS:
            raise ValueError(f"dataset name '{name}' is not allowed in an artefact")
        if not data.unit:
            raise ValueError(f"dataset '{name}' has no unit; it is '1' where there is none")
        if len(data.dims) != np.ndim(data.value) or not all(_DIM.fullmatch(dim) for dim in data.dims):
            raise ValueError(f"dataset '{name}' of shape {np.shape(data.value)} needs one name per axis, not {data.dims}")
        places = {size for size, dim in zip(np.shape(data.value), data.dims, strict=True) if dim == "parameter"}
        if (data.unit == MIXED) != bool(data.units) or (data.units and places != {len(data.units)}):
            raise ValueError(f"dataset '{name}' of unit '{data.unit}' needs the units of its parameters if it is '{MIXED}', else none")
    for name, result in content.parameters.items():
        if not np.isfinite(result.value):
            raise NumericsError(
                f"stage '{content.stage}': parameter {name} came out as {result.value}, expected a finite number; check the residuals "
                "and the start values"
            )


def _write(file: h5py.File, content: RecordContent, inputs: Mapping[str, str], folder: Path) -> None:
    file.attrs["schema"] = SCHEMA
    file.attrs["schema_version"] = SCHEMA_VERSION
    file.attrs["stage"] = content.stage
    file.attrs["thermofit_version"] = __version__
    file.attrs["source_digest"] = source_digest()
    file.attrs["created"] = datetime.now(UTC).isoformat(timespec="seconds")
    file.attrs["packages"] = json_text(_packages())
    file.attrs["identity"] = secrets.token_hex(16)
    file.attrs[_SEALED] = True
    if content.seed is not None:
        file.attrs["seed"] = content.seed
    file.attrs["config"] = json_text(content.config)
    file.attrs["inputs"] = json_text(inputs)
    file.attrs["input_paths"] = json_text({name: _written(Path(source), folder) for name, source in content.inputs.items()})
    file.attrs["summary"] = json_text(_texts(jsonable(content.summary), _portable(folder)))
    for name, data in content.datasets.items():
        _write_dataset(file, name, data)
    group = file.create_group(PARAMETERS)
    for name, result in content.parameters.items():
        stored = _write_dataset(group, name, Dataset(np.array(result.value, dtype=float), result.unit, ()))
        for key in ("sigma", "sigma_noise"):
            found = getattr(result, key)
            stored.attrs[key] = np.nan if found is None else found
        for key in ("free", "at_bound", "start", "lower", "upper"):
            stored.attrs[key] = getattr(result, key)


def _written(source: Path, folder: Path) -> str:
    """How the path of an input is written: relative where it goes with the artefact when the run folder is copied, that is in its folder,
    or an artefact in the one above (of several experiments); else as given."""
    home = folder.parent if source.suffix == ".h5" else folder
    return os.path.relpath(source, folder) if source.absolute().is_relative_to(home) else str(source)


def _portable(folder: Path) -> Callable[[str], str]:
    """Puts _HERE for the folder where a text names it or a path in it."""
    named = re.compile(re.escape(str(folder)) + r"(?=[/\\\s'\"`,;:)\]]|\.(?:\s|$)|$)")
    return lambda text: named.sub(lambda _: _HERE, text)


def _texts(value: Any, change: Callable[[str], str]) -> Any:
    """A tree of JSON with all its texts changed; keys stay."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, dict):
        return {key: _texts(item, change) for key, item in value.items()}
    return [_texts(item, change) for item in value] if isinstance(value, list) else value


def _packages() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return versions


def _write_dataset(group: h5py.Group, name: str, data: Dataset) -> h5py.Dataset:
    value = np.asarray(data.value)
    kind = value.dtype.kind
    if kind in "UO" and all(isinstance(text, str) for text in value.flat):
        stored = group.create_dataset(name, data=value.astype(object), dtype=h5py.string_dtype())
    elif kind in "biufc":
        stored = group.create_dataset(name, data=value, **storage_of(value))
    else:
        raise ValueError(f"dataset '{name}' has the type {value.dtype}: an artefact holds numbers, truth values and texts")
    stored.attrs["unit"] = data.unit
    stored.attrs["dims"] = " ".join(data.dims)
    if data.units:
        stored.attrs["units"] = json_text(data.units)
    return stored


def storage_of(value: np.ndarray) -> dict[str, Any]:
    """Series of large fields: one chunk per first index, shuffled and LZF (a third of the size at 0.5 GB/s); else contiguous."""
    if value.nbytes < _COMPRESS_FROM or value.ndim < 2 or value[0].nbytes < 4096:
        return {}
    return {"chunks": (1, *value.shape[1:]), "compression": "lzf", "shuffle": True}


@contextmanager
def _reading(path: Path) -> Iterator[h5py.File]:
    """Open for reading; what HDF5 says of a damaged file becomes a DataError."""
    try:
        check_regular(path)
        held = _seal(path)
        if held is False:
            raise _damaged(path)
        with h5py.File(path, "r", locking=False) as file:
            if held is None and _SEALED in file.attrs:
                raise _damaged(path)
            yield file
    except (OSError, RuntimeError, KeyError) as error:
        reason = str(error).strip("'\"").split(" (")[-1].rstrip(")")
        raise DataError(f"{path}: cannot be read as an artefact ({reason}): remove it and run its stage again") from error


def _seal(path: Path) -> bool | None:
    """Whether the content is what was written, None where it has no seal; a file that has not been touched is not read twice."""
    state = path.stat()
    if not path.is_file():
        return None
    return _seal_of_state(path, state.st_mtime_ns, state.st_ctime_ns, state.st_size, state.st_ino)


@lru_cache(maxsize=4096)
def _seal_of_state(path: Path, modified: int, changed: int, size: int, inode: int) -> bool | None:
    return seal_holds(path)


def _damaged(path: Path) -> DataError:
    return DataError(
        f"{path}: its content is not what was written there (the checksum differs, expected that of its last line): a disk, a copy or an "
        "editor has changed it; remove it and run its stage again"
    )


def _record(path: Path, mend: str = "run its stage again") -> Record:
    with _reading(path) as file:
        if file.attrs.get("schema") != SCHEMA:
            raise DataError(f"{path}: HDF5 file without the schema '{SCHEMA}', expected an artefact: {mend}")
        version = file.attrs.get("schema_version")
        if version != SCHEMA_VERSION:
            raise DataError(f"{path}: schema version {version}, this thermofit reads version {SCHEMA_VERSION}: {mend}")
        attributes: dict[str, Any] = {key: _attribute(file, key, path) for key in _TEXTS}
        parsed = {key: _parsed(attributes.pop(key), key, path) for key in ("packages", "config", "inputs", "input_paths", "summary")}
        here = path.absolute().parent
        paths = {name: os.path.normpath(here / str(text)) for name, text in parsed["input_paths"].items()}
        attributes |= {"schema_version": SCHEMA_VERSION, "packages": parsed["packages"], "input_paths": paths}
        attributes["seed"] = int(file.attrs["seed"]) if "seed" in file.attrs else None
        group = own(file, PARAMETERS, path) if PARAMETERS in file else {}
        results = {name: _parameter(own(group, name, path), path) for name in group}
        return Record(
            stage=attributes["stage"],
            path=path,
            attributes=attributes,
            config=parsed["config"],
            inputs=parsed["inputs"],
            parameters=results,
            summary=_texts(parsed["summary"], lambda text: text.replace(_HERE, str(here))),
            names=_names(file, path),
        )


def _names(file: h5py.File, path: Path) -> tuple[str, ...]:
    """Names of the datasets, each of which must have unit and dims."""
    names: list[str] = []

    def visit(name: str, item: h5py.HLObject) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith(f"{PARAMETERS}/"):
            _labels(item, path)
            names.append(name)

    file.visititems(visit)
    return tuple(names)


def _labels(stored: h5py.Dataset, path: Path) -> tuple[str, tuple[str, ...]]:
    refuse_elsewhere(stored, path)
    unit, text = stored.attrs.get("unit"), stored.attrs.get("dims")
    if not isinstance(unit, str) or not unit or not isinstance(text, str):
        raise DataError(f"{path}: dataset '{stored.name}' has no unit or no dims, expected both as texts: run its stage again")
    dims = tuple(text.split())
    if len(dims) != stored.ndim:
        raise DataError(f"{path}: dataset '{stored.name}' has {stored.ndim} axes, but {len(dims)} names ('{text}'): run its stage again")
    return unit, dims


def _units(stored: h5py.Dataset, path: Path) -> tuple[str, ...]:
    """Units along the axes of the parameters; none where the dataset has one unit."""
    text = stored.attrs.get("units")
    if text is None:
        return ()
    try:
        return tuple(str(unit) for unit in json.loads(text))
    except (json.JSONDecodeError, TypeError) as error:
        raise DataError(f"{path}: dataset '{stored.name}' has 'units' that are no JSON list ({error}): run its stage again") from error


def _dataset(stored: h5py.Dataset, path: Path) -> Dataset:
    unit, dims = _labels(stored, path)
    units = _units(stored, path)
    if h5py.check_string_dtype(stored.dtype) is None:
        return Dataset(np.asarray(stored[()]), unit, dims, units)
    return Dataset(np.asarray(stored.asstr()[()], dtype=str).reshape(stored.shape), unit, dims, units)


def _parameter(stored: h5py.Dataset, path: Path) -> ParameterResult:
    unit, _ = _labels(stored, path)
    attrs = stored.attrs
    sigma, noise = float(attrs["sigma"]), float(attrs.get("sigma_noise", np.nan))
    return ParameterResult(
        value=float(stored[()]),
        sigma=None if np.isnan(sigma) else sigma,
        sigma_noise=None if np.isnan(noise) else noise,
        unit=unit,
        free=bool(attrs["free"]),
        at_bound=bool(attrs["at_bound"]),
        start=float(attrs["start"]),
        lower=float(attrs["lower"]),
        upper=float(attrs["upper"]),
    )


def _attribute(file: h5py.File, key: str, path: Path) -> str:
    value = file.attrs.get(key)
    if not isinstance(value, str):
        raise DataError(f"{path}: artefact without the attribute '{key}', expected a text: run its stage again")
    return value


def _parsed(text: str, key: str, path: Path) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise DataError(f"{path}: attribute '{key}' is no JSON ({error}): run its stage again") from error
    if not isinstance(value, dict):
        raise DataError(f"{path}: attribute '{key}' is a JSON {type(value).__name__}, expected an object: run its stage again")
    return value


_ARTEFACT = ".h5"


def stale(record: Record) -> tuple[str, ...]:
    """What an artefact was made of and is no longer so, in words, one for each input; empty where it still follows from its inputs."""
    found = []
    for name, digest in record.inputs.items():
        path = Path(record.attributes["input_paths"].get(name, ""))
        if path == Path() or not path.exists() or path.absolute() == record.path.absolute().parent:
            continue
        what = path.name if path.suffix == _ARTEFACT else f"{name} '{path}'"
        if path_digest(path, _untouched, record.path.parent) != digest:
            found.append(f"{what} has changed since")
        elif path.suffix == _ARTEFACT and (deeper := _stale_artefact(path)):
            found.append(f"{what}, from which it was made, is stale itself: {deeper[0]}")
    return tuple(found)


def other_sources(record: Record) -> str:
    """A sentence where another thermofit, or other effect files, have made an artefact than would make it now; else empty."""
    made, now = str(record.attributes["source_digest"]), source_digest()
    if made == now:
        return ""
    return f"it was made by other sources of thermofit or of effect files ({made[:12]}, version {record.attributes['thermofit_version']})"


def read_current(path: Path, stage: str, study_file: str) -> Record:
    """Open the artefact of a stage that the next stage reads. Errors as `read_record`; StudyError where it is stale: the chain makes it
    anew, a single stage does not."""
    record = read_record(path, stage, f"thermofit {stage} {study_file}")
    if reasons := stale(record):
        again = f"run `thermofit run {study_file} --until {stage}`, which makes anew what is stale"
        raise StudyError(f"{path} is stale: {reasons[0]}; {again}")
    return record


def _stale_artefact(path: Path) -> tuple[str, ...]:
    """Of an artefact among the inputs; one that cannot be read is said by whoever reads it."""
    try:
        return stale(open_record(path))
    except ThermofitError:
        return ()


def _untouched(path: Path) -> str:
    """Digest of a file; one that has not been touched is not read twice in a process, for every stage asks for the raw data."""
    state = path.stat()
    return _of_state(path, state.st_mtime_ns, state.st_ctime_ns, state.st_size, state.st_ino)


@lru_cache(maxsize=4096)
def _of_state(path: Path, modified: int, changed: int, size: int, inode: int) -> str:
    return file_digest(path)
