"""The chain on a sheet: stages and joint fit on one layer, the check on its body."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import tiny

from thermofit.experiment.discretisation import SHEET
from thermofit.identify.budget import ROOM
from thermofit.records.artefact import open_record
from thermofit.records.staging import artefact_path
from thermofit.report.tables import meshes
from thermofit.study.study import Study


def test_chain_on_a_sheet(study_of: Callable[..., Study]) -> None:
    study = study_of("mesh={sheet: {n_x: 2, n_y: 12}}")
    body = open_record(artefact_path(study.run_dir, "identify-plastic"))
    found = {name: tiny.stage_run(name)(study).record for name in ("identify-elastic", "identify-plastic", "identify-thermal", "refine")}
    checked = tiny.stage_run("verify")(study).record
    assert meshes({"verify": checked}) == "sheet 2 x 12 hex8 of the quarter model"
    plastic = found["identify-plastic"]
    for name in ("M_y0", "M_yinf", "F"):
        assert plastic.parameters[name].value == pytest.approx(body.parameters[name].value, rel=1e-4), "one layer is one layer"
    for record in found.values():
        assert record.has(f"{ROOM}/{SHEET}"), record.stage
    rows = found["refine"].summary["budget"]["M_y0"]
    assert any(
        "the sheet 2 x 12 is fitted with its difference from the body in the data" in text for text in found["refine"].summary["notes"]
    )
    share = next(row["share"] for row in rows if row["cause"] == SHEET)
    assert 0.0 < share < 0.1, "a thin specimen: it is there, and small"
    assert 0.0 < checked.summary["sheet_error"]["u"]["over_noise"] < 0.1 and checked.summary["evaluations"]["forward"] == 2
    assert any("identified on the sheet 2 x 12, checked on the body 2 x 12 x 2" in text for text in checked.summary["notes"])
