"""Checkpoints: exact memo, emptied with another key, deaf to damage, safe against kills."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis.extra import numpy as hnp

from thermofit.core.errors import StudyError
from thermofit.records import checkpoint as module
from thermofit.records.checkpoint import Checkpoint

X = np.array([69000.0, 0.33])


def test_evaluations_survive_the_process(tmp_path: Path) -> None:
    first = Checkpoint(tmp_path / "c", "key")
    assert first.get(X) is None and first.count == 0
    first.put(X, residual=np.arange(5.0), force=np.array(3))
    again = Checkpoint(tmp_path / "c", "key")
    found = again.get(X)
    assert found is not None and set(found) == {"residual", "force"}
    np.testing.assert_array_equal(found["residual"], np.arange(5.0))
    assert again.count == 1 and again.corrupt == 0
    assert again.get(np.nextafter(X, np.inf)) is None
    assert again.get(X[None, :]) is None


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(x=hnp.arrays(np.float64, hnp.array_shapes(max_dims=1, max_side=6)))
def test_every_argument_is_found_again(tmp_path: Path, x: np.ndarray) -> None:
    store = Checkpoint(tmp_path / "c", "key")
    store.put(x, y=-x)
    found = store.get(-0.0 + x.copy())
    assert found is not None
    np.testing.assert_array_equal(found["y"], -x)
    assert store.corrupt == 0


def test_negative_zero_is_zero(tmp_path: Path) -> None:
    store = Checkpoint(tmp_path / "c", "key")
    store.put(np.array([-0.0]), y=np.ones(1))
    assert store.get(np.array([0.0])) is not None


def test_another_key_empties_the_folder_but_only_of_evaluations(tmp_path: Path) -> None:
    Checkpoint(tmp_path, "key").put(X, y=np.ones(2))
    (tmp_path / "notes.txt").write_text("of the user")
    other = Checkpoint(tmp_path, "other")
    assert other.count == 0 and other.get(X) is None
    assert Checkpoint(tmp_path, "key").count == 0
    assert (tmp_path / "notes.txt").exists()


@pytest.mark.parametrize("damage", ["truncated", "empty", "text", "flipped", "other x"])
def test_damaged_evaluations_are_removed_and_counted(tmp_path: Path, damage: str) -> None:
    store = Checkpoint(tmp_path, "key")
    store.put(X, y=np.arange(1000.0))
    (path,) = tmp_path.glob("*.npz")
    whole = path.read_bytes()
    spoilt = {
        "truncated": whole[: len(whole) // 2],
        "empty": b"",
        "text": b"no archive",
        "flipped": whole[:4000] + bytes([whole[4000] ^ 1]) + whole[4001:],
    }
    if damage == "other x":
        store.put(X + 1.0, y=np.zeros(1))
        (other,) = set(tmp_path.glob("*.npz")) - {path}
        os.replace(other, path)
    else:
        path.write_bytes(spoilt[damage])
    assert store.get(X) is None
    assert store.corrupt == 1 and store.count == 0
    assert store.get(X) is None and store.corrupt == 1


def test_discard_removes_everything_of_the_checkpoint(tmp_path: Path) -> None:
    store = Checkpoint(tmp_path / "c", "key")
    store.put(X, y=np.ones(2))
    store.discard()
    assert not (tmp_path / "c").exists()
    store.discard()


def test_objects_and_unwritable_folders_are_refused(tmp_path: Path) -> None:
    store = Checkpoint(tmp_path / "c", "key")
    with pytest.raises(TypeError, match="y"):
        store.put(X, y=np.array([object()]))
    (tmp_path / "file").write_text("")
    with pytest.raises(StudyError, match=r"checkpoint folder '.*file' cannot be written"):
        Checkpoint(tmp_path / "file", "key")


WRITER = """
import sys
import numpy as np
from pathlib import Path
from thermofit.records.checkpoint import Checkpoint

store = Checkpoint(Path(sys.argv[1]), "key")
for i in range(100000):
    store.put(np.array([float(i)]), y=np.full(20000, float(i)))
    print(i, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_killed_job_keeps_its_finished_evaluations(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(module.__file__).parents[2])}
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, env=environment, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = 1 + len(process.stdout.readlines())
    process.stdout.close()
    store = Checkpoint(tmp_path, "key")
    assert store.count >= done
    for i in range(store.count):
        found = store.get(np.array([float(i)]))
        assert found is not None and np.all(found["y"] == i)
    assert store.corrupt == 0
    assert not list(tmp_path.glob(".*"))
