"""Ncorr: files of version 7.3 that the tests write as MATLAB does (reversed axes, references, texts as codes)."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np
import pytest
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings

from thermofit.core.errors import DataError
from thermofit.read.formats import ncorr
from thermofit.read.formats.contents import DicSequence
from thermofit.read.formats.registry import format_of, head_of, read_native

SHAPE = (4, 6)
SPACING = 3.0
SCALE = 0.05
CUTOFF = 0.5


def put_text(group: h5py.Group, name: str, value: str) -> None:
    codes = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
    group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")


def put_empty(group: h5py.Group, name: str) -> h5py.Dataset:
    stored = group.create_dataset(name, data=np.zeros(2, dtype=np.uint64))
    stored.attrs["MATLAB_empty"] = np.uint8(1)
    return stored


def put_structs(file: h5py.File, group: h5py.Group, fields: Mapping[str, list[np.ndarray | None]]) -> None:
    """A struct array: references to its fields, except for a single struct. None is an empty matrix."""
    for name, values in fields.items():
        if len(values) == 1 and values[0] is not None:
            group.create_dataset(name, data=values[0].T)
            continue
        stored = []
        for k, value in enumerate(values):
            at = f"{group.name.replace('/', '_')}_{name}_{k}"
            store = file.require_group("#refs#")
            stored.append(put_empty(store, at) if value is None else store.create_dataset(at, data=value.T))
        references = np.array([[item.ref] for item in stored], dtype=h5py.ref_dtype)
        group.create_dataset(name, data=references)


def fields(stage: int) -> dict[str, np.ndarray]:
    """Fields of a stage in px: u grows to the right, v downwards; a node outside, a node above the cut-off, a node with u = v = 0."""
    row, column = np.indices(SHAPE, dtype=float)
    u, v, coefficient = 0.1 * stage * (column + 1), 0.2 * stage * (row + 1), np.full(SHAPE, 0.01)
    for field in (u, v, coefficient):
        field[0, 0] = 0.0
    u[1, 2] = v[1, 2] = u[3, 5] = v[3, 5] = 0.0
    coefficient[1, 2] = 0.9
    u[2, 0] = 0.0
    return {"u": u, "v": v, "corrcoef": coefficient}


def write(path: Path | io.BytesIO, n_stage: int = 3, info: Mapping[str, object] = {}, formatted: bool = True) -> None:
    """An analysis as Ncorr saves it; `info` replaces settings."""
    settings_ = {"type": "regular", "units": "mm", "spacing": SPACING, "pixtounits": SCALE, "radius": 20.0, "lenscoef": 0.0}
    settings_ |= {"cutoff_corrcoef": np.full(n_stage, CUTOFF)} | dict(info)
    with h5py.File(path, "w", **({} if isinstance(path, io.BytesIO) else {"userblock_size": 512})) as file:
        file.create_group("reference_save").create_dataset("gs", data=np.zeros((5, 5)))
        save = file.create_group("data_dic_save")
        group = save.create_group("dispinfo")
        for name, value in settings_.items():
            if isinstance(value, str):
                put_text(group, name, value)
            elif value is not None:
                group.create_dataset(name, data=np.atleast_2d(np.asarray(value, dtype=float)))
        stages = [fields(k + 1) for k in range(n_stage)]
        scale = float(settings_["pixtounits"] or 1.0)  # type: ignore[arg-type]
        columns: dict[str, list[np.ndarray | None]] = {f"plot_{name}_dic": [stage[name] for stage in stages] for name in stages[0]}
        for name in ("u", "v"):
            for where in ("ref", "cur"):
                columns[f"plot_{name}_{where}_formatted"] = [scale * stage[name] if formatted else None for stage in stages]
        columns["roi_dic"] = [np.zeros((1, 6), dtype=np.uint32) for _ in stages]
        put_structs(file, save.create_group("displacements"), columns)
        strain = [np.where(stage["u"] == 0, 0.0, 0.01 * (k + 1)) for k, stage in enumerate(stages)]
        put_structs(
            file, save.create_group("strains"), {f"plot_{name}_ref_formatted": [f.copy() for f in strain] for name in ("exx", "eyy", "exy")}
        )
    if isinstance(path, Path):
        data = path.read_bytes()
        path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(512, b"\0") + data[512:])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "analysis.mat"


def read(path: Path) -> DicSequence:
    content = read_native(path)
    assert isinstance(content, DicSequence)
    return content


def node(row: int, column: int) -> int:
    return row * SHAPE[1] + column


def test_stages_on_the_grid_in_mm(path: Path) -> None:
    write(path)
    content = read(path)
    assert content.traits.format == ncorr.NAME
    assert [stage.stage for stage in content.stages] == [1, 2, 3]
    for k, stage in enumerate(content.stages, start=1):
        assert stage.length_unit == "mm"
        assert stage.reference is not None and stage.displacement is not None
        # Node (row 2, column 4) from 0 sits at pixel (1 + 4 * (3 + 1), 1 + 2 * (3 + 1)).
        assert stage.reference[node(2, 4), :2] == pytest.approx([SCALE * 17, SCALE * 9])
        assert stage.displacement[node(2, 4), :2] == pytest.approx([SCALE * 0.5 * k, SCALE * 0.6 * k])
        assert stage.displacement[node(1, 5), :2] == pytest.approx([SCALE * 0.6 * k, SCALE * 0.4 * k])
        assert np.isnan(stage.displacement[:, 2]).all()
        assert stage.strain["exx"][node(2, 4)] == pytest.approx(0.01 * k)
    assert content.traits.header["spacing"] == "3"
    assert content.traits.remarks == ("y and v point down (image rows)", "the file has no time and no force")
    units = {column.meaning: (column.unit, column.source) for column in content.traits.columns}
    assert units["u"] == ("mm", "file")


def test_missing_nodes_are_zero_in_everything_or_above_the_cut_off(path: Path) -> None:
    write(path)
    content = read(path)
    stage = content.stages[0]
    assert stage.displacement is not None
    lost = np.flatnonzero(np.isnan(stage.displacement[:, 0]))
    # (3, 5) has u = v = 0 with a good coefficient, (2, 0) has u = 0 only: both are values.
    assert lost.tolist() == [node(0, 0), node(1, 2)]
    assert stage.displacement[node(3, 5), :2].tolist() == [0.0, 0.0]
    assert stage.displacement[node(2, 0), 0] == 0.0
    assert stage.traits.missing == 2
    assert content.traits.missing == 6
    assert np.isnan(stage.strain["exx"][lost]).all()


def test_single_stage_is_stored_without_references(path: Path) -> None:
    write(path, n_stage=1)
    content = read(path)
    assert len(content.stages) == 1
    assert content.stages[0].traits.missing == 2


def test_raw_fields_where_nothing_was_formatted(path: Path) -> None:
    write(path, info={"units": None, "pixtounits": None, "cutoff_corrcoef": None, "lenscoef": None}, formatted=False)
    content = read(path)
    stage = content.stages[1]
    assert stage.length_unit == "px"
    assert stage.reference is not None and stage.displacement is not None
    assert stage.reference[node(2, 4), :2].tolist() == [17.0, 9.0]
    assert stage.displacement[node(2, 4), :2] == pytest.approx([1.0, 1.2])
    assert any("not formatted" in remark for remark in content.traits.remarks)
    # Without formatting there is no cut-off: only the node outside is missing.
    assert stage.traits.missing == 1


@pytest.mark.parametrize(
    ("units", "length", "factor", "remark"),
    [
        ("in", "mm", 25.4 * SCALE, None),
        ("um", "mm", 1e-3 * SCALE, None),
        ("pixels", "px", 1.0, "pixtounits is 0.05, but the unit is 'pixels'"),
        ("furlong", "px", 1.0, "'furlong' is no known length"),
    ],
)
def test_units(path: Path, units: str, length: str, factor: float, remark: str | None) -> None:
    write(path, info={"units": units})
    content = read(path)
    stage = content.stages[0]
    assert stage.length_unit == length
    assert stage.reference is not None and stage.displacement is not None
    assert stage.displacement[node(2, 4), :2] == pytest.approx([0.5 * factor, 0.6 * factor])
    assert stage.reference[node(2, 4), :2] == pytest.approx([17 * factor, 9 * factor])
    assert remark is None or any(remark in found for found in content.traits.remarks)


def test_backward_analysis(path: Path) -> None:
    write(path, info={"type": "backward"})
    content = read(path)
    # The coefficients belong to another image: the node with u = v = 0 cannot be told from a missing one.
    assert content.stages[0].traits.missing == 3
    assert any("backward" in remark for remark in content.traits.remarks)
    write(path, info={"type": "backward"}, formatted=False)
    with pytest.raises(DataError, match="backward analysis without formatted displacements"):
        read(path)


def test_lens_correction_is_remarked(path: Path) -> None:
    write(path, info={"lenscoef": 1e-9})
    assert any("lens distortion" in remark for remark in read(path).traits.remarks)


def edit(path: Path, action: str) -> None:
    with h5py.File(path, "r+") as file:
        save = file["data_dic_save"]
        if action == "shape":
            target = file[save["displacements/plot_v_ref_formatted"][1, 0]]
            name = target.name
            del file[name]
            file.create_dataset(name, data=np.ones((3, 3)))
            save["displacements/plot_v_ref_formatted"][1, 0] = file[name].ref
        elif action == "stages":
            del save["displacements/plot_v_ref_formatted"]
            put_structs(file, save["displacements"], {"plot_v_ref_formatted": [np.ones(SHAPE)]})
        elif action == "zero":
            for name in ("plot_u_ref_formatted", "plot_v_ref_formatted", "plot_corrcoef_dic"):
                for reference in save["displacements"][name][:, 0]:
                    file[reference][...] = 0.0
        elif action == "nan":
            for reference in save["displacements/plot_u_ref_formatted"][:, 0]:
                file[reference][...] = np.nan
        elif action == "text":
            del save["displacements/plot_u_ref_formatted"]
            put_text(save["displacements"], "plot_u_ref_formatted", "nothing")
        else:
            del save[action]


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        ("shape", r"plot_v_ref_formatted of stage 2 has the shape \(3, 3\), u of stage 1 has \(4, 6\)"),
        ("stages", "plot_v_ref_formatted has 1 stages, u has 3"),
        ("zero", "no node of 3 stages was correlated"),
        ("nan", "no node of 3 stages was correlated"),
        ("text", "plot_u_ref_formatted of stage 1 is no matrix of numbers"),
        ("dispinfo", "data_dic_save.dispinfo is missing or empty"),
        ("displacements", "data_dic_save.displacements is missing or empty"),
        ("dispinfo/spacing", "dispinfo.spacing is missing or no finite number"),
        ("dispinfo/type", "dispinfo.type is '', expected 'regular' or 'backward'"),
    ],
)
def test_defects_are_named(path: Path, action: str, sentence: str) -> None:
    write(path)
    edit(path, action)
    with pytest.raises(DataError, match=sentence):
        ncorr.read(path)


@pytest.mark.parametrize("info", [{"pixtounits": -1.0}, {"spacing": 2.5}, {"spacing": -1.0}, {"pixtounits": 1e12}])
def test_settings_out_of_range(path: Path, info: dict[str, float]) -> None:
    write(path, info=info)
    with pytest.raises(DataError, match=r"dispinfo.(pixtounits|spacing) is"):
        ncorr.read(path)


def test_values_that_overflow_in_mm_are_refused(path: Path) -> None:
    write(path, n_stage=1, info={"units": "m", "pixtounits": 1.0})
    with h5py.File(path, "r+") as file:
        file["data_dic_save/displacements/plot_u_ref_formatted"][2, 2] = 1e307
    with pytest.raises(DataError, match="infinite values of stage 1"):
        ncorr.read(path)


def test_strains_may_be_absent(path: Path) -> None:
    write(path)
    edit(path, "strains")
    assert read(path).stages[0].strain == {}


def test_truncated_and_foreign_files(path: Path) -> None:
    write(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - 2000])
    assert format_of(path) is ncorr
    with pytest.raises(DataError, match="cannot be read as HDF5"):
        ncorr.read(path)
    with h5py.File(path, "w") as file:
        file["other"] = 1.0
    assert not ncorr.recognises(head_of(path))
    with pytest.raises(DataError, match="no variable 'data_dic_save'"):
        ncorr.read(path)


def small_file() -> bytes:
    buffer = io.BytesIO()
    write(buffer, n_stage=2)
    return buffer.getvalue()


SEED = small_file()


def check_damaged(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survives(ncorr.read, Path(folder) / "damaged.mat", data)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(SEED))
def test_damaged_files(data: bytes) -> None:
    check_damaged(data)


@pytest.mark.slow
@settings(max_examples=500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(SEED))
def test_many_damaged_files(data: bytes) -> None:
    check_damaged(data)
