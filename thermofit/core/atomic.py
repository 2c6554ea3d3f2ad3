"""Files that are there whole or not at all: written under a temporary name, then renamed.

A killed process leaves its temporary file behind; that harms nobody and is removed by the next writer of the same folder.
"""

from __future__ import annotations

import glob
import os
import secrets
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
