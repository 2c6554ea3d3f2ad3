"""Coupon records as XLSX workbooks: machine, HBM catman, testXpert."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from record_layouts import CATMAN, CATMAN_TWO_RATES, MACHINE, MACHINE_ROWS, TESTXPERT_BOOK, TESTXPERT_BOOKS, catman_rows, rows, workbook

from thermofit.core.errors import DataError
from thermofit.read.formats import catman_workbook, machine_workbook, testxpert_workbook
from thermofit.read.formats.contents import ChannelRecord, Content, Records
from thermofit.read.formats.registry import read_native

TABLE = np.array(rows())


def read(folder: Path, data: bytes) -> Content:
    path = folder / "book.xlsx"
    path.write_bytes(data)
    return read_native(path)


def test_padded_machine_workbook(tmp_path: Path) -> None:
    record = read(tmp_path, MACHINE)
    assert isinstance(record, ChannelRecord) and record.traits.format == machine_workbook.NAME
    assert record.about == pytest.approx({"gauge_length": 8.0, "diameter": 5.98, "area": 28.086})
    assert list(record.channels) == ["S/No", "System Date", "C_1_Temps[s]", "C_1_Force[kN]", "C_1_Angle[mm]", "e_true"]
    np.testing.assert_allclose(record.channels["C_1_Force[kN]"], 1e3 * TABLE[:, 1])
    assert f"{60 - len(MACHINE_ROWS)} empty rows at the end dropped" in record.traits.remarks
    assert "column 'System Date' holds date and time, read as seconds since 1970" in record.traits.remarks


def test_several_sheets_are_several_tests(tmp_path: Path) -> None:
    records = read(tmp_path, workbook({"one": MACHINE_ROWS, "note": [["text"]], "two": MACHINE_ROWS}))
    assert isinstance(records, Records) and list(records.tests) == ["one", "two"]


def test_catman_names_and_units(tmp_path: Path) -> None:
    record = read(tmp_path, CATMAN)
    assert isinstance(record, ChannelRecord) and record.traits.format == catman_workbook.NAME
    assert list(record.channels) == ["Time 1 - default sample rate", "Extenso", "Temperature"]
    assert list(record.units.values()) == ["s", "mm", "K"]
    assert len(record.channels["Extenso"]) == len(TABLE)
    np.testing.assert_allclose(record.channels["Temperature"][:2], [296.15, 296.25])


def test_catman_channels_follow_the_clock_of_their_rate(tmp_path: Path) -> None:
    records = read(tmp_path, CATMAN_TWO_RATES)
    assert isinstance(records, Records)
    fast, slow = records.tests["Time 1 - default sample rate"], records.tests["Time 1 - slow sample rate"]
    assert list(fast.channels)[1:] == ["Extenso", "Temperature"] and list(slow.channels)[1:] == ["Load"]
    assert len(fast.channels["Extenso"]) == 12 and len(slow.channels["Load"]) == 6
    np.testing.assert_allclose(slow.channels["Load"], 1e3 * TABLE[:6, 1])


def test_catman_channel_without_clock_is_refused(tmp_path: Path) -> None:
    table = catman_rows(True)
    table[-1][1] = None  # one value less: neither as long as the fast nor as the slow clock
    with pytest.raises(DataError, match="channel 'Extenso' has 11 values, and no time column has its rate and length"):
        read(tmp_path, workbook({"Sheet1": table}))


def test_testxpert_workbook(tmp_path: Path) -> None:
    record = read(tmp_path, TESTXPERT_BOOK)
    assert isinstance(record, ChannelRecord) and record.traits.format == testxpert_workbook.NAME
    assert record.about == pytest.approx({"thickness": 1.3, "width": 6.0})
    meanings = [column.meaning for column in record.traits.columns]
    assert meanings == ["time", "force", "extension", "displacement"]


def test_testxpert_workbook_with_several_specimens(tmp_path: Path) -> None:
    records = read(tmp_path, TESTXPERT_BOOKS)
    assert isinstance(records, Records)
    assert [test.about["thickness"] for test in records.tests.values()] == pytest.approx([1.3, 2.3])


def test_damaged_workbook_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"book.xlsx: the workbook cannot be opened"):
        read(tmp_path, MACHINE[: len(MACHINE) // 2])
    with pytest.raises(DataError, match="no known format"):
        read(tmp_path, workbook({"Sheet1": [["text"], [1.0, 2.0]]}))
