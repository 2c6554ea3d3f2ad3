"""Files made to do harm: nothing of them is run, none leads to another file, none fills the memory."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import tiny
import yaml

from thermofit.core.errors import DataError, StudyError, ThermofitError
from thermofit.read.formats import mat5
from thermofit.read.formats.workbook import read_sheets, sheet_names
from thermofit.records import foreign_hdf5
from thermofit.records.artefact import open_record
from thermofit.records.checkpoint import Checkpoint
from thermofit.stages.inspect import inspect
from thermofit.study.study import load_study

SHEET = b'<?xml version="1.0"?><worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>%s</sheetData></worksheet>'
BOOK = (
    b'<?xml version="1.0"?><workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" '
    b'xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships"><sheets>'
    b'<sheet name="a" sheetId="1" r:id="r1"/></sheets>'
    b"</workbook>"
)
RELATIONS = (
    b'<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r1" '
    b'Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet" Target="worksheets/sheet1.xml"/></Relationships>'
)
CELL = b'<row r="%d"><c r="%s%d"><v>1</v></c></row>'


class Touch:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return Path.touch, (self.mark,)  # type: ignore[return-value]


def workbook(path: Path, rows: bytes, more: bytes = b"") -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "_rels/.rels", RELATIONS.replace(b"/worksheet", b"/officeDocument", 1).replace(b"worksheets/sheet1", b"xl/workbook")
        )
        archive.writestr("xl/workbook.xml", BOOK)
        archive.writestr("xl/_rels/workbook.xml.rels", RELATIONS)
        archive.writestr("xl/worksheets/sheet1.xml", SHEET % rows)
        if more:
            archive.writestr("xl/media/image1.png", more)
    return path


def test_workbooks_that_fill_the_memory_are_refused(tmp_path: Path) -> None:
    good = workbook(tmp_path / "good.xlsx", CELL % (1, b"A", 1) + CELL % (2, b"B", 2))
    assert read_sheets(good)[0].rows == [[1.0, ""], ["", 1.0]] and sheet_names(good) == ["a"]
    far = workbook(tmp_path / "far.xlsx", CELL % (1, b"A", 1) + CELL % (1048576, b"XFD", 1048576))
    large = workbook(tmp_path / "large.xlsx", CELL % (1, b"A", 1), bytes(300 << 20))
    assert large.stat().st_size < 1 << 20
    tracemalloc.start()
    for path, said in ((far, "cells from first to last"), (large, "unpacks to more than 256 MB")):
        with pytest.raises(DataError, match=rf"{path.name}: the workbook .*{said}"):
            read_sheets(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 << 20


def test_workbook_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    path = workbook(tmp_path / "lies.xlsx", CELL % (1, b"A", 1), bytes(300 << 20))
    content = path.read_bytes()
    path.write_bytes(content.replace(struct.pack("<I", 300 << 20), struct.pack("<I", 1000)))
    with pytest.raises(DataError, match="the workbook cannot be opened"):
        read_sheets(path)


def test_matlab_file_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mat5, "LARGEST", 4 << 20)
    one = zlib.compress(struct.pack("<II", 2, 1 << 20) + bytes(1 << 20))
    header = b"MATLAB 5.0 MAT-file".ljust(126) + b"IM"
    path = tmp_path / "a.mat"
    path.write_bytes(header + 8 * (struct.pack("<II", 15, len(one)) + one))
    with pytest.raises(ValueError, match="cut short or too large"):
        list(mat5.variables(path))


def external_link(file: h5py.File, other: Path) -> None:
    file["analysis/values"] = h5py.ExternalLink(str(other), "/secret")


def soft_link(file: h5py.File, other: Path) -> None:
    file["analysis/values"] = h5py.SoftLink("/analysis/plain")


def external_storage(file: h5py.File, other: Path) -> None:
    file["analysis"].create_dataset("values", (4,), "f8", external=[(str(other), 0, 32)])


def virtual(file: h5py.File, other: Path) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource(str(other), "secret", (4,))
    file["analysis"].create_virtual_dataset("values", layout)


@pytest.mark.parametrize(
    ("lead", "said"),
    [
        (external_link, r"'/analysis/values' is a link to file '.*other\.h5'"),
        (soft_link, "'/analysis/values' is a link, expected"),
        (external_storage, "the values of '/analysis/values' lie in other files"),
        (virtual, "the values of '/analysis/values' lie in other files"),
    ],
)
def test_hdf5_leads_to_no_other_file(tmp_path: Path, lead: Callable[[h5py.File, Path], None], said: str) -> None:
    other, path = tmp_path / "other.h5", tmp_path / "a.h5"
    with h5py.File(other, "w") as file:
        file["secret"] = np.arange(4.0)
    with h5py.File(path, "w") as file:
        file.create_group("analysis")["plain"] = np.zeros(4)
        lead(file, other)
    with pytest.raises(DataError, match=said):
        foreign_hdf5.read_foreign(path, "analysis")
    with h5py.File(path, "a") as file:
        file["top"] = h5py.ExternalLink(str(other), "/secret")
    with pytest.raises(DataError, match="'/top' is a link to file"):
        foreign_hdf5.read_foreign(path, "top")


def test_small_hdf5_file_does_not_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign_hdf5, "ROOM", 4 << 20)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("analysis")
        for k in range(8):
            group.create_dataset(str(k), (1 << 20,), "u1", compression="gzip", chunks=(1 << 20,), fillvalue=0)[:] = 0
    with pytest.raises(DataError, match="far more values than it has room for"):
        foreign_hdf5.read_foreign(tmp_path / "a.h5", "analysis")


def test_artefact_of_others_leads_to_no_other_file(tmp_path: Path) -> None:
    from report_runs import fields  # an artefact is made where it is needed

    from thermofit.records.artefact import Dataset, RecordContent, write_record

    path = tmp_path / "verify.h5"
    value = fields()["u"]
    write_record(path, RecordContent("verify", {}, {}, {"u": Dataset(value, "mm", ("time", "point", "component"))}))
    with h5py.File(path, "a") as file:
        del file.attrs["sealed"], file["parameters"]
        file["parameters"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/")
    with pytest.raises(DataError, match="'/parameters' is a link to file"):
        open_record(path)


@pytest.mark.parametrize("name", ["a.pkl", "a.npy", "a.npz", "a.csv", "a.mat", "a.xlsx", "experiment.yaml"])
def test_pickles_are_not_run(tmp_path: Path, name: str) -> None:
    mark = tmp_path / "mark"
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / name
    if name.endswith((".npy", ".npz")):
        save = np.save if name.endswith("npy") else np.savez
        save(path, np.array([Touch(mark)], dtype=object), allow_pickle=True)
    else:
        path.write_bytes(pickle.dumps(Touch(mark)))
    for place in (path, path.parent):
        try:
            inspect(place)
        except ThermofitError as error:
            assert "\n" not in str(error)
    store = Checkpoint(tmp_path / "kept", "key")
    store.put(np.zeros(1), y=np.zeros(1))
    (kept,) = (tmp_path / "kept").glob("*.npz")
    kept.write_bytes(path.read_bytes())
    assert store.get(np.zeros(1)) is None and not mark.exists()


@pytest.mark.parametrize(
    "text", ["!!python/object/apply:os.system ['touch mark']", "!!python/object/new:os.system [touch mark]", "!!python/name:os.system"]
)
def test_yaml_makes_no_objects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.chdir(tmp_path)
    study = tmp_path / "study.yaml"
    study.write_text(f"name: {text}\n", encoding="utf-8")
    with pytest.raises(StudyError):
        load_study(study)
    study = tiny.write(tmp_path, tiny.tree(tmp_path / "run"))
    with pytest.raises(StudyError):
        load_study(study, [f"name={text}"])
    assert not (tmp_path / "mark").exists()


def test_a_study_writes_into_no_folder_of_other_things_unless_the_command_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    for folder in (home, elsewhere, tmp_path / "here"):
        folder.mkdir()
    (home / "link").symlink_to(elsewhere)
    monkeypatch.chdir(tmp_path / "here")

    def study(run_dir: str | None, name: str = "tiny") -> Path:
        tree = {**tiny.tree(home / "run"), "name": name, "run_dir": run_dir}
        path = home / "study.yaml"
        path.write_text(yaml.safe_dump(tree), encoding="utf-8")
        return path

    for good in (None, "runs/a", str(home / "run"), str(tmp_path / "here" / "x")):
        load_study(study(good))
    (elsewhere / "letter.txt").touch()
    for bad in (str(elsewhere), "../elsewhere", "runs/../../elsewhere", str(home / "link")):
        with pytest.raises(StudyError, match=r"key 'run_dir' is .* say it on the command line, --run-dir"):
            load_study(study(bad))
    assert load_study(study(str(elsewhere)), [f"run_dir={elsewhere}"]).run_dir == elsewhere
    for name in ("..", "...", "../a"):
        with pytest.raises(StudyError, match="name"):
            load_study(study(None, name))


EFFECT = """
from pathlib import Path
from thermofit.core.parameters import Param
Path(__file__).with_name("ran").touch()
SLOT, FORMULA, SOURCE = "sensor", "made up", "made up"
PARAMS = (Param("shift.by", "K", 0.0, -5.0, 5.0, 0.1, "shift", probe=0.5),)
def sensor(theta, scene, by):
    return theta + by
"""


def test_first_use_of_an_effect_file_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("THERMOFIT_EFFECTS", raising=False)
    file, study = tmp_path / "shift.py", tiny.write(tmp_path, {**tiny.tree(tmp_path / "run"), "effects": ["shift.py"]})
    code = "import sys; from thermofit.study import paths as f; from thermofit.study.study import load_study; from pathlib import Path\n"
    code += "f.cache_root = lambda: Path(sys.argv[2])\nload_study(sys.argv[1])"

    def said() -> str:
        ran = subprocess.run([sys.executable, "-c", code, str(study), str(tmp_path / "c")], capture_output=True, text=True, check=True)
        return ran.stderr

    file.write_text(EFFECT, encoding="utf-8")
    assert f"first use of the effect file {file}, which key 'effects' of {study} names: it is run as Python code" in said()
    assert (tmp_path / "ran").exists() and not said()
    file.write_text(EFFECT + "\n# edited\n", encoding="utf-8")
    assert str(file) in said()
