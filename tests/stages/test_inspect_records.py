"""What `inspect` says of coupon records as people keep them: its lines are a study's, which reads the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
import yaml

from thermofit.core.experiment import CouponRecord
from thermofit.read.coupon import read_coupon
from thermofit.stages.inspect import inspect
from thermofit.study.study import load_study

STRAIN = np.linspace(0.0, 0.1, 60)
STRESS = 400.0 * np.tanh(STRAIN / 0.004)


def table(names: str, *columns: np.ndarray) -> str:
    return names + "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in np.stack(columns, axis=1))


def look(folder: Path, text: str, name: str = "test.csv") -> dict[str, Any]:
    (folder / name).write_text(text, encoding="utf-8")
    return inspect(folder / name)


def read(folder: Path, suggestion: str, **more: Any) -> tuple[CouponRecord, ...]:
    """The records of a study made of the suggested lines, with what they leave to fill in."""
    tree = yaml.safe_load(suggestion)
    for entry in (*tree["coupon"].get("records", ()), *tree["coupon"].get("series", ())):
        entry.update(more)
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump({"name": "bar", **tree}, allow_unicode=True), encoding="utf-8")
    study = load_study(path)
    assert study.coupon is not None
    return read_coupon(study.coupon, folder)


def test_rate_and_temperature_of_the_header_go_into_the_study(tmp_path: Path) -> None:
    result = look(tmp_path, "# Temperature: 400 K\n# strain rate = 5e-3 1/s\n" + table("strain,stress [MPa]\n", STRAIN, STRESS))
    assert "rate: 0.005     # 1/s, from the header" in result["suggestion"] and "initial_temperature" not in result["suggestion"]
    (record,) = read(tmp_path, result["suggestion"], strain="strain")
    assert record.theta_start == 400.0 and record.time[-1] == pytest.approx(20.0)


def test_true_stress_and_lateral_strain_are_offered_by_their_words(tmp_path: Path) -> None:
    text = table(
        "t [s],wahre Dehnung [-],true stress [MPa],Querdehnung [-]\n", 1e3 * STRAIN, np.log1p(STRAIN), STRESS * (1 + STRAIN), -0.4 * STRAIN
    )
    result = look(tmp_path, text)
    lines = yaml.safe_load(result["suggestion"])["coupon"]["records"][0]
    assert lines["strain"] == {"true_strain": "wahre Dehnung [-]"} and lines["stress"] == {"true_stress": "true stress [MPa]"}
    assert lines["lateral"] == "Querdehnung [-]"
    (record,) = read(tmp_path, result["suggestion"], initial_temperature_degC=20)
    np.testing.assert_allclose(record.stress, STRESS, atol=1e-5)
    assert record.lateral is not None


def test_a_pair_of_strains_is_told_apart_by_size_and_said(tmp_path: Path) -> None:
    result = look(tmp_path, table("t [s],exx [-],eyy [-],s [MPa]\n", 1e3 * STRAIN, -0.4 * STRAIN, STRAIN, STRESS))
    lines = yaml.safe_load(result["suggestion"])["coupon"]["records"][0]
    assert (lines["strain"], lines["lateral"]) == ("eyy [-]", "exx [-]")
    assert "# eyy [-] changes more than exx [-] and is taken as the one along the load: check it" in result["suggestion"]


def test_columns_without_names_are_listed_by_number(tmp_path: Path) -> None:
    result = look(tmp_path, table("", STRAIN, STRESS))
    assert result["format"] == "table of numbers without known names"
    assert "give its name or number of 1 (0 to 0.1), 2 (0 to 400)" in result["suggestion"]
    (record,) = read(tmp_path, result["suggestion"], strain=1, stress={"column": 2, "unit": "MPa"}, rate=1e-3, initial_temperature_degC=20)
    np.testing.assert_allclose(record.stress, STRESS, atol=1e-5)


def test_tests_below_each_other_become_a_series(tmp_path: Path) -> None:
    rows = "".join(
        f"{name},{hot},{e:.9g},{f * s:.9g}\n"
        for name, hot, f in (("A", 20, 1), ("B", 300, 0.5))
        for e, s in zip(STRAIN, STRESS, strict=True)
    )
    result = look(tmp_path, "file,temp [degC],strain [-],stress [MPa]\n" + rows)
    assert any(remark.startswith("2 blocks of rows in which 'file', 'temp [degC]' hold one value each") for remark in result["remarks"])
    entry = yaml.safe_load(result["suggestion"])["coupon"]["series"][0]
    assert entry["each"] == {"where.file": ["A", "B"]}
    first, second = read(tmp_path, result["suggestion"], rate=1e-3, initial_temperature_degC=20)
    np.testing.assert_allclose(second.stress, 0.5 * first.stress, atol=1e-5)
    assert (first.name, second.name) == ("A", "B")


def test_blocks_told_apart_by_two_columns_of_numbers(tmp_path: Path) -> None:
    rows = "".join(
        f"{hot},{rate},{e:.9g},{s:.9g}\n" for hot in (25, 300) for rate in (0.001, 1) for e, s in zip(STRAIN, STRESS, strict=True)
    )
    result = look(tmp_path, "T,strain rate,strain [-],stress [MPa]\n" + rows)
    entry = yaml.safe_load(result["suggestion"])["coupon"]["series"][0]
    assert entry["each"] == {"where.T": [25, 25, 300, 300], "where.strain rate": [0.001, 1, 0.001, 1]}
    assert '# temperature_degC: [25, 25, 300, 300]     # "T": say the unit' in result["suggestion"]
    assert len(read(tmp_path, result["suggestion"], rate=1e-3, initial_temperature_degC=20)) == 4


def test_counted_cycles_of_one_clock_are_one_test(tmp_path: Path) -> None:
    time = np.arange(300.0)
    result = look(tmp_path, table("cycle,t [s],strain [-],stress [MPa]\n", time // 100, time, np.sin(time / 16), 300 * np.sin(time / 16)))
    assert "records" in yaml.safe_load(result["suggestion"])["coupon"] and not any("below each other" in text for text in result["remarks"])


def test_a_sensor_that_stands_still_beside_another_says_nothing(tmp_path: Path) -> None:
    text = table("t [s],T1 [degC],T2 [degC],strain [-],stress [MPa]\n", STRAIN, 490 + STRAIN, 0 * STRAIN, STRAIN, STRESS)
    lines = yaml.safe_load(look(tmp_path, text.replace("T1", "Temp 1").replace("T2", "Temp 2"))["suggestion"])["coupon"]["records"][0]
    assert lines["temperature"] == "Temp 1 [degC]"


def test_a_wild_sample_is_told(tmp_path: Path) -> None:
    wild = STRESS.copy()
    wild[40] = -300.0
    remarks = look(tmp_path, table("t [s],strain [-],stress [MPa]\n", STRAIN, STRAIN, wild))["remarks"]
    assert "stress [MPa]: 1 wild samples, far off their neighbours: row 40 (-300) (leave_out)" in remarks
    assert not any(
        "wild" in remark for remark in look(tmp_path, table("t [s],strain [-],stress [MPa]\n", STRAIN, STRAIN, STRESS))["remarks"]
    )


def test_a_channel_on_another_sheet_is_offered_with_its_clock(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    machine, camera = book.active, book.create_sheet("camera")
    machine.title = "machine"
    machine.append(["time [s]", "force [N]"])
    camera.append(["time [s]", "strain [-]", "force [N]"])
    wave = STRAIN * np.sin(60 * STRAIN) + STRAIN
    for k, (e, s) in enumerate(zip(wave, STRESS * wave, strict=True)):
        machine.append([float(k), float(20 * s)])
        camera.append([k + 7.0, float(e), float(20 * s)])
    book.save(tmp_path / "book.xlsx")
    result = inspect(tmp_path / "book.xlsx")
    (entry,) = yaml.safe_load(result["suggestion"])["coupon"]["records"]
    assert entry["test"] == "machine" and entry["strain"] == {"column": "strain [-]", "test": "camera"}
    (record,) = read(tmp_path, result["suggestion"], stress={"force": "force [N]", "area": 20}, initial_temperature_degC=20)
    np.testing.assert_allclose(record.strain, wave, atol=1e-6)


def test_many_records_of_a_folder_become_a_series(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    for hot in (20, 300):
        (folder / f"flow_{hot}C.csv").write_text(table("strain [-],stress [MPa]\n", STRAIN, STRESS * (1 - hot / 1000)), encoding="utf-8")
    result = inspect(folder)
    entry = yaml.safe_load(result["suggestion"])["coupon"]["series"][0]
    assert entry["files"] == str(folder / "flow_*C.csv")
    pattern = str(folder / "flow_{temperature_degC}C.csv")
    cold, hot = read(tmp_path, result["suggestion"].replace("initial_temperature_degC:", "rate: 1.0e-3 #"), files=pattern, rate=1e-3)
    assert (cold.theta_start, hot.theta_start) == (pytest.approx(293.15), pytest.approx(573.15))
    assert any("from the name of the file" in remark for remark in hot.remarks)
