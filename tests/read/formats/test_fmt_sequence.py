"""Many stage files as one field: joined, sorted, checked; times are never guessed, repairs are counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import mutations
from hypothesis import given, settings
from hypothesis import strategies as st
from layouts import GOM, LEGACY_COORDINATES, LEGACY_DISPLACEMENTS, LOAD, MATCHID_3D, MATRIX, SECTION, TABLE

from thermofit.core.errors import DataError
from thermofit.core.experiment import DicField
from thermofit.read.formats.clock import Rules
from thermofit.read.formats.naming import number_order, stage_time
from thermofit.read.formats.sequence import after_fracture, read_dic_files

PLACE = {3: (0.0, 0.0), 4: (1.0, 0.0), 8: (0.0, 1.0), 9: (1.0, 1.0)}
NOISE = np.random.default_rng(1).normal(scale=1e-3, size=(40, 4, 2))


def aramis(number: int, time: float, shift: float, ids: tuple[int, ...] = (3, 4, 8, 9)) -> str:
    """A stage in which every point moves by `shift` along y and by noise; coordinates are the deformed ones."""
    rows = []
    for k, name in enumerate(ids):
        u, v = (0.0, 0.0) if shift == 0.0 else (round(NOISE[number, k, 0], 4), round(shift + NOISE[number, k, 1], 4))
        x, y = PLACE[name]
        rows.append(f"{name};{x + u:.4f};{y + v:.4f};0.5000;{u:.4f};{v:.4f};0.0000")
    stage = f"# Stage: S{number}\nstage;index;relative_time;date\nS{number};{number};{time};2023\n# Name : s\n"
    return (
        "# Units: length:mm angle:deg time:s\n" + stage + "id;x;y;z;displacement_x;displacement_y;displacement_z\n" + "\n".join(rows) + "\n"
    )


def write(folder: Path, texts: dict[str, str | bytes]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / "*"


def table(number: int) -> bytes:
    """A stage of the general table whose displacements differ from those of other numbers."""
    return TABLE.replace(b"0.0370", f"0.{number:02d}70".encode())


def series(folder: Path, n: int = 6) -> Path:
    return write(folder, {f"surface_{0.5 * k} s.csv": aramis(k, 0.5 * k, 0.1 * k) for k in range(n)})


def test_stages_are_joined_by_number_and_sorted_by_time(tmp_path: Path) -> None:
    texts = {f"a_{k}.csv": aramis(k, time, 0.1 * k) for k, time in ((0, 0.0), (2, 21.555), (10, 22.0), (9, 30.0))}
    texts["a_2.csv"] = aramis(2, 21.555, 0.2, (9, 4, 3))
    field, remarks = read_dic_files(write(tmp_path / "f", texts), Rules())
    assert field.time.tolist() == [0.0, 21.555, 22.0, 30.0]
    assert field.point_id.tolist() == [3, 4, 8, 9]
    np.testing.assert_allclose(field.reference[:, :2], list(PLACE.values()), atol=1e-9)
    assert np.isnan(field.displacement[1, 2]).all()
    np.testing.assert_allclose(field.displacement[2, :, 1], 1.0, atol=5e-3)
    assert field.displacement[1, 3, 1] == pytest.approx(0.2 + NOISE[2, 0, 1], abs=1e-4)
    assert "1 of 16 displacements missing, 1 of 4 points concerned" in remarks
    assert "2 stages sorted by time, their names or numbers give another order" in remarks


@pytest.mark.parametrize(
    ("name", "stage", "time"),
    [
        ("Fl\u00e4chenkomponente 1_21.555 s.csv", None, 21.555),
        ("surface_3,5 s.csv", None, 3.5),
        ("x1v1_section0_0-12.txt", 12, None),
        ("prefix-Stage-0-7.txt", 7, None),
        ("VHPS_140_140_3_0151.csv", 151, None),
        ("Img_Simu_0001.bmp 14.csv", 14, None),
        ("patD107_0.tif_U[mm].csv", 107, None),
        ("mesh_plane_4.csv_0.tiff_V[mm].csv", 4, None),
        ("TimeStep_23.csv", 23, None),
        ("DICe_solution_059.txt", 59, None),
        ("20231116_displacements_raw.csv", None, None),
        ("test_20231116.csv", None, None),
    ],
)
def test_file_names(name: str, stage: int | None, time: float | None) -> None:
    assert stage_time(Path("folder_9") / name) == (stage, time)


def test_names_are_sorted_by_numbers() -> None:
    names = ["rec_10.csv", "rec_9.csv", "rec_100.csv", "rec_9.5 s.csv"]
    assert [p.name for p in sorted(map(Path, names), key=number_order)] == ["rec_9.csv", "rec_9.5 s.csv", "rec_10.csv", "rec_100.csv"]


def test_times_are_required(tmp_path: Path) -> None:
    pattern = write(tmp_path / "f", {f"a_{k}.csv": table(k) for k in (1, 2, 10)})
    with pytest.raises(DataError, match=r"a_1.csv: 3 of 3 stages have no time, neither in the file nor in its name; give 'times'"):
        read_dic_files(pattern, Rules())
    field, remarks = read_dic_files(pattern, Rules(rate=2.0, time_offset_s=1.0))
    assert field.time.tolist() == [1.0, 1.5, 5.5]
    assert "7 numbers of stages are missing: gaps in time" in remarks
    assert read_dic_files(pattern, Rules(times=(0.0, 4.0, 5.0)))[0].time.tolist() == [0.0, 4.0, 5.0]
    with pytest.raises(DataError, match="'times' lists 2 times, expected 3"):
        read_dic_files(pattern, Rules(times=(0.0, 4.0)))
    with pytest.raises(DataError, match="'times' does not increase"):
        read_dic_files(pattern, Rules(times=(0.0, 4.0, 4.0)))


def test_times_of_the_names_are_used(tmp_path: Path) -> None:
    field, _ = read_dic_files(write(tmp_path / "f", {"a_9.5 s.csv": table(1), "a_10.25 s.csv": table(2)}), Rules())
    assert field.time.tolist() == [9.5, 10.25]


def test_equal_times_and_numbers_are_refused(tmp_path: Path) -> None:
    pattern = write(tmp_path / "f", {"a.csv": aramis(0, 0.0, 0.0), "b.csv": aramis(1, 0.0, 0.1)})
    with pytest.raises(DataError, match=r"b.csv: the time 0 s is also that of a.csv"):
        read_dic_files(pattern, Rules())
    pattern = write(tmp_path / "g", {"a_1.csv": TABLE, "b_1.csv": TABLE})
    with pytest.raises(DataError, match=r"b_1.csv: the number 1 is also that of a_1.csv"):
        read_dic_files(pattern, Rules(rate=1.0))


def test_mixed_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"b_1.csv: this is GOM point cloud .* but a_0.csv is ARAMIS / ZEISS CSV"):
        read_dic_files(write(tmp_path / "f", {"a_0.csv": aramis(0, 0.0, 0.0), "b_1.csv": GOM}), Rules())
    moved = aramis(1, 1.0, 0.1).replace("4;1.0", "4;1.2")
    with pytest.raises(DataError, match=r"b.csv: the reference position of point 4 is 0.2.* mm away from that in earlier stages"):
        read_dic_files(write(tmp_path / "g", {"a.csv": aramis(0, 0.0, 0.0), "b.csv": moved}), Rules())
    inches = aramis(1, 1.0, 0.1).replace("length:mm", "length:in")
    with pytest.raises(DataError, match=r"the reference position of point"):
        read_dic_files(write(tmp_path / "h", {"a.csv": aramis(0, 0.0, 0.0), "b.csv": inches}), Rules())


@pytest.mark.parametrize(("name", "data"), [("Image.csv", LOAD), ("a_0.tif_U[mm].csv", MATRIX), ("a_0-1.txt", SECTION)])
def test_wrong_kinds_are_refused(tmp_path: Path, name: str, data: bytes) -> None:
    write(tmp_path / "f", {name: data})
    with pytest.raises(DataError, match="expected points with coordinates and displacements"):
        read_dic_files(tmp_path / "f", Rules(rate=1.0))
    with pytest.raises(DataError, match="no file found, expected exports of a DIC system"):
        read_dic_files(tmp_path / "f" / "*.zip", Rules(rate=1.0))


def test_duplicate_points_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="id 3 occurs a second time in this stage"):
        read_dic_files(write(tmp_path / "f", {"a.csv": aramis(0, 0.0, 0.0, (3, 4, 3))}), Rules())
    twice = TABLE + b"-1.2132,18.6820,0.0370,-0.0073\n"
    with pytest.raises(DataError, match="1 pairs of points are at one position"):
        read_dic_files(write(tmp_path / "g", {"a.csv": twice}), Rules(times=(0.0,)))


def test_points_without_numbers_are_joined_by_position(tmp_path: Path) -> None:
    header = b"x-coordinate [mm],y-coordinate [mm],x-displacement [mm],y-displacement [mm]\n"
    first = header + b"0,0,0,0\n1,0,0,0\n0,1,0,0\n1,1,0,0\n"
    second = header + b"1.0001,1,0.1,0.4\n0,0,0.1,0.1\n2,2,0.1,0.5\n1,0,0.1,0.2\n"
    field, remarks = read_dic_files(write(tmp_path / "f", {"a_0.csv": first, "a_1.csv": second}), Rules(rate=1.0))
    np.testing.assert_array_equal(field.reference[:, :2], [[0, 0], [1, 0], [0, 1], [1, 1], [2, 2]])
    np.testing.assert_array_equal(field.displacement[1, :, 1], [0.1, 0.2, np.nan, 0.4, 0.5])
    np.testing.assert_array_equal(field.displacement[0, :, 1], [0, 0, 0, 0, np.nan])
    assert "points have no numbers: joined by reference position within 0.01 mm" in remarks
    other = header + b"5,5,0.1,0.4\n6,5,0.1,0.1\n0,0,0.1,0.5\n"
    with pytest.raises(DataError, match="2 of 3 reference positions are not those of earlier stages"):
        read_dic_files(write(tmp_path / "g", {"a_0.csv": first, "a_1.csv": other}), Rules(rate=1.0))


def test_current_coordinates_join_by_reference(tmp_path: Path) -> None:
    later = MATCHID_3D.replace(b"1.5,2.5,0.5,0.5,0.25,0.125", b"2.5,3.5,0.5,1.5,1.25,0.125").replace(b"2.5,2.5,0.5,0.5", b"3.5,2.5,0.5,1.5")
    field, _ = read_dic_files(write(tmp_path / "f", {"TimeStep_1.csv": MATCHID_3D, "TimeStep_2.csv": later}), Rules(rate=1.0))
    assert field.displacement.shape == (2, 2, 3)
    np.testing.assert_allclose(field.displacement[1, :, 0], 1.5)


def test_coordinates_only_give_differences_to_the_first_stage(tmp_path: Path) -> None:
    later = b"# Stage: 160\n# Units: length:m\nid,x,y,z\n3,0.4277,0.0954,0.0013\n2,0.4263,0.0955,-0.006\n99,1,1,1\n"
    field, remarks = read_dic_files(write(tmp_path / "f", {"a_0151.csv": GOM, "a_0160.csv": later}), Rules(rate=1.0))
    assert field.point_id.tolist() == [2, 3, 5]
    np.testing.assert_allclose(field.displacement[1], [[0.9749, -0.0139, -0.0376], [0.03, 0.04, -0.0193], [np.nan] * 3], atol=1e-9)
    assert "1 rows of points that the first stage lacks left out" in remarks
    with pytest.raises(DataError, match="one stage of coordinates has no displacements"):
        read_dic_files(write(tmp_path / "g", {"a_1.csv": GOM}), Rules(rate=1.0))


def test_coordinates_in_a_file_of_their_own(tmp_path: Path) -> None:
    texts: dict[str, str | bytes] = {"u-Stage-0-0.txt": LEGACY_COORDINATES, "d-Stage-0-7.txt": LEGACY_DISPLACEMENTS}
    field, _ = read_dic_files(write(tmp_path / "f", texts), Rules(times=(3.0,)))
    np.testing.assert_allclose(field.reference, [[1.0, 2.0, 0.5], [2.0, 2.0, 0.5]])
    np.testing.assert_allclose(field.displacement[0, :, 1], [0.2, 0.3])
    with pytest.raises(DataError, match="the file has displacements only"):
        read_dic_files(tmp_path / "f" / "d-*", Rules(times=(3.0,)))


def test_stage_without_any_displacement_is_left_out(tmp_path: Path) -> None:
    pattern = series(tmp_path / "f")
    lines = aramis(2, 1.0, 0.2).split("\n")
    empty = [";".join([*line.split(";")[:4], "", "", ""]) if k >= 6 and line else line for k, line in enumerate(lines)]
    write(tmp_path / "f", {"surface_1.0 s.csv": "\n".join(empty)})
    with pytest.raises(DataError, match=r"surface_1.0 s.csv"):
        # A stage of nothing but empty cells is no table of displacements: which is said, and where.
        read_dic_files(write(tmp_path / "g", {"surface_1.0 s.csv": "\n".join(empty)}), Rules())
    field, remarks = read_dic_files(pattern, Rules())
    assert field.time.tolist() == [0.0, 0.5, 1.5, 2.0, 2.5]
    assert "1 stages without any displacement left out (surface_1.0 s.csv)" in remarks


def test_frozen_stages_after_fracture_are_cut(tmp_path: Path) -> None:
    pattern = series(tmp_path / "f", 12)
    for k in (12, 13, 14):
        write(tmp_path / "f", {f"surface_{0.5 * k} s.csv": aramis(11, 0.5 * k, 1.1)})
    field, remarks = read_dic_files(pattern, Rules())
    assert field.time[-1] == 5.5
    assert "3 last stages from 6 s on left out: after fracture, 3 repeat the extreme values of the one before" in remarks


def test_fracture_itself_is_cut_with_the_frozen_stages(tmp_path: Path) -> None:
    pattern = series(tmp_path / "f", 12)
    for k in (12, 13):
        write(tmp_path / "f", {f"surface_{0.5 * k} s.csv": aramis(12, 0.5 * k, 9.0)})
    field, remarks = read_dic_files(pattern, Rules())
    assert field.time[-1] == 5.5
    assert any("the one before these jumps by more than 10 times" in remark for remark in remarks)


def test_torn_stages_are_cut_and_rests_are_not(tmp_path: Path) -> None:
    pattern = series(tmp_path / "f", 6)
    write(tmp_path / "f", {"surface_9 s.csv": aramis(7, 9.0, 5.0, (3,))})
    field, remarks = read_dic_files(pattern, Rules())
    assert field.time[-1] == 2.5
    assert "1 last stages from 9 s on left out: after fracture, 1 hold fewer than half of the points" in remarks
    still = write(tmp_path / "g", {f"a_{k}.csv": aramis(k, float(k), 0.0) for k in range(4)})
    assert len(read_dic_files(still, Rules())[0].time) == 4


def test_points_that_go_one_by_one_are_no_fracture() -> None:
    u = np.random.default_rng(3).normal(size=(30, 100, 3))
    for k in range(30):
        u[k, : 3 * k] = np.nan
    assert after_fracture(u) == (30, "")
    u[25:, :95] = np.nan
    assert after_fracture(u)[0] == 25


def test_units_pixels_and_axes(tmp_path: Path) -> None:
    pattern = write(tmp_path / "f", {"a.csv": TABLE.replace(b" [mm]", b" [px]")})
    with pytest.raises(DataError, match="the file is in pixels; give 'mm_per_pixel'"):
        read_dic_files(pattern, Rules(times=(0.0,)))
    rules = Rules(times=(0.0,), mm_per_pixel=0.5, axes=("-y", "x", "z"), origin_mm=(1.0, 2.0, 0.0))
    field, _ = read_dic_files(pattern, rules)
    np.testing.assert_allclose(field.reference[0, :2], [-(18.6820 * 0.5 - 2.0), -1.2132 * 0.5 - 1.0])
    np.testing.assert_allclose(field.displacement[0, 0, :2], [0.0073 * 0.5, 0.0370 * 0.5])
    pattern = write(tmp_path / "g", {"a.csv": TABLE.replace(b" [mm]", b"")})
    with pytest.raises(DataError, match="does not say its unit of length; give 'unit: mm'"):
        read_dic_files(pattern, Rules(times=(0.0,)))
    np.testing.assert_allclose(read_dic_files(pattern, Rules(times=(0.0,), unit="in"))[0].reference[0, 0], -1.2132 * 25.4)
    pattern = write(tmp_path / "h", {"a.csv": TABLE})
    with pytest.raises(DataError, match="'mm_per_pixel' is given, but the file is in mm"):
        read_dic_files(pattern, Rules(times=(0.0,), mm_per_pixel=0.5))
    with pytest.raises(DataError, match="the file is in mm, but 'unit' is in; correct"):
        read_dic_files(pattern, Rules(times=(0.0,), unit="in"))


def test_open_coordinates_can_be_declared_deformed(tmp_path: Path) -> None:
    pattern = write(tmp_path / "f", {"a.csv": TABLE})
    field, _ = read_dic_files(pattern, Rules(times=(0.0,), coordinates_of="deformed"))
    np.testing.assert_allclose(field.reference[0, :2], [-1.2132 - 0.0370, 18.6820 + 0.0073])
    with pytest.raises(DataError, match="'coordinates_of' is deformed, but the format says itself"):
        read_dic_files(series(tmp_path / "g"), Rules(coordinates_of="deformed"))


def check_field(field: DicField) -> None:
    """Shapes fit, times increase, every point is somewhere and measured at least once."""
    n_t, n_s = len(field.time), len(field.point_id)
    assert n_t > 0 and n_s > 0
    assert field.displacement.shape == (n_t, n_s, 3) and field.reference.shape == (n_s, 3)
    assert np.isfinite(field.time).all() and (np.diff(field.time) > 0.0).all()
    assert np.isfinite(field.reference[:, :2]).all()
    assert not np.isinf(field.displacement).any()
    assert len(np.unique(field.point_id)) == n_s
    assert np.isfinite(field.displacement[:, :, :2]).all(axis=2).any(axis=0).all()


def damage(data: st.DataObject, folder: Path) -> None:
    """Four stages of which one is damaged: a field or one sentence that names a file of the folder."""
    stages = {f"a_{k}.csv": aramis(k, 0.5 * k, 0.1 * k).encode() for k in range(4)}
    if data.draw(st.booleans()):
        stages = {f"a_{k}.csv": table(k) for k in range(4)}
    name = data.draw(st.sampled_from(sorted(stages)))
    stages[name] = data.draw(mutations(stages[name]))
    rules = data.draw(st.sampled_from([Rules(), Rules(rate=2.0), Rules(unit="mm", rate=1.0)]))
    pattern = write(folder / "fuzzed", dict(stages))
    try:
        field, remarks = read_dic_files(pattern, rules)
    except DataError as error:
        assert "\n" not in str(error) and str(folder / "fuzzed") in str(error)
        return
    check_field(field)
    assert remarks


@settings(max_examples=40)
@given(data=st.data())
def test_damaged_stage_among_sound_ones(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    damage(data, tmp_path_factory.getbasetemp())


@pytest.mark.slow
@settings(max_examples=500)
@given(data=st.data())
def test_500_damaged_stages_among_sound_ones(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    damage(data, tmp_path_factory.getbasetemp())
