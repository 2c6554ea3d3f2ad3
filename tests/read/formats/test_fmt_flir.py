"""FLIR: the sequence of Thermal Studio, single frames of ResearchIR, with and without their headers."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings

from thermofit.core.errors import DataError
from thermofit.read.formats import flir_frame, flir_sequence
from thermofit.read.formats.contents import ThermalFrames
from thermofit.read.formats.registry import format_of, head_of, read_native

IMAGES = 20.0 + np.arange(3 * 2 * 4).reshape(3, 2, 4) / 8.0
PARAMETERS = "Parameters:,Emissivity: ,0.95\n" + "".join(
    f",{name}: ,{value}\n" for name, value in [("Distance", "1 m"), ("Humidity", "50 %")]
)


def sequence(numbers: tuple[int, ...] = (1, 2, 3), parameters: str = PARAMETERS, gap: str = "") -> bytes:
    text = "File:,C:\\data\\Rec_0001.csq\n\n" + parameters
    for number, image in zip(numbers, IMAGES, strict=True):
        for k, row in enumerate(image):
            text += f"Frame {number}" * (k == 0) + "".join(f",{value:.3f}" for value in row) + "\n" + gap
    return text.encode()


def frame(header: str = "", n_column: int = 12) -> bytes:
    rows = 300.0 + np.arange(5 * n_column).reshape(5, n_column) / 16.0
    return (header + "\n".join(",".join(f"{value:.4f}" for value in row) for row in rows) + "\n").encode()


def read(path: Path, data: bytes, module: object) -> ThermalFrames:
    path.write_bytes(data)
    assert format_of(path) is module
    frames = read_native(path)
    assert isinstance(frames, ThermalFrames)
    return frames


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "Rec_000083_12.csv"


@pytest.mark.parametrize("parameters", [PARAMETERS, ""])
@pytest.mark.parametrize("gap", ["", "\n", ",,,,\n"])
def test_sequence(path: Path, parameters: str, gap: str) -> None:
    frames = read(path, sequence(parameters=parameters, gap=gap), flir_sequence)
    assert np.array_equal(frames.values, IMAGES)
    assert frames.unit == ""
    assert frames.time is None
    assert frames.traits.header.get("Emissivity") == ("0.95" if parameters else None)
    assert frames.traits.header["Frames"] == "1..3"
    assert any("neither the unit nor the time" in remark for remark in frames.traits.remarks)


def test_frames_are_sorted_and_gaps_are_counted(path: Path) -> None:
    frames = read(path, sequence((12, 2, 9)), flir_sequence)
    assert np.array_equal(frames.values, IMAGES[[1, 2, 0]])
    assert "8 frame numbers between 2 and 12 are missing" in frames.traits.remarks
    assert any("sorted by number" in remark for remark in frames.traits.remarks)


def test_sequence_with_semicolons_and_decimal_commas(path: Path) -> None:
    data = sequence().replace(b",", b";").replace(b".", b",")
    assert np.array_equal(read(path, data, flir_sequence).values, IMAGES)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.rsplit(b"\n", 2)[0] + b"\n", r"frame 3 has \(1, 4\) rows and columns, frame 1 has \(2, 4\)"),
        (lambda data: data[:-12], r"found 3 values parted by comma, expected 4"),
        (lambda data: data.replace(b"Frame 2", b"Frame 1"), r"frame 1 begins a second time"),
        (lambda data: data.replace(b"Frame 2", b"Fr"), r"found 'Fr' in the first column, expected 'Frame n'"),
        (lambda data: data.replace(b"Frame", b""), r"found no frame with values"),
        (lambda data: data.replace(b"File:", b""), r"line 1: found no 'File:'"),
        (lambda data: data.split(b"Frame 1")[0] + b"Frame 1,a,b\n,c,d\n", r"none of the 4 pixels holds a number"),
    ],
)
def test_defects_of_a_sequence(path: Path, change: Callable[[bytes], bytes], sentence: str) -> None:
    path.write_bytes(change(sequence()))
    with pytest.raises(DataError, match=sentence):
        flir_sequence.read(path)


def test_bare_frame(path: Path) -> None:
    frames = read(path, frame(), flir_frame)
    assert frames.values.shape == (1, 5, 12)
    assert frames.values[0, 1, 1] == 300.8125
    assert frames.unit == ""
    assert frames.time is None
    assert frames.traits.header["frame"] == "12"


def test_frame_below_a_header(path: Path) -> None:
    frames = read(path, frame("Camera:,A655\nDate:,2020-01-01\nTemperature unit:,C\n\n"), flir_frame)
    assert frames.unit == "K"
    assert frames.values[0, 0, 0] == pytest.approx(573.15)
    assert frames.traits.header["Camera"] == "A655"


def test_trailing_separators_and_void_pixels(path: Path) -> None:
    frames = read(path, frame().replace(b"\n", b",\n").replace(b"300.8125", b"NaN"), flir_frame)
    assert frames.values.shape == (1, 5, 12)
    assert frames.traits.missing == 1


def test_counts_of_five_digits_are_no_pairs(path: Path) -> None:
    rows = b"\n".join(b",".join(b"%d" % (12345 + k) for k in range(12)) for _ in range(3))
    assert read(path, rows, flir_frame).values[0, 0, 1] == 12346


@pytest.mark.parametrize(
    "data",
    [
        b"time,force,a,b,c,d,e,f,g,h,i,j\n" + frame(),
        frame(n_column=6),
        frame() + b"1,2,3,4,5,6,7,8,9,10,11,12,13\n" + frame(),
        b"one line of text",
    ],
)
def test_other_tables_are_no_frames(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    assert not flir_frame.recognises(head_of(path))
    assert not flir_sequence.recognises(head_of(path))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.rsplit(b",", 3)[0], r"line 5: found 9 values parted by comma, expected 12"),
        (
            lambda data: data.replace(b"300.", b"x").replace(b"301.", b"x"),
            r"line 1: found no row of more than ten numbers nor 'name:,value'",
        ),
        (lambda data: b"a,b\nc,d\n", "found no row of more than ten numbers"),
        (lambda data: b"Temperature unit:,K\n" + data.replace(b"300.0000", b"-1"), "below absolute zero"),
    ],
)
def test_defects_of_a_frame(path: Path, change: Callable[[bytes], bytes], sentence: str) -> None:
    path.write_bytes(change(frame()))
    with pytest.raises(DataError, match=sentence):
        flir_frame.read(path)


def check_damaged_sequence(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survives(flir_sequence.read, Path(folder) / "damaged.csv", data)


def check_damaged_frame(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survives(flir_frame.read, Path(folder) / "damaged.csv", data)


SEQUENCES = (sequence(), sequence(parameters=""))
FRAMES = (frame(), frame("Camera:,A655\nTemperature unit:,C\n"))


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*SEQUENCES))
def test_damaged_sequences(data: bytes) -> None:
    check_damaged_sequence(data)


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*SEQUENCES))
def test_many_damaged_sequences(data: bytes) -> None:
    check_damaged_sequence(data)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*FRAMES))
def test_damaged_frames(data: bytes) -> None:
    check_damaged_frame(data)


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*FRAMES))
def test_many_damaged_frames(data: bytes) -> None:
    check_damaged_frame(data)
