"""Public sets of measured data: registry, local mirror, downloads and their hashes, `data list` and `data fetch`."""

from __future__ import annotations

import hashlib
import http.server
import json
import os
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.digest import file_digest
from thermofit.core.errors import DataError, StudyError
from thermofit.read import data_sets as module
from thermofit.read.data_sets import DataSet, Origin, SetFile, data_set, data_sets, obtain, place_of, present
from thermofit.stages import data as stage

CONTENT = b"time,force\n0,1\n"
ROOT = os.environ.get("THERMOFIT_DATA", "")
SETS = (
    "304L-rates-tension",
    "6061T6-temperature-tension",
    "native-format-samples",
    "s235-plate-hole-dic",
    "steel-cyclic-with-temperature",
    "steel-sheet-luders-plc-temperature",
    "tension-necking-dic-images",
)


class _Silent(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """No line for each request."""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """Address of a server of the folder `public`."""
    (tmp_path / "public").mkdir()
    made = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(_Silent, directory=str(tmp_path / "public")))
    thread = threading.Thread(target=made.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{made.server_address[1]}"
    made.shutdown()
    thread.join()
    made.server_close()


@pytest.fixture(autouse=True)
def no_mirror(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the mirror nor the cache of this machine."""
    monkeypatch.delenv("THERMOFIT_DATA", raising=False)
    monkeypatch.setenv("THERMOFIT_CACHE_DIR", str(tmp_path / "cache"))


def made_up(url: str | None, content: bytes = CONTENT) -> DataSet:
    """A set of one file in a folder, whose name holds a blank."""
    file = SetFile("in/a b.csv", len(content), hashlib.sha256(content).hexdigest(), url)
    return DataSet("made-up", "A test", "nothing", "no one", {"here": Origin("x/y", "0" * 40, "MIT")}, (file,))


def call(*arguments: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, result.stdout, result.stderr


def test_registry_names_project_commit_licence_and_hash_of_every_file() -> None:
    assert tuple(data_sets()) == SETS
    for data in data_sets().values():
        assert data.title and data.use and data.citation and data.licences
        assert len({file.path for file in data.files}) == len(data.files) > 0
        for origin in data.origins.values():
            assert origin.project.count("/") == 1
            assert set(origin.commit) <= set("0123456789abcdef") and len(origin.commit) in (7, 40)
        for file in data.files:
            assert len(file.sha256) == 64 and file.size > 0
            assert not file.path.startswith("/") and ".." not in file.path
            assert file.url is None or any(f"/{o.project}/{o.commit}/" in file.url for o in data.origins.values())
    derived = [file.path for data in data_sets().values() for file in data.files if file.url is None]
    assert derived == ["derived_node_displacements_px.csv"]


def test_addresses_are_percent_encoded() -> None:
    urls = [file.url for data in data_sets().values() for file in data.files if file.url]
    assert all(url.isascii() and not set(url) & set(' []"') for url in urls)
    blank = next(url for url in urls if "VirtualImageMatchID" in url)
    assert urlsplit(blank).path.endswith("/Img_Simu_0001.bmp%201.csv")
    assert unquote(blank).endswith("/cbbuaa/FEMU-DIC/4b7fcc0/Demo/VirtualImageMatchID/Img_Simu_0001.bmp 1.csv")


@pytest.mark.parametrize("name", SETS)
def test_mirror_holds_what_the_registry_says(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file of the mirror has the size and SHA-256 of the registry, and the registry knows every file but the notes."""
    root = ROOT
    if not root:
        pytest.skip("THERMOFIT_DATA is not set: the mirror of the real sets is not at hand")
    monkeypatch.setenv("THERMOFIT_DATA", root)
    data = data_set(name)
    if present(Path(root), data) == 0:
        pytest.skip(f"THERMOFIT_DATA holds no real/{name}")
    for file in data.files:
        path, how = obtain(data, file, None)
        assert how == "mirror" and path is not None
        assert path.stat().st_size == file.size
    folder = Path(root) / "real" / name
    there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file() and p.name not in ("README.md", "LICENSE")}
    assert there <= {file.path for file in data.files}


def test_file_is_downloaded_checked_and_kept(server: str, tmp_path: Path) -> None:
    (tmp_path / "public" / "a b.csv").write_bytes(CONTENT)
    data = made_up(f"{server}/a%20b.csv")
    path, how = obtain(data, data.files[0], tmp_path / "to")
    assert (path, how) == (tmp_path / "to" / "real" / "made-up" / "in" / "a b.csv", "downloaded")
    assert path is not None and path.read_bytes() == CONTENT
    (tmp_path / "public" / "a b.csv").unlink()
    assert obtain(data, data.files[0], tmp_path / "to") == (path, "there")
    assert present(tmp_path / "to", data) == 1
    cached, how = obtain(data, data.files[0], None, lambda _, target: target.write_bytes(CONTENT) and None)
    assert (cached, how) == (tmp_path / "cache" / "data" / "real" / "made-up" / "in" / "a b.csv", "downloaded")


def test_wrong_download_leaves_nothing_behind(server: str, tmp_path: Path) -> None:
    (tmp_path / "public" / "a b.csv").write_bytes(CONTENT + b"!")
    data = made_up(f"{server}/a%20b.csv")
    with pytest.raises(DataError, match=r"another SHA-256 .* of the registry"):
        obtain(data, data.files[0], tmp_path / "to")
    assert [p for p in (tmp_path / "to").rglob("*") if p.is_file()] == []


def test_file_that_the_server_does_not_have(server: str, tmp_path: Path) -> None:
    data = made_up(f"{server}/other.csv")
    with pytest.raises(DataError, match=r"other.csv: cannot be downloaded \(the server answers 404\); connect .* THERMOFIT_DATA"):
        obtain(data, data.files[0], tmp_path / "to")


def test_without_a_network_one_sentence(tmp_path: Path) -> None:
    data = made_up("http://127.0.0.1:9/a%20b.csv")
    with pytest.raises(DataError, match=r"cannot be downloaded \(no connection\); connect to the network, or let THERMOFIT_DATA name"):
        obtain(data, data.files[0], tmp_path / "to")


def test_mirror_is_taken_first_and_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = made_up("http://127.0.0.1:9/never")
    mirror = place_of(tmp_path / "mirror", data, data.files[0])
    mirror.parent.mkdir(parents=True)
    mirror.write_bytes(CONTENT)
    monkeypatch.setenv("THERMOFIT_DATA", str(tmp_path / "mirror"))
    assert obtain(data, data.files[0], None) == (mirror, "mirror")
    copy, how = obtain(data, data.files[0], tmp_path / "to")
    assert how == "mirror" and copy == place_of(tmp_path / "to", data, data.files[0]) and copy.read_bytes() == CONTENT
    mirror.write_bytes(CONTENT[:-1])
    with pytest.raises(DataError, match=r"a b.csv: the SHA-256 is .*, expected .* remove it and fetch it again"):
        obtain(data, data.files[0], None)


def test_copy_that_was_changed_is_not_taken(tmp_path: Path) -> None:
    data = made_up("http://127.0.0.1:9/never")
    place = place_of(tmp_path / "to", data, data.files[0])
    place.parent.mkdir(parents=True)
    place.write_bytes(CONTENT.replace(b"1", b"2"))
    with pytest.raises(DataError, match="changed or cut short"):
        obtain(data, data.files[0], tmp_path / "to")


def test_derived_file_is_only_in_a_mirror(tmp_path: Path) -> None:
    data = made_up(None)
    assert obtain(data, data.files[0], tmp_path / "to") == (None, "not public")


def test_mirror_that_is_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("THERMOFIT_DATA", str(tmp_path / "nowhere"))
    code, _, error = call("data", "list")
    assert code == StudyError.exit_code
    assert "THERMOFIT_DATA is" in error and "which is no folder" in error and "Traceback" not in error


def test_list_says_what_is_here(tmp_path: Path) -> None:
    code, out, _ = call("data", "list", "--json")
    assert code == 0
    result = json.loads(out)
    assert [entry["name"] for entry in result["sets"]] == list(SETS)
    s235 = result["sets"][SETS.index("s235-plate-hole-dic")]
    assert (s235["files"], s235["bytes"], s235["licences"], s235["present"]) == (2, 514354, ["CC-BY-4.0"], "no")
    code, out, _ = call("data", "list")
    assert code == 0
    assert "s235-plate-hole-dic" in out and "cite" in out and "derived, only in a local mirror" in out
    assert out.strip().splitlines()[-1].startswith("verdict   7 public sets, 0 complete here; THERMOFIT_DATA is not set")


def test_fetch_says_how_to_point_the_variable(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "public" / "a b.csv").write_bytes(CONTENT)
    data = made_up(f"{server}/a%20b.csv")
    monkeypatch.setattr(module, "data_sets", lambda: {data.name: data})
    monkeypatch.setattr(stage, "data_sets", lambda: {data.name: data})
    code, out, _ = call("data", "fetch", "--to", tmp_path / "to", "--json")
    result = json.loads(out)
    assert code == 0
    assert result["sets"][0]["counts"] == {"mirror": 0, "there": 0, "downloaded": 1, "not public": 0}
    assert result["sets"][0]["folders"] == [str(tmp_path / "to" / "real" / "made-up")]
    assert f"export THERMOFIT_DATA={tmp_path / 'to'}" in result["verdict"]
    monkeypatch.setenv("THERMOFIT_DATA", str(tmp_path / "to"))
    code, out, _ = call("data", "fetch", "made-up")
    assert code == 0
    assert out.splitlines()[-1].endswith(
        f"1 file of 1 set checked by SHA-256, 0 of them downloaded; they lie in {tmp_path / 'to'}/real, which THERMOFIT_DATA names"
    )


def test_fetch_of_an_unknown_set_names_the_near_one() -> None:
    code, _, error = call("data", "fetch", "s235-plate-hole")
    assert code == StudyError.exit_code
    assert error.strip() == "error: there is no data set 's235-plate-hole'; did you mean 's235-plate-hole-dic'?"


def test_fetch_without_a_network_ends_with_exit_code_3(monkeypatch: pytest.MonkeyPatch) -> None:
    data = data_set("s235-plate-hole-dic")
    offline = replace(data, files=tuple(replace(file, url="http://127.0.0.1:9/x") for file in data.files))
    monkeypatch.setattr(module, "data_sets", lambda: {data.name: offline})
    code, out, error = call("data", "fetch", data.name, "--json")
    assert code == DataError.exit_code
    assert json.loads(out)["exit_code"] == DataError.exit_code
    assert "no connection" in error and "Traceback" not in error


@pytest.mark.parametrize("command", ["list", "fetch"])
def test_help_has_an_example(command: str) -> None:
    code, out, _ = call("data", command, "--help")
    assert code == 0
    assert f"thermofit data {command} " in out and "--json" in out


def test_digest_of_a_file(tmp_path: Path) -> None:
    """The registry was made with the same digest."""
    path = tmp_path / "x"
    path.write_bytes(CONTENT)
    assert file_digest(path) == hashlib.sha256(CONTENT).hexdigest()
