"""Pipes, devices and files without end are refused before they are opened."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import pytest

from thermofit.core.digest import path_digest
from thermofit.core.errors import DataError, StudyError, ThermofitError
from thermofit.core.files import TEXT_LIMIT, check_regular
from thermofit.read.formats.registry import head_of
from thermofit.read.formats.text import read_text
from thermofit.read.raw_text import read_lines
from thermofit.records.artefact import open_record
from thermofit.study.study import load_study

READERS: dict[str, Callable[[Path], object]] = {
    "raw text": lambda path: read_lines(path, "a table"),
    "native text": lambda path: read_text(path, "a table"),
    "recognition": head_of,
    "digest": path_digest,
    "artefact": open_record,
    "study": load_study,
}


@pytest.fixture(autouse=True)
def patience() -> Iterator[None]:
    """A reader that waits for a writer, or reads without end, is stopped."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError("still reading after 10 s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_is_no_file_is_refused(tmp_path: Path, reader: str, kind: str) -> None:
    path = tmp_path / "force.csv"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(ThermofitError, match="a pipe or a device, not a file"):
        READERS[reader](path)


def test_a_link_to_a_file_and_a_folder_pass(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    check_regular(tmp_path / "b", 1)
    check_regular(tmp_path)
    with pytest.raises(FileNotFoundError):
        check_regular(tmp_path / "c")


def test_a_text_that_is_too_long_is_not_read(tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    study.write_text("# x\n" * (TEXT_LIMIT // 4 + 1))
    with pytest.raises(StudyError, match=rf"holds {TEXT_LIMIT + 4} bytes, more than the {TEXT_LIMIT} that are read"):
        load_study(study)
    with pytest.raises(DataError, match="more than the 10 that are read"):
        read_lines(study, "a description", 10)
