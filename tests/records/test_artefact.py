"""Artefacts: round trip, self-description, freshness, damage, and a writer killed at any moment."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import string
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from thermofit.core.errors import DataError, NumericsError, StudyError
from thermofit.records import artefact
from thermofit.records.artefact import Dataset, ParameterResult, RecordContent, fresh, of_parameters, open_record, read_record, write_record

MADE_BY = "thermofit interpolate study.yaml"
RESULT = ParameterResult(68396.66, 12.5, "MPa", True, False, 60000.0, 30000.0, 150000.0)


def content(folder: Path, **changes: object) -> RecordContent:
    raw = folder / "force.csv"
    if not raw.exists():
        raw.write_text("time_s,force_N\n0,0\n")
    given = {
        "stage": "interpolate",
        "config": {"name": "b1", "window": {"abs_x_max": np.float64(11.0)}, "times": (0.0, 1.5), "path": Path("a/b")},
        "inputs": {"force": raw},
        "datasets": {"fields/u": Dataset(np.arange(6.0).reshape(2, 3), "mm", ("time", "node"))},
        "parameters": {"E": RESULT, "nu": ParameterResult(0.34, None, "1", False, False, 0.34, 0.0, 0.499)},
        "summary": {"verdict": "done", "channels": {"u": {"n": np.int64(6), "chi2_reduced": float("nan")}}},
        "seed": 7,
    }
    return RecordContent(**{**given, **changes})  # type: ignore[arg-type]


def test_record_comes_back_with_its_provenance(tmp_path: Path) -> None:
    write_record(tmp_path / "run" / "interpolate.h5", content(tmp_path))
    record = read_record(tmp_path / "run" / "interpolate.h5", "interpolate", MADE_BY)
    assert record.config == {"name": "b1", "window": {"abs_x_max": 11.0}, "times": [0.0, 1.5], "path": "a/b"}
    assert record.summary == {"verdict": "done", "channels": {"u": {"n": 6, "chi2_reduced": None}}}
    json.dumps(record.summary, allow_nan=False)
    assert record.parameters["E"] == RESULT
    assert record.parameters["nu"].sigma is None
    assert record.attributes["seed"] == 7
    assert set(record.attributes["packages"]) == {"python", "numpy", "scipy", "numba", "h5py", "nlopt"}
    assert record.attributes["packages"]["numpy"] == np.__version__
    assert record.attributes["created"].endswith("+00:00")
    assert len(record.inputs["force"]) == 64
    assert record.names == ("fields/u",)
    assert record.has("fields/u") and not record.has("fields") and not record.has("parameters/E")
    assert record["fields/u"].unit == "mm" and record["fields/u"].dims == ("time", "node")
    np.testing.assert_array_equal(record["fields/u"].value, np.arange(6.0).reshape(2, 3))
    assert list((tmp_path / "run").iterdir()) == [tmp_path / "run" / "interpolate.h5"]


def test_entries_with_units_of_their_own(tmp_path: Path) -> None:
    """A covariance has no single unit: an entry has the product of the units of its two places."""
    covariance = of_parameters(np.eye(2), ("parameter", "parameter"), ("MPa", "1"))
    found = write_record(tmp_path / "a.h5", content(tmp_path, datasets={"covariance": covariance}))["covariance"]
    assert (found.unit, found.units, found.dims) == ("mixed", ("MPa", "1"), ("parameter", "parameter"))
    assert artefact.layout(open_record(tmp_path / "a.h5"))["covariance"].units == ("MPa", "1")
    with h5py.File(tmp_path / "a.h5") as file:
        assert json.loads(file["covariance"].attrs["units"]) == ["MPa", "1"]


@pytest.mark.parametrize(
    "data",
    [
        Dataset(np.eye(2), "mixed", ("parameter", "parameter")),
        Dataset(np.eye(2), "MPa", ("parameter", "parameter"), ("MPa", "1")),
        Dataset(np.eye(2), "mixed", ("parameter", "parameter"), ("MPa",)),
        Dataset(np.eye(2), "mixed", ("time", "node"), ("MPa", "1")),
    ],
)
def test_units_of_entries_must_fit(tmp_path: Path, data: Dataset) -> None:
    with pytest.raises(ValueError, match="needs the units of its parameters"):
        write_record(tmp_path / "a.h5", content(tmp_path, datasets={"covariance": data}))


def test_paths_in_the_folder_of_an_artefact_go_with_it(tmp_path: Path) -> None:
    """A copied run folder speaks of itself; what lies outside stays where it is, and names that only begin alike are others."""
    old, new = tmp_path / "run", tmp_path / "copy"
    (old / "raw").mkdir(parents=True)
    (old / "raw" / "force.csv").write_text("1")
    (tmp_path / "part.h5").write_text("1")
    text = f"written to {old}: see '{old}/a.png', not {old}2/b.png or {old}.old"
    summary = {"figures": [str(old / "figures" / "a.png")], "of": {"b": str(old)}, "verdict": text}
    inputs = {"raw": old / "raw", "force": content(tmp_path).inputs["force"], "part": tmp_path / "part.h5"}
    write_record(old / "a.h5", content(tmp_path, summary=summary, inputs=inputs))
    assert open_record(old / "a.h5").summary == summary
    shutil.copytree(old, new)
    record = open_record(new / "a.h5")
    assert record.summary["figures"] == [str(new / "figures" / "a.png")] and record.summary["of"] == {"b": str(new)}
    assert record.summary["verdict"] == f"written to {new}: see '{new}/a.png', not {old}2/b.png or {old}.old"
    assert record.attributes["input_paths"] == {
        "raw": str(new / "raw"), "force": str(inputs["force"]), "part": str(tmp_path / "part.h5")
    }  # fmt: skip


def test_file_describes_itself_to_any_hdf5_reader(tmp_path: Path) -> None:
    write_record(tmp_path / "a.h5", content(tmp_path))
    with h5py.File(tmp_path / "a.h5") as file:
        assert file.attrs["schema"] == "thermofit" and file.attrs["schema_version"] == 1
        assert file["fields/u"].attrs["dims"] == "time node"
        assert file["parameters/E"].attrs["unit"] == "MPa" and file["parameters/E"][()] == 68396.66


ARRAYS = hnp.arrays(
    st.one_of(
        hnp.boolean_dtypes(),
        hnp.integer_dtypes(),
        hnp.unsigned_integer_dtypes(),
        hnp.floating_dtypes(sizes=(32, 64)),
        hnp.complex_number_dtypes(),
    ),
    hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5),
)
TEXTS = hnp.arrays(
    object,
    hnp.array_shapes(min_dims=0, max_dims=2, min_side=0, max_side=4),
    elements=st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=8),
).map(lambda array: array.astype(str))


UNITS = st.text(string.ascii_letters + "/^ ()0123456789", min_size=1)
NAMES = st.from_regex(r"[a-z_]{1,6}(/[a-z_]{1,6})?", fullmatch=True)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(value=ARRAYS | TEXTS, unit=UNITS, name=NAMES)
def test_any_array_comes_back(tmp_path: Path, value: np.ndarray, unit: str, name: str) -> None:
    dims = tuple(f"axis{i}" for i in range(value.ndim))
    write_record(tmp_path / "a.h5", content(tmp_path, datasets={name: Dataset(value, unit, dims)}))
    back = open_record(tmp_path / "a.h5")[name]
    assert (back.unit, back.dims, back.value.shape) == (unit, dims, value.shape)
    native = value.dtype.newbyteorder("=")
    assert back.value.dtype.newbyteorder("=") == native or native.kind == back.value.dtype.kind == "U"
    np.testing.assert_array_equal(back.value, value)


def test_large_frames_come_back_and_are_stored_by_frame(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).normal(297.0, 0.02, (5, 300, 250)).astype(np.float32)
    frames[0, 0, :] = np.nan
    write_record(tmp_path / "a.h5", content(tmp_path, datasets={"frames": Dataset(frames, "K", ("frame", "row", "col"))}))
    np.testing.assert_array_equal(open_record(tmp_path / "a.h5")["frames"].value, frames)
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["frames"].chunks == (1, 300, 250)


def test_large_config_and_summary_fit(tmp_path: Path) -> None:
    log = [{"evaluation": i, "x": [float(i)] * 6} for i in range(5000)]
    write_record(tmp_path / "a.h5", content(tmp_path, summary={"log": log}))
    assert open_record(tmp_path / "a.h5").summary == {"log": log}


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("u", Dataset(np.zeros(3), "", ("time",))),
        ("u", Dataset(np.zeros((3, 2)), "mm", ("time",))),
        ("u", Dataset(np.zeros(3), "mm", ("the time",))),
        ("parameters/E", Dataset(np.zeros(3), "mm", ("time",))),
        ("/u", Dataset(np.zeros(3), "mm", ("time",))),
        ("u", Dataset(np.array([object()]), "mm", ("time",))),
        ("u", Dataset(np.array(["2024-01-01"], dtype="datetime64[s]"), "s", ("time",))),
    ],
)
def test_content_that_no_reader_could_trust_is_refused_and_nothing_is_left(tmp_path: Path, name: str, data: Dataset) -> None:
    with pytest.raises(ValueError):
        write_record(tmp_path / "run" / "a.h5", content(tmp_path, datasets={name: data}))
    assert not list(tmp_path.glob("run/*"))


def test_parameter_that_is_no_number_is_refused(tmp_path: Path) -> None:
    bad = ParameterResult(float("nan"), None, "MPa", True, False, 1.0, 0.0, 2.0)
    with pytest.raises(NumericsError, match="parameter E came out as nan"):
        write_record(tmp_path / "a.h5", content(tmp_path, parameters={"E": bad}))


def test_fresh_only_while_config_input_source_and_stage_are_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, made = tmp_path / "a.h5", content(tmp_path)
    assert not fresh(path, made.stage, made.config, made.inputs)
    write_record(path, made)
    assert fresh(path, made.stage, made.config, made.inputs)
    assert not fresh(path, "verify", made.config, made.inputs)
    assert not fresh(path, made.stage, {**made.config, "name": "b2"}, made.inputs)
    assert not fresh(path, made.stage, made.config, {})
    assert not fresh(path, made.stage, made.config, {**made.inputs, "dic": tmp_path / "missing"})
    with monkeypatch.context() as patch:
        patch.setattr(artefact, "source_digest", lambda: "edited")
        assert not fresh(path, made.stage, made.config, made.inputs)
    made.inputs["force"].write_text("time_s,force_N\n0,1\n")
    assert not fresh(path, made.stage, made.config, made.inputs)


def test_fresh_sees_a_change_inside_a_raw_folder(tmp_path: Path) -> None:
    raw = tmp_path / "raw"
    (raw / "ir").mkdir(parents=True)
    (raw / "ir" / "0001.csv").write_text("1;2\n")
    made = content(tmp_path, inputs={"raw": raw})
    write_record(tmp_path / "a.h5", made)
    (raw / ".DS_Store").write_text("left by a file browser")
    assert fresh(tmp_path / "a.h5", made.stage, made.config, made.inputs)
    (raw / "ir" / "0001.csv").rename(raw / "ir" / "0002.csv")
    assert not fresh(tmp_path / "a.h5", made.stage, made.config, made.inputs)


def test_missing_artefact_names_the_command_that_makes_it(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"'.*interpolate.h5' of 'interpolate' is missing: run `thermofit interpolate study.yaml` first"):
        read_record(tmp_path / "interpolate.h5", "interpolate", MADE_BY)


def test_damaged_or_foreign_files_are_data_errors(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_record(path, content(tmp_path, datasets={"u": Dataset(np.zeros(50000), "mm", ("node",))}))
    whole = path.read_bytes()
    for size in (0, 1, 200, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(DataError, match=r"a\.h5"):
            read_record(path, "interpolate", MADE_BY)
        assert not fresh(path, "interpolate", {}, {})
    path.write_text("no HDF5 at all")
    with pytest.raises(DataError, match="cannot be read as an artefact"):
        open_record(path)
    path.write_bytes(whole)
    with pytest.raises(DataError, match=r"of stage 'interpolate', expected 'calibrate-ir': run `thermofit calibrate-ir s.yaml` again"):
        read_record(path, "calibrate-ir", "thermofit calibrate-ir s.yaml")


def spoil_schema(file: h5py.File) -> None:
    file.attrs["schema"] = "other"


def spoil_version(file: h5py.File) -> None:
    file.attrs["schema_version"] = 2


def spoil_unit(file: h5py.File) -> None:
    del file["fields/u"].attrs["unit"]


def spoil_dims(file: h5py.File) -> None:
    file["fields/u"].attrs["dims"] = "time"


def spoil_config(file: h5py.File) -> None:
    file.attrs["config"] = "{"


def spoil_inputs(file: h5py.File) -> None:
    del file.attrs["inputs"]


def spoil_parameter(file: h5py.File) -> None:
    del file["parameters/E"].attrs["sigma"]


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (spoil_schema, "without the schema"),
        (spoil_version, "schema version 2, this thermofit reads version 1"),
        (spoil_unit, "'/fields/u' has no unit"),
        (spoil_dims, "has 2 axes, but 1 names"),
        (spoil_config, "attribute 'config' is no JSON"),
        (spoil_inputs, "without the attribute 'inputs'"),
        (spoil_parameter, "sigma"),
    ],
)
def test_artefact_edited_by_hand_is_a_data_error(tmp_path: Path, spoil: object, text: str) -> None:
    write_record(tmp_path / "a.h5", content(tmp_path))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        spoil(file)  # type: ignore[operator]
        del file.attrs["sealed"]  # as earlier versions wrote them
    with pytest.raises(DataError, match=text) as caught:
        read_record(tmp_path / "a.h5", "interpolate", MADE_BY)
    assert "\n" not in str(caught.value)


def test_turned_bit_is_noticed_wherever_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    record = write_record(path, content(tmp_path))
    whole = path.read_bytes()
    for place in range(0, len(whole), max(len(whole) // 300, 1)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :])
        with pytest.raises(DataError, match=r"a\.h5: (its content is not what was written|cannot be read)") as caught:
            read_record(path, "interpolate", MADE_BY)
        assert "\n" not in str(caught.value) and not fresh(path, "interpolate", {}, {})
        with pytest.raises(DataError):
            record["fields/u"]
    path.write_bytes(whole)
    assert open_record(path).stage == "interpolate"
    with h5py.File(path, "r+") as file:  # an editor takes the seal away
        file.attrs["stage"] = "verify"
    with pytest.raises(DataError, match="its content is not what was written"):
        open_record(path)


def test_asking_for_an_unknown_or_a_replaced_dataset_is_a_data_error(tmp_path: Path) -> None:
    record = write_record(tmp_path / "a.h5", content(tmp_path))
    with pytest.raises(DataError, match=r"no dataset 'theta'.*it holds fields/u"):
        record["theta"]
    write_record(tmp_path / "a.h5", content(tmp_path))
    with pytest.raises(DataError, match="written anew while it was in use"):
        record["fields/u"]


def test_interrupt_while_writing_leaves_the_old_artefact_and_no_rubbish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_record(tmp_path / "run" / "a.h5", content(tmp_path, seed=1))

    def interrupted(value: np.ndarray) -> dict[str, object]:
        raise KeyboardInterrupt

    monkeypatch.setattr(artefact, "storage_of", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_record(tmp_path / "run" / "a.h5", content(tmp_path, seed=2))
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["a.h5"]
    assert open_record(tmp_path / "run" / "a.h5").attributes["seed"] == 1


def test_folder_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("a file, where a folder is expected")
    with pytest.raises(StudyError, match=r"artefact '.*' cannot be written"):
        write_record(tmp_path / "run" / "a.h5", content(tmp_path))


FULL_DISK = """
import resource, sys
import numpy as np
from pathlib import Path
from thermofit.records.artefact import Dataset, RecordContent, write_record
from thermofit.core.errors import StudyError

resource.setrlimit(resource.RLIMIT_FSIZE, (2000000, 2000000))
try:
    write_record(Path(sys.argv[1]), RecordContent("interpolate", {}, {}, {"u": Dataset(np.zeros(1000000), "mm", ("node",))}))
except StudyError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are a matter of POSIX")
def test_full_disk_is_one_sentence_and_leaves_the_old_artefact(tmp_path: Path) -> None:
    path = tmp_path / "run" / "a.h5"
    write_record(path, content(tmp_path))
    done = subprocess.run([sys.executable, "-c", FULL_DISK, str(path)], env=_environment(), capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "cannot be written" in done.stdout and done.stdout.count("\n") == 1
    assert open_record(path).attributes["seed"] == 7
    assert [found.name for found in path.parent.iterdir()] == ["a.h5"]


WRITER = """
import sys
import numpy as np
from pathlib import Path
from thermofit.records.artefact import Dataset, RecordContent, write_record

for count in range(1, 100000):
    value = np.full((8, 200, 200), float(count))
    write_record(Path(sys.argv[1]), RecordContent("interpolate", {"count": count}, {}, {"u": Dataset(value, "mm", ("time", "y", "x"))}))
    print(count, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_writer_killed_at_any_moment_leaves_an_intact_artefact(tmp_path: Path) -> None:
    path = tmp_path / "run" / "a.h5"
    chance = random.Random(3)
    partials = 0
    for _ in range(6):
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, env=_environment())
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        record = read_record(path, "interpolate", MADE_BY)
        np.testing.assert_array_equal(record["u"].value, float(record.config["count"]))
        partials += len(list(path.parent.iterdir())) - 1
    write_record(path, content(tmp_path))
    assert [found.name for found in path.parent.iterdir()] == ["a.h5"], f"{partials} partial files were left by the killed writers"


def _environment() -> dict[str, str]:
    package = Path(artefact.__file__).parents[2]
    return {**os.environ, "PYTHONPATH": str(package)}
