"""Kernels compiled side by side: what runs is what a chain needs, a child that fails is no error, and it is done once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import tiny

from thermofit.experiment import compiling


def test_both_drivers_run() -> None:
    compiling.compile_point()
    compiling.compile_body()
    compiling.compile_heat()


@pytest.mark.parametrize(("program", "done"), [("true", True), ("false", False)])
def test_is_done_once_and_only_where_the_child_has_ended_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, done: bool
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(compiling, "DONE", tmp_path / "compiled")
    monkeypatch.setattr(compiling.sys, "executable", f"/bin/{program}")
    monkeypatch.setattr(compiling, "compile_point", lambda: calls.append("point"))
    monkeypatch.setattr(compiling, "compile_heat", lambda: calls.append("heat"))
    for _ in range(2):
        compiling.compiled()
    assert (tmp_path / "compiled").exists() is done
    assert calls == ["point", "heat"] * (1 if done else 2)


LEFT = """
import sys
from numba.core import event
from thermofit.experiment.compiling import compiled
compiled()
late = []
class Listener(event.Listener):
    def on_start(self, e):
        late.append(e.data["dispatcher"].py_func)
    def on_end(self, e):
        pass
event.register("numba:compile", Listener())
import tiny
study = tiny.load_study(sys.argv[1])
for name in tiny.CHAIN:
    tiny.stage_run(name)(study)
own = sorted({f"{f.__module__}.{f.__name__}" for f in late if f.__module__.startswith("thermofit")})
print("\\n".join(own))
"""


@pytest.mark.slow
def test_nothing_is_left_to_compile_for_a_chain(tmp_path: Path) -> None:
    """In a cache of its own: from the virtual test to the thermal parameters no kernel is compiled after these."""
    study = tiny.write(tmp_path, tiny.tree(tmp_path / "run"))
    paths = os.pathsep.join([str(Path(tiny.__file__).parent), str(Path(compiling.__file__).parents[2])])
    environment = {**os.environ, "PYTHONPATH": paths, "THERMOFIT_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-c", LEFT, str(study)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []
