"""numba settings: the decorator of all kernels, and a kernel cache that notices every edit.

A cached numba kernel that calls a function of another file does not notice an edit of that file and silently returns
the old answer. The cache therefore lives in a folder named after the digest of all kernel sources, which is set here
before any kernel is decorated: kernel modules take their decorator from this module and from nowhere else.
"""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, overload

# Idle threads of OpenMP spin by default, which takes the processor away from whatever else runs; set before numba loads OpenMP.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba
import numba.extending

from thermofit.core.called import KNOWN, Kernel
from thermofit.core.digest import kernel_digest
from thermofit.core.errors import StudyError
from thermofit.core.files import cache_root

KEEP_DAYS = 30.0
"""Caches that no process has used for so long are removed."""

_settings: Any = numba.config
_overload: Any = numba.extending.overload
_F = TypeVar("_F", bound=Callable[..., Any])


@overload
def kernel(function: _F, /) -> _F: ...


@overload
def kernel(*, parallel: bool = ..., inline: str = ..., **options: Any) -> Callable[[_F], _F]: ...


def kernel(function: Any = None, /, *, parallel: bool = False, inline: str = "never", **options: Any) -> Any:
    """Compile a function by numba in nopython mode, cached: `@kernel`, `@kernel(parallel=True)`, `@kernel(inline="always")`.

    Arithmetic is IEEE (no fastmath) and division by zero gives inf or nan as in numpy, so that a kernel reports failure by
    its return value; `options` go to numba.njit.

    `forceinline=True` copies the code into every caller, and is said for each kernel: of one that does not say it, numba takes what its
    first caller says.
    """
    # numba resets its settings when a NUMBA_ variable of the environment changes, and fixes the cache at decoration.
    _settings.CACHE_DIR = str(CACHE_FOLDER)
    choices = {
        "cache": True,
        "forceinline": False,
        "fastmath": False,
        "error_model": "numpy",
        "parallel": parallel,
        "inline": inline,
        **options,
    }
    return (lambda given: _compiled(given, **choices)) if function is None else _compiled(function, **choices)


def _compiled(function: Any, *, cache: bool, **choices: Any) -> Any:
    if _settings.DISABLE_JIT:
        return function
    if not KNOWN[0] <= numba.version_info.short <= KNOWN[1]:
        return numba.njit(cache=cache, **choices)(function)
    made = Kernel(function, targetoptions={"nopython": True, "boundscheck": None, **choices})
    if cache:
        made.enable_caching()
    return made


def by_type(function: Callable[..., Any]) -> Callable[[Any], Any]:
    """Decorate what chooses the code of `function` in kernels: it takes numba's types of the arguments, and returns a function of the same
    arguments. `@by_type(surface_gradient)`; outside kernels `function` is called as it stands."""
    options = {"error_model": "numpy", "fastmath": False, "forceinline": True, "no_cfunc_wrapper": True}
    chosen: Callable[[Any], Any] = _overload(function, jit_options=options, strict=False)
    return chosen


def set_threads(n: int) -> int:
    """Threads of parallel kernels: n, at most those of the machine; the number set. StudyError for n < 1."""
    if n < 1:
        raise StudyError(f"numerics.threads is {n}: expected a whole number of at least 1")
    number = min(int(n), int(_settings.NUMBA_NUM_THREADS))
    numba.set_num_threads(number)
    return number


def use_cache() -> Path:
    """Create the folder of this digest, remove forgotten ones, and return it."""
    name = f"{kernel_digest()[:16]}-py{platform.python_version()}-numba{numba.__version__}"
    root = cache_root() / "numba"
    folder = root / name
    if _writable(folder):
        os.utime(folder)
        remove_forgotten(root, time.time() - KEEP_DAYS * 86400.0)
    else:
        folder = _private_temporary() / name
        folder.mkdir(exist_ok=True)
    return folder


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private_temporary() -> Path:
    """A folder of this user alone in the temporary folder: cached kernels are code, and others can write there."""
    if hasattr(os, "getuid"):
        folder = Path(tempfile.gettempdir()) / f"thermofit-{os.getuid()}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            status = folder.lstat()
            if status.st_uid == os.getuid() and status.st_mode & 0o777 == 0o700 and folder.is_dir() and not folder.is_symlink():
                return folder
        except OSError:
            pass
    return Path(tempfile.mkdtemp(prefix="thermofit-"))


def remove_forgotten(root: Path, before: float) -> None:
    """Remove caches last used before that time, as far as possible: a cache is never worth a failure."""
    try:
        forgotten = [folder for folder in root.iterdir() if folder.is_dir() and folder.stat().st_mtime < before]
    except OSError:
        return
    for folder in forgotten:
        shutil.rmtree(folder, ignore_errors=True)


CACHE_FOLDER = use_cache()
"""Folder of the compiled kernels of these sources."""
