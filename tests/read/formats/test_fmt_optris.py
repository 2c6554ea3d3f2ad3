"""Optris PIX Connect: commas that part columns and are decimal signs; paired only where nothing else is possible or the width is given."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings

from thermofit.core.errors import DataError
from thermofit.read.formats import flir_frame, optris
from thermofit.read.formats.contents import ThermalFrames
from thermofit.read.formats.registry import format_of, head_of, read_native

IMAGE = 27.0 + np.arange(3 * 8).reshape(3, 8) * 0.3


def snapshot(image: np.ndarray, decimals: int = 1) -> bytes:
    rows = (",".join(f"{value:.{decimals}f}" for value in row) for row in image)
    return "\n".join(rows).replace(".", ",").encode() + b"\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "snapshot.csv"


def test_one_decimal(path: Path) -> None:
    path.write_bytes(snapshot(IMAGE))
    assert format_of(path) is optris
    frames = read_native(path)
    assert isinstance(frames, ThermalFrames)
    assert frames.values.shape == (1, 3, 8)
    assert frames.values[0] == pytest.approx(IMAGE)
    assert (frames.traits.separator, frames.traits.decimal) == (",", ",")
    assert frames.unit == ""
    assert frames.time is None


def test_two_decimals_with_a_leading_zero(path: Path) -> None:
    path.write_bytes(snapshot(IMAGE + 0.05, 2))
    frames = optris.read(path)
    assert frames.values[0] == pytest.approx(IMAGE + 0.05)


def test_negative_values_keep_their_sign(path: Path) -> None:
    image = IMAGE - 27.5
    path.write_bytes(snapshot(image))
    assert image[0, 0] == -0.5
    assert optris.read(path, image_width=8).values[0] == pytest.approx(image)


@pytest.mark.parametrize(
    "data",
    [
        snapshot(IMAGE - 25.0),  # 2,0,2,3: may be a matrix of whole numbers
        snapshot(IMAGE * 0 + 27.25, 2),  # 27,25: no zero leads the decimals
        b"\n".join([b",".join(b"%d" % (20 + k) for k in range(12))] * 4),
    ],
)
def test_ambiguous_pairs_need_the_width(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    assert format_of(path) is optris
    with pytest.raises(DataError, match=r"snapshot.csv: commas part columns .* or give the width of the image"):
        optris.read(path)
    width = (data.split(b"\n")[0].count(b",") + 1) // 2
    assert optris.read(path, image_width=width).values.shape[2] == width
    with pytest.raises(DataError, match="give another width"):
        optris.read(path, image_width=2 * width)


def test_tables_that_are_no_pairs(path: Path) -> None:
    points = b"\n".join([b",".join(b"%.1f" % (20 + k) for k in range(12))] * 4)
    for data in (points, snapshot(IMAGE).replace(b"\n", b",5\n"), b"1,2\n3,4\n", b"a,b\n"):
        path.write_bytes(data)
        assert not optris.recognises(head_of(path))
    path.write_bytes(points)
    assert format_of(path) is flir_frame


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (snapshot(IMAGE).replace(b"27,3", b"27.3"), "line 1: found other than pairs of whole numbers"),
        (snapshot(IMAGE)[:-6], "line 3: found another number of cells than in line 1"),
        (snapshot(IMAGE).replace(b"27,3", b"27,33"), "commas part columns and may be decimal signs too"),
        (b"words\n", "line 1: found other than pairs"),
    ],
)
def test_defects_are_named(path: Path, data: bytes, sentence: str) -> None:
    path.write_bytes(data)
    with pytest.raises(DataError, match=sentence):
        optris.read(path)


def check_damaged(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survives(optris.read, Path(folder) / "damaged.csv", data)


SEEDS = (snapshot(IMAGE), snapshot(IMAGE + 0.05, 2))


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*SEEDS))
def test_damaged_files(data: bytes) -> None:
    check_damaged(data)


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*SEEDS))
def test_many_damaged_files(data: bytes) -> None:
    check_damaged(data)
