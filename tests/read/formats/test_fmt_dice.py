"""DICe: with and without a header, both choices of columns, failed points, ids."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings
from samples import sample

from thermofit.core.errors import DataError
from thermofit.read.formats import dice
from thermofit.read.formats.contents import DicStage
from thermofit.read.formats.registry import format_of, read_native

COLUMNS = (
    "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,GAMMA,BETA,STATUS_FLAG,"
    "VSG_STRAIN_XX,VSG_STRAIN_YY,VSG_STRAIN_XY"
)
ROWS = (
    "0,2.3990E+003,3.3590E+003,3.3352E+000,3.0549E+001,5.7E-003,1.8E-001,0.0000E+000,4.0000E+000,-1.7E-002,-1.1E-002,1.2E-002",
    "7,2.4140E+003,3.3440E+003,2.9507E+000,3.0912E+001,-1.0000E+000,-1.0000E+000,-1.0000E+000,5.0000E+000,0,0,0",
    "3,2.4290E+003,3.3290E+003,0.0000E+000,0.0000E+000,6.8E-003,1.2E-001,0.0000E+000,4.0000E+000,-3.8E-002,3.0E-003,-1.4E-003",
    "4,2.4440E+003,3.3290E+003,1.0000E+000,2.0000E+000,-1.0000E+000,-1.0000E+000,-1.0000E+000,1.1E+001,0,0,0",
)
HEADER = """***
*** Digital Image Correlation Engine (DICe), (git sha1: v1.0)
***
*** Reference image: ./images/oht_cfrp_00.tiff
*** Subset size: 27
*** Step size: x 35 y 35 (-1 implies not regular grid)
*** Coordinates given with (0,0) as upper left corner of image, x positive right, y positive down
***
"""
BARE = ("\n".join((COLUMNS, *ROWS)) + "\n").encode()
MATCHED = (
    HEADER
    + "COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,VSG_STRAIN_XX,VSG_STRAIN_YY,GAMMA,MATCH\n"
    + "6.1000E+01,9.7100E+02,-4.8353E-02,-4.1987E-01,-1.3676E-04,3.7741E-04,3.1975E-03,0.0000E+00\n"
    + "6.1000E+01,9.3600E+02,-5.6253E-02,-4.3417E-01,-1.5780E-04,3.5836E-04,3.4097E-03,-1.0000E+00\n"
).encode()


def read(path: Path, data: bytes) -> DicStage:
    path.write_bytes(data)
    assert format_of(path) is dice
    stage = read_native(path)
    assert isinstance(stage, DicStage)
    return stage


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "DICe_solution_059.txt"


def test_without_header_failed_by_sigma(path: Path) -> None:
    stage = read(path, BARE)
    assert stage.point_id.tolist() == [0, 7, 3, 4]
    assert stage.length_unit == "px"
    assert stage.stage == 59
    assert stage.reference is not None and stage.displacement is not None
    assert stage.reference[1, :2].tolist() == [2414.0, 3344.0]
    assert stage.displacement[0, :2].tolist() == [3.3352, 30.549]
    assert np.isnan(stage.displacement[[1, 3]]).all()
    assert stage.displacement[2, :2].tolist() == [0.0, 0.0]
    assert stage.strain["exy"][0] == 0.012
    assert np.isnan(stage.strain["exx"][1])
    assert stage.traits.missing == 2
    assert "STATUS_FLAG of failed points: 5 (initialisation failed): 1, 11 (iterations exhausted): 1" in stage.traits.remarks
    assert any(remark.startswith("y points down (fixed by the format)") for remark in stage.traits.remarks)


def test_with_header_failed_by_match(path: Path) -> None:
    stage = read(path, MATCHED)
    assert stage.traits.missing == 1
    assert stage.point_id.tolist() == [0, 1]
    assert any(remark.startswith("y points down (stated in the header)") for remark in stage.traits.remarks)
    assert stage.traits.header["Subset size"] == "27"
    assert set(stage.strain) == {"exx", "eyy"}


def test_neither_sigma_nor_match_is_said(path: Path) -> None:
    stage = read(path, b"COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y\n1,2,3,4\n")
    assert any("failed points cannot be told" in remark for remark in stage.traits.remarks)


def test_ragged_and_void_rows_are_counted(path: Path) -> None:
    stage = read(path, BARE.replace(b"2.4290E+003,", b"nan,").rstrip()[:-6])
    assert stage.traits.missing == 3
    assert any("shorter" in remark for remark in stage.traits.remarks)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.replace(b"\n7,", b"\n3,"), r"line 4: SUBSET_ID 3 occurs a second time"),
        (lambda data: data.replace(b"\n7,", b"\n7.5,"), r"line 3: SUBSET_ID is 7.5, expected a whole number"),
        (lambda data: data.replace(b"\n7,", b"\n,"), r"line 3: SUBSET_ID is nan, expected a whole number"),
        (lambda data: data.replace(b"COORDINATE_Y", b"COORDINATE_Z"), "line 1: no column COORDINATE_Y"),
        (lambda data: data.split(b"\n")[0], "the file ends before line 2"),
        (lambda data: b"\n".join((data.split(b"\n")[0], data.split(b"\n")[2])), "none of the 1 points was correlated"),
        (lambda data: b"***\n*** only a header\n", "the file ends within its header"),
        (lambda data: data.replace(b"E+003,", b"E+003,0,"), r"found 14 cells, expected 12"),
        (lambda data: data + data, "the header occurs a second time"),
    ],
)
def test_defects_are_named(path: Path, change: Callable[[bytes], bytes], sentence: str) -> None:
    path.write_bytes(change(BARE))
    with pytest.raises(DataError, match=sentence):
        dice.read(path)


@pytest.mark.parametrize(
    ("name", "n", "missing", "stage"),
    [
        ("DICe_solution_059.txt", 15606, 139, 59),
        ("dic_challenge_12/DICe_solution_01.txt", 230, 0, 1),
        ("dic_challenge_12/DICe_solution_11.txt", 230, 0, 11),
        ("full_field/DICe_solution_0.txt", 972, 0, 0),
    ],
)
def test_samples(name: str, n: int, missing: int, stage: int) -> None:
    path = sample(f"dice/{name}")
    assert format_of(path) is dice
    found = dice.read(path)
    assert len(found.point_id) == n
    assert found.traits.missing == missing
    assert found.displacement is not None
    assert int(np.isnan(found.displacement[:, 0]).sum()) == missing
    assert found.stage == stage
    assert found.length_unit == "px"


def check_damaged(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survives(dice.read, Path(folder) / "DICe_solution_1.txt", data)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(BARE, MATCHED))
def test_damaged_files(data: bytes) -> None:
    check_damaged(data)


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(BARE, MATCHED))
def test_many_damaged_files(data: bytes) -> None:
    check_damaged(data)
