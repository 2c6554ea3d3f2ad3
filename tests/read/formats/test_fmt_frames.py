"""Infrared frames of many files: times from stamps and dates, or from the user, never guessed; sizes and units are checked."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.read.formats import registry
from thermofit.read.formats.clock import Rules
from thermofit.read.formats.contents import Head, ThermalFrames, Traits
from thermofit.read.formats.frames import read_frame_files


def read(path: Path) -> ThermalFrames:
    """A format for these tests: unit;date;times;rows;columns;value."""
    unit, date, times, rows, columns, value = path.read_text().split(";")
    stamps = np.array([float(t) for t in times.split()]) if times else None
    n = 1 if stamps is None else len(stamps)
    frames = np.full((n, int(rows), int(columns)), float(value)) + np.arange(n)[:, None, None]
    return ThermalFrames(Traits("camera", path, remarks=("clipped",)), frames, unit, stamps, date)


@pytest.fixture(autouse=True)
def camera(monkeypatch: pytest.MonkeyPatch) -> None:
    def recognises(head: Head) -> bool:
        return b";" in head.first

    monkeypatch.setattr(registry, "FORMATS", (SimpleNamespace(NAME="camera", recognises=recognises, read=read), *registry.FORMATS))


def files(folder: Path, *texts: str) -> Path:
    folder.mkdir()
    for k, text in enumerate(texts):
        (folder / f"rec_{k + 8}.csv").write_text(text)
    return folder / "*.csv"


def test_frames_of_one_file(tmp_path: Path) -> None:
    sequence, remarks = read_frame_files(files(tmp_path / "a", "degC;;0 0.5 1;2;3;20"), Rules(time_offset_s=2.0), "back")
    assert sequence.time.tolist() == [2.0, 2.5, 3.0]
    assert sequence.frames.shape == (3, 2, 3) and sequence.frames.dtype == np.float32
    np.testing.assert_allclose(sequence.frames[2], 295.15)
    assert remarks == ("camera: 1 files", "clipped")


def test_dates_of_several_files_give_times(tmp_path: Path) -> None:
    texts = ("K;2021-10-12T13:48:50;0;1;1;300", "K;2021-10-12T13:48:49;0;1;1;299", "K;2021-10-12T13:48:52;0.5;1;1;302")
    sequence, remarks = read_frame_files(files(tmp_path / "a", *texts), Rules(), "front")
    assert sequence.time.tolist() == [0.0, 1.0, 3.5]
    assert sequence.frames[:, 0, 0].tolist() == [299.0, 300.0, 302.0]
    assert any("2 frames sorted by time" in remark for remark in remarks)


def test_unknown_times_are_required(tmp_path: Path) -> None:
    pattern = files(tmp_path / "a", *["K;;;1;1;300"] * 3)
    with pytest.raises(DataError, match="3 of 3 frames have no time"):
        read_frame_files(pattern, Rules(), "back")
    assert read_frame_files(pattern, Rules(rate=4.0), "back")[0].time.tolist() == [0.0, 0.25, 0.5]
    pattern = files(tmp_path / "b", "K;yesterday;0;1;1;300", "K;today;0;1;1;300")
    with pytest.raises(DataError, match="2 of 2 frames have no time"):
        read_frame_files(pattern, Rules(), "back")
    pattern = files(tmp_path / "c", *["K;2021-10-12T13:48:50;0;1;1;300"] * 2)
    with pytest.raises(DataError, match=r"the time 0 s is also that of rec_8\.csv"):
        read_frame_files(pattern, Rules(), "back")


@pytest.mark.parametrize(
    ("texts", "rules", "message"),
    [
        (("K;;0;1;2;300", "K;;1;2;2;300"), Rules(), "rec_9.csv: the frame has 2 rows x 2 columns, expected 1 rows x 2 columns"),
        ((";;0;1;2;300",), Rules(), "does not say its unit; give 'unit: degC'"),
        ((";;0;1;2;300",), Rules(unit="mm"), "the values are in mm, expected temperatures"),
        (("mK;;0;1;2;300",), Rules(), "the values are in mK, expected temperatures"),
        (("K;;0;1;2;-1",), Rules(), "found -1 K, which is no temperature"),
        (("K;;0;1;2;nan",), Rules(), "2 pixels have no temperature"),
    ],
)
def test_defects(tmp_path: Path, texts: tuple[str, ...], rules: Rules, message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_frame_files(files(tmp_path / "a", *texts), rules, "back")


def test_unit_of_the_user_is_taken(tmp_path: Path) -> None:
    sequence, _ = read_frame_files(files(tmp_path / "a", ";;0;1;2;68"), Rules(unit="degF"), "back")
    np.testing.assert_allclose(sequence.frames, 293.15)
