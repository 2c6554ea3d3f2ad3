"""ARAMIS, ZEISS and GOM exports: deformed and reference coordinates, units, stage and time, and what is wrong in a file."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np
import pytest
from layouts import (
    ARAMIS,
    ARAMIS_COMMAS,
    CONNECTIONS,
    GOM,
    LEGACY,
    LEGACY_COORDINATES,
    LEGACY_DISPLACEMENTS,
    NODEMAP,
    SECTION,
)

from thermofit.core.errors import DataError
from thermofit.read.formats import aramis_csv, aramis_legacy, aramis_section, dlr_nodemap, gom_points
from thermofit.read.formats.contents import ChannelRecord, DicStage
from thermofit.read.formats.registry import format_of, read_native
from thermofit.stages.inspect import inspect


def stage_of(path: Path, data: bytes) -> DicStage:
    path.write_bytes(data)
    content = read_native(path)
    assert isinstance(content, DicStage)
    return content


def test_aramis_coordinates_are_deformed(tmp_path: Path) -> None:
    stage = stage_of(tmp_path / "component 1_21.555 s.csv", ARAMIS)
    assert stage.traits.format == aramis_csv.NAME
    assert stage.point_id.tolist() == [0, 1, 7]
    assert stage.reference is not None and stage.displacement is not None and stage.deformed is not None
    np.testing.assert_allclose(stage.reference[0], [12.3454, -9.4776, -0.2035], atol=1e-12)
    np.testing.assert_allclose(stage.displacement[1], [0.0005, -0.0006, 0.0004])
    np.testing.assert_allclose(stage.deformed[2], [13.3458, -9.4783, -0.2031])
    np.testing.assert_allclose(stage.strain["exx"], [0.0014, 0.0015, 0.0016])
    assert (stage.time, stage.stage, stage.length_unit) == (21.5551, 2, "mm")
    traits = stage.traits
    assert (traits.encoding, traits.separator, traits.decimal, traits.missing) == ("utf-8", ";", ".", 0)
    assert traits.header["Name"] == "Fl\u00e4chenkomponente 1"
    assert [(c.meaning, c.source) for c in traits.columns if c.name in ("x", "epsilon_x")] == [("x", "file"), ("exx", "format")]


def test_aramis_with_decimal_commas_and_other_units(tmp_path: Path) -> None:
    data = ARAMIS.decode().replace(".", ",").replace("length:mm", "length:m").replace("time:s", "time:ms").encode("utf-16")
    stage = stage_of(tmp_path / "a.csv", data)
    assert stage.reference is not None
    np.testing.assert_allclose(stage.reference[0], [12345.4, -9477.6, -203.5])
    assert stage.time == pytest.approx(0.0215551)
    assert (stage.traits.encoding, stage.traits.decimal) == ("utf-16", ",")


def test_aramis_with_coordinates_twice(tmp_path: Path) -> None:
    stage = stage_of(tmp_path / "a.csv", ARAMIS_COMMAS)
    assert stage.reference is not None
    np.testing.assert_allclose(stage.reference[:2], [[1.0, 1.0, 0.0], [2.0, 1.0, 0.0]], atol=1e-12)
    assert stage.traits.missing == 1
    assert "coordinates are there twice, shifted by 10, 20, 0; the first are used" in stage.traits.remarks
    with pytest.raises(DataError, match="two blocks of coordinates are not the same points"):
        stage_of(tmp_path / "b.csv", ARAMIS_COMMAS.replace(b"12.5000", b"12.6000"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"\n7;", b"\n1;", r"line 9: id 1 occurs a second time in this stage; remove one of the rows"),
        (b"\n7;", b"\n7.5;", r"line 9: id is 7.5, expected a whole number"),
        (b"length:mm", b"length:furlong", r"line 6: column 'x': the unit 'furlong' is not known, expected one of mm"),
        (b"length:mm", b"length:kN", r"column 'x' is in kN, expected the unit of a length"),
        (b"21.5551", b"soon", r"line 4: relative_time is no number, expected seconds"),
        (b"time:s", b"time:mm", r"the time of the stage is in mm, expected the unit of a time"),
        (b"-0.0018\r\n", b"-0.0018;9;9\r\n", r"line 9: found 13 cells, expected 11 as in the header"),
    ],
)
def test_aramis_defects(tmp_path: Path, old: bytes, new: bytes, message: str) -> None:
    assert old in ARAMIS
    with pytest.raises(DataError, match=message):
        stage_of(tmp_path / "a.csv", ARAMIS.replace(old, new))


def test_two_exports_in_one_file_and_truncated_ones(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"line 15: the header occurs a second time, expected one stage in a file"):
        stage_of(tmp_path / "a.csv", ARAMIS + ARAMIS)
    header = ARAMIS[: ARAMIS.index(b"0;12.3458")]
    with pytest.raises(DataError, match=r"the file ends before line 7, expected rows of numbers"):
        stage_of(tmp_path / "b.csv", header)
    short = stage_of(tmp_path / "c.csv", ARAMIS[: ARAMIS.rindex(b"0.0006;")])
    assert short.traits.missing == 1
    assert {"1 rows shorter than the header, padded", "1 points without displacement"} <= set(short.traits.remarks) or (
        "1 rows without coordinates left out" in short.traits.remarks
    )


@pytest.mark.parametrize("index", [b"1e300", b"2.5", b"x", b""])
def test_stage_number_that_is_none_is_left_to_the_name(tmp_path: Path, index: bytes) -> None:
    assert stage_of(tmp_path / "a_17.csv", ARAMIS.replace(b'2";2;', b'2";' + index + b";")).stage == 17


def test_gom_points_have_coordinates_only(tmp_path: Path) -> None:
    stage = stage_of(tmp_path / "shell_0151.csv", GOM)
    assert stage.traits.format == gom_points.NAME
    assert stage.displacement is None and stage.reference is None and stage.deformed is not None
    np.testing.assert_allclose(stage.deformed[2], [1.0, 2.0, 3.0])
    assert (stage.stage, stage.time, stage.length_unit) == (151, None, "mm")


def test_nodemap_coordinates_are_the_reference(tmp_path: Path) -> None:
    stage = stage_of(tmp_path / "dic_results_1_52.txt", NODEMAP)
    assert stage.traits.format == dlr_nodemap.NAME
    assert stage.reference is not None and stage.displacement is not None
    np.testing.assert_allclose(stage.reference[0], [-1.5, 2.0, 0.1])
    np.testing.assert_allclose(stage.displacement[2], [0.03, 0.02, 0.001])
    np.testing.assert_allclose(stage.strain["exx"], [0.001, np.nan, 0.001])
    np.testing.assert_allclose(stage.strain["exy"], [0.003, np.nan, 0.003])
    assert (stage.time, stage.stage, stage.traits.encoding, stage.traits.missing) == (12.5, 52, "latin-1", 1)
    assert stage.signals == {"force": (14985.6119156, ""), "Kraft": (15102.5390625, "")}
    assert stage.traits.header["process area"] == "20 mm\u00b2"


def test_connections_beside_a_nodemap_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="this is the list of triangles beside a nodemap"):
        stage_of(tmp_path / "a_connections.txt", CONNECTIONS)


def test_legacy_points_span_lines(tmp_path: Path) -> None:
    stage = stage_of(tmp_path / "a.txt", LEGACY)
    assert stage.traits.format == aramis_legacy.NAME
    assert stage.point_id.tolist() == [4000003, 4000004]
    assert stage.reference is not None and stage.displacement is not None and stage.deformed is not None
    np.testing.assert_allclose(stage.reference, [[1.0, 2.0, 0.5], [2.0, 2.0, 0.5]])
    np.testing.assert_allclose(stage.deformed[0], [1.1, 2.2, 0.5])
    np.testing.assert_allclose(stage.displacement[0], [0.1, 0.2, 0.0])
    assert {name: value[0] for name, value in stage.strain.items()} == {
        **{"exx": pytest.approx(0.015), "eyy": pytest.approx(0.025), "e1": pytest.approx(0.03)},
        **{"e2": pytest.approx(-0.01), "e3": pytest.approx(-0.02)},
    }
    assert stage.signals == {"AD-0": (5.25, "V")}
    assert (stage.stage, stage.time) == (12, pytest.approx(12.25))
    assert any("lengths are taken as mm and strains as %" in remark for remark in stage.traits.remarks)


def test_legacy_coordinates_and_displacements_in_files_of_their_own(tmp_path: Path) -> None:
    base, moved = stage_of(tmp_path / "a-Stage-0-0.txt", LEGACY_COORDINATES), stage_of(tmp_path / "b-Stage-0-7.txt", LEGACY_DISPLACEMENTS)
    assert base.displacement is None and base.reference is not None
    assert moved.reference is None and moved.displacement is not None
    np.testing.assert_allclose(moved.displacement[1], [0.1, 0.3, 0.0])
    assert (moved.stage, moved.traits.decimal) == (7, ",")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"2.1 2.2 0.5\n", b"2.1 2.2\n", r"line 20: found 2 numbers, expected 3 as in the first point"),
        (b"3.0 -1.0 -2.0\n   4", b"3.0 -1.0\n   4", r"line 12: the first lines hold .* numbers, expected 16 for a point"),
        (b"   4    4", b"   4.5    4", r"line 18: the indices of the point are no whole numbers"),
        (b"   4    4", b"   3    4", r"occurs a second time in this stage"),
    ],
)
def test_legacy_defects(tmp_path: Path, old: bytes, new: bytes, message: str) -> None:
    assert old in LEGACY
    with pytest.raises(DataError, match=message):
        stage_of(tmp_path / "a.txt", LEGACY.replace(old, new))
    with pytest.raises(DataError, match="the file ends inside a point of 6 lines"):
        stage_of(tmp_path / "b.txt", LEGACY[: LEGACY.rindex(b"1.5 2.5")])


def test_section_is_a_curve_in_millimetres(tmp_path: Path) -> None:
    path = tmp_path / "x1_section12_0-11.txt"
    path.write_bytes(SECTION)
    record = read_native(path)
    assert isinstance(record, ChannelRecord)
    assert format_of(path) is aramis_section
    np.testing.assert_allclose(record.channels["Sectionlength"], [0.0, 0.133532, 0.267])
    np.testing.assert_allclose(record.channels["deltaL"], [-0.0015, -0.001535, 0.0016])
    assert record.units == {"Sectionlength": "mm", "deltaL": "mm"}
    assert (record.traits.header, record.traits.decimal, record.traits.missing) == ({"stage": "11"}, ",", 0)


_LEGACY = "# Stage : 0 - 1\n# Index_x, Index_y, Coordinate-undef (x,y,z), Displ{} (x,y,z)\n"
_ROWS = "1 1 0 0 0 0.1 0.2 0.3\n2 1 1 0 0 0.1 0.2 0.3\n"
_LONG = 200_000 * " "


@pytest.mark.parametrize(
    "text",
    [
        _LEGACY.format(_LONG) + _ROWS,
        _LEGACY.format(_LONG + "!") + _ROWS,
        "# Stage : 0 - 1\n# Index_x, Index_y, Coordinate" + _LONG + "undef" + _LONG + "? (x,y,z)\n" + _ROWS,
        "# Stage : 0 - 1\n# Index_x, Index_y, Coord" + 100_000 * "a " + "!\n" + _ROWS,
        _LEGACY.format("") + _ROWS + "3" + _LONG + "1 2 0 0 0.1 0.2 0.3\n",
        _LEGACY.format("") + _ROWS.replace("\n", _LONG + "\n"),
    ],
)
def test_endless_blanks_end_at_once(tmp_path: Path, text: str) -> None:
    """200,000 blanks between two words of a comment line or two numbers of a row: read, or one sentence, in no time."""
    path = tmp_path / "prefix-Stage-0-1.txt"
    path.write_text(text, encoding="utf-8")
    begin = process_time()
    try:
        inspect(path)
    except DataError as error:
        assert len(str(error)) < 600 and "\n" not in str(error)
    assert process_time() - begin < 5.0
