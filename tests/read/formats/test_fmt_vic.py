"""VIC-3D and VIC-2D: CSV and MAT, what is metric and what is px, and which points were not correlated."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings
from samples import sample

from thermofit.core.errors import DataError
from thermofit.read.formats import vic, vic_mat
from thermofit.read.formats.contents import DicStage
from thermofit.read.formats.registry import format_of, head_of, read_native

HEADER_3D = ("X", "Y", "Z", "U", "V", "W", "exx", "eyy", "exy", "gamma", "sigma", "x", "y", "u", "v", "q", "r")
HEADER_2D = ("x", "y", "u", "v", "sigma", "x_c", "y_c", "u_c", "v_c", "exx", "eyy", "exy")
HEADER_PX = ("x", "y", "u", "v", "exx", "eyy", "exy", "sigma")


def values_3d() -> np.ndarray:
    """Six points: the second not correlated, the third with a displacement of exactly 0."""
    rows = [
        [0.1 * k, 0.2 * k, 0.3, 0.01 * k, -0.02 * k, 0.03, 0.001, -0.0003, 0.0, 0.0, 0.01, 60 + 7 * k, 289, 1.5, 2.5, 3.0, 4.0]
        for k in range(6)
    ]
    rows[1] = [0.0] * 10 + [-1.0, 67, 289, 0, 0, 0, 0]
    rows[2][3:6] = [0.0, 0.0, 0.0]
    return np.array(rows)


def csv(names: tuple[str, ...], rows: np.ndarray) -> bytes:
    """As VIC writes: quoted names with a blank before and two after the comma, and a blank line between rows of the grid."""
    lines = ["  ".join(f' "{name}",' for name in names).rstrip(",")]
    lines[0] = " " + ",  ".join(f'"{name}"' for name in names)
    for k, row in enumerate(rows):
        lines.append(",".join(f"{value:.7g}" for value in row))
        if k == 2:
            lines.append("")
    return ("\n".join(lines) + "\n\n").encode()


SEED_3D = csv(HEADER_3D, values_3d())


def read(path: Path, data: bytes) -> DicStage:
    path.write_bytes(data)
    stage = read_native(path)
    assert isinstance(stage, DicStage)
    return stage


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "stage.csv"


def test_metric_columns_are_told_from_pixels_by_case(path: Path) -> None:
    stage = read(path, SEED_3D)
    assert format_of(path) is vic
    assert stage.length_unit == "mm"
    assert stage.reference is not None and stage.displacement is not None
    assert stage.reference[3] == pytest.approx([0.3, 0.6, 0.3])
    assert stage.displacement[3] == pytest.approx([0.03, -0.06, 0.03])
    assert stage.strain["eyy"][3] == pytest.approx(-0.0003)
    assert set(stage.strain) == {"exx", "eyy", "exy"}
    meanings = {column.name: column.meaning for column in stage.traits.columns}
    assert meanings["X"] == "x"
    assert meanings["x"] == ""
    assert stage.traits.separator == ","


def test_points_are_missing_by_sigma_and_never_by_zero_displacement(path: Path) -> None:
    stage = read(path, SEED_3D)
    assert stage.reference is not None and stage.displacement is not None
    assert stage.traits.missing == 1
    assert np.flatnonzero(np.isnan(stage.displacement).any(axis=1)).tolist() == [1]
    assert np.isnan(stage.reference[1]).all()
    assert np.isnan(stage.strain["exx"][1])
    assert stage.displacement[2].tolist() == [0.0, 0.0, 0.0]


def test_calibrated_columns_of_vic_2d(path: Path) -> None:
    rows = np.array([[10, 20, 1.0, 2.0, 0.01, 0.5, 1.0, 0.05, 0.1, 0.001, 0.002, 0.0], [17, 20, 0, 0, -1, 0, 0, 0, 0, 0, 0, 0]])
    stage = read(path, csv(HEADER_2D, rows))
    assert stage.length_unit == "mm"
    assert stage.reference is not None and stage.displacement is not None
    assert stage.reference[0, :2].tolist() == [0.5, 1.0]
    assert stage.displacement[0, :2].tolist() == [0.05, 0.1]
    assert np.isnan(stage.reference[:, 2]).all()
    assert stage.traits.missing == 1
    assert any("taken as mm" in remark for remark in stage.traits.remarks)


def test_pixels_where_there_is_no_metric_column(path: Path) -> None:
    rows = np.array([[10, 20, 1.0, 2.0, 0.001, 0.002, 0.0, 0.02], [17, 20, 0, 0, 0, 0, 0, -1]])
    stage = read(path, csv(HEADER_PX, rows))
    assert stage.length_unit == "px"
    assert stage.reference is not None and stage.displacement is not None
    assert stage.reference[:, 0].tolist() == [10.0, 17.0]
    assert np.isnan(stage.displacement[1]).all()


def test_without_sigma_only_points_with_nothing_but_zeros_are_missing(path: Path) -> None:
    keep = [k for k, name in enumerate(HEADER_3D) if name != "sigma"]
    stage = read(path, csv(tuple(HEADER_3D[k] for k in keep), values_3d()[:, keep]))
    assert stage.traits.missing == 1
    assert any("no column sigma" in remark for remark in stage.traits.remarks)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.replace(b'"U"', b'"X"'), r"line 1: two columns are called 'X'"),
        (lambda data: data.replace(b'"U"', b'"P"').replace(b'"u"', b'"p"'), r"line 1: found no columns X, Y, U, V"),
        (lambda data: data.replace(b'"exx"', b'"eyy"'), r"line 1: two columns are called 'eyy'"),
        (lambda data: data.split(b"\n")[0], r"line 2.* expected rows of numbers"),
        (lambda data: data.replace(b",0.01,", b",-1,"), r"none of the 6 points was correlated"),
        (lambda data: b"\n".join([data.split(b"\n")[0], b",".join([b"nan"] * 17)]), r"no number found"),
        (lambda data: data.replace(b"\n0.4,", b"\n0.4,0,0,0,"), r"found 20 cells, expected 17"),
    ],
)
def test_defects_are_named(path: Path, change: Callable[[bytes], bytes], sentence: str) -> None:
    path.write_bytes(change(SEED_3D))
    with pytest.raises(DataError, match=sentence):
        vic.read(path)


def test_a_cut_row_counts_as_missing_and_is_remarked(path: Path) -> None:
    stage = read(path, SEED_3D.rstrip()[:-20])
    assert stage.traits.missing in (1, 2)
    assert any("shorter" in remark for remark in stage.traits.remarks)
    stage = read(path, SEED_3D.rstrip().rsplit(b",", 13)[0])
    assert stage.traits.missing == 2


def test_other_tables_are_not_taken(path: Path) -> None:
    for header in (b"time,x,y,u,v\n1,2,3,4,5\n", b"id,x,y,z\n0,1,2,3\n", b"x,y,u,v,exx\n1,2,3,4,5\n", b"X;Y\n1;2\n"):
        path.write_bytes(header)
        assert not vic.recognises(head_of(path))


def mat(**matrices: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, matrices, do_compression=False)
    return buffer.getvalue()


def matrices() -> dict[str, np.ndarray]:
    y, x = np.mgrid[0:3, 0:4].astype(np.float32)
    sigma = np.full((3, 4), 0.01, dtype=np.float32)
    sigma[1, 1] = -1.0
    found = {"x": 10 * x, "y": 10 * y, "u": 0.1 * x, "v": 0.2 * y, "exx": 0.001 * x, "sigma": sigma}
    calibrated = {"x_c": 0.5 * x + 1, "y_c": 0.5 * y + 1, "u_c": 0.005 * x, "v_c": 0.01 * y}
    for field in calibrated.values():
        field[1, 1] = 0.0
    return {name: field.astype(np.float32) for name, field in (found | calibrated).items()}


SEED_MAT = mat(**matrices())


def test_mat_export(tmp_path: Path) -> None:
    path = tmp_path / "stage.mat"
    stage = read(path, SEED_MAT)
    assert format_of(path) is vic_mat
    assert stage.length_unit == "mm"
    assert stage.reference is not None and stage.displacement is not None
    assert stage.reference[6, :2] == pytest.approx([2.0, 1.5])
    assert stage.displacement[6, :2] == pytest.approx([0.01, 0.01])
    assert np.flatnonzero(np.isnan(stage.displacement[:, 0])).tolist() == [5]
    assert stage.traits.missing == 1
    assert stage.displacement.dtype == np.float64


def test_mat_export_in_pixels_keeps_the_places_of_lost_points(tmp_path: Path) -> None:
    stage = read(tmp_path / "stage.mat", mat(**{name: field for name, field in matrices().items() if not name.endswith("_c")}))
    assert stage.length_unit == "px"
    assert stage.reference is not None
    assert stage.reference[5, :2].tolist() == [10.0, 10.0]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"u_c": np.ones((2, 2))}, r"u_c has the shape \(2, 2\), sigma has \(3, 4\)"),
        ({"sigma": np.array("text")}, "expected sigma and X, Y, U, V"),
        ({"sigma": np.full((3, 4), -1.0)}, "none of the 12 points was correlated"),
        ({"sigma": np.full((3, 4), np.nan)}, "none of the 12 points was correlated"),
    ],
)
def test_defects_of_a_mat_export(tmp_path: Path, change: dict[str, np.ndarray], sentence: str) -> None:
    path = tmp_path / "stage.mat"
    path.write_bytes(mat(**(matrices() | change)))
    with pytest.raises(DataError, match=sentence):
        vic_mat.read(path)


def test_signalling_nan_of_single_precision_is_a_missing_point(tmp_path: Path) -> None:
    path = tmp_path / "stage.mat"
    third = np.frombuffer(np.array([0.01], dtype=np.float32).tobytes() * 2)
    assert third.nbytes == 8
    # The first two values of sigma become signalling NaN (0x7f800001).
    path.write_bytes(SEED_MAT.replace(third.tobytes(), bytes.fromhex("0100807f0100807f"), 1))
    assert vic_mat.read(path).traits.missing == 3


def test_truncated_mat_export(tmp_path: Path) -> None:
    path = tmp_path / "stage.mat"
    path.write_bytes(SEED_MAT[: len(SEED_MAT) // 2])
    with pytest.raises(DataError, match=r"stage.mat: the MAT file is damaged \(the file ends inside"):
        vic_mat.read(path)


@pytest.mark.parametrize("name", ["def_init_vic3d.csv", "def_final_vic3d.csv"])
def test_samples(name: str) -> None:
    path = sample(f"vic3d/{name}")
    assert format_of(path) is vic
    stage = vic.read(path)
    assert len(stage.point_id) == 4212
    assert stage.traits.missing == 895
    assert stage.displacement is not None and stage.reference is not None
    assert int(np.isnan(stage.displacement).any(axis=1).sum()) == 895
    assert int(np.isnan(stage.reference).any(axis=1).sum()) == 895


def test_samples_have_one_reference() -> None:
    first, last = (vic.read(sample(f"vic3d/def_{name}_vic3d.csv")) for name in ("init", "final"))
    both = np.isfinite(first.reference).all(axis=1) & np.isfinite(last.reference).all(axis=1)  # type: ignore[arg-type]
    assert both.sum() > 3000
    assert np.array_equal(first.reference[both], last.reference[both])  # type: ignore[index]
    assert not np.array_equal(first.displacement[both], last.displacement[both])  # type: ignore[index]


def check_damaged(data: bytes) -> None:
    is_mat = data.startswith(b"MATLAB")
    with tempfile.TemporaryDirectory() as folder:
        survives(vic_mat.read if is_mat else vic.read, Path(folder) / "damaged.csv", data)


SEEDS = (SEED_3D, csv(HEADER_2D, np.ones((4, 12))), SEED_MAT)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*SEEDS))
def test_damaged_files(data: bytes) -> None:
    check_damaged(data)


@pytest.mark.slow
@settings(max_examples=1000, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*SEEDS))
def test_many_damaged_files(data: bytes) -> None:
    check_damaged(data)
