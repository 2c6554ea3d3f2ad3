"""Tension tests in MATLAB 5 files, and the reader of the container."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from record_layouts import MATLAB_CELLS, MATLAB_FLAT, MATLAB_PACKED, matlab, matlab_tests, rows

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Content, Records
from thermofit.read.formats.mat5 import variables
from thermofit.read.formats.matlab_tests import NAME
from thermofit.read.formats.registry import read_native

TABLE = np.array(rows())


def read(folder: Path, data: bytes) -> Content:
    path = folder / "tests.mat"
    path.write_bytes(data)
    return read_native(path)


@pytest.mark.parametrize("data", [MATLAB_CELLS, MATLAB_PACKED], ids=["plain", "compressed"])
def test_cell_array_of_structs(tmp_path: Path, data: bytes) -> None:
    records = read(tmp_path, data)
    assert isinstance(records, Records) and records.traits.format == NAME and list(records.tests) == ["GL_A", "GL_B"]
    first, second = records.tests.values()
    assert first.about == pytest.approx({"area": 7.8, "gauge_length": 40.0, "width": 6.0, "thickness": 1.3, "temperature": 373.15})
    np.testing.assert_allclose(first.channels["F"], TABLE[:, 1])
    np.testing.assert_allclose(second.channels["F"], TABLE[:, 1] - 3.0)
    assert any("F0 = -3 N" in remark for remark in second.traits.remarks)
    assert not any("F0 =" in remark for remark in first.traits.remarks)


def test_flat_variables(tmp_path: Path) -> None:
    record = read(tmp_path, MATLAB_FLAT)
    assert isinstance(record, ChannelRecord)
    assert record.about == {"area": 8.34, "gauge_length": 25.0} and record.traits.header["Af"] == "2.3"
    assert [column.meaning for column in record.traits.columns] == ["time", "force", "extension", "displacement"]


def test_repeated_tag_is_numbered(tmp_path: Path) -> None:
    records = read(tmp_path, matlab(matlab_tests(["A", "A"])))
    assert isinstance(records, Records) and list(records.tests) == ["A", "A (2)"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"data": np.array([[1.0]]), "F": np.ones((9, 1)), "t": np.ones((9, 1))}, "no cell array with tests"),
        ({"F": np.ones((9, 1)), "t": np.ones((8, 1))}, "differ in length"),
        ({"F": "text", "t": np.ones((9, 1))}, "no force 'F'"),
        ({"F": np.ones((3, 3)), "t": np.ones((9, 1))}, "no column of numbers"),
    ],
)
def test_wrong_variables_are_one_sentence(tmp_path: Path, content: dict[str, object], words: str) -> None:
    with pytest.raises(DataError, match=words) as caught:
        read(tmp_path, matlab(content))
    assert "tests.mat" in str(caught.value)


def test_truncated_file_is_one_sentence(tmp_path: Path) -> None:
    for data in (MATLAB_CELLS, MATLAB_PACKED):
        with pytest.raises(DataError, match="the MAT file is damaged"):
            read(tmp_path, data[: len(data) - 20])


def test_container_agrees_with_scipy(tmp_path: Path) -> None:
    """Numbers of all kinds, both compressed and not, texts, cells and structs within structs."""
    table = np.arange(24.0).reshape(2, 3, 4)
    content = {"a": table, "b": table.astype(np.uint8), "c": "text", "d": {"x": {"y": 3.5}, "z": np.array([[1, 2]], dtype=np.int16)}}
    for compressed in (False, True):
        path = tmp_path / "all.mat"
        path.write_bytes(matlab(content, compressed))
        found, wanted = dict(variables(path)), scipy.io.loadmat(io.BytesIO(path.read_bytes()))
        for name in ("a", "b"):
            np.testing.assert_array_equal(found[name], wanted[name])  # type: ignore[arg-type]
        assert found["c"] == "text"
        assert found["d"][0]["x"][0]["y"] == 3.5  # type: ignore[index, call-overload]
        np.testing.assert_array_equal(found["d"][0]["z"], [[1, 2]])  # type: ignore[index, call-overload]
