"""Kernels compiled side by side: what runs is what a chain needs, a child that fails is no error, and it is done once."""

from __future__ import annotations

from pathlib import Path

import pytest

from thermofit.experiment import compiling


def test_both_drivers_run() -> None:
    compiling.compile_point()
    compiling.compile_body()


@pytest.mark.parametrize(("program", "done"), [("true", True), ("false", False)])
def test_is_done_once_and_only_where_the_child_has_ended_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, done: bool
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(compiling, "DONE", tmp_path / "compiled")
    monkeypatch.setattr(compiling.sys, "executable", f"/bin/{program}")
    monkeypatch.setattr(compiling, "compile_point", lambda: calls.append("point"))
    for _ in range(2):
        compiling.compiled()
    assert (tmp_path / "compiled").exists() is done
    assert len(calls) == (1 if done else 2)
