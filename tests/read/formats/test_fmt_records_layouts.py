"""Records as people keep them: words and results above the names, no names, units anywhere, dates, words of true and nominal."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st
from record_layouts import workbook

from thermofit.read.formats import bare_table, machine_workbook
from thermofit.read.formats.contents import ChannelRecord
from thermofit.read.formats.record_columns import column_of
from thermofit.read.formats.record_dates import seconds_of, start_in_header
from thermofit.read.formats.record_table import number_of, read_preamble, stated
from thermofit.read.formats.record_words import kind_of
from thermofit.read.formats.registry import read_native


def read(folder: Path, text: str, name: str = "record.csv") -> ChannelRecord:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    content = read_native(path)
    assert isinstance(content, ChannelRecord)
    return content


def rows(separator: str = ",", decimal: str = ".", n: int = 30, width: int = 3) -> str:
    """Time, strain and stress, and so on."""
    table = [[0.1 * k, 1e-4 * k, 20.5 * k, 20.0 + k][:width] for k in range(n)]
    return "".join(separator.join(f"{x:.5f}".replace(".", decimal) for x in row) + "\n" for row in table)


def meanings(record: ChannelRecord) -> dict[str, str]:
    return {column.name: column.meaning for column in record.traits.columns}


@pytest.mark.parametrize(
    "above",
    [
        "# Tension test of DP600, specimen 3\n# lab A, operator B\n",
        "Tension test, force and strain, of the north hall\n",
        "Sample,three\nMaterial,steel\nOperator,N.N.\n\n",
        "% made by hand, on paper, twice\n",
    ],
)
def test_words_above_the_names_are_no_names(tmp_path: Path, above: str) -> None:
    record = read(tmp_path, above + "time,strain,stress\n" + rows())
    assert meanings(record) == {"time": "time", "strain": "strain", "stress": "stress"}
    assert len(record.channels["time"]) == 30


def test_names_that_are_words_of_units_are_names(tmp_path: Path) -> None:
    """`strain` is a spelling of the unit 1, too: below a comment of two words it is a name all the same."""
    record = read(tmp_path, "# lab A, operator B\nstrain,stress\n" + rows(width=2))
    assert list(record.channels) == ["strain", "stress"]


def test_unknown_names_win_over_a_sentence_with_known_words(tmp_path: Path) -> None:
    """As many words as there are columns count more than words that are known."""
    record = read(tmp_path, "force, strain, of the machine, north\na,b,c\n" + rows())
    assert list(record.channels) == ["a", "b", "c"]


def test_results_above_the_record(tmp_path: Path) -> None:
    results = "Specimen;Rm;A;E\n;MPa;%;GPa\nS1;512;23;210\nS2;514;22;209\n\n"
    record = read(tmp_path, results + "Time;Force;Strain\ns;kN;%\n" + rows(";"))
    assert meanings(record) == {"Time": "time", "Force": "force", "Strain": "strain"}
    assert list(record.units.values()) == ["s", "N", "1"]
    assert len(record.channels["Time"]) == 30 and record.channels["Strain"][1] == pytest.approx(0.205)


def test_results_above_the_record_in_a_workbook(tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    table = [["Peak force", "Rm", "A"], ["kN", "MPa", "%"], [14.2, 512, 23], [], ["Time", "Force", "Strain"], ["s", "kN", "%"]]
    path.write_bytes(workbook({"one": [*table, *[[0.1 * k, 0.5 * k, 0.01 * k] for k in range(20)]]}))
    record = read_native(path)
    assert isinstance(record, ChannelRecord) and record.traits.format == machine_workbook.NAME
    assert list(record.channels) == ["Time", "Force", "Strain"] and len(record.channels["Time"]) == 20
    assert record.channels["Force"][2] == pytest.approx(1000.0)


@pytest.mark.parametrize("below", ["s,%,MPa\n", "[s],[%],[MPa]\n", "(s),(%),(N/mm\u00b2)\n", "\ns,%,MPa\n\n"])
def test_units_in_a_row_below_the_names(tmp_path: Path, below: str) -> None:
    record = read(tmp_path, "time,strain,stress\n" + below + rows())
    assert list(record.units.values()) == ["s", "1", "MPa"]
    assert record.channels["strain"][10] == pytest.approx(1e-5)


def test_names_with_blanks_above_columns_of_blanks(tmp_path: Path) -> None:
    """`True strain  True stress` above two columns are two names and not four."""
    two = "".join(f"{1e-3 * k:.4f} {3.0 * k:.2f}\n" for k in range(20))
    for names in (
        "True strain   True stress",
        "True strain, True stress",
        "strain(true) [-] stress(true) [MPa]",
        "True strain\tTrue stress",
    ):
        record = read(tmp_path, f"{names}\n{two}")
        assert list(meanings(record).values()) == ["true_strain", "true_stress"], names
        assert record.channels[list(record.channels)[1]][2] == pytest.approx(6.0)


def test_a_table_without_names(tmp_path: Path) -> None:
    """Columns are numbered, which a remark says; nothing is said of their meaning."""
    record = read(tmp_path, "# Temperature: 293 K\n" + rows(" "))
    assert list(record.channels) == ["column 1", "column 2", "column 3"]
    assert set(meanings(record).values()) == {""} and record.about == {"temperature": 293.0}
    assert any("has no names: its columns are called column 1 to column 3" in remark for remark in record.traits.remarks)
    assert record.traits.format == bare_table.NAME


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", "."), (" ", ","), ("|", ".")])
def test_tables_without_names_in_any_layout(tmp_path: Path, separator: str, decimal: str) -> None:
    record = read(tmp_path, rows(separator, decimal))
    np.testing.assert_allclose(record.channels["column 3"], 20.5 * np.arange(30.0))


@pytest.mark.parametrize(
    ("line", "about"),
    [
        ("# Temperature: 293 K", {"temperature": 293.0}),
        ("# strain rate = 1e-3 1/s", {"rate": 1e-3}),
        ("# Strain rate: 0.001 s^-1", {"rate": 1e-3}),
        ("strain rate (1/s): 5x10^-3", {"rate": 5e-3}),
        ("Strain Rate [/s] = 10^-2", {"rate": 1e-2}),
        ("# T0 = 20 degC; strain_rate = 2 /s", {"temperature": 293.15, "rate": 2.0}),
        ("# Test temperature: 68 F (room)", {"temperature": 293.15}),
        ("# Temperature 300 \u00b0C", {"temperature": 573.15}),
        ("Pr\u00fcftemperatur: 20,5 \u00b0C", {"temperature": 293.65}),
        ("# Dehnrate: 0,001 1/s", {"rate": 1e-3}),
        ("% gauge length [mm]: 25.4, area: 12.5 mm^2", {"gauge_length": 25.4, "area": 12.5}),
        ("# strain rate: 6 1/min", {"rate": 0.1}),
    ],
)
def test_statements_of_comment_lines(tmp_path: Path, line: str, about: dict[str, float]) -> None:
    for names in ("time,strain,stress\n", "# time, strain, stress\n"):
        record = read(tmp_path, f"{line}\n{names}" + rows())
        assert record.about == pytest.approx(about)
        assert list(record.channels) == ["time", "strain", "stress"]


@pytest.mark.parametrize(
    "line", ["# Temperature: 293", "# strain rate = 1e-3", "# rate: 10 Hz", "# strain rate: fast 3 m", "# Temperature: 293 Kg"]
)
def test_statements_without_a_known_unit_are_not_taken_and_said(tmp_path: Path, line: str) -> None:
    record = read(tmp_path, f"{line}\ntime,strain,stress\n" + rows())
    assert record.about == {}
    if "fast" not in line:
        assert any("is not taken: expected a number with a known unit" in remark for remark in record.traits.remarks)


@given(
    name=st.sampled_from(["Temperature", "test temperature", "T"]),
    value=st.floats(1.0, 3000.0),
    unit=st.sampled_from([("K", 1.0, 0.0), ("degC", 1.0, 273.15), ("F", 5 / 9, 459.67)]),
    sign=st.sampled_from([": ", "=", " = ", " "]),
    mark=st.sampled_from(["# ", "", "%", "// "]),
)
def test_any_statement_of_a_temperature_is_read(name: str, value: float, unit: tuple[str, float, float], sign: str, mark: str) -> None:
    word, factor, shift = unit
    found = read_preamble([], number_of, [f"{mark}{name}{sign}{value!r} {word}"])
    assert found.about == pytest.approx({"temperature": (value + shift) * factor})


@given(st.text(max_size=60))
def test_statements_never_fail(text: str) -> None:
    for _, value, _, _ in stated(text, number_of):
        assert isinstance(value, float)
    read_preamble([[text, 3.0, text]], number_of, [text])


@pytest.mark.parametrize(
    ("cell", "unit", "meaning"),
    [
        ("Force, kN", "kN", "force"),
        ("Stress / MPa", "MPa", "stress"),
        ("Stress N/mm\u00b2", "N/mm\u00b2", "stress"),
        ("Strain in %", "%", "strain"),
        ("strain_%", "%", "strain"),
        ("Strain microstrain", "microstrain", "strain"),
        ("stress (GPa)", "GPa", "stress"),
        ("Eng. stress [ksi]", "ksi", "stress"),
        ("Kraft [kN]", "kN", "force"),
        ("\u03b5 [\u00b5\u03b5]", "\u00b5\u03b5", "strain"),
        ("wahre Spannung [MPa]", "MPa", "true_stress"),
        ("log. Dehnung [-]", "-", "true_strain"),
        ("contrainte vraie (MPa)", "MPa", "true_stress"),
        ("technische Dehnung in %", "%", "strain"),
        ("TrueStrain", "", "true_strain"),
        ("nominal stress_MPa", "MPa", "stress"),
        ("strain_1", "", "strain"),
        ("channel 1 s", "", ""),
        ("lateral strain", "", "lateral_strain"),
        ("Querdehnung [%]", "%", "lateral_strain"),
        ("e_t [-]", "-", "lateral_strain"),
        ("transverse displacement [mm]", "mm", "lateral_extension"),
        ("Traverse abs. [mm]", "mm", "displacement"),
        ("lateral force [N]", "N", "force"),
        ("exx", "", "strain"),
        ("eps_yy [-]", "-", "strain"),
    ],
)
def test_words_and_units_of_a_column(cell: str, unit: str, meaning: str) -> None:
    column = column_of(cell)
    assert (column.unit, column.meaning) == (unit, meaning)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("true stress", "true"),
        ("Engineering Strain", "nominal"),
        ("eng_strain", "nominal"),
        ("EngStress", "nominal"),
        ("length", ""),
        ("technical stress", "nominal"),
        ("Nennspannung", "nominal"),
        ("true and engineering", ""),
        ("logging channel", ""),
        ("Umformgrad", "true"),
    ],
)
def test_words_of_true_and_nominal(text: str, kind: str) -> None:
    assert kind_of(text) == kind


def test_true_stress_in_a_line_above_the_names_is_told(tmp_path: Path) -> None:
    record = read(tmp_path, "# true stress - true strain curve\nstrain,stress\n" + rows(width=2))
    assert any("speaks of true quantities" in remark for remark in record.traits.remarks)
    record = read(tmp_path, "# true stress - true strain curve\nstrain (true),stress (true)\n" + rows(width=2))
    assert not any("speaks of" in remark for remark in record.traits.remarks)


def test_force_stress_and_strain_in_units_of_the_header(tmp_path: Path) -> None:
    names = "Force [kN],Stress [GPa],s2 [psi],s3 [ksi],Strain [%],e2 [microstrain]"
    record = read(tmp_path, names + "\n" + "".join("1,2,3,4,5,6\n" for _ in range(12)))
    psi = 4.4482216152605 / 25.4**2
    assert [record.channels[c.name][0] for c in record.traits.columns] == pytest.approx([1e3, 2e3, 3 * psi, 4e3 * psi, 0.05, 6e-6])


def test_dates_and_times_of_day_are_clocks(tmp_path: Path) -> None:
    begun = dt.datetime(2018, 12, 11, 23, 59, 58)
    stamps = [begun + dt.timedelta(seconds=0.5 * k) for k in range(12)]
    text = "stamp,date,clock,strain\n" + "".join(
        f"{s:%Y-%m-%d %H:%M:%S.%f},{s:%d.%m.%Y},{s:%H:%M:%S.%f},{1e-3 * k}\n" for k, s in enumerate(stamps)
    )
    record = read(tmp_path, text.replace("strain", "force"))
    np.testing.assert_allclose(np.diff(record.channels["stamp"]), 0.5)
    assert record.channels["stamp"][0] == (begun - dt.datetime(1970, 1, 1)).total_seconds()
    assert meanings(record) == {"stamp": "date", "date": "date", "clock": "date", "force": "force"}
    alone = read(tmp_path, "\n".join(",".join(line.split(",")[2:]) for line in text.replace("strain", "force").splitlines()))
    np.testing.assert_allclose(np.diff(alone.channels["clock"]), 0.5, err_msg="on past midnight")
    assert meanings(alone)["clock"] == "time"


def test_dates_of_a_workbook(tmp_path: Path) -> None:
    begun = dt.datetime(2020, 2, 29, 8, 0, 0)
    path = tmp_path / "book.xlsx"
    table = [["stamp", "force [N]"], *[[begun + dt.timedelta(seconds=k), 2.0 * k] for k in range(12)]]
    path.write_bytes(workbook({"one": table}))
    record = read_native(path)
    assert isinstance(record, ChannelRecord)
    np.testing.assert_allclose(np.diff(record.channels["stamp"]), 1.0, atol=1e-3)
    assert record.channels["stamp"][0] == pytest.approx((begun - dt.datetime(1970, 1, 1)).total_seconds(), abs=1e-3)


def test_day_and_month_that_cannot_be_told_apart_are_no_date() -> None:
    assert seconds_of(["03/04/2020 10:00", "03/04/2020 10:01"]) is None
    first, second = seconds_of(["03/14/2020 10:00"]), seconds_of(["14/03/2020 10:00"])
    assert first is not None and second is not None and first[0][0] == second[0][0]
    assert seconds_of(["30.02.2020 10:00"]) is None and seconds_of(["25:00:00"]) is None and seconds_of(["1.5", "2.5"]) is None


@given(
    st.datetimes(dt.datetime(1971, 1, 1), dt.datetime(2068, 1, 1)),
    st.sampled_from(["%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%Y-%m-%dT%H:%M:%S.%fZ"]),
)
def test_any_date_is_read_to_the_microsecond(stamp: dt.datetime, form: str) -> None:
    found = seconds_of([stamp.strftime(form)])
    assert found is not None and found[0][0] == pytest.approx((stamp - dt.datetime(1970, 1, 1)).total_seconds(), abs=1e-5)


def test_the_start_of_a_test_in_its_header() -> None:
    began = (dt.datetime(2018, 12, 11, 14, 50, 3) - dt.datetime(1970, 1, 1)).total_seconds()
    assert start_in_header({"Start": "2018-12-11 14:50:03", "Operator": "A"}) == began
    assert start_in_header({"Test date": "11.12.2018", "Time": "14:50:03"}) == began
    assert start_in_header({"Test date": "11.12.2018"}) is None
    assert start_in_header({"Start": "2018-12-11 14:50:03", "End time": "2018-12-11 15:50:03"}) is None


def test_names_and_units_flush_with_columns_of_fixed_width(tmp_path: Path) -> None:
    """Names with blanks and brackets in them, more words than columns: told by where they stand."""
    names = ("No.", "Time", "Tem.1", "Force", "kf (Def.)", "Phi  (D)", "Phi* (D)")
    units = ("", "s", "\u00b0C", "N", "N/mm\u00b2", "", "1/s")
    lines = ["".join(f"{word:>13}" for word in row) for row in (names, units)]
    lines += ["".join(f"{x:13.4f}" for x in (k, 0.1 * k, 400 + k, -2 * k, 3 * k, 1e-3 * k, 0.01)) for k in range(20)]
    record = read(tmp_path, "\n".join(lines) + "\n", "test.asc")
    assert list(record.channels) == ["No.", "Time", "Tem.1", "Force", "kf (Def.)", "Phi (D)", "Phi* (D)"]
    assert list(record.units.values()) == ["", "s", "K", "N", "MPa", "", "1/s"]
    left = ["".join(f"{word:<13}" for word in names[1:5])]
    left += ["".join(f"{x:<13.4f}" for x in (0.1 * k, 400 + k, -2 * k, 3 * k)) for k in range(20)]
    assert list(read(tmp_path, "\n".join(left) + "\n").channels) == ["Time", "Tem.1", "Force", "kf (Def.)"]


def test_more_words_than_columns_of_blanks_never_shift_the_names(tmp_path: Path) -> None:
    record = read(tmp_path, "the true strain and the true stress\n" + rows(" ", width=2))
    assert list(record.channels) == ["column 1", "column 2"]
    assert any("7 words stand above 2 columns" in remark for remark in record.traits.remarks)


def test_a_column_with_a_single_number_speaks_of_the_test(tmp_path: Path) -> None:
    body = "".join(f"{0.1 * k},{5.0 * k},{'650,12.5,7.25' if k == 0 else ',,'}\n" for k in range(20))
    record = read(tmp_path, "time,force [N],temperature [degC],Original area (mm^2),Final area (mm^2)\n" + body)
    assert list(record.channels) == ["time", "force [N]"] and record.traits.missing == 0
    assert record.about == pytest.approx({"temperature": 923.15, "area": 12.5})
    assert "column 'temperature [degC]' holds one number, 650 degC, and says the temperature of the test" in record.traits.remarks
    assert any("'Final area (mm^2)' holds one number, 7.25 mm^2, and is no channel" in remark for remark in record.traits.remarks)


def test_sizes_after_fracture_are_not_those_of_the_specimen(tmp_path: Path) -> None:
    head = (
        "Cross-section after fracture: 8.76 mm\u00b2\nOriginal cross-section: 19.66 mm\u00b2\nStrain rate: 0.00099 s-1\nTemperature: RT\n"
    )
    record = read(tmp_path, head + "time;strain;stress\n" + rows(";"))
    assert record.about == pytest.approx({"area": 19.66, "rate": 0.00099})
    assert any("the header line 'Temperature' (RT) is not taken" in remark for remark in record.traits.remarks)


def test_a_unit_behind_a_name_is_no_statement(tmp_path: Path) -> None:
    """`strain rate 1/s` in a row of names that do not fit the columns is no rate of 1."""
    record = read(tmp_path, "strain stress MPa strain rate 1/s\n" + rows(" "))
    assert record.about == {} and [column_of(name).meaning for name in ("E", "e")] == ["", "strain"]


def test_capital_t_without_a_unit_is_a_temperature_and_t_a_time(tmp_path: Path) -> None:
    assert [column_of(name).meaning for name in ("T", "t", "T [s]", "T [K]")] == ["temperature", "time", "time", "temperature"]
    assert column_of("Position (m) Run #1").unit == "m" and column_of("strain%").unit == "%"
    assert column_of("strainrate").meaning == "rate"


def test_units_that_begin_with_a_percent_sign_are_no_comment(tmp_path: Path) -> None:
    record = read(tmp_path, "strain;stress\n%;MPa\n" + rows(";", width=2))
    assert list(record.units.values()) == ["1", "MPa"]


def test_a_sheet_without_names(tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    path.write_bytes(workbook({"Exp": [[1e-3 * k, 3.0 * k, 2e-3 * k, 4.0 * k] for k in range(20)], "note": [["by hand"]]}))
    record = read_native(path)
    assert isinstance(record, ChannelRecord) and list(record.channels) == [f"column {k}" for k in (1, 2, 3, 4)]
    assert record.channels["column 4"][3] == 12.0 and any("has no names" in remark for remark in record.traits.remarks)


def test_arrays_of_a_mat_file_have_no_names(tmp_path: Path) -> None:
    path = tmp_path / "test.mat"
    scipy.io.savemat(path, {"test_data": np.stack([np.linspace(0, 0.1, 20), np.linspace(0, 500, 20)], axis=1), "note": "true"})
    record = read_native(path)
    assert isinstance(record, ChannelRecord) and list(record.channels) == ["column 1", "column 2"]
    assert record.channels["column 2"][-1] == 500.0
