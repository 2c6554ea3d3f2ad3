"""Files: regular ones only; there whole or not at all; with a checksum of their own; and the folder of what can be made or fetched again.

A file is written under a temporary name, then renamed. A killed process leaves its temporary file behind; that harms nobody and is removed
by the next writer of the same folder. The seal is one line of text behind the content, `thermofit-sha256` and the digest of all bytes
before it: a bit that a disk or a copy has turned is noticed when the file is read. HDF5 and zip leave alone what follows their own end, so
that a sealed file opens in every other programme as well.
"""

from __future__ import annotations

import errno
import glob
import hashlib
import os
import secrets
import shutil
import socket
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from platformdirs import user_cache_path

TEXT_LIMIT = 500_000
"""Bytes of a text that is written by hand, such as a study; YAML of that size takes some seconds to read."""


def check_regular(path: Path, largest: int | None = None) -> None:
    """OSError where the path is a pipe or a device, which may have no end, or holds more than `largest` bytes.

    A folder passes: whoever opens it says that it is one.
    """
    state = path.stat()
    if not stat.S_ISREG(state.st_mode) and not stat.S_ISDIR(state.st_mode):
        raise OSError(errno.EINVAL, "is a pipe or a device, not a file", str(path))
    if largest is not None and state.st_size > largest:
        raise OSError(errno.EFBIG, f"holds {state.st_size} bytes, more than the {largest} that are read", str(path))


CACHE_VARIABLE = "THERMOFIT_CACHE_DIR"
"""Environment variable that replaces the user's cache folder."""


def cache_root() -> Path:
    """Folder of thermofit in the user's cache (or `THERMOFIT_CACHE_DIR`); it need not exist."""
    if given := os.environ.get(CACHE_VARIABLE):
        return Path(given).expanduser()
    return user_cache_path("thermofit", appauthor=False, opinion=False)


_LEAD = b"\nthermofit-sha256 "
_LENGTH = len(_LEAD) + 64 + 1
_BLOCK = 1 << 20


def seal(path: Path) -> None:
    """Append the seal to a file that is written whole. OSError where that fails."""
    line = _LEAD + _digest(path, path.stat().st_size).encode() + b"\n"
    with open(path, "ab") as stream:
        stream.write(line)


def seal_holds(path: Path) -> bool | None:
    """Whether the content is what was sealed; None where the file has no seal. OSError where it cannot be read."""
    size = path.stat().st_size
    with open(path, "rb") as stream:
        stream.seek(max(size - _LENGTH, 0), os.SEEK_SET)
        line = stream.read(_LENGTH)
    if not line.startswith(_LEAD):
        return None
    return line == _LEAD + _digest(path, size - _LENGTH).encode() + b"\n"


def _digest(path: Path, size: int) -> str:
    """sha256 of the first `size` bytes."""
    digest = hashlib.sha256()
    with open(path, "rb") as stream:
        while size > 0 and (block := stream.read(min(_BLOCK, size))):
            digest.update(block)
            size -= len(block)
    return digest.hexdigest()


_SUFFIX = ".partial"
_FORGOTTEN_S = 86400.0
"""A temporary file of another machine (shared folder) is taken for dead after this time without a write, in s."""


@contextmanager
def replacing(path: Path, durable: bool = True) -> Iterator[Path]:
    """Give a temporary path in the folder of `path`; rename it to `path` at the end, remove it on any exception.

    `durable`: data and name are on the disk when this returns (fsync), so that even a power cut leaves old or new.
    The folder is created where it is missing. Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_beside(path)
    try:
        yield temporary
        if durable:
            _sync(temporary)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    if durable and os.name == "posix":
        _sync(path.parent)


def temporary_beside(path: Path) -> Path:
    """A name in the folder of `path` that says whose it is: what a killed process leaves under it `remove_partial` removes."""
    return path.parent / f".{path.name}.{_host()}.{os.getpid()}.{secrets.token_hex(4)}{_SUFFIX}"


def remove_partial(folder: Path, name: str | None = None) -> int:
    """Remove what killed writers (of the file or folder `name`, or of any) left in the folder; living writers keep theirs. The number
    removed."""
    removed = 0
    for path in folder.glob(f".{'*' if name is None else glob.escape(name)}.*{_SUFFIX}"):
        with suppress(OSError):
            if _is_dead(path):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()
                removed += 1
    return removed


def _is_dead(path: Path) -> bool:
    _, host, pid, _, _ = path.name.rsplit(".", 4)
    if host == _host() and pid.isdigit() and sys.platform != "win32":
        return not _runs(int(pid))
    return time.time() - path.stat().st_mtime > _FORGOTTEN_S


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _host() -> str:
    return socket.gethostname().split(".")[0] or "host"


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR if path.is_file() else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
