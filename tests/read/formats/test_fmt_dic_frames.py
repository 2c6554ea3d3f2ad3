"""Tables of many DIC frames: layouts, defects, damaged copies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermofit.core.errors import DataError
from thermofit.read.formats import dic_frames
from thermofit.read.formats.contents import DicSequence
from thermofit.read.formats.registry import format_of, read_native

HEADER = "frame,node,ix,iy,x_ref_px,y_ref_px,u_px,v_px"


def table(frames: int = 3, points: int = 4, header: str = HEADER) -> str:
    rows = (f"{f},{p},0,{p},{10.0 * p},{20.0 + p},{0.5 * f},{-0.25 * f}" for f in range(frames) for p in range(points))
    return "# derived: pixels, y down\n" + header + "\n" + "\n".join(rows) + "\n"


def read_text_of(path: Path, text: str) -> DicSequence:
    path.write_text(text, encoding="utf-8")
    assert format_of(path) is dic_frames
    content = read_native(path)
    assert isinstance(content, DicSequence)
    return content


def test_frames_become_stages(tmp_path: Path) -> None:
    content = read_text_of(tmp_path / "a.csv", table())
    assert [stage.stage for stage in content.stages] == [0, 1, 2]
    last = content.stages[-1]
    assert last.length_unit == "px" and last.displacement is not None and last.reference is not None
    assert np.allclose(last.displacement[:, :2], [1.0, -0.5])
    assert np.allclose(last.reference[2, :2], [20.0, 22.0])
    assert "px: y of an image points down" in content.traits.remarks


def test_units_in_names_in_brackets_or_nowhere(tmp_path: Path) -> None:
    for header, unit in (
        ("stage,point,a,b,x_mm,y_mm,u_mm,v_mm", "mm"),
        ("Frame,Node,a,b,x [mm],y [mm],u [mm],v [mm]", "mm"),
        ("frame,node,a,b,x,y,u,v", ""),
    ):
        assert read_text_of(tmp_path / "a.csv", table(header=header)).stages[0].length_unit == unit


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("1,2,0,2,", "1.5,2,0,2,", "line 9: the frame is 1.5, expected a whole number"),
        ("1,2,0,2,", "one,2,0,2,", "line 9: the frame is nan"),
        ("1,2,0,2,", "1,1,0,2,", "line 9: node 1 occurs a second time"),
        ("v_px", "v_mm", "expected coordinates and displacements in one unit"),
        ("0,0,0,0,", "0,0,0,0,7,7,7,7,7,7,", "expected 8 as in the header"),
    ],
)
def test_defects_are_one_sentence(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table().replace(old, new, 1), encoding="utf-8")
    with pytest.raises(DataError, match=words):
        dic_frames.read(path)


def test_points_lost_in_a_frame_are_missing(tmp_path: Path) -> None:
    content = read_text_of(tmp_path / "a.csv", table().replace("20.0,22.0,0.5,-0.25", "20.0,22.0,NaN,NaN", 1))
    assert content.traits.missing == 1
    moved = content.stages[1].displacement
    assert moved is not None and np.isnan(moved[2, 0])


def damaged_copies(data: st.DataObject, folder: Path) -> None:
    damaged = data.draw(mutations(table().encode(), table(header="frame;node;a;b;x_mm;y_mm;u_mm;v_mm").replace(",", ";").encode()))
    survives(dic_frames.read, folder / "frames.csv", damaged)
    survives(read_native, folder / "frames.csv", damaged)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_damaged_copy(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    damaged_copies(data, tmp_path_factory.getbasetemp())


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_500_damaged_copies(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    damaged_copies(data, tmp_path_factory.getbasetemp())
