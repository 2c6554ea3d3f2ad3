"""HDF5 files of other programmes: MATLAB's conventions are undone, damage and excess become one sentence."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from thermofit.core.errors import DataError
from thermofit.records import foreign_hdf5
from thermofit.records.foreign_hdf5 import foreign_names, read_foreign


def text(group: h5py.Group, name: str, value: str) -> None:
    codes = np.array([[ord(letter)] for letter in value], dtype=np.uint16)
    group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of MATLAB's kind: 512 bytes of its own, then structs, a cell array, texts and an empty matrix."""
    path = tmp_path / "save.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("analysis")
        group.create_dataset("matrix", data=np.arange(6.0).reshape(2, 3))
        text(group, "unit", "mm\u00b2")
        empty = group.create_dataset("nothing", data=np.array([0, 4], dtype=np.uint64))
        empty.attrs["MATLAB_empty"] = np.uint8(1)
        void = group.create_dataset("no_text", data=np.array([0, 0], dtype=np.uint64))
        void.attrs["MATLAB_empty"], void.attrs["MATLAB_class"] = np.uint8(1), np.bytes_("char")
        store = file.create_group("#refs#")
        for k in range(2):
            store.create_dataset(f"m{k}", data=np.full((1, 2), float(k)))
        references = np.array([[store["m0"].ref], [store["m1"].ref]], dtype=h5py.ref_dtype)
        group.create_dataset("cells", data=references)
        group.create_dataset("roi_dic", data=np.zeros(3))
    return path


def test_tree_is_as_matlab_shows_it(path: Path) -> None:
    tree = read_foreign(path, "analysis", skip=lambda name: name.startswith("roi_"))
    assert set(tree) == {"matrix", "unit", "nothing", "no_text", "cells"}
    assert np.array_equal(tree["matrix"], np.arange(6.0).reshape(2, 3).T)
    assert tree["unit"] == "mm\u00b2"
    assert tree["no_text"] == ""
    assert tree["nothing"].shape == (0, 4)
    assert [field.shape for field in tree["cells"]] == [(2, 1), (2, 1)]
    assert [field[0, 0] for field in tree["cells"]] == [0.0, 1.0]
    assert set(foreign_names(path)) == {"analysis", "#refs#"}


def test_missing_variable_is_named(path: Path) -> None:
    with pytest.raises(DataError, match=r"save.mat: no variable 'data_dic_save' in this HDF5 file, found .*analysis"):
        read_foreign(path, "data_dic_save")


def test_truncated_and_foreign_files_are_refused(path: Path) -> None:
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", b"MATLAB 7.3 MAT-file" + bytes(1000)):
        path.write_bytes(damaged)
        with pytest.raises(DataError, match=r"save.mat: cannot be read as HDF5 \(.*\), expected an undamaged file; copy or save it again"):
            read_foreign(path, "analysis")


def test_loop_of_references_ends(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        loop = file["analysis"].create_dataset("loop", shape=(1, 1), dtype=h5py.ref_dtype)
        loop[0, 0] = file["analysis"].ref
    with pytest.raises(DataError, match="claims more than 24 levels"):
        read_foreign(path, "analysis")


def test_more_values_than_the_file_has_room_for_are_refused(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["analysis"].create_dataset("huge", shape=(200_000, 10_000), chunks=(100, 100), dtype=float)
    with pytest.raises(DataError, match="at '/analysis/huge' the file claims more than"):
        read_foreign(path, "analysis")


def test_number_of_objects_is_limited(path: Path) -> None:
    budget = foreign_hdf5.ReadingLimit(path, 10_000, objects=3)
    with h5py.File(path) as file, pytest.raises(DataError, match="objects"):
        foreign_hdf5.tree_of(file["analysis"], budget, lambda name: False, 0)


def test_reference_that_leads_nowhere_and_false_emptiness(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["analysis"].create_dataset("void", shape=(1, 1), dtype=h5py.ref_dtype)
    with pytest.raises(DataError, match="'/analysis/void' holds a reference that leads nowhere"):
        read_foreign(path, "analysis")
    with h5py.File(path, "r+") as file:
        del file["analysis/void"]
        file["analysis/nothing"][...] = [3, 4]
    with pytest.raises(DataError, match="marked as empty, but its shape is"):
        read_foreign(path, "analysis")


def test_soft_link_that_dangles(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["analysis/dangling"] = h5py.SoftLink("/nowhere")
    with pytest.raises(DataError, match="'/analysis/dangling' is a link"):
        read_foreign(path, "analysis")
