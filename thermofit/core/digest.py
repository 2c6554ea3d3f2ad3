"""Digests of sources and data: what an artefact and the kernel cache are keyed by.

A digest is a sha256 in hexadecimal. Every file enters with its relative name, so that moving code between files
changes the digest even where the concatenated text stays the same.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path

from thermofit.core.errors import DataError
from thermofit.core.files import check_regular

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of the package thermofit."""

KERNEL_ROOMS = ("effects", "law", "point", "body")
"""Rooms whose every source may be compiled into a kernel."""

_NO_KERNEL = b"from thermofit.core.jit import set_threads\n"
"""A module that asks for no more of `core.jit` than this compiles nothing."""

_OUTSIDE_KERNELS = tuple(f"core/{name}" for name in ("atomic", "digest", "errors", "files", "folders", "jsonable", "sealed", "yaml_text"))
"""Beginnings of the names of those modules of core from which no kernel takes a constant."""

EFFECTS_VARIABLE = "THERMOFIT_EFFECTS"
"""Environment variable that names effect files of the user; set from the key `effects` of a study."""
_compiled_with: list[tuple[Path, ...]] = []
"""The effect files by which the kernels of this process are named, once they are loaded."""
_BLOCK = 1 << 20
_THREADS = 4


def file_digest(path: Path) -> str:
    """sha256 of the bytes of one file. OSError where it cannot be read or is no regular file."""
    digest = hashlib.sha256()
    check_regular(path)
    with open(path, "rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def path_digest(path: Path, digest_of: Callable[[Path], str] = file_digest, without: Path | None = None) -> str:
    """sha256 of a file, or of the sorted relative names and contents of all files of a folder; `digest_of` gives that of one file.

    What lies in the folder `without` is left out: results may lie among the data that they are made of.
    Names that start with a dot are left out: file browsers write them while one looks at the data.
    DataError where the path is missing or unreadable.
    """
    try:
        if path.is_dir():
            files = _visible_files(path)
            if without is not None and path.absolute() in without.absolute().parents:
                files = [file for file in files if not file.absolute().is_relative_to(without.absolute())]
            return _combined(path, files, digest_of)
        return digest_of(path)
    except OSError as error:
        raise DataError(f"input '{path}' cannot be read ({error.strerror or error}): expected a readable file or folder") from error


def source_digest(rooms: Sequence[str] = ()) -> str:
    """sha256 over the .py sources of the named rooms (folders of thermofit), of all where none is named, and the user's effects.

    Computed once per process: the code that runs is the code that was loaded, whatever is edited meanwhile.
    """
    return _with_effects(_source_digest(PACKAGE, tuple(sorted(rooms))))


def kernel_digest(package: Path = PACKAGE) -> str:
    """sha256 over all sources that a compiled kernel may contain.

    These are the kernel rooms, what core lends to them (constants are frozen into compiled code), and every other module that
    imports `thermofit.core.jit`, and the effect files of the user. In doubt a source is in: a needless compilation is slow, a stale
    kernel is wrong.
    """
    if package == PACKAGE:
        _compiled_with.append(effect_files())
    return _with_effects(_combined(package, (path for path in _sources(package) if _may_be_compiled(package, path))))


def _with_effects(own: str) -> str:
    """A digest that knows the effect files of the user as well; the same where there are none."""
    foreign = effect_files()
    if not foreign:
        return own
    return hashlib.sha256("".join([own, *of_users(foreign)]).encode()).hexdigest()


@lru_cache(maxsize=16)
def of_users(files: tuple[Path, ...]) -> tuple[str, ...]:
    """Digests of the user's effect files when this process first asked, before it loaded them: an edit meanwhile is not what runs."""
    return tuple(path_digest(path) for path in files)


def effect_files() -> tuple[Path, ...]:
    """Effect files of the user, as the environment names them (`EFFECTS_VARIABLE`)."""
    return tuple(Path(name) for name in os.environ.get(EFFECTS_VARIABLE, "").split(os.pathsep) if name)


def use_effect_files(files: Sequence[Path]) -> bool:
    """Name the user's effect files to this process and those that it starts; False where it has loaded kernels without them already."""
    if effect_files() != tuple(files):
        if _compiled_with:
            return False
        os.environ[EFFECTS_VARIABLE] = os.pathsep.join(str(path) for path in files)
    return True


@lru_cache(maxsize=16)
def _source_digest(package: Path, rooms: tuple[str, ...]) -> str:
    return _combined(package, _sources(package, rooms))


def _sources(package: Path, rooms: Sequence[str] = ()) -> list[Path]:
    folders = [package / room for room in rooms] or [package]
    return [path for folder in folders for path in folder.rglob("*.py")]


def _may_be_compiled(package: Path, path: Path) -> bool:
    name = path.relative_to(package).as_posix()
    room = name.split("/")[0]
    if room in KERNEL_ROOMS:
        return True
    if room == "core":
        return not name.startswith(_OUTSIDE_KERNELS)
    return b"core.jit" in path.read_bytes().replace(_NO_KERNEL, b"")


def _visible_files(folder: Path) -> list[Path]:
    return [
        path for path in folder.rglob("*") if not any(part.startswith(".") for part in path.relative_to(folder).parts) and path.is_file()
    ]


def _combined(root: Path, files: Iterable[Path], digest_of: Callable[[Path], str] = file_digest) -> str:
    """sha256 over `relative name, digest of contents` of the files, sorted by name."""
    named = sorted((path.relative_to(root).as_posix(), path) for path in files)
    with ThreadPoolExecutor(_THREADS) as pool:
        digests = list(pool.map(digest_of, (path for _, path in named)))
    combined = hashlib.sha256()
    for (name, _), digest in zip(named, digests, strict=True):
        combined.update(f"{name}\0{digest}\n".encode("utf-8", "surrogateescape"))
    return combined.hexdigest()
