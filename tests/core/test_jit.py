"""The kernel cache: hit by an unedited process, missed after an edit of a called file, for serial, inlined and parallel kernels."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from thermofit.core import digest, jit
from thermofit.core.errors import StudyError
from thermofit.core.files import CACHE_VARIABLE, cache_root

CALLEE = """
from thermofit.core.jit import kernel

@kernel
def factor(x):
    return {factor} * x

@kernel(inline="always")
def shift(x):
    return x + {shift}
"""

CALLER = """
import numpy as np
from thermofit.core.jit import kernel
from thermofit.effects.callee import factor, shift
from numba import prange

@kernel
def answer(x):
    return factor(shift(x))

@kernel(parallel=True)
def answers(x):
    y = np.empty_like(x)
    for i in prange(x.size):
        y[i] = factor(shift(x[i]))
    return y
"""

MAIN = """
import numpy as np
from thermofit.core.jit import CACHE_FOLDER
from thermofit.law.caller import answer, answers
a, b = answer(1.0), answers(np.ones(3))
compiled = sum(sum(f.stats.cache_misses.values()) for f in (answer, answers))
hits = sum(sum(f.stats.cache_hits.values()) for f in (answer, answers))
print(a, b[2], compiled, hits)
"""


@pytest.fixture
def house(tmp_path: Path) -> Path:
    package = tmp_path / "thermofit"
    for room in ("core", "effects", "law"):
        (package / room).mkdir(parents=True)
        (package / room / "__init__.py").write_text("")
    (package / "__init__.py").write_text("")
    for name in ("jit", "called", "digest", "errors", "files"):
        shutil.copy(digest.PACKAGE / "core" / f"{name}.py", package / "core")
    (package / "effects" / "callee.py").write_text(CALLEE.format(factor=2.0, shift=1.0))
    (package / "law" / "caller.py").write_text(CALLER)
    return tmp_path


def run(house: Path, cache: Path) -> tuple[float, float, int, int]:
    environment = {**os.environ, "PYTHONPATH": str(house), "THERMOFIT_CACHE_DIR": str(cache), "NUMBA_NUM_THREADS": "2"}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-c", MAIN], cwd=house, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    a, b, compiled, hits = done.stdout.split()
    return float(a), float(b), int(compiled), int(hits)


def test_cache_is_hit_when_unedited_and_missed_after_an_edit_of_a_called_file(house: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(house, cache) == (4.0, 4.0, 2, 0)
    assert run(house, cache) == (4.0, 4.0, 0, 2)
    (house / "thermofit" / "effects" / "callee.py").write_text(CALLEE.format(factor=3.0, shift=4.0))
    assert run(house, cache) == (15.0, 15.0, 2, 0)
    assert len(list((cache / "numba").iterdir())) == 2


def test_forgotten_caches_are_removed_and_recent_ones_kept(tmp_path: Path) -> None:
    now = time.time()
    for name, age_days in (("old", 31.0), ("recent", 29.0)):
        (tmp_path / name / "deep").mkdir(parents=True)
        (tmp_path / name / "deep" / "kernel.nbc").write_text("x")
        os.utime(tmp_path / name, (now - age_days * 86400, now - age_days * 86400))
    jit.remove_forgotten(tmp_path, now - jit.KEEP_DAYS * 86400)
    assert [path.name for path in tmp_path.iterdir()] == ["recent"]
    jit.remove_forgotten(tmp_path / "nowhere", now)


def test_unwritable_cache_falls_back_to_a_private_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("where a folder is expected")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    folder = jit.use_cache()
    assert folder.is_dir() and folder.is_relative_to(tmp_path / "tmp")
    if sys.platform != "win32":
        assert folder.parent.stat().st_mode & 0o077 == 0
        assert jit.use_cache() == folder
        folder.parent.chmod(0o777)
        assert not jit.use_cache().is_relative_to(folder.parent)


def test_cache_root_honours_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    assert cache_root() == tmp_path
    monkeypatch.delenv(CACHE_VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_root().name == "thermofit"
    if sys.platform == "linux":
        assert cache_root() == tmp_path / "xdg" / "thermofit"


def test_kernels_divide_like_numpy() -> None:
    @jit.kernel(cache=False)
    def quotient(a: float, b: float) -> float:
        return a / b

    assert quotient(1.0, 0.0) == np.inf
    assert np.isnan(quotient(0.0, 0.0))


def test_threads_are_limited_to_the_machine() -> None:
    assert jit.set_threads(1) == 1
    assert jit.set_threads(10000) == jit.numba.config.NUMBA_NUM_THREADS == jit.numba.get_num_threads()
    with pytest.raises(StudyError, match=r"numerics\.threads is 0"):
        jit.set_threads(0)


@pytest.mark.parametrize("module", ["records.artefact", "records.checkpoint", "records.progress", "core.digest", "core.files"])
def test_records_import_numba_only_for_kernels(module: str) -> None:
    text = f"import sys, thermofit.{module}; assert 'numba' not in sys.modules, 'numba'; assert 'rich' not in sys.modules, 'rich'"
    environment = {**os.environ, "PYTHONPATH": str(digest.PACKAGE.parent)}
    done = subprocess.run([sys.executable, "-c", text], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
