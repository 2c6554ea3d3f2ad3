"""Public sets of measured data: where each file lies, its SHA-256, its licence; taken from a local mirror, else downloaded.

The folder `sets` beside this module holds one YAML file for each set: title, use, citation, origins (GitHub project, commit, licence) and
files (local path, size, SHA-256, origin and remote path; none of these two where the file was derived and is in a local mirror only).
"""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

from thermofit.core.digest import file_digest
from thermofit.core.errors import DataError, StudyError
from thermofit.core.files import cache_root
from thermofit.core.yaml_text import parse_yaml
from thermofit.study.errors import near_miss

DATA_VARIABLE = "THERMOFIT_DATA"
"""Environment variable: the folder of measured data. The sets lie in its folder `real`."""
SETS_FOLDER = "real"
_HOST = "https://raw.githubusercontent.com"
_TIMEOUT = 30.0

Downloader = Callable[[str, Path], None]
"""Writes what lies at a URL to a file; OSError where it cannot be had."""


@dataclass(frozen=True)
class Origin:
    """A public GitHub project at a commit, and the licence of its data."""

    project: str
    commit: str
    licence: str


@dataclass(frozen=True)
class SetFile:
    """One file of a set: `path` inside the set, `size` in bytes, `sha256`, `url` (None: derived, only in a local mirror), `note`."""

    path: str
    size: int
    sha256: str
    url: str | None
    note: str = ""


@dataclass(frozen=True)
class DataSet:
    """A set as the package knows it."""

    name: str
    title: str
    use: str
    citation: str
    origins: Mapping[str, Origin]
    files: tuple[SetFile, ...]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    @property
    def licences(self) -> tuple[str, ...]:
        """Licences of the origins, each once."""
        return tuple(dict.fromkeys(origin.licence for origin in self.origins.values()))


@cache
def data_sets() -> Mapping[str, DataSet]:
    """All sets by name."""
    found = sorted(entry.name for entry in (files("thermofit.read") / "sets").iterdir() if entry.name.endswith(".yaml"))
    return {name.removesuffix(".yaml"): _load(name) for name in found}


def _load(file_name: str) -> DataSet:
    tree = parse_yaml((files("thermofit.read") / "sets" / file_name).read_text(encoding="utf-8"), file_name, DataError)
    origins = {key: Origin(**value) for key, value in tree["origins"].items()}
    entries = tuple(
        SetFile(f["path"], f["size"], f["sha256"], _url(origins[f["origin"]], f["remote"]) if "origin" in f else None, f.get("note", ""))
        for f in tree["files"]
    )
    return DataSet(file_name.removesuffix(".yaml"), tree["title"], tree["use"], tree["citation"], origins, entries)


def _url(origin: Origin, remote: str) -> str:
    """Address of a file at its commit, percent-encoded: paths hold blanks, brackets and letters beyond ASCII."""
    return f"{_HOST}/{origin.project}/{origin.commit}/{quote(remote)}"


def data_set(name: str) -> DataSet:
    """The set of that name. StudyError for an unknown one, with the near miss."""
    known = data_sets()
    if name not in known:
        raise StudyError(f"there is no data set '{name}'{near_miss(name, known)}")
    return known[name]


def mirror_root() -> Path | None:
    """The folder that THERMOFIT_DATA names, None where it names none. StudyError where it is no folder."""
    value = os.environ.get(DATA_VARIABLE)
    if not value:
        return None
    root = Path(value)
    if not root.is_dir():
        raise StudyError(f"{DATA_VARIABLE} is '{value}', which is no folder; set it to the folder that holds '{SETS_FOLDER}', or unset it")
    return root


def download_root() -> Path:
    """Where downloaded sets go when no folder is named."""
    return cache_root() / "data"


def place_of(root: Path, data: DataSet, file: SetFile) -> Path:
    """Where a file of a set lies below a root."""
    return root / SETS_FOLDER / data.name / file.path


def present(root: Path, data: DataSet) -> int:
    """How many files of a set lie below a root with the right size; their content is checked when they are fetched."""
    return sum(1 for file in data.files if _size(place_of(root, data, file)) == file.size)


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else -1


def check(path: Path, file: SetFile) -> None:
    """DataError where a file is not, byte for byte, the one of the registry."""
    found = file_digest(path)
    if found != file.sha256:
        raise DataError(
            f"{path}: the SHA-256 is {found[:12]}..., expected {file.sha256[:12]}... as in the registry of data sets; "
            f"the file was changed or cut short: remove it and fetch it again"
        )


def obtain(data: DataSet, file: SetFile, target: Path | None, download: Downloader | None = None) -> tuple[Path | None, str]:
    """A file of a set, checked: where it lies, and where it came from: "mirror", "there", "downloaded", or "not public" (path None).

    A file of the mirror is taken first, and copied where a `target` root is named. Otherwise what lies below the target (default: the
    cache) is kept, and what does not is downloaded to it. DataError for a wrong hash and where the network does not give the file.
    """
    mirror = mirror_root()
    source = None if mirror is None else place_of(mirror, data, file)
    local = place_of(target or download_root(), data, file)
    if source is not None and source.is_file():
        check(source, file)
        if target is None or local == source:
            return source, "mirror"
        if not local.is_file():
            local.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, local)
        check(local, file)
        return local, "mirror"
    if local.is_file():
        check(local, file)
        return local, "there"
    if file.url is None:
        return None, "not public"
    local.parent.mkdir(parents=True, exist_ok=True)
    _retrieve(file, local, download)
    return local, "downloaded"


def _retrieve(file: SetFile, local: Path, download: Downloader | None) -> None:
    """Download to a temporary name, check the hash, rename: pooch leaves nothing half done behind."""
    import pooch

    def to_file(url: str, output_file: str, _: object) -> None:
        (download or _download)(url, Path(output_file))

    logger = pooch.get_logger()
    level = logger.level
    # pooch reports every file on stderr; the command says it in one line at the end.
    logger.setLevel(logging.WARNING)
    try:
        pooch.retrieve(file.url, f"sha256:{file.sha256}", fname=local.name, path=local.parent, downloader=to_file)
    except ValueError:
        raise DataError(
            f"{file.url}: what was downloaded has another SHA-256 than {file.sha256[:12]}... of the registry of data sets; "
            f"try again, and if it stays so take the set from another mirror by {DATA_VARIABLE}"
        ) from None
    except OSError as error:
        raise DataError(
            f"{file.url}: cannot be downloaded ({_reason(error)}); connect to the network, or let {DATA_VARIABLE} name a folder in which "
            f"'{SETS_FOLDER}' holds the set"
        ) from None
    finally:
        logger.setLevel(level)


def _download(url: str, path: Path) -> None:
    """The real thing; errors of requests are OSError."""
    import pooch

    with path.open("wb") as file:
        pooch.HTTPDownloader(progressbar=False, timeout=_TIMEOUT)(url, file, None)


def _reason(error: OSError) -> str:
    """A few words on why a download failed: answers of a server carry their code, all else is a network that is not there."""
    response = getattr(error, "response", None)
    if response is not None:
        return f"the server answers {response.status_code}"
    return "no connection" if type(error).__module__.startswith("requests") else str(error.strerror or error)
