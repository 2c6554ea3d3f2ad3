"""Files of the wrong kind: every reader refuses what it cannot read, and what is damaged never comes out of the registry as a traceback."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import ModuleType

import pytest
import test_fmt_dice
import test_fmt_flir
import test_fmt_irbis
import test_fmt_ncorr
import test_fmt_optris
import test_fmt_vic
from fuzz import mutations, survives
from hypothesis import HealthCheck, given, settings

from thermofit.core.errors import DataError
from thermofit.read.formats import dice, flir_frame, flir_sequence, irbis, ncorr, optris, vic, vic_mat
from thermofit.read.formats.registry import FORMATS, format_of, read_native

SEEDS: dict[str, tuple[ModuleType, bytes]] = {
    "vic 3d": (vic, test_fmt_vic.SEED_3D),
    "vic mat": (vic_mat, test_fmt_vic.SEED_MAT),
    "ncorr": (ncorr, test_fmt_ncorr.SEED),
    "dice": (dice, test_fmt_dice.BARE),
    "dice with header": (dice, test_fmt_dice.MATCHED),
    "irbis old": (irbis, test_fmt_irbis.old()),
    "irbis new": (irbis, test_fmt_irbis.new()),
    "flir sequence": (flir_sequence, test_fmt_flir.sequence()),
    "flir frame": (flir_frame, test_fmt_flir.frame()),
    "optris": (optris, test_fmt_optris.SEEDS[0]),
}
READERS = tuple({module.__name__: module for module, _ in SEEDS.values()}.values())
STRANGE = {
    "picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 4,
    "archive": b"PK\x03\x04" + bytes(200),
    "prose": b"A letter about the tests of last week, in which nothing is a number.\nKind regards\n",
    "blank lines": b"\n \n\t\n",
    "one number": b"1.5\n",
    "hdf5 signature only": b"\x89HDF\r\n\x1a\n" + bytes(2000) + b"data_dic_save",
    "mat header only": b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM",
}


@pytest.mark.parametrize("name", SEEDS)
def test_each_file_is_recognised_by_one_reader(tmp_path: Path, name: str) -> None:
    module, data = SEEDS[name]
    path = tmp_path / "file.txt"  # the suffix says nothing
    path.write_bytes(data)
    assert format_of(path) is module
    assert module in FORMATS


@pytest.mark.parametrize("name", STRANGE)
@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__.rsplit(".", 1)[-1])
def test_strange_files_are_refused(tmp_path: Path, reader: ModuleType, name: str) -> None:
    path = tmp_path / "strange.csv"
    path.write_bytes(STRANGE[name])
    with pytest.raises(DataError, match=r"strange\.csv"):
        reader.read(path)


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__.rsplit(".", 1)[-1])
def test_files_of_other_formats_are_refused_or_sound(tmp_path: Path, reader: ModuleType) -> None:
    for module, data in SEEDS.values():
        if module is not reader:
            survives(reader.read, tmp_path / "other.csv", data)


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__.rsplit(".", 1)[-1])
def test_absent_files_are_named(tmp_path: Path, reader: ModuleType) -> None:
    with pytest.raises(DataError, match=r"nowhere\.csv"):
        reader.read(tmp_path / "nowhere.csv")


def check_damaged(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        survives(read_native, Path(folder) / "damaged.dat", data)


@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*(data for _, data in SEEDS.values())))
def test_damaged_files_through_the_registry(data: bytes) -> None:
    check_damaged(data)


@pytest.mark.slow
@settings(max_examples=1500, suppress_health_check=[HealthCheck.too_slow])
@given(mutations(*(data for _, data in SEEDS.values())))
def test_many_damaged_files_through_the_registry(data: bytes) -> None:
    check_damaged(data)
