"""Coupon records of other people's projects: the native files give the strengths, areas, clocks and signs that their authors state."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import StudyError
from thermofit.core.experiment import CouponRecord
from thermofit.read.coupon import read_coupon
from thermofit.read.coupon_signs import thermoelastic_slope
from thermofit.read.formats.contents import ChannelRecord, Records
from thermofit.read.formats.registry import read_native
from thermofit.study.coupon import Coupon

DATA = Path(os.environ.get("THERMOFIT_DATA", "/nonexistent")) / "real"
CYCLIC = DATA / "steel-cyclic-with-temperature"
SHEET = DATA / "steel-sheet-luders-plc-temperature"
RATES = DATA / "304L-rates-tension"
HOT = DATA / "6061T6-temperature-tension"
pytestmark = pytest.mark.skipif(not CYCLIC.is_dir(), reason="needs THERMOFIT_DATA with real/steel-cyclic-with-temperature and others")

MACHINE = {
    "file": "LP9_1_181211.xlsx",
    "time": "C_1_Temps[s]",
    "strain": {"extension": "C_1_Angle[mm]"},
    "stress": {"force": "C_1_Force[kN]", "diameter": 5.98},
    "temperature": {"column": "Temperature", "file": "Temp_LP9_1_181211.XLSX"},
    "tension": "negative",
    "initial_temperature_degC": 23.8,
}
SANDIA = {"time": "time", "strain": "engineering_strain", "stress": {"column": "engineering_stress", "unit": "ksi"}}


def read(folder: Path, **settings: Any) -> CouponRecord:
    return read_coupon(Coupon.model_validate({"records": [settings]}), folder)[0]


def stress_at(record: CouponRecord, strain: float) -> float:
    """Stress at the first passage of a strain, NaN where it is not reached."""
    after = np.flatnonzero(record.strain >= strain)
    if not after.size:
        return np.nan
    part = slice(max(0, int(after[0]) - 1), int(after[0]) + 1)
    return float(np.interp(strain, record.strain[part], record.stress[part]))


def said(record: CouponRecord, words: str) -> bool:
    return any(words in remark for remark in record.remarks)


def test_cyclic_steel_with_two_clocks() -> None:
    record = read(CYCLIC, **MACHINE)
    assert record.time.size == 6053 and record.temperature is not None
    assert np.abs(record.stress).max() == pytest.approx(720.0, abs=2.0)
    assert record.temperature.max() - 273.15 == pytest.approx(30.0, abs=0.1)
    clock = next(remark for remark in record.remarks if "clock of the temperature" in remark)
    assert float(clock.split(" is ")[1].split(" s")[0]) == pytest.approx(17.0, abs=0.1)
    assert not said(record, "flipped") and not said(record, "contradict")
    slope = thermoelastic_slope(record.time, record.stress, record.temperature)
    assert slope is not None and -1.5e-3 < slope[0] < -0.3e-3, "steel: -alpha theta / rho c = -1.0e-3 K/MPa, smeared by the sensor"
    kinds = {label.split(" ")[0] for _, _, label in record.phases}
    assert kinds == {"elastic", "loading", "unloading", "hold"}


def test_cyclic_steel_read_with_the_wrong_sign_is_suspected() -> None:
    record = read(CYCLIC, **{**MACHINE, "tension": "positive"})
    assert said(record, "the sign of force and strain looks flipped")


def test_temperature_workbook_alone_gives_the_same_test() -> None:
    alone = read(
        CYCLIC,
        file="Temp_LP9_1_181211.XLSX",
        time="Time 1 - default sample rate",
        strain={"extension": "Extenso", "gauge_length": 8.0},
        stress={"force": "Load", "diameter": 5.98},
        temperature="Temperature",
        tension="negative",
    )
    both = read(CYCLIC, **MACHINE)
    shifted = np.interp(both.time + 16.964, alone.time, alone.stress)
    assert float(np.sqrt(np.mean((shifted - both.stress) ** 2))) < 4.0
    assert alone.theta_start == pytest.approx(273.15 + 23.8, abs=0.05)


def test_true_values_of_the_workbook_agree_with_force_and_extension() -> None:
    positive = {"tension": "positive"}
    strain, stress = {"true_strain": "e_true", **positive}, {"true_stress": "sigma_true", "unit": "MPa", **positive}
    true = read(CYCLIC, **{**MACHINE, "strain": strain, "stress": stress})
    raw = read(CYCLIC, **MACHINE)
    np.testing.assert_allclose(true.strain, raw.strain, atol=1e-7)
    np.testing.assert_allclose(true.stress, raw.stress, atol=0.05)


def test_padded_workbook() -> None:
    settings = {**MACHINE, "file": "test_specimen_2/Excel/testData_25022019.xlsx", "temperature": None, "window": [0.0, 247.0]}
    settings["stress"] = {"force": "C_1_Force[kN]"}
    record = read(CYCLIC, **{key: value for key, value in settings.items() if value is not None})
    assert said(record, "81905 empty rows at the end dropped") and said(record, "area 28.1802 mm^2 from the header")
    assert record.strain.max() == pytest.approx(0.125, abs=0.01)
    assert record.stress.max() == pytest.approx(473.9, abs=1.0)
    assert not said(record, "jump")


def test_cycles_as_text() -> None:
    record = read(
        CYCLIC,
        file="HEM320C-LP8_Specimen_1_processed_data.csv",
        time="Time[s]",
        strain="Eng_Strain[]",
        stress="Eng_Stress[MPa]",
        tension="negative",
        initial_temperature_degC=20.0,
        points=2000,
    )
    assert record.time.size <= 2000 and said(record, "thinned from 8434")
    assert (record.strain.min(), record.strain.max()) == pytest.approx((-0.0393, 0.0622), abs=1e-3)
    assert (record.stress.min(), record.stress.max()) == pytest.approx((-623.4, 570.8), abs=1.0)
    assert sum(label.startswith("unloading") for _, _, label in record.phases) >= 3


MEDIANS = {
    "1e-4": (15, (314, 345, 383, 433, 499, 564)),
    "1e-2": (9, (332, 358, 399, 447, 516, 581)),
    "500s": (14, (397, 422, 471, 529)),
    "1800s": (14, (418, 448, 501, 561, 635, 672)),
    "3600s": (12, (431, 444, 501, 563, 635, 678)),
}


@pytest.mark.parametrize("rate", MEDIANS)
def test_rate_series(rate: str) -> None:
    """Median stresses at 1, 2, 5, 10, 20, 40 % as the description of the data states them."""
    number, wanted = MEDIANS[rate]
    files = sorted((RATES / "ductile_failure_small_tension_data").glob("cleaned_*.csv"))
    ending = {"1e-4": "0.0001.csv", "1e-2": "0.01.csv"}.get(rate)
    chosen = [file for file in files if (file.name.endswith(ending) if ending else f"SRI_{rate}" in file.name)]
    records = [read(RATES, file=str(file), **SANDIA) for file in chosen]
    assert len(records) == number
    assert all(record.theta_start == pytest.approx(297.04, abs=0.01) for record in records)
    for strain, stress in zip((0.01, 0.02, 0.05, 0.1, 0.2, 0.4), wanted, strict=False):
        assert np.nanmedian([stress_at(record, strain) for record in records]) == pytest.approx(stress, rel=0.01)


def test_round_bars_to_the_maximum_force() -> None:
    file = RATES / "ductile_failure_ASTME8_304L_data" / "cleaned_R1S1-Large.dat"
    record = read(RATES, file=str(file), until="maximum-force", initial_temperature_degC=23.0, **SANDIA)
    assert record.stress.max() == pytest.approx(579.7, abs=0.5) and record.stress[-1] == record.stress.max()
    force = {**SANDIA, "stress": {"force": "load", "unit": "lbf", "diameter": 0.25 * 25.4}}
    from_force = read(RATES, file=str(file), until="maximum-force", initial_temperature_degC=23.0, **force)
    assert from_force.stress.max() == pytest.approx(record.stress.max(), rel=0.01)


@pytest.mark.parametrize(
    ("kind", "at_2", "at_5"), [("NM", (305, 315), (316, 330)), ("CA", (305, 315), (316, 330)), ("200C", (228, 231), (223, 227))]
)
def test_aluminium_at_room_temperature_and_hot(kind: str, at_2: tuple[float, float], at_5: tuple[float, float]) -> None:
    files = sorted((HOT / "uniaxial_tension" / "processed_data").glob(f"cleaned_*{kind}*.csv"))
    settings: dict[str, Any] = dict(SANDIA)
    if kind == "CA":
        settings = {**SANDIA, "rate": 8.5e-4}
        del settings["time"]
    if kind == "200C":
        settings["temperature"] = {"column": "temperature", "unit": "degF"}
    records = [read(HOT, file=str(file), **settings) for file in files]
    assert len(records) >= 10
    for strain, (low, high) in ((0.02, at_2), (0.05, at_5)):
        assert low * 0.98 <= np.nanmedian([stress_at(record, strain) for record in records]) <= high * 1.02
    for record in records:
        if record.temperature is not None:
            assert np.abs(record.temperature - 473.15).max() < 2.5
            assert not said(record, "flipped")
        assert kind != "CA" or said(record, "time built from the strain")


def test_compression_with_coarse_time() -> None:
    file = HOT / "uniaxial_material_point_data" / "true_engineering_stress_strain_compression_C-RD-01.csv"
    record = read(HOT, file=str(file), initial_temperature_degC=23.0, **SANDIA)
    assert said(record, "2 repeated rows dropped") and said(record, "2651 rows that share the time of the row before")
    true = {"strain": {"true_strain": "true_strain"}, "stress": {"true_stress": "true_stress", "unit": "ksi"}}
    again = read(HOT, file=str(file), initial_temperature_degC=23.0, **{**SANDIA, **true})
    assert again.time.size == record.time.size


def test_matlab_cells_and_their_workbook_are_one_test() -> None:
    settings = {"time": "t", "strain": {"extension": "dL"}, "stress": {"force": "F"}, "until": "maximum-force"}
    cell = read(SHEET, file="import_Tensile_GL-Temp.mat", test="GLL25_A", **settings)
    book = read(
        SHEET,
        file="Tensile_GL-Temp/Tensile-renamed-1.XLSX",
        time="Test time",
        strain={"extension": "Strain", "gauge_length": 40.0},
        stress={"force": "Standard force", "thickness": 1.32},
        initial_temperature_degC=25.0,
        until="maximum-force",
    )
    assert cell.stress.max() == pytest.approx(8660.4765625 / 7.8144, rel=1e-6)
    assert cell.theta_start == pytest.approx(298.15)
    np.testing.assert_allclose(cell.stress, book.stress, rtol=1e-6)
    np.testing.assert_allclose(cell.strain, book.strain, atol=1e-9)
    assert said(read(SHEET, file="import_Tensile_GL-Temp.mat", test="GLL150_A", **settings), "F0 = -2200 N")
    with pytest.raises(StudyError, match=r"test' is 'GLL25', but .* holds no such test; did you mean 'GLL250'"):
        read(SHEET, file="import_Tensile_GL-Temp.mat", test="GLL25", **settings)
    with pytest.raises(StudyError, match=r"test' is missing, and .* holds 13 tests"):
        read(SHEET, file="import_Tensile_GL-Temp.mat", **settings)


@pytest.mark.parametrize(("name", "tests"), [("GL-Temp", 13), ("GL-DIC", 3), ("GL", 5), ("FB", 5), ("DP", 4), ("QP", 4)])
def test_every_matlab_set(name: str, tests: int) -> None:
    records = read_native(SHEET / f"import_Tensile_{name}.mat")
    assert isinstance(records, Records) and len(records.tests) == tests
    for record in records.tests.values():
        assert set(record.units.values()) == {"s", "N", "mm"}
        assert 7.0 < record.about["area"] < 11.0
        assert record.about["area"] == pytest.approx(record.about["width"] * record.about["thickness"], rel=1e-3)


def test_testxpert_text() -> None:
    record = read_native(SHEET / "other_machine_outputs_examples" / "Invar_LT_05_01.txt")
    assert isinstance(record, ChannelRecord) and record.traits.encoding == "latin-1"
    assert record.about == pytest.approx({"thickness": 1.5, "width": 4.89, "area": 7.335, "gauge_length": 30.0})
    assert {len(values) for values in record.channels.values()} == {5336}
