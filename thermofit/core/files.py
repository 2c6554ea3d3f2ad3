"""Opening files that others made: regular ones only, and none larger than asked for."""

from __future__ import annotations

import errno
import stat
from pathlib import Path

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
