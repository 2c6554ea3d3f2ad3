"""Where thermofit keeps what it can make or fetch again."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path

CACHE_VARIABLE = "THERMOFIT_CACHE_DIR"
"""Environment variable that replaces the user's cache folder."""


def cache_root() -> Path:
    """Folder of thermofit in the user's cache (or `THERMOFIT_CACHE_DIR`); it need not exist."""
    if given := os.environ.get(CACHE_VARIABLE):
        return Path(given).expanduser()
    return user_cache_path("thermofit", appauthor=False, opinion=False)
