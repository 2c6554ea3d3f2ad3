"""HDF5 files of other programmes, read into nested dicts, lists, arrays and texts; MATLAB's conventions (version 7.3) are undone.

MATLAB writes arrays with reversed axes, texts as arrays of codes, empty arrays as their shape, and the members of cell and struct arrays
as references to objects elsewhere in the file. Its class objects cannot be understood and come as the arrays of numbers that they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from thermofit.core.errors import DataError

MAX_BYTES = 4 << 30
"""Limit of all values that are read from one file."""
ROOM, EXPANDED = 256 << 20, 20
"""All values together may take this many bytes, and so many times those of the file besides: a small file does not fill the memory."""
MAX_OBJECTS = 100_000
MAX_DEPTH = 24
_MAX_RATIO = 1100
"""No filter of HDF5 packs tighter than deflate (1032:1): a dataset that claims to is damaged."""
_DAMAGES = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError, AttributeError, NotImplementedError)
"""What h5py raises for defects of a file, depending on where they are."""


@dataclass
class ReadingLimit:
    """What may still be read; counted down while a tree is walked."""

    path: Path
    file_bytes: int
    objects: int = MAX_OBJECTS
    values: int = MAX_BYTES

    def take(self, item: h5py.HLObject, depth: int) -> None:
        """Count one object at that depth before it is read. DataError where the file claims more than is left, or than it has room for."""
        size = int(item.size or 0) * int(item.dtype.itemsize) if isinstance(item, h5py.Dataset) else 0
        self.objects -= 1
        self.values -= size
        if depth > MAX_DEPTH or self.objects < 0 or self.values < 0 or size > _MAX_RATIO * self.file_bytes:
            raise DataError(
                f"{self.path}: at '{item.name}' the file claims more than {MAX_DEPTH} levels, {MAX_OBJECTS} objects or {MAX_BYTES >> 30} "
                "GiB, or far more values than it has room for, expected an undamaged export of fewer stages; export it again in parts"
            )


def foreign_names(path: Path) -> tuple[str, ...]:
    """Names in the root of an HDF5 file; DataError where it is none or is damaged."""
    with _opened(path) as file:
        return tuple(str(name) for name in file)


def read_foreign(path: Path, name: str, skip: Callable[[str], bool] = lambda name: False) -> Any:
    """The tree below `name` of the root: groups as dicts, references as lists (in MATLAB's order), texts as str, else arrays.

    Arrays have their axes as MATLAB shows them. Members whose name satisfies `skip` are left out unread. DataError for a file that
    is truncated, damaged or no HDF5, that lacks `name`, or that claims more than the limits of this module.
    """
    with _opened(path) as file:
        if name not in file:
            raise DataError(f"{path}: no variable '{name}' in this HDF5 file, found {', '.join(file) or 'none'}; save the whole analysis")
        size = path.stat().st_size
        return tree_of(own(file, name, path), ReadingLimit(path, size, values=min(MAX_BYTES, ROOM + EXPANDED * size)), skip, 0)


def own(group: h5py.Group, name: str, path: Path) -> h5py.HLObject:
    """The member of a group, which has to lie there itself. DataError for a link: it may lead to any other file."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        to = f" to file '{link.filename}'" if isinstance(link, h5py.ExternalLink) else ""
        raise DataError(f"{path}: '{group.name.rstrip('/')}/{name}' is a link{to}, expected the data themselves; save the file whole")
    return group[name]


def refuse_elsewhere(item: h5py.Dataset, path: Path) -> None:
    """DataError for a dataset whose values lie in other files."""
    if item.is_virtual or item.external:
        raise DataError(f"{path}: the values of '{item.name}' lie in other files, expected them in this one; save the file whole")


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except _DAMAGES as error:
        reason = " ".join(str(error).split()).strip("'\"")[:120]
        raise DataError(f"{path}: cannot be read as HDF5 ({reason}), expected an undamaged file; copy or save it again") from None


def tree_of(item: h5py.HLObject, budget: ReadingLimit, skip: Callable[[str], bool], depth: int) -> Any:
    """An item of a file as nested dicts, lists, arrays and texts, within the budget; DataError beyond it."""
    budget.take(item, depth)
    if isinstance(item, h5py.Group):
        return {str(name): tree_of(own(item, name, budget.path), budget, skip, depth + 1) for name in item if not skip(name)}
    if not isinstance(item, h5py.Dataset):
        raise DataError(f"{budget.path}: '{item.name}' is neither a group nor a dataset, expected one of them; save the file again")
    refuse_elsewhere(item, budget.path)
    if item.attrs.get("MATLAB_empty", 0):
        return "" if _matlab_class(item) == "char" else _no_values(item, budget)
    if h5py.check_ref_dtype(item.dtype) is h5py.Reference:
        return [tree_of(_target(item, reference, budget), budget, skip, depth + 1) for reference in np.ravel(item[()])]
    if h5py.check_string_dtype(item.dtype) is not None:
        return np.asarray(item.asstr()[()]).T
    values = np.asarray(item[()]).T
    if _matlab_class(item) == "char" and values.dtype.kind == "u":
        return "".join(chr(code) for code in values.ravel() if code < 0xD800)
    return values


def _no_values(item: h5py.Dataset, budget: ReadingLimit) -> np.ndarray:
    """An empty array; MATLAB stores its shape as the values."""
    shape = np.ravel(item[()])
    if shape.size > 32 or np.prod(shape, dtype=float) != 0:
        raise DataError(f"{budget.path}: '{item.name}' is marked as empty, but its shape is {shape[:8]}; save the file again")
    return np.zeros(tuple(int(n) for n in shape))


def _target(item: h5py.Dataset, reference: h5py.Reference, budget: ReadingLimit) -> h5py.HLObject:
    if not reference:
        raise DataError(f"{budget.path}: '{item.name}' holds a reference that leads nowhere, expected an object; save the file again")
    return item.file[reference]


def _matlab_class(item: h5py.Dataset) -> str:
    name = item.attrs.get("MATLAB_class", b"")
    return name.decode("latin-1") if isinstance(name, bytes) else str(name)
