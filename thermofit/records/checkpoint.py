"""Memo of the evaluations of a long stage: after a kill the same run finds its finished evaluations again."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

import numpy as np

from thermofit.core.errors import StudyError
from thermofit.core.files import remove_partial, replacing, seal, seal_holds
from thermofit.records.stopping import keeps, kept

_KEY_FILE = "key"
_ARGUMENT = "__x__"
_DAMAGED = (zipfile.BadZipFile, EOFError, OSError, ValueError, KeyError)


class Checkpoint:
    """Evaluations `x -> arrays` of one job in one folder, one file each, written atomically.

    `key` is the digest of all that the evaluations depend on besides x (config, inputs, source): a folder of another key
    is emptied. `corrupt` counts the files that could not be read and were removed. StudyError where the folder cannot be written.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.folder = Path(folder)
        self.key = key
        self.corrupt = 0
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            remove_partial(self.folder)
            if self._stored_key() != key:
                self._remove_evaluations()
                with replacing(self.folder / _KEY_FILE, durable=False) as temporary:
                    temporary.write_text(key, encoding="utf-8")
        except OSError as error:
            raise self._unwritable(error) from error
        keeps(self)

    @property
    def count(self) -> int:
        """Number of stored evaluations."""
        return sum(1 for _ in self.folder.glob("*.npz"))

    def get(self, x: np.ndarray) -> dict[str, np.ndarray] | None:
        """The arrays that were stored for exactly this x, or None."""
        argument = _canonical(x)
        path = self._path(argument)
        if not path.exists():
            return None
        try:
            if not seal_holds(path):
                raise ValueError("not what was stored")
            with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            if not np.array_equal(arrays.pop(_ARGUMENT), argument, equal_nan=True):
                raise ValueError("stored for another x")
        except _DAMAGED:
            self.corrupt += 1
            path.unlink(missing_ok=True)
            return None
        return arrays

    def put(self, x: np.ndarray, **arrays: np.ndarray) -> None:
        """Store the arrays of one evaluation; a kill leaves the whole file or none. Stopped where the end was asked for meanwhile."""
        argument = _canonical(x)
        if objects := [name for name, array in arrays.items() if np.asarray(array).dtype.hasobject]:
            raise TypeError(f"arrays of Python objects cannot be read back: {', '.join(objects)}")
        try:
            with replacing(self._path(argument), durable=False) as temporary:
                with open(temporary, "wb") as stream:
                    np.savez(stream, **{_ARGUMENT: argument}, **arrays)  # type: ignore[arg-type]
                seal(temporary)
        except OSError as error:
            raise self._unwritable(error) from error
        kept()

    def discard(self) -> None:
        """Remove the evaluations, and the folder where nothing else is in it: the artefact is safely written."""
        if not self.folder.is_dir():
            return
        remove_partial(self.folder)
        self._remove_evaluations()
        (self.folder / _KEY_FILE).unlink(missing_ok=True)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _stored_key(self) -> str | None:
        try:
            return (self.folder / _KEY_FILE).read_text(encoding="utf-8")
        except (FileNotFoundError, UnicodeDecodeError):
            return None

    def _remove_evaluations(self) -> None:
        for path in self.folder.glob("*.npz"):
            path.unlink(missing_ok=True)

    def _path(self, argument: np.ndarray) -> Path:
        digest = hashlib.sha256(f"{argument.shape}".encode() + argument.tobytes())
        return self.folder / f"{digest.hexdigest()[:32]}.npz"

    def _unwritable(self, error: OSError) -> StudyError:
        return StudyError(
            f"checkpoint folder '{self.folder}' cannot be written ({error.strerror or error}): expected a writable folder with free "
            "space; free it or choose another run folder"
        )


def _canonical(x: np.ndarray) -> np.ndarray:
    """x as contiguous float64 without negative zero, so that equal arguments have equal bytes."""
    return np.ascontiguousarray(x, dtype=np.float64) + 0.0
