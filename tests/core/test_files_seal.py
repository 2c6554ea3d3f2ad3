"""Every turned bit of a sealed file is noticed."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from thermofit.core.files import seal, seal_holds


@pytest.mark.parametrize("content", [b"", b"x", bytes(range(256)) * 9000])
def test_content_as_it_was_sealed(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a"
    path.write_bytes(content)
    assert seal_holds(path) is None
    seal(path)
    assert seal_holds(path) and path.read_bytes().startswith(content)


def test_turned_bits_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(bytes(range(256)))
    seal(path)
    whole = path.read_bytes()
    for place in range(len(whole)):
        bit = 1 << random.Random(place).randrange(8)
        path.write_bytes(whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :])
        assert not seal_holds(path)
    for end in (0, 10, 256, len(whole) - 1):
        path.write_bytes(whole[:end])
        assert not seal_holds(path)
