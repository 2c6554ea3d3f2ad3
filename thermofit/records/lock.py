"""One process at a time in a run folder: the second one is told who is there.

The lock is that of the operating system on the file `RUN_DIR/.lock` (flock), which ends with the process however it ends: what a killed
one has left is no lock, and is taken over without a question. The file says whose it is. Folders below a locked one belong to it.
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from thermofit.core.errors import StudyError
from thermofit.core.files import remove_partial

LOCK = ".lock"
_held: set[Path] = set()
"""Folders that this process has locked."""
_worker = False


def lend() -> None:
    """This process works for another one, which has the lock."""
    global _worker
    _worker = True


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Have a run folder for this process alone while the block runs; within it, of it and of what lies below it again without a word.

    What killed writers have left there is removed first. StudyError where another process has it. A folder that cannot be written, or
    whose file system knows no locks, is not locked: nothing can be written there, or nobody could tell.
    """
    folder = folder.absolute()
    if fcntl is None or _worker or any(place in _held for place in (folder, *folder.parents)):
        yield
        return
    descriptor = _taken(folder)
    if descriptor is None:
        yield
        return
    _held.add(folder)
    try:
        for place in (folder, *(path for path in folder.iterdir() if path.is_dir() and not path.is_symlink())):
            remove_partial(place)
        yield
    finally:
        _held.discard(folder)
        with suppress(OSError):
            (folder / LOCK).unlink()
        os.close(descriptor)


def _taken(folder: Path) -> int | None:
    """Descriptor of the locked file; None where there can be none."""
    path = folder / LOCK
    while True:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = _owner(descriptor)
            os.close(descriptor)
            raise StudyError(
                f"run folder '{folder}' is in use by {owner}: wait until it has ended, end it, or take another folder with --run-dir"
            ) from None
        except OSError:
            os.close(descriptor)
            return None
        if _is(descriptor, path):
            with suppress(OSError):
                _sign(descriptor)
            return descriptor
        os.close(descriptor)  # its owner has ended, and removed it, since it was opened


def _is(descriptor: int, path: Path) -> bool:
    """Whether the open file is still the one of that name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _sign(descriptor: int) -> None:
    """Write who has the lock."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    owner = {"host": platform.node(), "pid": os.getpid(), "command": command[:300], "since": time.time()}
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(owner).encode(), 0)


def _owner(descriptor: int) -> str:
    """Who has the lock, in words."""
    try:
        owner: dict[str, Any] = json.loads(os.pread(descriptor, 4096, 0))
        since = float(owner["since"])
        at = datetime.fromtimestamp(since, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        age = max(time.time() - since, 0.0)
        return f"process {owner['pid']} on {owner['host']} (`{owner['command']}`, since {at}, {age:.0f} s ago)"
    except (ValueError, KeyError, TypeError, OSError):
        return "another process"
