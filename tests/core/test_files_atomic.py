"""Atomic replacement and the remains of killed writers."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from thermofit.core.files import remove_partial, replacing


def dead_pid() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def partial(folder: Path, name: str, host: str, pid: int) -> Path:
    path = folder / f".{name}.{host}.{pid}.00ff00ff.partial"
    path.write_text("half")
    return path


def test_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    for durable, text in ((True, "one"), (False, "two")):
        with replacing(path, durable) as temporary:
            temporary.write_text(text)
            assert not path.exists() or path.read_text() == "one"
        assert path.read_text() == text
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_text("three")
        raise KeyboardInterrupt
    assert path.read_text() == "two"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="processes of this machine are asked for by signal 0")
def test_only_the_remains_of_dead_writers_are_removed(tmp_path: Path) -> None:
    here = socket.gethostname().split(".")[0]
    dead = partial(tmp_path, "a.h5", here, dead_pid())
    alive = partial(tmp_path, "a.h5", here, os.getpid())
    other_name = partial(tmp_path, "b.h5", here, dead_pid())
    elsewhere = partial(tmp_path, "a.h5", "elsewhere", 1)
    assert remove_partial(tmp_path, "a.h5") == 1
    assert not dead.exists() and alive.exists() and other_name.exists() and elsewhere.exists()
    two_days_ago = time.time() - 2 * 86400
    os.utime(elsewhere, (two_days_ago, two_days_ago))
    assert remove_partial(tmp_path) == 2
    assert not elsewhere.exists() and not other_name.exists() and alive.exists()


def test_names_with_brackets_are_names(tmp_path: Path) -> None:
    remains = partial(tmp_path, "a[1].h5", "elsewhere", 1)
    os.utime(remains, (0, 0))
    assert remove_partial(tmp_path, "a[1].h5") == 1
