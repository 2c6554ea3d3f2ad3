"""Digests notice every edit that matters, and nothing else."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from thermofit.core.digest import EFFECTS_VARIABLE, PACKAGE, kernel_digest, of_users, path_digest, source_digest
from thermofit.core.errors import DataError
from thermofit.records.artefact import RecordContent, fresh, write_record


def house(folder: Path) -> Path:
    texts = {
        "core/parameters.py": "E = 1.0",
        "core/files.py": "",
        "study/models.py": "",
        "effects/film.py": "A = 1",
        "point/update.py": "",
        "observe/force.py": "",
        "observe/search.py": "from thermofit.core.jit import kernel",
        "observe/threads.py": "from thermofit.core.jit import set_threads\n",
        "fit/problem.py": "",
    }
    for name, text in texts.items():
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    "name", ["effects/film.py", "point/update.py", "core/parameters.py", "observe/search.py", "body/new.py", "core/new.py"]
)
def test_edit_of_a_possible_kernel_source_changes_the_kernel_digest(tmp_path: Path, name: str) -> None:
    package = house(tmp_path)
    before = kernel_digest(package)
    (package / name).parent.mkdir(exist_ok=True)
    (package / name).write_text("edited = 1")
    assert kernel_digest(package) != before


@pytest.mark.parametrize(
    "name",
    [
        "core/files.py",
        "core/errors_more.py",
        "study/models.py",
        "observe/threads.py",
        "observe/force.py",
        "fit/problem.py",
        "effects/notes.txt",
    ],
)
def test_edit_elsewhere_leaves_the_kernel_digest(tmp_path: Path, name: str) -> None:
    package = house(tmp_path)
    before = kernel_digest(package)
    (package / name).write_text("edited = 1")
    assert kernel_digest(package) == before


def test_moving_code_between_files_is_an_edit(tmp_path: Path) -> None:
    package = house(tmp_path)
    before = kernel_digest(package)
    (package / "effects/film.py").rename(package / "effects/loss.py")
    assert kernel_digest(package) != before


def test_source_digest_knows_rooms() -> None:
    digests = {source_digest(), source_digest(("core",)), source_digest(("effects",))}
    assert len(digests) == 3 and all(len(digest) == 64 for digest in digests)
    assert source_digest(("core", "effects")) == source_digest(("effects", "core"))
    assert PACKAGE.name == "thermofit"


def test_file_digest_is_the_sha256_of_its_bytes(tmp_path: Path) -> None:
    data = bytes(range(256)) * 9000
    (tmp_path / "a.bin").write_bytes(data)
    assert path_digest(tmp_path / "a.bin") == hashlib.sha256(data).hexdigest()


def test_folder_digest_knows_names_contents_and_depth(tmp_path: Path) -> None:
    seen = set()
    for files in ({"a": "1", "b": "2"}, {"a": "2", "b": "1"}, {"a": "1", "c": "2"}, {"a": "1", "d/b": "2"}, {"a": "1"}, {}):
        folder = tmp_path / str(len(seen))
        folder.mkdir()
        for name, text in files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
        seen.add(path_digest(folder))
    assert len(seen) == 6


def test_missing_input_is_a_data_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"input '.*nowhere' cannot be read"):
        path_digest(tmp_path / "nowhere")


def loaded_anew(monkeypatch: pytest.MonkeyPatch, *files: Path) -> None:
    """As in a new process with these effect files."""
    monkeypatch.setenv(EFFECTS_VARIABLE, os.pathsep.join(map(str, files)))
    of_users.cache_clear()


def test_effect_files_of_a_user_are_part_of_both_digests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None, one, the same edited, two, and two in the other order: five sources, each with kernels of its own."""
    package, (one, two) = house(tmp_path / "house"), (tmp_path / "one.py", tmp_path / "two.py")
    one.write_text("A = 1")
    two.write_text("B = 1")
    seen = []
    for files, text in (((), "A = 1"), ((one,), "A = 1"), ((one,), "A = 2"), ((one, two), "A = 2"), ((two, one), "A = 2")):
        one.write_text(text)
        loaded_anew(monkeypatch, *files)
        seen.append((source_digest(), source_digest(("core",)), kernel_digest(package)))
    assert all(len(set(digests)) == 5 for digests in zip(*seen, strict=True))
    one.write_text("A = 1")
    loaded_anew(monkeypatch, one)
    assert (source_digest(), source_digest(("core",)), kernel_digest(package)) == seen[1]


def test_an_edit_of_an_effect_file_while_a_process_runs_is_not_what_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "one.py"
    file.write_text("A = 1")
    loaded_anew(monkeypatch, file)
    before = source_digest()
    file.write_text("A = 2")
    assert source_digest() == before, "an artefact that it writes now was made by the old file"
    loaded_anew(monkeypatch, file)
    assert source_digest() != before


def test_an_artefact_is_stale_once_an_effect_file_of_the_user_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, path = tmp_path / "one.py", tmp_path / "verify.h5"
    file.write_text("A = 1")
    loaded_anew(monkeypatch, file)
    write_record(path, RecordContent(stage="verify", config={}, inputs={}, datasets={}, parameters={}, summary={"stage": "verify"}))
    assert fresh(path, "verify", {}, {})
    file.write_text("A = 2")
    loaded_anew(monkeypatch, file)
    assert not fresh(path, "verify", {}, {})
    loaded_anew(monkeypatch)
    assert not fresh(path, "verify", {}, {}), "without the file it is another model as well"


def test_results_among_the_data_are_no_data(tmp_path: Path) -> None:
    """A run folder may lie in the raw folder; a raw folder in the run folder is one all the same."""
    raw = tmp_path / "raw"
    (raw / "run").mkdir(parents=True)
    (raw / "force.csv").write_text("1")
    before = path_digest(raw, without=raw / "run")
    (raw / "run" / "interpolate.h5").write_text("2")
    assert path_digest(raw, without=raw / "run") == before != path_digest(raw)
    (raw / "force.csv").write_text("3")
    assert path_digest(raw, without=raw / "run") != before
    assert path_digest(raw, without=tmp_path) == path_digest(raw, without=raw) == path_digest(raw)


def test_effect_files_are_named_before_kernels_are_loaded_or_not_at_all(tmp_path: Path) -> None:
    """In a process of its own: this one has kernels."""
    code = (
        "import os, sys; from pathlib import Path; from thermofit.core.digest import effect_files, use_effect_files; "
        "one, two = [Path(name) for name in sys.argv[1:]]; assert use_effect_files([one]) and effect_files() == (one,); "
        "import thermofit.core.jit; assert use_effect_files([one]); assert not use_effect_files([two]) and effect_files() == (one,)"
    )
    files = [tmp_path / "one.py", tmp_path / "two.py"]
    for file in files:
        file.write_text("A = 1")
    environment = {key: value for key, value in os.environ.items() if key != EFFECTS_VARIABLE}
    done = subprocess.run([sys.executable, "-c", code, *map(str, files)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
