"""Text of native files: encodings, separators, decimal signs, missing cells, ragged rows, header cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Head
from thermofit.read.formats.text import (
    BLANKS,
    Layout,
    decode,
    detect_layout,
    head_lines,
    name_and_unit,
    parse_number,
    read_block,
    read_text,
    split_cells,
)

PATH = Path("file.csv")


@pytest.mark.parametrize(
    ("codec", "encoding"),
    [
        ("utf-8", "utf-8"),
        ("utf-8-sig", "utf-8 with byte order mark"),
        ("utf-16", "utf-16"),
        ("utf-16-le", "utf-16"),
        ("utf-16-be", "utf-16"),
        ("latin-1", "latin-1"),
    ],
)
def test_encoding_is_found(codec: str, encoding: str) -> None:
    assert decode("temp\u00e9rature \u00b0C;1,5\n".encode(codec)) == ("temp\u00e9rature \u00b0C;1,5\n", encoding)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "binary.csv"
    path.write_bytes(b"abc\x00\x01;1;2\n")
    with pytest.raises(DataError, match=r"binary.csv: found zero bytes, so it is no text, expected a table"):
        read_text(path, "a table")
    path.write_bytes(b"\n\n")
    with pytest.raises(DataError, match="the file is empty"):
        read_text(path, "a table")
    with pytest.raises(DataError, match="no such file"):
        read_text(tmp_path / "absent", "a table")


def test_head_may_end_inside_a_character() -> None:
    data = "a;\u00e4".encode()
    assert head_lines(Head(PATH, 100, data[:-1])) == ["a;"]
    assert head_lines(Head(PATH, 3, data[:-1])) == ["a;\u00c3"]
    assert head_lines(Head(PATH, 2, b"\x00\x01")) == []


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends(tmp_path: Path, end: str) -> None:
    path = tmp_path / "a"
    path.write_bytes(end.join(["a", "", "b", "", ""]).encode())
    assert read_text(path, "x").lines == ["a", "", "b"]


@pytest.mark.parametrize(
    ("lines", "separator", "decimal"),
    [
        (["1.5,2", "3,4"], ",", "."),
        (["1.5;2", "3;4"], ";", "."),
        (["1,5;2", "3;4"], ";", ","),
        (["0;0", *["1;2"] * 300, "1;2,5"], ";", ","),
        (["1,5\t2", "3\t4"], "\t", ","),
        (["0,13  -0,01", "0,25  0,02"], BLANKS, ","),
        ([" 1.5   2 ", "3 4"], BLANKS, "."),
        (["1, 2, 3", "4, 5, 6"], ",", "."),
        (["27,6,27,8"], ",", "."),
        (["Non un numero reale;0,1;", "Non un numero reale;Non un numero reale;"], ";", ","),
        (["1;10.02.2023;2,5"], ";", ","),
        (["1.5"], BLANKS, "."),
        (['"1,5","2"', '"3","4"'], ",", ","),
    ],
)
def test_layout_is_found(lines: list[str], separator: str, decimal: str) -> None:
    assert detect_layout(lines, PATH) == Layout(separator, decimal)


def test_two_decimal_signs_are_refused() -> None:
    with pytest.raises(DataError, match=r"file.csv: found numbers with decimal points \(.*1.5\) and with decimal commas \(.*2,5\)"):
        detect_layout(["1.5;2", "3;2,5"], PATH)


def test_missing_cells_are_counted_and_rows_padded() -> None:
    lines = ["1,5;Non un numero reale;3;", "", "4;;6,25E+002;", "7;8"]
    table = read_block(lines, PATH, 5, Layout(";", ","))
    np.testing.assert_array_equal(table.values, [[1.5, np.nan, 3.0], [4.0, np.nan, 625.0], [7.0, 8.0, np.nan]])
    assert table.lines.tolist() == [5, 7, 8]
    assert (table.missing, table.ragged, table.empty) == (3, 1, ())


def test_column_of_texts_is_empty_not_missing() -> None:
    table = read_block(["1;a;x", "2;b;5"], PATH, 1, Layout(";", "."))
    assert (table.missing, table.empty) == (1, (1,))


def test_row_longer_than_header_is_refused() -> None:
    assert read_block(["1;2;;", "3;4"], PATH, 3, Layout(";", "."), 2).values.shape == (2, 2)
    with pytest.raises(DataError, match=r"file.csv, line 4: found 3 cells, expected 2 as in the header"):
        read_block(["1;2", "1;2;3"], PATH, 3, Layout(";", "."), 2)


@pytest.mark.parametrize("lines", [[], [""], ["a;b"], ["nan;inf", "1e999;-"]])
def test_block_without_a_number_is_refused(lines: list[str]) -> None:
    with pytest.raises(DataError, match=r"file.csv"):
        read_block(lines, PATH, 1, Layout(";", "."))


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("7.425000000E+000", 7.425),
        ("-1D-3", -1e-3),
        (".5", 0.5),
        ('"2."', 2.0),
        ("1_0", np.nan),
        ("nan", np.nan),
        ("0x1", np.nan),
        ("1,5", np.nan),
    ],
)
def test_numbers(cell: str, value: float) -> None:
    np.testing.assert_equal(parse_number(cell), value)


def test_cells_in_quotes() -> None:
    assert split_cells(' "X",  "Y, mm",  "U"', ",") == ["X", "Y, mm", "U"]
    assert split_cells('"a;b', ";") in (["a", "b"], ["a;b"])
    assert split_cells("a  b\tc", BLANKS) == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("coor.Image X [mm]", ("coor.Image X", "mm")),
        ("strain.Strain-global frame: Exx [ ]", ("strain.Strain-global frame: Exx", "1")),
        (" Force [N]", ("Force", "N")),
        ("Standardkraft (kN)", ("Standardkraft", "kN")),
        ('"id"', ("id", "")),
        ("[mm]", ("[mm]", "")),
    ],
)
def test_header_cells(cell: str, expected: tuple[str, str]) -> None:
    assert name_and_unit(cell) == expected


@pytest.mark.parametrize(("cell", "separator"), [("1.234,5", ";"), ("1'234.5", ";"), ("12 345,5", "\t"), ("1,234.5", ";")])
def test_thousands_are_no_missing_cells(cell: str, separator: str) -> None:
    with pytest.raises(DataError, match=r"file.csv, line 4: found .*, expected numbers without separators of thousands"):
        read_block([f"2{separator}1", f"2{separator}{cell}"], PATH, 3, Layout(separator, ","))


def test_clean_tables_are_read_as_those_cell_by_cell() -> None:
    lines = ["1;-2.5e3;.5", " 4 ;5.;6"]
    fast, slow = (read_block(lines, PATH, 1, Layout(";", "."), width) for width in (3, None))
    np.testing.assert_array_equal(fast.values, slow.values)
    assert fast.lines.tolist() == slow.lines.tolist() == [1, 2]
    assert read_block(["1;2", "3;inf"], PATH, 1, Layout(";", "."), 2).missing == 1
