"""The report of a small run and of its closed loop, from raw files to a browser."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import tiny
from browser import browser, chromium
from looked_at import moves, opens_well
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.study.study import Study

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no Chromium found: install the package `chromium` to look at the report"),
]


ROOT = Path(__file__).resolve().parents[2]


def looked_at(page: Path, profile: Path, *, before_and_after: bool) -> None:
    """Narrow and wide, light and dark, with all that moves moved; a folder named by THERMOFIT_PICTURES keeps pictures of it."""
    with browser(chromium() or "", profile) as tab:
        for width in (400, 1600):
            opens_well(tab, page, width, dark=True)
            opens_well(tab, page, width)
            if (kept := os.environ.get("THERMOFIT_PICTURES")) is not None:
                tab.picture(Path(kept) / f"{page.parent.name}-{width}.png")
        moves(tab, page, before_and_after=before_and_after)


@pytest.mark.as_written
def test_the_report_of_the_demo(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["run", str(ROOT / "configs" / "quickstart.yaml"), "--run-dir", str(tmp_path / "demo")])
    assert result.exit_code == 0, result.output
    looked_at(tmp_path / "demo" / "report.html", tmp_path / "profile", before_and_after=False)


def test_the_report_of_a_loop_on_a_whole_test(tmp_path: Path) -> None:
    """Ten minutes: raw files of a full-field test whose effect nobody declared."""
    if not (Path(os.environ.get("THERMOFIT_DATA", "")) / "blind" / "B3").is_dir():
        pytest.skip("no blind/B3 in the folder that THERMOFIT_DATA names")
    given = [str(ROOT / "configs" / "blind-b3.yaml"), "--set", "mesh=coarse", "--run-dir", str(tmp_path / "loop")]
    for command in ("run", "close-loop"):
        result = CliRunner().invoke(app, [command, *given])
        assert result.exit_code in (0, 5), result.output
    content = json.loads((tmp_path / "loop" / "report.json").read_text(encoding="utf-8"))
    assert content["verdict"]["asked"] == "loop"
    looked_at(tmp_path / "loop" / "report.html", tmp_path / "profile", before_and_after=True)


@pytest.mark.as_written
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
