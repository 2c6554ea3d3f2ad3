"""`inspect` on the public sets: format, units, points and missing values of every file, beside counts made here by a few plain lines."""

from __future__ import annotations

import csv
import json
import math
import os
from pathlib import Path
from typing import Any

import pytest
import scipy.io
import yaml
from python_calamine import CalamineWorkbook
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.errors import DataError
from thermofit.read.coupon import read_coupon
from thermofit.stages.inspect import inspect
from thermofit.study.coupon import Coupon

ROOT = Path(os.environ.get("THERMOFIT_DATA", "nowhere")) / "real"
pytestmark = pytest.mark.skipif(
    not ROOT.is_dir(), reason="THERMOFIT_DATA is not set or holds no real sets: `thermofit data fetch` gets them"
)

Expected = tuple[str, set[str], int, int]
"""Beginning of the format's name, units as written, points or rows, missing."""


def lines_of(path: Path) -> list[str]:
    return [line for line in path.read_bytes().decode("latin-1").splitlines() if line.strip()]


def number(cell: object) -> float:
    """A cell as a number, NaN where it is none."""
    try:
        return float(str(cell).strip().strip('"').replace(",", "."))
    except ValueError:
        return math.nan


def gom(path: Path) -> Expected:
    return "GOM point cloud", {"mm"}, sum(line[0].isdigit() for line in lines_of(path)), 0


def section(path: Path) -> Expected:
    rows = [line.split() for line in lines_of(path)[1:]]
    return "ARAMIS section", {"mm"}, len(rows), sum(math.isnan(number(cell)) for row in rows for cell in row)


def dice(path: Path) -> Expected:
    rows = [line.split(",") for line in lines_of(path) if not line.startswith("***")]
    failed = [k for k, name in enumerate(rows[0]) if name in ("SIGMA", "MATCH")]
    return "DICe", {"px", "1"}, len(rows) - 1, sum(any(float(row[k]) < 0 for k in failed) for row in rows[1:])


def vic(path: Path) -> Expected:
    rows = list(csv.reader(lines_of(path), skipinitialspace=True))
    sigma = [name.strip() for name in rows[0]].index("sigma")
    return "VIC-3D", {"mm", "1", "px"}, len(rows) - 1, sum(float(row[sigma]) < 0 for row in rows[1:])


def irbis(path: Path) -> Expected:
    lines = lines_of(path)
    rows = [[cell for cell in line.split(";") if cell.strip()] for line in lines[lines.index("[Data]") + 1 :]]
    return "InfraTec IRBIS", {"mK"}, sum(len(row) for row in rows), sum(math.isnan(number(cell)) for row in rows for cell in row)


def matrix(path: Path) -> Expected:
    rows = [line.rstrip(";").split(";") for line in lines_of(path)]
    cells = len(rows) * max(len(row) for row in rows)
    return "MatchID matrix", {"mm"}, cells, cells - sum(not math.isnan(number(cell)) for row in rows for cell in row)


def matchid(path: Path) -> Expected:
    rows = [line.split(";") for line in lines_of(path)]
    return "MatchID table", {"mm", "1"}, len(rows) - 1, sum(any(math.isnan(number(cell)) for cell in row[:4]) for row in rows[1:])


def plain(path: Path, name: str = "coupon record", head: int = 1, units: tuple[str, ...] = ()) -> Expected:
    """A table of numbers separated by commas; columns that hold no number at all are no channels."""
    rows = list(csv.reader(lines_of(path)))[head:]
    columns = [[number(row[k]) if k < len(row) else math.nan for row in rows] for k in range(max(len(row) for row in rows))]
    missing = sum(sum(map(math.isnan, column)) for column in columns if not all(map(math.isnan, column)))
    return name, set(units), len(rows), missing


def sandia(path: Path) -> Expected:
    return plain(path, "Sandia state file", 2)


def xpert_text(path: Path) -> Expected:
    rows = [line for line in lines_of(path) if not line.startswith('"')]
    return "ZwickRoell testXpert text", {"s", "mm", "N"}, len(rows), 0


def sheet(path: Path, name: str, units: set[str], start: str, head: int) -> Expected:
    """The sheet whose name begins with `start`; rows that hold any number, `head` rows of names above them."""
    book = CalamineWorkbook.from_path(str(path))
    rows = book.get_sheet_by_name(next(n for n in book.sheet_names if n.startswith(start))).to_python(skip_empty_area=False)[head:]
    filled = [row for row in rows if any(isinstance(cell, float) for cell in row)]
    width = max(len(row) for row in filled)
    columns = [[row[k] if k < len(row) else "" for row in filled] for k in range(width)]
    counts = [sum(isinstance(cell, float) for cell in column) for column in columns]
    return name, units, len(filled), sum(len(filled) - n for n in counts if n)


def xpert_book(path: Path) -> Expected:
    return sheet(path, "ZwickRoell testXpert workbook", {"s", "mm", "N"}, "Values", 3)


def matlab(path: Path) -> Expected:
    """Cell array `data` of structs, or the variables of one test: rows in which any channel is a number, NaN among these."""
    tree = scipy.io.loadmat(path, simplify_cells=True)
    if "data" in tree:
        found = tree["data"]
        tests = [found] if isinstance(found, dict) else list(found)
    else:
        tests = [tree]
    rows = missing = 0
    for test in tests:
        channels = [test[key] for key in ("t", "F", "dL", "u", "utr") if key in test and len(test[key])]
        kept = [row for row in zip(*channels, strict=True) if not all(math.isnan(x) for x in row)]
        rows += len(kept)
        missing += sum(math.isnan(x) for row in kept for x in row)
    return "MATLAB 5", {"s", "N", "mm"}, rows, missing


def frames(path: Path) -> Expected:
    rows = [line.split(",") for line in lines_of(path)[2:]]
    return "CSV table of many DIC frames", {"px"}, len(rows), sum(any(math.isnan(number(cell)) for cell in row[4:8]) for row in rows)


CSV_S235 = ("mm",)
FILES: tuple[tuple[str, Any], ...] = (
    ("native-format-samples/gom-points/*.csv", gom),
    ("native-format-samples/aramis-sections/*/*.txt", section),
    ("native-format-samples/dice/**/DICe_solution_*.txt", dice),
    ("native-format-samples/vic3d/*.csv", vic),
    ("native-format-samples/infratec-irbis/*.txt", irbis),
    ("native-format-samples/matchid-matrix/*/*.csv", matrix),
    ("native-format-samples/matchid-table/*.csv", matchid),
    ("304L-rates-tension/ductile_failure_ASTME8_304L_data/*.dat", plain),
    ("304L-rates-tension/*/cleaned_*.csv", sandia),
    ("304L-rates-tension/*/grip_disp_vs_time_*.dat", plain),
    ("6061T6-temperature-tension/*/processed_data/*", sandia),
    ("6061T6-temperature-tension/uniaxial_material_point_data/*.csv", plain),
    ("s235-plate-hole-dic/*.csv", lambda path: plain(path, "CSV table of coordinates", 1, CSV_S235)),
    ("tension-necking-dic-images/derived_*.csv", frames),
    ("steel-cyclic-with-temperature/HEM320C*.csv", lambda path: plain(path, "coupon record", 1, ("s", "kN", "mm", "MPa", "1"))),
    ("steel-sheet-luders-plc-temperature/Tensile_*/*.XLSX", xpert_book),
    ("steel-sheet-luders-plc-temperature/**/*.mat", matlab),
    ("steel-sheet-luders-plc-temperature/other_machine_outputs_examples/*.txt", xpert_text),
)
MACHINE = {
    "steel-cyclic-with-temperature/LP9_1_181211.xlsx": ("machine workbook", {"s", "kN", "mm", "Mpa", "1", "%"}, 6),
    "steel-cyclic-with-temperature/test_specimen_2/Excel/testData_25022019.xlsx": ("machine workbook", {"s", "kN", "mm", "Mpa"}, 6),
}
UNREAD = ("hot-strips-dic-strain",)
"""Sets of workbooks that no reader takes: strains along the axis of a strip, without a force."""
CASES = [(path, count) for pattern, count in FILES for path in sorted(ROOT.glob(pattern))]


def label(path: object) -> str:
    return path.relative_to(ROOT).as_posix() if isinstance(path, Path) else ""


def compare(path: Path, expected: Expected) -> None:
    name, units, points, missing = expected
    found = inspect(path)
    assert found["format"].startswith(name)
    assert (found["points"], found["missing"]) == (points, missing)
    assert set(found["units"]) == units or set(found["units"]) < units == {"s", "N", "mm"}


@pytest.mark.parametrize(("path", "count"), CASES, ids=label)
def test_file(path: Path, count: Any) -> None:
    """What `inspect` says is what plain lines of Python count."""
    compare(path, count(path))


@pytest.mark.parametrize("name", MACHINE)
def test_machine_workbook(name: str) -> None:
    """The machine workbooks: rows below the header in row 7, with texts and dates in the date column, padded with empty rows."""
    path = ROOT / name
    if not path.is_file():
        pytest.skip(f"{name} is not in the mirror")
    title, units, head = MACHINE[name]
    book = CalamineWorkbook.from_path(str(path))
    rows = book.get_sheet_by_index(0).to_python(skip_empty_area=False)[head + 1 :]
    filled = [row for row in rows if any(isinstance(cell, float) for cell in row)]
    found = inspect(path)
    assert found["format"].startswith(title)
    assert (found["points"], found["missing"], set(found["units"])) == (len(filled), 0, units)


def test_catman_workbook_and_its_flipped_sign() -> None:
    """The temperature workbook of LP9: rows with a time, degrees Celsius, and compression counted positive, which the sensor shows."""
    path = ROOT / "steel-cyclic-with-temperature" / "Temp_LP9_1_181211.XLSX"
    if not path.is_file():
        pytest.skip("the set steel-cyclic-with-temperature is not in the mirror")
    rows = CalamineWorkbook.from_path(str(path)).get_sheet_by_index(0).to_python(skip_empty_area=False)
    filled = [row for row in rows[3:] if isinstance(row[0], float) and all(isinstance(cell, float) for cell in row[:2])]
    found = inspect(path)
    assert found["format"].startswith("HBM catman")
    assert (found["points"], found["missing"], found["units"]) == (len(filled), 0, ["s", "kN", "mm", "\u00b0C"])
    assert any("looks flipped" in remark for remark in found["remarks"])
    assert "tension: negative" in found["suggestion"]


def test_lines_for_a_record_read_it() -> None:
    """The suggested section reads the record of HEM320 once the temperature, which the file does not hold, is filled in."""
    path = ROOT / "steel-cyclic-with-temperature" / "HEM320C-LP8_Specimen_1_processed_data.csv"
    if not path.is_file():
        pytest.skip("the set steel-cyclic-with-temperature is not in the mirror")
    section = yaml.safe_load(inspect(path)["suggestion"])["coupon"]
    assert section["records"][0].pop("initial_temperature_degC") is None
    section["records"][0]["initial_temperature_degC"] = 22.0
    (record,) = read_coupon(Coupon.model_validate(section), Path())
    assert len(record.time) == 8434
    assert record.stress.max() == pytest.approx(623.37, abs=0.01)


def test_every_data_file_is_recognised() -> None:
    """What no reader takes is listed here: notes, licences, pictures, two side files of a test, and strains along a line over time."""
    told = {path for path, _ in CASES} | {ROOT / name for name in MACHINE}
    told.add(ROOT / "steel-cyclic-with-temperature" / "Temp_LP9_1_181211.XLSX")
    for path in sorted(p for p in ROOT.rglob("*") if p.is_file() and p not in told):
        if path.suffix == ".tif":
            assert inspect(path)["format"] == "picture (TIFF)"
        else:
            unread = path.relative_to(ROOT).parts[0] in UNREAD and path.suffix == ".xlsx"
            assert unread or path.name in ("README.md", "LICENSE", "filter_info.csv", "specimen_description.csv")
            with pytest.raises(DataError, match="no known format recognised" if unread else "its first line is '"):
                inspect(path)


def test_folder_of_the_samples() -> None:
    """One line for each sequence: six sections of 21 stages, two stages of VIC-3D with 895 points lost in each."""
    result = CliRunner().invoke(app, ["inspect", str(ROOT / "native-format-samples"), "--json"])
    groups = {group["files"]: group for group in json.loads(result.stdout)["groups"]}
    sections = [group for name, group in groups.items() if "section" in name and group["native"]]
    assert [group["count"] for group in sections] == [21] * 6
    vic3d = [group for name, group in groups.items() if name.startswith("vic3d/def")]
    assert [(group["count"], group["points"], group["missing"]) for group in vic3d] == [(1, 4212, 895)] * 2
