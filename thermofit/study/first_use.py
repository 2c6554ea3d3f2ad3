"""Effect files of the user are code that runs with the user's rights: the first use of each is said before anything of it runs.

What has been used is kept in the user's cache by path and content, so that an edited file, or the same name elsewhere, is said again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from thermofit.core.digest import file_digest
from thermofit.core.files import cache_root

_SEEN = "effects-used"


def first_uses(files: Sequence[Path]) -> list[Path]:
    """Those of the effect files whose content has not been used from where it stands; from now on it has."""
    new = []
    for path in files:
        mark = cache_root() / _SEEN / hashlib.sha256(f"{path.absolute()}\0{file_digest(path)}".encode()).hexdigest()
        if not mark.exists():
            new.append(path)
            with suppress(OSError):  # where nothing can be kept it is said every time
                mark.parent.mkdir(parents=True, exist_ok=True)
                mark.touch()
    return new


def notice(study: Path, file: Path) -> str:
    """What the user reads before an effect file is used for the first time."""
    return f"note: first use of the effect file {file.absolute()}, which key 'effects' of {study} names: it is run as Python code"
