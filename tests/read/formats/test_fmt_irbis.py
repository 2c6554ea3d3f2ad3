"""InfraTec IRBIS: sections, the separator and decimal sign of the data alone, units, lock-in, time stamps, clipped pixels."""

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
from thermofit.read.formats import irbis
from thermofit.read.formats.contents import ThermalFrames
from thermofit.read.formats.registry import format_of, read_native

VALUES = np.array([[20.5, 21.25, 22.0], [23.5, 24.75, 25.0]])


def old(unit: str = "\u00b0C", parameter: bool = True) -> bytes:
    """A German `.asc`: decimal commas, tabs, Latin-1, stamps of 1 s."""
    rows = "\r\n".join("\t".join(f"{value:.2f}".replace(".", ",") for value in row) for row in VALUES)
    stamps = "[Parameter]\r\nRecDate=05.03.2019\r\nRecTime=14:07:09\r\n" if parameter else ""
    regions = "[MeasDefs]\r\nP1\t1\t2\r\nKey=9\t3\r\n"
    return f"[Settings]\r\nTempUnit={unit}\r\nImageWidth=3\r\nImageHeight=2\r\n{stamps}{regions}[Data]\r\n{rows}\r\n".encode("latin-1")


def new(content: str = "Amplitude", unit: str = "mK", shot: str = "290,000;310,000") -> bytes:
    """Version 3: announced semicolon and point for the data, decimal commas in the header, a separator at the end of each row."""
    lines = ["[Settings]", "Version=3", "DelimiterValue=0x3B", "CommaValue=0x2E", "LIT.LockInFrequency=7.547", "Params.Rec.Date=2021-10-12"]
    lines += ["Params.Rec.Time=13:48:49.893", "Params.TimeStamp=15753204,12", f"ShotRange={shot}", f"Content={content}", f"TempUnit={unit}"]
    lines += ["ImageWidth=3", "ImageHeight=2", "", "[Data]"] + [";".join(f"{value:.3f}" for value in row) + ";" for row in VALUES]
    return "\n".join(line for line in lines if not line.endswith("=")).encode("latin-1") + b"\n"


def read(path: Path, data: bytes) -> ThermalFrames:
    path.write_bytes(data)
    assert format_of(path) is irbis
    frames = read_native(path)
    assert isinstance(frames, ThermalFrames)
    return frames


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "frame.asc"


def test_old_export_with_decimal_commas(path: Path) -> None:
    frames = read(path, old())
    assert frames.unit == "K"
    assert frames.values == pytest.approx(VALUES[np.newaxis] + 273.15)
    assert (frames.traits.encoding, frames.traits.separator, frames.traits.decimal) == ("latin-1", "\t", ",")
    assert frames.date == "2019-03-05T14:07:09.000"
    assert frames.time is not None
    assert frames.time.tolist() == [0.0]
    assert frames.traits.missing == 0


@pytest.mark.parametrize(("unit", "kelvin"), [("C", VALUES + 273.15), ("K", VALUES), ("\u00b0F", (VALUES + 459.67) / 1.8)])
def test_units_of_temperature(path: Path, unit: str, kelvin: np.ndarray) -> None:
    assert read(path, old(unit)).values[0] == pytest.approx(kelvin)


def test_lock_in_amplitude_is_no_temperature(path: Path) -> None:
    frames = read(path, new())
    assert frames.unit == "mK"
    assert np.array_equal(frames.values[0], VALUES)
    assert frames.date == "2021-10-12T13:48:49.893"
    assert (frames.traits.separator, frames.traits.decimal) == (";", ".")
    assert all(column.meaning != "temperature" for column in frames.traits.columns)
    assert not any("clipped" in remark for remark in frames.traits.remarks)


def test_lock_in_phase_is_in_degrees(path: Path) -> None:
    frames = read(path, new("Phase", "mK"))
    assert frames.unit == "deg"
    assert np.array_equal(frames.values[0], VALUES)


def test_unknown_content_and_unit_are_left_as_they_are(path: Path) -> None:
    frames = read(path, new("Counts", "DL"))
    assert frames.unit == "DL"
    assert any("Content=Counts is no temperature" in remark for remark in frames.traits.remarks)
    frames = read(path, new("", ""))
    assert frames.unit == ""
    assert any("unit is not known" in remark for remark in frames.traits.remarks)
    frames = read(path, new("", "mK"))
    assert frames.unit == "mK"
    assert np.array_equal(frames.values[0], VALUES)


@pytest.mark.parametrize(
    ("shot", "count"),
    [("20,500;30,000", 1), ("20,500;25,000", 2), ("293,650;298,150", 2), ("0,000;100,000", 0)],
)
def test_pixels_at_the_ends_of_the_range_are_counted(path: Path, shot: str, count: int) -> None:
    found = [remark for remark in read(path, new("", "C", shot)).traits.remarks if "suspected clipped" in remark]
    assert [int(remark.split()[0]) for remark in found] == ([count] if count else [])


def test_a_range_that_is_none_is_remarked(path: Path) -> None:
    for shot, words in (("500;600", "most pixels lie outside"), ("5", "is no range"), ("9;1", "is no range")):
        assert any(words in remark for remark in read(path, new("", "C", shot)).traits.remarks)


def test_no_stamp_means_no_time(path: Path) -> None:
    for data in (old(parameter=False), old().replace(b"05.03.2019", b"35.03.2019")):
        frames = read(path, data)
        assert frames.time is None
        assert frames.date == ""
        assert any("no time stamp" in remark for remark in frames.traits.remarks)


def test_regions_are_no_settings(path: Path) -> None:
    frames = read(path, b"[MeasDefs]\nTempUnit=K\t3\nImageWidth=9\t3\n" + old())
    assert frames.values[0] == pytest.approx(VALUES + 273.15)


def test_a_lost_section_line_does_not_lose_the_settings(path: Path) -> None:
    path.write_bytes(new().replace(b"[Settings]\n", b""))
    assert irbis.read(path).unit == "mK"


def test_size_that_is_not_in_the_header_is_remarked(path: Path) -> None:
    frames = read(path, new().replace(b"ImageHeight=2\n", b""))
    assert "the header does not say how large the image is: 2 rows of 3 pixels were found" in frames.traits.remarks


def test_the_announced_separator_holds_against_the_look_of_the_data(path: Path) -> None:
    path.write_bytes(new().replace(b"0x3B", b"0x09"))
    with pytest.raises(DataError, match="line 16: found 1 values parted by tab, expected 3"):
        irbis.read(path)


def test_cells_without_number_are_counted(path: Path) -> None:
    frames = read(path, new().replace(b"24.750", b"***"))
    assert frames.traits.missing == 1
    assert np.isnan(frames.values[0, 1, 1])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.replace(b"[Data]", b"[MeasDefs]"), r"no section \[Data\] found"),
        (lambda data: data.split(b"[Data]")[0] + b"[Data]\n", r"\[Data\] is empty"),
        (lambda data: data.rsplit(b"\n", 2)[0], r"\[Data\] has 1 rows, expected 2 by ImageHeight"),
        (lambda data: data.replace(b";24.750", b""), r"line 17: found 2 values parted by semicolon, expected 3"),
        (lambda data: data.replace(b"ImageWidth=3", b"ImageWidth=4"), r"found 3 values .*, expected 4"),
        (lambda data: data.replace(b"ImageWidth=3", b"ImageWidth=-3"), r"ImageWidth is '-3'"),
        (lambda data: data.replace(b"0x3B", b"semicolon"), r"DelimiterValue is 'semicolon'"),
        (lambda data: data.replace(b"0x3B", b"0x2E"), r"DelimiterValue and CommaValue are both '.'"),
        (lambda data: data.replace(b"0x2E", b"0x3B"), r"CommaValue announces ';'"),
        (lambda data: data.split(b"[Data]")[0] + b"[Data]\nx;x;x\nx;x;x\n", r"none of the 6 pixels holds a number"),
        (lambda data: data.replace(b"Content=Amplitude", b"").replace(b"=mK", b"=C").replace(b"20.500", b"-300"), "below absolute zero"),
    ],
)
def test_defects_are_named(path: Path, change: Callable[[bytes], bytes], sentence: str) -> None:
    path.write_bytes(change(new()))
    with pytest.raises(DataError, match=sentence):
        irbis.read(path)


def test_sample() -> None:
    path = sample("infratec-irbis/QF01_FreqSweep_reverse_Results_0008_Period0001_Amp.txt")
    assert format_of(path) is irbis
    frames = irbis.read(path)
    assert frames.values.shape == (1, 164, 1280)
    assert frames.unit == "mK"
    assert frames.values[0, 0, :3].tolist() == [0.907, 1.458, 0.405]
    assert frames.traits.missing == 0
    assert frames.date == "2021-10-12T13:48:49.893"


def check_damaged(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        frames = survives(irbis.read, Path(folder) / "damaged.asc", data)
    # The header says how large the image is: nothing else passes as long as it says so.
    if frames is not None and b"ImageWidth=3" in data and b"ImageHeight=2" in data and data.count(b"Image") == 2:
        assert frames.values.shape == (1, 2, 3)  # type: ignore[union-attr]


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(old(), new(), new("", "C")))
def test_damaged_files(data: bytes) -> None:
    check_damaged(data)


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(old(), new(), new("", "C")))
def test_many_damaged_files(data: bytes) -> None:
    check_damaged(data)
