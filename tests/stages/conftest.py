"""One run of the whole chain on a tiny virtual experiment, shared by the tests of the stages."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tiny

from thermofit.study.study import Study, load_study


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder in which every stage of the chain has left its artefact. Not to be written into."""
    folder = tmp_path_factory.mktemp("tiny")
    study = load_study(tiny.write(folder, tiny.tree(folder / "run")))
    for name in tiny.CHAIN:
        tiny.stage_run(name)(study)
    return folder / "run"


@pytest.fixture
def study_of(finished: Path, tmp_path: Path) -> Callable[..., Study]:
    """Study on a copy of the finished run folder, with overrides such as `stages.thermal.free=[c0]`."""

    def make(*overrides: str, **sections: Any) -> Study:
        run = tmp_path / "run"
        if not run.exists():
            shutil.copytree(finished, run)
        return load_study(tiny.write(tmp_path, {**tiny.tree(run), **sections}), overrides)

    return make
