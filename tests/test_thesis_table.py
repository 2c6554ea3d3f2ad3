"""The configurations of the thesis's experiments and the script that prints their results beside the thesis."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from thermofit.core.artefact import ParameterResult, RecordContent, write_record
from thermofit.core.parameters import param
from thermofit.core.study import load_study

ROOT = Path(__file__).parents[1]
EXPERIMENTS = ("exp1", "exp2", "exp3")


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("thesis_table", ROOT / "scripts" / "thesis_table.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_truth_of_the_study_is_what_the_thesis_printed(script: ModuleType, name: str) -> None:
    study = load_study(ROOT / "configs" / f"{name}.yaml")
    assert study.simulate is not None and study.virtual
    for stage, (_, values) in script.THESIS[name].items():
        assert set(study.stage(stage.removeprefix("identify-")).free) == set(values)
        for parameter, value in values.items():
            assert study.simulate.truth[parameter] == pytest.approx(value, rel=1e-12)
    assert study.gridsearch is not None and study.gridsearch.stage == "thermal"
    assert all(set(start) == set(script.THESIS[name]["identify-thermal"][1]) for start in study.gridsearch.starts)


def test_jaw_temperatures_of_table_5_21_are_those_of_the_study(script: ModuleType) -> None:
    study = load_study(ROOT / "configs" / "exp3.yaml")
    assert study.sensitivity is not None and set(study.sensitivity.values) == set(script.TABLE_5_21)


def test_figures_agree_with_the_collected_tables(script: ModuleType) -> None:
    """Against the collected figures of the thesis, where the data folder with its neighbour `reference` is there."""
    data = os.environ.get("THERMOFIT_DATA")
    path = Path(data).parent / "reference" / "thesis_tables.yaml" if data else None
    if path is None or not path.exists():
        pytest.skip("no thesis_tables.yaml beside the folder THERMOFIT_DATA")
    tables = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert script.THESIS["exp1"]["identify-plastic"][1] == tables["table_5_3_plastic_exp1_model1"]["optimal"]
    assert script.THESIS["exp2"]["identify-plastic"][1] == tables["table_5_13_plastic_exp2"]["model2"]
    names = ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp")
    for value, row in script.TABLE_5_21.items():
        printed = dict(zip(names, tables["sensitivity_exp3"]["table_5_21_clamp_varied"][value], strict=False))
        assert row == pytest.approx({**printed, "alpha_exp": 1e-6 * printed["alpha_exp"]})


def result(name: str, value: float, free: bool) -> ParameterResult:
    return ParameterResult(value, 0.01 * value if free else None, param(name).unit, free, False, 0.9 * value, 0.0, 1e9)


def test_table_is_printed_from_the_artefacts(script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = {name: value for _, values in script.THESIS["exp2"].values() for name, value in values.items()}
    contents = {"simulate": (truth, 1.0, False), **{stage: (values, 1.02, True) for stage, (_, values) in script.THESIS["exp2"].items()}}
    for stage, (values, factor, free) in contents.items():
        parameters = {name: result(name, factor * value, free) for name, value in values.items()}
        write_record(tmp_path / f"{stage}.h5", RecordContent(stage, {}, {}, {}, parameters, {"verdict": "made up"}))
    assert script.main(["exp2", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if " kappa " in line)
    assert "193.688" in row and "+2.00 %" in row and "+2.0" in row and "189.89" in row and "5.15" in row
    names = list(script.THESIS["exp2"]["identify-thermal"][1])
    optimum = {"failed": False, "converged": True, "optimum": dict.fromkeys(names, 1.5), "f": 30.0, "evaluations": {"forward": 12}}
    summary = {"verdict": "valley", "starts": [optimum, {"failed": True}], "channels": {"dtheta": {"n": 60}}}
    thermal = {name: result(name, 1.0, True) for name in names}
    write_record(tmp_path / "gridsearch.h5", RecordContent("gridsearch", {}, {}, {}, thermal, summary))
    assert script.main(["exp2", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "0.50000" in printed and "failed" in printed and "thesis, Table 5.15: all four starts" in printed
    (tmp_path / "identify-thermal.h5").unlink()
    assert script.main(["exp2", str(tmp_path)]) == 2
    assert "run `make exp2` first" in capsys.readouterr().err
