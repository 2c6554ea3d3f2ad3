"""Coupon records as text: plain tables, Sandia state files, testXpert."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from record_layouts import COMMENTED, INSTRON, PLAIN, SANDIA, SCHENCK, TESTXPERT, TESTXPERT_TABS, rows

from thermofit.core.errors import DataError
from thermofit.read.formats import coupon_text, sandia_text, testxpert_text
from thermofit.read.formats.contents import ChannelRecord
from thermofit.read.formats.registry import format_of, read_native

TABLE = np.array(rows())


def written(folder: Path, data: bytes, name: str = "record.dat") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def read(folder: Path, data: bytes) -> ChannelRecord:
    content = read_native(written(folder, data))
    assert isinstance(content, ChannelRecord)
    return content


def test_names_with_units_in_brackets(tmp_path: Path) -> None:
    record = read(tmp_path, PLAIN)
    assert record.traits.format == coupon_text.NAME
    assert list(record.channels) == ["C_1_Temps[s]", "C_1_Force[kN]", "ext[mm]", "ext[mm] (2)"]
    assert list(record.units.values()) == ["s", "N", "mm", "mm"]
    np.testing.assert_allclose(record.channels["C_1_Force[kN]"], 1e3 * TABLE[:, 1])
    np.testing.assert_allclose(record.channels["ext[mm] (2)"], TABLE[:, 3])
    assert [column.meaning for column in record.traits.columns] == ["time", "force", "extension", "extension"]
    assert any("occurs more than once" in remark for remark in record.traits.remarks)


def test_units_in_a_row_and_decimal_commas(tmp_path: Path) -> None:
    record = read(tmp_path, INSTRON)
    assert (record.traits.separator, record.traits.decimal, record.traits.missing) == ("semicolon", "comma", 4)
    np.testing.assert_allclose(record.channels["Load"], 1e3 * TABLE[:, 1])
    strain = record.channels["Extensometer elongation"]
    np.testing.assert_allclose(strain[:8], TABLE[:8, 2])
    assert np.isnan(strain[8:]).all() and record.units["Extensometer elongation"] == "1"


def test_mark_of_channels_that_are_not_connected(tmp_path: Path) -> None:
    record = read(tmp_path, SCHENCK)
    assert "Drehwinkel [V]" not in record.channels
    assert record.traits.encoding == "latin-1" and record.units["Pyrometer [\u00b0C]"] == "K"
    np.testing.assert_allclose(record.channels["Pyrometer [\u00b0C]"][:2], [293.15, 293.25])
    assert any(remark.startswith("12 cells hold -1000000") for remark in record.traits.remarks)


def test_names_behind_a_mark_of_comments(tmp_path: Path) -> None:
    record = read(tmp_path, COMMENTED)
    assert list(record.channels) == ["time", "displacement"]
    assert list(record.units.values()) == ["", ""], "no unit is made up"


def test_units_behind_underscores_where_the_name_agrees(tmp_path: Path) -> None:
    record = read(tmp_path, b"time_s,force_kN,sensor_N,e_true,strain_1\n" + b"".join(b"%d,1,2,3,4\n" % k for k in range(9)))
    assert list(record.units.values()) == ["s", "N", "", "", ""]
    assert record.channels["force_kN"][0] == 1000.0
    assert [column.meaning for column in record.traits.columns] == ["time", "force", "", "true_strain", "strain"]


def test_states_of_a_sandia_file(tmp_path: Path) -> None:
    record = read(tmp_path, SANDIA)
    assert record.traits.format == sandia_text.NAME
    assert record.about["temperature"] == pytest.approx(297.04, abs=0.01)
    assert record.about["rate"] == 1e-4 and record.traits.header["direction"] == "R11"
    assert "degR" in record.traits.remarks[0]
    np.testing.assert_array_equal(record.channels["load"], TABLE[:, 1])
    assert record.units["load"] == ""


def test_testxpert_with_commas_and_latin_1(tmp_path: Path) -> None:
    record = read(tmp_path, TESTXPERT)
    assert record.traits.format == testxpert_text.NAME and record.traits.encoding == "latin-1"
    assert record.about == pytest.approx({"thickness": 1.5, "width": 4.89, "area": 7.335, "gauge_length": 30.0})
    meanings = {column.name: column.meaning for column in record.traits.columns}
    assert meanings == {"Time": "time", "Standard force": "force", "Strain": "extension", "Capteur de course": "displacement"}
    assert record.units["Strain"] == "mm", "a strain in mm is an elongation"


def test_testxpert_with_tabs_in_german(tmp_path: Path) -> None:
    record = read(tmp_path, TESTXPERT_TABS)
    assert record.traits.format == testxpert_text.NAME and record.traits.separator == "tab"
    assert record.about == pytest.approx({"thickness": 0.19, "width": 11.8})
    np.testing.assert_allclose(record.channels["Dehnung"], 0.01 * TABLE[:, 2])


def test_short_rows_and_rows_without_numbers_are_counted(tmp_path: Path) -> None:
    record = read(tmp_path, PLAIN + b",,,\n6.0,18\n")
    assert len(record.channels["ext[mm]"]) == 13
    assert "1 rows without any number dropped" in record.traits.remarks
    assert any(remark.startswith("1 rows are shorter than the names") for remark in record.traits.remarks)
    assert record.traits.missing == 2


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"time;load\n" + b"", "no row of column names"),
        (PLAIN + b"1,2,3,4,5\n", "line 14: found 5 cells, expected 4"),
        (INSTRON + b"9.5;1;2;3\n", "decimal points .* decimal commas"),
        (b"1,2\n3,4\n5,6\n", "no row of column names"),
        (b"\x00\x01\x02", "no text"),
    ],
)
def test_wrong_tables_are_one_sentence(tmp_path: Path, data: bytes, words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        coupon_text.read(written(tmp_path, data))
    assert "record.dat" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"{'temperature': 'hot'}", "state temperature is 'hot'"),
        (b"{'temperature': -3}", "state temperature is '-3'"),
        (b"{'temperature': 1e999}", "state temperature is 'inf'"),
        (b"['temperature']", "no dictionary of states"),
        (b"{'a': __import__('os')}", "no dictionary of states"),
    ],
)
def test_wrong_states_are_one_sentence(tmp_path: Path, line: bytes, words: str) -> None:
    with pytest.raises(DataError, match=words):
        sandia_text.read(written(tmp_path, line + b"\ntime,load\n0,1\n1,2\n"))


@pytest.mark.parametrize(
    "data",
    [
        b"x [mm],y [mm],u [mm],sigma\n0,0,0,1\n1,1,1,1\n2,2,2,2\n",
        b"SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,SIGMA,VSG_STRAIN_XX\n0,1,2,3,4,5\n1,1,2,3,4,5\n",
        b"name,value\na,1\nb,2\n",
        b"hello world\nthis is text\n",
    ],
)
def test_other_tables_are_no_coupon_records(tmp_path: Path, data: bytes) -> None:
    path = written(tmp_path, data)
    try:
        found = format_of(path)
    except DataError:
        return
    assert found not in (coupon_text, sandia_text, testxpert_text)
