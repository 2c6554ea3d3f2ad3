"""The report of a small run and of its closed loop, from raw files to a browser."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import tiny
from browser import browser, chromium
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.study.study import Study

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no Chromium found: install the package `chromium` to look at the report"),
]


def test_loop_from_raw_files_opens(study_of: Callable[..., Study], tmp_path: Path) -> None:
    study = study_of("parameters.alpha_exp=0", f"parameters.kappa={tiny.TRUTH['kappa']}", "stages.thermal.free=[c0,beta]")
    changed = [f"--set={key}" for key in (*study.overrides, "diagnosis.free=[c0,beta]", "diagnosis.max_effects=1")]
    for command in ("run", "close-loop"):
        result = CliRunner().invoke(app, [command, str(study.source), *changed])
        assert result.exit_code in (0, 5), result.output
        assert f"report    {study.run_dir / 'report.html'}" in result.output
        content = json.loads((study.run_dir / "report.json").read_text(encoding="utf-8"))
        assert content["verdict"]["asked"] == {"run": "verification", "close-loop": "loop"}[command]
        with browser(chromium() or "", tmp_path / f"profile-{command}") as tab:
            for width in (400, 1600):
                tab.open(study.run_dir / "report.html", width)
                assert tab.complaints() == [] and tab.value("document.documentElement.scrollWidth") <= width
            first = tab.value("document.getElementById('map').toDataURL()")
            tab.value("document.getElementById('swap').click()")
            assert (tab.value("document.getElementById('map').toDataURL()") != first) == (command == "close-loop")
    assert "lacks thermal_expansion" in content["verdict"]["sentence"]


def test_a_run_that_fails_leaves_a_page(study_of: Callable[..., Study]) -> None:
    study = study_of()
    (study.run_dir / "raw" / "force.csv").write_text("time_s,force_N\n0,x\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["run", str(study.source), "--from", "interpolate"])
    assert result.exit_code == 3
    content = json.loads((study.run_dir / "report.json").read_text(encoding="utf-8"))
    assert "force.csv" in content["verdict"]["open"][0] and not content["verdict"]["trustworthy"]
