"""Reader of the raw folder: round trip, every defect named with file and line, and mutated files."""

import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from thermofit.core.errors import DataError
from thermofit.core.experiment import CELSIUS
from thermofit.read import raw as reader
from thermofit.read.raw import read_description, read_dic, read_experiment, read_force, read_infrared

HEADER = "id,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"
POINTS = {1: (-1.0, 2.0, 0.6), 2: (1.5, -2.25, 0.6), 7: (0.0, 0.5, 0.6)}


def description() -> dict:
    return {
        "specimen": {
            "gauge_width_mm": 25.0,
            "thickness_mm": 1.2,
            "parallel_length_mm": 100.0,
            "shoulder_radius_mm": 25.0,
            "grip_width_mm": 35.0,
            "total_length_mm": 150.0,
            "gripped_length_each_end_mm": 10.0,
        },
        "temperatures": {"theta_air_degC": 24.4, "theta_clamp_degC": 23.6},
        "time": {"unit": "s"},
        "force": {"file": "force.csv"},
        "dic": {"folder": "dic", "stages": 3, "side": "front (z = +t/2)"},
        "ir": {
            "folder": "ir",
            "frames": 3,
            "unit": "degC",
            "side": "back (z = -t/2): mirrored",
            "image_shape": [4, 5],
            "landmarks_frame": 0,
            "landmarks": {
                "length": {"p1": [0.0, 1.0], "p2": [3.0, 1.0], "length_mm": 30},
                "edge_left": {"p1": [0, 0], "p2": [3, 0]},
                "edge_right": {"p1": [1.5, 4]},
                "circle": {"p1": [1, 1], "p2": [2, 1], "p3": [1.5, 3]},
            },
        },
        "programme": ["0-1 s: no load", "loading"],
    }


def stage_text(time: float, ids: tuple[int, ...] = (1, 2, 7)) -> str:
    rows = [f"{i},{POINTS[i][0]},{POINTS[i][1]},{POINTS[i][2]},{0.01 * i},{0.1 * time},{-0.001 * i}" for i in ids]
    return "\n".join([f"# time_s: {time:.3f}", HEADER, *rows]) + "\n"


def frame_text(time: float) -> str:
    rows = [",".join(f"{20.0 + row + 0.1 * column + time:.3f}" for column in range(5)) for row in range(4)]
    return "\n".join([f"# time_s: {time:.3f}", *rows]) + "\n"


def make(folder: Path) -> Path:
    """A small experiment of three stages (id 2 is lost in the second) and three frames."""
    for name in ("dic", "ir"):
        (folder / name).mkdir(parents=True)
    (folder / "experiment.yaml").write_text(yaml.safe_dump(description(), sort_keys=False))
    rows = [f"{0.1 * k:.3f},{100.0 * k:.2f},{0.01 * k:.4f}" for k in range(31)]
    (folder / "force.csv").write_text("\n".join(["time_s,force_N,crosshead_mm", *rows]) + "\n")
    for k, (time, ids) in enumerate(((0.0, (1, 2, 7)), (1.0, (7, 1)), (2.0, (1, 2, 7)))):
        (folder / "dic" / f"stage_{k:04d}.csv").write_text(stage_text(time, ids))
    for k in range(3):
        (folder / "ir" / f"frame_{k:04d}.csv").write_text(frame_text(0.5 + k))
    return folder


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return make(tmp_path / "raw")


def change(folder: Path, dotted: str, value: object) -> None:
    """Set (or with None delete) a key of experiment.yaml."""
    path = folder / "experiment.yaml"
    tree = yaml.safe_load(path.read_text())
    *parents, last = dotted.split(".")
    place = tree
    for part in parents:
        place = place[part]
    if value is None:
        del place[last]
    else:
        place[last] = value
    path.write_text(yaml.safe_dump(tree, sort_keys=False))


def edit(path: Path, line: int, text: str | None) -> None:
    """Replace (or with None remove) a line, counted from 1."""
    lines = path.read_text().splitlines()
    lines[line - 1 : line] = [] if text is None else [text]
    path.write_text("\n".join(lines) + "\n")


def refuse(folder: Path, *words: str) -> None:
    """One sentence that holds all words."""
    with pytest.raises(DataError) as caught:
        read_experiment(folder)
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_reads_everything(raw: Path) -> None:
    e = read_experiment(raw)
    assert e.specimen.gauge_width == 25.0 and e.specimen.gripped_length == 10.0
    assert e.theta_air == pytest.approx(24.4 + CELSIUS) and e.theta_clamp == pytest.approx(23.6 + CELSIUS)
    assert e.programme == ("0-1 s: no load", "loading")
    np.testing.assert_allclose(e.force.force, 100.0 * np.arange(31))
    np.testing.assert_allclose(e.force.crosshead, 0.01 * np.arange(31))
    assert e.dic is not None and e.dic.side == "front"
    assert e.dic.point_id.tolist() == [1, 2, 7]
    np.testing.assert_allclose(e.dic.reference, list(POINTS.values()))
    np.testing.assert_allclose(e.dic.displacement[1], [[0.01, 0.1, -0.001], [np.nan] * 3, [0.07, 0.1, -0.007]])
    assert e.ir is not None and e.ir.side == "back" and e.ir.frames.dtype == np.float32
    assert e.ir.time.tolist() == [0.5, 1.5, 2.5]
    assert e.ir.frames[2, 3, 4] == pytest.approx(20.0 + 3 + 0.4 + 2.5 + CELSIUS, abs=1e-4)
    assert e.landmarks is not None and e.landmarks.edge_right.tolist() == [1.5, 4.0] and e.landmarks.length_mm == 30.0
    assert e.repairs == ("dic: 1 of 9 rows missing, 1 of 3 points concerned",)


def test_reads_parts_alone(raw: Path) -> None:
    shutil.rmtree(raw / "ir")
    e = read_experiment(raw, parts=("force", "dic"))
    assert e.ir is None and e.dic is not None and e.landmarks is not None
    assert len(read_force(read_description(raw)).time) == 31
    assert read_dic(read_description(raw))[0].time.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(DataError, match="declares it"):
        read_infrared(read_description(raw))
    with pytest.raises(ValueError, match="unknown parts"):
        read_experiment(raw, parts=("dic", "infrared"))


@pytest.mark.parametrize("name", ["dic", "ir"])
def test_undeclared_field_is_none_and_said(raw: Path, name: str) -> None:
    change(raw, name, None)
    e = read_experiment(raw)
    assert getattr(e, name) is None
    assert any(f"no section '{name}'" in text for text in e.repairs)
    shutil.rmtree(raw / name)
    assert not any(f"no section '{name}'" in text for text in read_experiment(raw).repairs)


def test_sorted_by_time_not_by_name(raw: Path) -> None:
    (raw / "ir" / "frame_0000.csv").rename(raw / "ir" / "frame_0009.csv")
    (raw / "dic" / "stage_0000.csv").rename(raw / "dic" / "stage_10000.csv")
    e = read_experiment(raw)
    assert e.ir is not None and e.dic is not None
    assert e.ir.time.tolist() == [0.5, 1.5, 2.5] and e.dic.time.tolist() == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(e.ir.frames[:, 0, 0] - CELSIUS, [20.5, 21.5, 22.5], atol=1e-4)
    np.testing.assert_allclose(e.dic.displacement[:, 0, 1], [0.0, 0.1, 0.2])
    assert sum("sorted by time" in text for text in e.repairs) == 2


def test_counts_what_is_not_as_declared(raw: Path) -> None:
    (raw / "ir" / "frame_0001.csv").unlink()
    (raw / "ir" / "notes.txt").write_text("x")
    text = " ".join(read_experiment(raw).repairs)
    assert "2 frames found, 3 declared" in text and "1 other files left unread" in text


def test_crosshead_is_optional_and_columns_go_by_name(raw: Path) -> None:
    (raw / "force.csv").write_text("force_N,time_s\n" + "".join(f"{10 * k},{k}\n" for k in range(5)))
    force = read_force(read_description(raw))
    assert force.crosshead is None and force.time.tolist() == [0, 1, 2, 3, 4] and force.force[4] == 40.0


def rename(path: Path, line: int, columns: dict[str, tuple[str, float]]) -> None:
    """Name columns of a table otherwise, in line `line` of its file, and multiply their values."""
    lines = path.read_text().splitlines()
    names = lines[line - 1].split(",")
    for old, (new, factor) in columns.items():
        k = names.index(old)
        names[k] = new
        for n in range(line, len(lines)):
            cells = lines[n].split(",")
            cells[k] = f"{factor * float(cells[k]):.12g}"
            lines[n] = ",".join(cells)
    lines[line - 1] = ",".join(names)
    path.write_text("\n".join(lines) + "\n")


def test_units_in_the_names_of_columns_are_converted(raw: Path) -> None:
    plain = read_experiment(raw)
    rename(raw / "force.csv", 1, {"force_N": ("force_kN", 1e-3), "time_s": ("time_ms", 1e3), "crosshead_mm": ("crosshead_um", 1e3)})
    for path in (raw / "dic").glob("*.csv"):
        rename(path, 2, {"ux_mm": ("ux_um", 1e3), "y_mm": ("y_m", 1e-3)})
    for path in (raw / "ir").glob("*.csv"):
        first, *rest = path.read_text().splitlines()
        path.write_text("\n".join([f"# time_ms: {1e3 * float(first.split(':')[1]):g}", *rest]) + "\n")
    e = read_experiment(raw)
    assert e.dic is not None and plain.dic is not None and e.ir is not None and plain.ir is not None
    for found, wanted in (
        (e.force.force, plain.force.force),
        (e.force.time, plain.force.time),
        (e.force.crosshead, plain.force.crosshead),
        (e.dic.displacement, plain.dic.displacement),
        (e.dic.reference, plain.dic.reference),
        (e.ir.time, plain.ir.time),
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert "force.csv: force_kN is converted to force_N" in e.repairs
    assert "dic: ux_um is converted to ux_mm in 3 stages" in e.repairs


@pytest.mark.parametrize(
    ("file", "line", "text", "words"),
    [
        ("force.csv", 1, "time_s,force_V,crosshead_mm", ("column 'force_V' is in 'V'", "convert its values to N and name it 'force_N'")),
        ("force.csv", 1, "time_s,force_MPa,crosshead_mm", ("'force_MPa'", "convert its values to N")),
        ("force.csv", 1, "time_s,Kraft,crosshead_mm", ("'force_N' is missing", "with the unit that its values are in")),
        ("force.csv", 1, "time_s,force_kN,force_lbf", ("force_kN and force_lbf hold the same",)),
        ("ir/frame_0001.csv", 1, "# time_px: 1.0", ("'px'", "no known unit of time", "convert it to s")),
    ],
)
def test_a_unit_that_cannot_be_converted_is_to_be(raw: Path, file: str, line: int, text: str, words: tuple[str, ...]) -> None:
    edit(raw / file, line, text)
    refuse(raw, *words)


def test_the_unit_of_a_key_is_to_be_converted_with_its_value(raw: Path) -> None:
    path = raw / "experiment.yaml"
    path.write_text(path.read_text().replace("theta_air_degC", "theta_air_K"))
    refuse(raw, "found 'theta_air_K' instead: convert the value from K to degC and name it 'theta_air_degC'")


def test_byte_order_mark_and_windows_line_ends(raw: Path) -> None:
    want = read_experiment(raw)
    for path in [*raw.glob("*.csv"), *raw.glob("*/*.csv")]:
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    got = read_experiment(raw)
    assert got.ir is not None and want.ir is not None and got.repairs == want.repairs
    np.testing.assert_array_equal(got.ir.frames, want.ir.frames)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("specimen", None, ("experiment.yaml: key 'specimen' is missing",)),
        ("specimen.gauge_width_mm", None, ("specimen.gauge_width_mm' is missing", "add it")),
        ("specimen.thickness_mm", -1.0, ("specimen.thickness_mm' is -1.0", "above 0")),
        ("specimen.thickness_mm", True, ("expected a number",)),
        ("specimen.thickness_mm", "1,2", ("'1,2'", "expected a number")),
        ("specimen.grip_width_mm", 20.0, ("gauge_width_mm' is 25 mm", "20 mm")),
        ("specimen", 3, ("key 'specimen' is 3", "section")),
        ("temperatures.theta_air_degC", float("nan"), ("theta_air_degC' is nan",)),
        ("temperatures.theta_air_degC", -300.0, ("theta_air_degC' is -300",)),
        ("ir.unit", "K", ("ir.unit' is 'K'", "expected degC")),
        ("ir.unit", None, ("ir.unit' is missing",)),
        ("time.unit", "ms", ("time.unit' is 'ms'", "expected s")),
        ("ir.side", "left", ("ir.side' is 'left'", "front or back")),
        ("ir.side", None, ("ir.side' is missing",)),
        ("dic.folder", "nowhere", ("nowhere", "does not exist")),
        ("dic.folder", "a\0b", ("dic.folder'", "name of a file or folder")),
        ("dic.folder", "a" * 5000, ("dic.folder'", "name of a file or folder")),
        ("dic.stages", "many", ("dic.stages' is 'many'",)),
        ("force.file", "kraft.csv", ("kraft.csv", "no such file")),
        ("force.file", "dic", ("dic: is a directory",)),
        ("ir.image_shape", [4, 6], ("frame_0000.csv", "4 rows x 5 columns", "4 rows x 6 columns")),
        ("ir.image_shape", [4], ("ir.image_shape' is [4]",)),
        ("ir.landmarks_frame", 3, ("landmarks_frame' is 3", "3 frames")),
        ("ir.landmarks_frame", "first", ("landmarks_frame' is 'first'",)),
        ("ir.landmarks.circle.p3", None, ("ir.landmarks.circle.p3' is missing",)),
        ("ir.landmarks.circle.p3", [1.0], ("circle.p3' is [1.0]", "[row, col]")),
        ("ir.landmarks.length.length_mm", 0, ("length.length_mm' is 0",)),
        ("programme", "loading", ("key 'programme' is 'loading'",)),
    ],
)
def test_wrong_description(raw: Path, key: str, value: object, words: tuple[str, ...]) -> None:
    change(raw, key, value)
    refuse(raw, *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gauge_width_mm", "gauge_widht_mm", ("found 'gauge_widht_mm'",)),
        ("theta_air_degC", "theta_air_K", ("theta_air_degC' is missing", "found 'theta_air_K'")),
        ("landmarks:", "landmark:", ("key 'ir.landmark' is not known", "'landmarks'")),
        ("programme:", "program:", ("key 'program' is not known", "'programme'")),
        ("\ndic:", "\nDIC:", ("key 'DIC' is not known", "'dic'")),
        ("  thickness_mm: 1.2", "  thickness_mm: 1.2\n  thickness_mm: 1.3", ("line 4", "given twice")),
        ("  thickness_mm: 1.2", "  thickness_mm: [1.2", ("experiment.yaml, line",)),
        ("thickness_mm: 1.2", "thickness_mm: 2024-13-45", ("thickness_mm' is '2024-13-45'", "expected a number above 0")),
        ("thickness_mm: 1.2", "thickness_mm:", ("thickness_mm' is empty",)),
    ],
)
def test_misspelt_description(raw: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    path = raw / "experiment.yaml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    refuse(raw, *words)


def test_scientific_notation_without_point_is_a_number(raw: Path) -> None:
    """YAML 1.1 reads 12e-1 as a text."""
    path = raw / "experiment.yaml"
    path.write_text(path.read_text().replace("thickness_mm: 1.2", "thickness_mm: 12e-1"))
    assert read_description(raw).specimen.thickness_mm == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("file", "line", "text", "words"),
    [
        ("ir/frame_0001.csv", 1, None, ("frame_0001.csv, line 1", "# time_s")),
        ("ir/frame_0001.csv", 1, "# time_s: nan", ("line 1", "'nan'", "finite")),
        ("ir/frame_0001.csv", 1, "# time_s: 0.5", ("frame_0001.csv, line 1", "0.5 s", "frame_0000.csv")),
        ("ir/frame_0001.csv", 3, "20,20,NaN,20,20", ("frame_0001.csv, line 3, column 3", "'NaN'")),
        ("ir/frame_0001.csv", 3, "20,20,,20,20", ("line 3, column 3", "''")),
        ("ir/frame_0001.csv", 3, "20,20,1e999,20,20", ("line 3, column 3",)),
        ("ir/frame_0001.csv", 3, "20,20,2O,20,20", ("line 3, column 3", "'2O'")),
        ("ir/frame_0001.csv", 3, "20;20;20;20;20", ("line 3, column 1",)),
        ("ir/frame_0001.csv", 3, "20,20,20,20", ("line 3: found 4 cells, expected 5",)),
        ("ir/frame_0001.csv", 3, "20,20,20,20,20 # x", ("line 3, column 5",)),
        ("ir/frame_0001.csv", 3, "", ("line 3: the line is empty",)),
        ("ir/frame_0001.csv", 3, None, ("frame_0001.csv", "3 rows x 5 columns", "4 rows")),
        ("ir/frame_0001.csv", 3, "20,20,20,-274,20", ("line 3, column 4", "absolute zero")),
        ("dic/stage_0001.csv", 1, None, ("stage_0001.csv, line 1", "# time_s")),
        ("dic/stage_0001.csv", 2, "id,x_mm,y_mm,z_mm,ux_mm,uy_mm,uz", ("line 2", "'uz_mm' is missing")),
        ("dic/stage_0001.csv", 2, HEADER + ",id", ("line 2", "'id' is named twice")),
        ("dic/stage_0001.csv", 3, "7,0,0.5,0.6,nan,0,0", ("line 3, column 5 (ux_mm)",)),
        ("dic/stage_0001.csv", 3, "7.5,0,0.5,0.6,0,0,0", ("line 3", "7.5", "whole number")),
        ("dic/stage_0001.csv", 3, "1,-1.0,2.0,0.6,0,0,0", ("line 4", "id 1 occurs a second time")),
        ("dic/stage_0001.csv", 3, "7,0,0.6,0.6,0,0,0", ("stage_0001.csv, line 3", "point 7", "0.1 mm away")),
        ("dic/stage_0001.csv", 3, "7,0,0.5,0.6,0,0", ("line 3: found 6 cells, expected 7",)),
        ("force.csv", 1, "time,force_N", ("force.csv, line 1", "'time_s' is missing")),
        ("force.csv", 5, "0.2,1,1", ("force.csv, line 5", "0.2 s after 0.2 s")),
        ("force.csv", 5, "0.25,1,1e1e", ("line 5, column 3 (crosshead_mm)",)),
    ],
)
def test_wrong_line(raw: Path, file: str, line: int, text: str | None, words: tuple[str, ...]) -> None:
    edit(raw / file, line, text)
    refuse(raw, *words)


@pytest.mark.parametrize("file", ["experiment.yaml", "force.csv", "dic/stage_0002.csv", "ir/frame_0000.csv"])
@pytest.mark.parametrize(("content", "word"), [(b"", "empty"), (b"\n \n", "empty"), (b"\xff\xfe\x00", "UTF-8")])
def test_empty_or_binary_file(raw: Path, file: str, content: bytes, word: str) -> None:
    (raw / file).write_bytes(content)
    refuse(raw, file.split("/")[-1], word)


@pytest.mark.parametrize(
    ("file", "keep"), [("force.csv", 1), ("force.csv", 2), ("dic/stage_0000.csv", 1), ("dic/stage_0000.csv", 2), ("ir/frame_0000.csv", 1)]
)
def test_file_cut_short(raw: Path, file: str, keep: int) -> None:
    path = raw / file
    path.write_text("\n".join(path.read_text().splitlines()[:keep]) + "\n")
    refuse(raw, path.name)


def test_missing_folder_or_file(raw: Path, tmp_path: Path) -> None:
    refuse(tmp_path / "nothing", "nothing", "does not exist")
    for path in (raw / "dic").glob("*"):
        path.rename(path.with_suffix(".txt"))
    refuse(raw, "no file stage_NNNN.csv")
    (raw / "experiment.yaml").unlink()
    refuse(raw, "experiment.yaml", "no such file")


def test_force_must_span_the_fields(raw: Path) -> None:
    path = raw / "force.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:22]) + "\n")
    refuse(raw, "force.csv", "ends 0.500 s before the last infrared frame")
    path.write_text("\n".join([lines[0], *lines[3:]]) + "\n")
    refuse(raw, "force.csv", "begins 0.200 s after the first DIC stage")
    path.write_text("\n".join([lines[0], *lines[2:]]) + "\n")
    assert any("begins 0.100 s" in text and "one sample" in text for text in read_experiment(raw).repairs)


@settings(max_examples=40, deadline=None)
@given(
    stages=st.lists(
        st.tuples(
            st.integers(0, 10**6),
            st.dictionaries(st.integers(-5, 2**40), st.tuples(*[st.floats(-50, 50)] * 3), min_size=1, max_size=8),
        ),
        min_size=1,
        max_size=4,
        unique_by=lambda stage: stage[0],
    )
)
def test_displacements_come_back_exactly(stages: list[tuple[int, dict[int, tuple[float, ...]]]]) -> None:
    """Any ids in any order over stages in any order: what was written is read, what was not is NaN."""
    with tempfile.TemporaryDirectory() as name:
        folder = make(Path(name) / "raw")
        shutil.rmtree(folder / "dic")
        (folder / "dic").mkdir()
        for k, (time, rows) in enumerate(stages):
            lines = [f"# time_s: {time / 1000!r}", HEADER, *(f"{i},{i % 7},0,0,{u[0]!r},{u[1]!r},{u[2]!r}" for i, u in rows.items())]
            (folder / "dic" / f"stage_{k}.csv").write_text("\n".join(lines))
        dic, _ = read_dic(read_description(folder))
    assert dic.time.tolist() == sorted(time / 1000 for time, _ in stages)
    by_time = {time / 1000: rows for time, rows in stages}
    for time, displacement in zip(dic.time, dic.displacement, strict=True):
        for i, u in zip(dic.point_id, displacement, strict=True):
            rows = by_time[time]
            if int(i) in rows:
                assert tuple(u) == rows[int(i)]
            else:
                assert np.isnan(u).all()


FILES = ("experiment.yaml", "force.csv", "dic/stage_0001.csv", "ir/frame_0001.csv")


def test_more_points_than_any_camera_shows_are_refused(raw: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "MOST_POINTS", 2)
    with pytest.raises(DataError, match=r"dic: found 3 DIC points, expected at most 2; export points that lie farther apart"):
        read_dic(read_description(raw))


@pytest.fixture(scope="module")
def fuzz_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("fuzz") / "raw")


@settings(max_examples=400, deadline=None)
@given(
    file=st.sampled_from(FILES),
    at=st.floats(0, 1),
    cut=st.integers(0, 30),
    insert=st.one_of(
        st.binary(max_size=4),
        st.sampled_from(
            [b"\n", b",", b"nan", b"-", b"e", b":", b"- ", b"#", b"0", b"{", b"&a *a", b"inf", b"!!", b"\n\n", b"'", b'"', b"\t", b"1_0"]
        ),
    ),
)
def test_mutated_file_is_refused_or_read_whole(fuzz_folder: Path, file: str, at: float, cut: int, insert: bytes) -> None:
    """Never anything but a DataError in one line or an experiment that holds together."""
    path = fuzz_folder / file
    original = path.read_bytes()
    start = int(at * len(original))
    path.write_bytes(original[:start] + insert + original[start + cut :])
    try:
        e = read_experiment(fuzz_folder)
    except DataError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000
        return
    finally:
        path.write_bytes(original)
    assert np.isfinite(e.force.force).all() and (np.diff(e.force.time) > 0).all()
    if e.dic is not None:
        assert e.dic.displacement.shape == (len(e.dic.time), len(e.dic.point_id), 3) and (np.diff(e.dic.time) > 0).all()
        assert np.isfinite(e.dic.reference).all()
        missing = int(np.isnan(e.dic.displacement[:, :, 0]).sum())
        assert any(text.startswith(f"dic: {missing} of") for text in e.repairs)
    if e.ir is not None:
        assert e.ir.frames.shape == (3, 4, 5) and np.isfinite(e.ir.frames).all() and (np.diff(e.ir.time) > 0).all()
    assert np.isfinite([e.theta_air, e.theta_clamp, *vars(e.specimen).values()]).all()


def test_large_frames_are_read(tmp_path: Path) -> None:
    """640 x 512 pixels, the format of a full camera."""
    folder = make(tmp_path / "raw")
    change(folder, "ir.image_shape", [512, 640])
    row = ",".join(["24.365"] * 640)
    for k in range(3):
        (folder / "ir" / f"frame_{k:04d}.csv").write_text(f"# time_s: {k + 0.5}\n" + "\n".join([row] * 512) + "\n")
    sequence, _ = read_infrared(read_description(folder))
    assert sequence.frames.shape == (3, 512, 640)
    assert np.all(sequence.frames == np.float32(24.365 + 273.15))


def test_reads_a_measured_set() -> None:
    data = os.environ.get("THERMOFIT_DATA")
    if not data or not (Path(data) / "blind" / "B1").is_dir():
        pytest.skip("THERMOFIT_DATA with blind/B1 is not there")
    e = read_experiment(Path(data) / "blind" / "B1")
    assert e.dic is not None and e.ir is not None
    assert e.dic.displacement.shape == (124, 1150, 3) and e.ir.frames.shape == (135, 218, 90)
    assert len(e.repairs) == 1 and "rows missing" in e.repairs[0]
