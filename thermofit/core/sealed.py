"""A file that carries the checksum of its own content: a bit that a disk or a copy has turned is noticed when the file is read.

The seal is one line of text behind the content, `thermofit-sha256` and the digest of all bytes before it. HDF5 and zip leave alone what
follows their own end, so that a sealed file opens in every other programme as well.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

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
