"""MatchID exports: tables of both versions, matrices with words for missing values, load files; and the general table of points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from layouts import LOAD, MATCHID, MATCHID_3D, MATRIX, TABLE

from thermofit.core.errors import DataError
from thermofit.read.formats import dic_table, matchid_load, matchid_matrix, matchid_table
from thermofit.read.formats.contents import ChannelRecord, Content, DicStage, ScalarField
from thermofit.read.formats.registry import head_of, read_native


def read(path: Path, data: bytes) -> Content:
    path.write_bytes(data)
    return read_native(path)


def test_table_with_three_digit_exponents(tmp_path: Path) -> None:
    stage = read(tmp_path / "Img_Simu_0001.bmp 12.csv", MATCHID)
    assert isinstance(stage, DicStage) and stage.reference is not None and stage.displacement is not None
    assert stage.traits.format == matchid_table.NAME
    np.testing.assert_allclose(stage.reference[0, :2], [7.425, 10.775])
    np.testing.assert_allclose(stage.displacement[1, :2], [-6.879484919e-4, -0.1699327147])
    np.testing.assert_allclose(stage.strain["eyy"][0], 7.441691839e-3)
    assert np.isnan(stage.displacement[:, 2]).all()
    assert (stage.stage, stage.length_unit, stage.traits.missing, len(stage.point_id)) == (12, "mm", 1, 3)
    assert "1 points not correlated (rows of zeros)" in stage.traits.remarks
    assert next(c for c in stage.traits.columns if c.meaning == "exx").unit == "1"


def test_reference_stage_keeps_its_zeros(tmp_path: Path) -> None:
    header = MATCHID.split(b"\r\n")[0]
    stage = read(tmp_path / "a_0.csv", header + b"\r\n1;2;0;0;0;0;0\r\n2;2;0;0;0;0;0\r\n3;2;0;0;0;0;0\r\n")
    assert isinstance(stage, DicStage)
    assert (len(stage.point_id), stage.traits.missing) == (3, 0)


def test_most_points_may_be_lost_and_one_may_lie_at_the_origin(tmp_path: Path) -> None:
    header = MATCHID.split(b"\r\n")[0]
    stage = read(tmp_path / "a_1.csv", header + b"\r\n0;0;1E-003;0;0;0;0\r\n2;2;0;0;0;0;0\r\n3;2;0;0;0;0;0\r\n4;2;0;0;0;0;0\r\n")
    assert isinstance(stage, DicStage)
    assert (len(stage.point_id), stage.traits.missing) == (1, 3)
    stage = read(tmp_path / "a_1.csv", header + b"\r\n0;0;1E-003;0;0;0;0\r\n2;2;1;0;0;0;0\r\n0;0;1;0;0;0;0\r\n4;2;1;0;0;0;0\r\n")
    assert isinstance(stage, DicStage)
    assert (len(stage.point_id), stage.traits.missing) == (2, 2)


def test_table_in_three_dimensions_holds_current_coordinates(tmp_path: Path) -> None:
    stage = read(tmp_path / "TimeStep_7.csv", MATCHID_3D)
    assert isinstance(stage, DicStage) and stage.reference is not None
    np.testing.assert_allclose(stage.reference, [[1.0, 2.25, 0.375], [2.0, 2.25, 0.375]])
    assert (stage.stage, stage.traits.missing) == (7, 1)
    assert "world coordinates are current ones: reference = coordinates - displacements" in stage.traits.remarks


def test_table_without_units_does_not_guess_them(tmp_path: Path) -> None:
    stage = read(tmp_path / "a_1.csv", b"x_pic,y_pic,x,y,u,v,exx\n1,2,0.1,0.2,0.01,0.02,0.001\n3,4,0.3,0.4,0.01,0.02,0.001\n")
    assert isinstance(stage, DicStage)
    assert stage.traits.format == matchid_table.NAME
    assert stage.length_unit == ""


def test_pixels_beside_millimetres_are_refused(tmp_path: Path) -> None:
    data = MATCHID.replace(b"coor.Image X [mm];coor.Image Y [mm]", b"Coordinates.Image X [Pixel];Coordinates.Image Y [Pixel]")
    with pytest.raises(DataError, match=r"in px and .* in mm, expected coordinates and displacements in one unit"):
        read(tmp_path / "a.csv", data)


def test_matrix_with_words_for_missing_values(tmp_path: Path) -> None:
    field = read(tmp_path / "patD107_0.tif_U[mm].csv", MATRIX)
    assert isinstance(field, ScalarField)
    np.testing.assert_array_equal(field.values, [[0.001, np.nan, -0.003], [0.004, 0.005, 0.006], [0.007, np.nan, np.nan]])
    traits = field.traits
    assert (traits.format, traits.missing, traits.decimal, traits.separator) == (matchid_matrix.NAME, 3, ",", ";")
    assert (field.quantity, field.unit, traits.header) == ("U", "mm", {"stage": "107"})
    assert traits.remarks == ("1 rows shorter than the others, padded",)


def test_matrix_needs_quantity_and_unit_in_its_name(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no known format recognised"):
        read(tmp_path / "matrix.csv", MATRIX)
    with pytest.raises(DataError, match=r"the unit \[furlong\] in the file's name is not known"):
        read(tmp_path / "a_0.tif_U[furlong].csv", MATRIX)


def test_load_file_has_names_with_blanks(tmp_path: Path) -> None:
    record = read(tmp_path / "Image.csv", LOAD)
    assert isinstance(record, ChannelRecord)
    assert record.traits.format == matchid_load.NAME
    np.testing.assert_array_equal(record.channels["Force [N]"], [1000.0, 2000.5, 3001.0])
    np.testing.assert_array_equal(record.channels["TimeStamp"], [10.5, 11.5, 12.5])


def test_load_file_in_kilonewtons_and_without_unit(tmp_path: Path) -> None:
    record = read(tmp_path / "a.csv", b"index;Force [kN]\n1;0,5\n2;1,5\n")
    assert isinstance(record, ChannelRecord)
    np.testing.assert_array_equal(record.channels["Force"], [500.0, 1500.0])
    assert record.units["Force"] == "N"
    record = read(tmp_path / "b.csv", b"index;Load\n1;0,5\n2;1,5\n")
    assert isinstance(record, ChannelRecord)
    assert (record.units["Load"], record.traits.remarks) == ("", ("'Load' has no unit in the file",))


def test_load_file_is_no_record_of_a_testing_machine(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"index;Force [kN];Extension [in]\n1;0,5;0,1\n")
    assert not matchid_load.recognises(head_of(path))
    record = read(path, b"File;TimeStamp; Force [kN];Stroke [in]\na;1;0,5;2\n")
    assert isinstance(record, ChannelRecord)
    assert record.traits.format == matchid_load.NAME
    np.testing.assert_allclose([record.channels["Force"][0], record.channels["Stroke"][0]], [500.0, 50.8])
    assert record.units == {"TimeStamp": "s", "Force": "N", "Stroke": "mm"}


def test_load_file_in_volts_only_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no force in N, kN or lbf among the columns"):
        read(tmp_path / "a.csv", b"File;TimeStamp; Force [V]\na;1;0.1\n")


def test_general_table_says_what_it_assumes(tmp_path: Path) -> None:
    stage = read(tmp_path / "field.csv", TABLE)
    assert isinstance(stage, DicStage) and stage.reference is not None and stage.displacement is not None
    assert stage.traits.format == dic_table.NAME
    np.testing.assert_allclose(stage.reference[1, :2], [-0.1821, 1.2009])
    np.testing.assert_allclose(stage.displacement[0, :2], [0.0370, -0.0073])
    assert (stage.traits.missing, stage.length_unit, stage.time) == (1, "mm", None)
    assert "taken as reference" in stage.traits.remarks[0]


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"X Position (mm);Y Position (mm);Disp X (um);Disp Y (um)", None),
        (b"X Position (mm);Y Position (mm);Disp X (px);Disp Y (px)", "expected coordinates and displacements in one unit"),
        (b"X Position (mm);Y Position (mm);Disp X (kg);Disp Y (kg)", "the unit 'kg' is not known"),
        (b"X coord;X Position;Y coord;Disp X;Disp Y", "'X coord' and 'X Position' both hold x"),
    ],
)
def test_general_table_by_names(tmp_path: Path, header: bytes, message: str | None) -> None:
    data = header + b"\n" + b";".join([b"1,5"] * header.count(b";")) + b";2,5\n"
    if message is not None:
        with pytest.raises(DataError, match=message):
            read(tmp_path / "a.csv", data)
        return
    stage = read(tmp_path / "a.csv", data)
    assert isinstance(stage, DicStage) and stage.displacement is not None
    np.testing.assert_allclose(stage.displacement[0, :2], [0.0015, 0.0025])
