"""Damaged copies of a small native file, and what a reader may make of them: a DataError of one sentence or content with sound shapes."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import ChannelRecord, Content, DicSequence, DicStage, Records, ScalarField, ThermalFrames

SEPARATORS = (b";", b",", b"\t", b" ", b"|")
NO_NUMBERS = (
    b"NaN",
    b"Non un numero reale",
    b"",
    b"n. def.",
    b"1e999",
    b"-1#IND",
    b"--",
    b"inf",
    b"1.2.3",
    b"1,5",
    b"1_0",
    b'"',
    b"\xb2",
    b"0",
)
LIMIT_SECONDS = 5.0
"""A small file is read in milliseconds; longer is a hang."""


def _lines(data: bytes) -> list[bytes]:
    return data.split(b"\n")


def _delete_line(data: bytes, rng: random.Random) -> bytes:
    lines = _lines(data)
    del lines[rng.randrange(len(lines))]
    return b"\n".join(lines)


def _repeat_line(data: bytes, rng: random.Random) -> bytes:
    lines = _lines(data)
    lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    return b"\n".join(lines)


def _swap_lines(data: bytes, rng: random.Random) -> bytes:
    lines = _lines(data)
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _repeat_header(data: bytes, rng: random.Random) -> bytes:
    lines = _lines(data)
    lines.insert(rng.randrange(len(lines)), lines[min(rng.randrange(8), len(lines) - 1)])
    return b"\n".join(lines)


def _edit_cell(data: bytes, rng: random.Random) -> bytes:
    """Delete, double, swap or replace one cell of one line."""
    lines = _lines(data)
    k = rng.randrange(len(lines))
    separator = max(SEPARATORS, key=lines[k].count)
    cells = lines[k].split(separator)
    i, j, kind = rng.randrange(len(cells)), rng.randrange(len(cells)), rng.randrange(4)
    if kind == 0:
        del cells[i]
    elif kind == 1:
        cells.insert(j, cells[i])
    elif kind == 2:
        cells[i], cells[j] = cells[j], cells[i]
    else:
        cells[i] = rng.choice(NO_NUMBERS)
    lines[k] = separator.join(cells)
    return b"\n".join(lines)


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _flip(data: bytes, rng: random.Random) -> bytes:
    if not data:
        return data
    k = rng.randrange(len(data))
    return data[:k] + bytes([rng.randrange(256)]) + data[k + 1 :]


def _change_separator(data: bytes, rng: random.Random) -> bytes:
    return data.replace(rng.choice(SEPARATORS), rng.choice(SEPARATORS))


def _change_decimal(data: bytes, rng: random.Random) -> bytes:
    return data.replace(b".", b",")


def _line_ends(data: bytes, rng: random.Random) -> bytes:
    return data.replace(b"\n", rng.choice((b"\r\n", b"\r", b"\n\n")))


def _insert_bytes(data: bytes, rng: random.Random) -> bytes:
    k = rng.randrange(len(data) + 1)
    return data[:k] + rng.choice((b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\x0c", b"\x1a", b"[", b"#", b"\n")) + data[k:]


MUTATIONS: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    *(_delete_line, _repeat_line, _swap_lines, _repeat_header, _edit_cell, _edit_cell, _truncate, _flip, _flip),
    *(_change_separator, _change_decimal, _line_ends, _insert_bytes),
)


def mutate(data: bytes, steps: list[tuple[int, int]]) -> bytes:
    """Apply steps (index of a mutation, seed of its choices) one after the other."""
    for index, seed in steps:
        data = MUTATIONS[index](data, random.Random(seed))
    return data


def mutations(*seeds: bytes) -> st.SearchStrategy[bytes]:
    """Strategy of damaged copies of one of the seeds, one to five damages each."""
    steps = st.lists(st.tuples(st.integers(0, len(MUTATIONS) - 1), st.integers(0, 2**32)), min_size=1, max_size=5)
    return st.builds(mutate, st.sampled_from(seeds), steps)


def _array(values: object, shape: tuple[int, ...]) -> None:
    assert isinstance(values, np.ndarray)
    assert values.shape == shape, f"shape {values.shape}, expected {shape}"
    assert values.dtype.kind in "fi"
    assert not np.isinf(values).any()


def _stage(stage: DicStage) -> None:
    n = len(stage.point_id)
    assert n > 0
    _array(stage.point_id, (n,))
    known = [values for values in (stage.reference, stage.displacement, stage.deformed) if values is not None]
    assert known, "a stage holds coordinates, displacements or both"
    for values in known:
        _array(values, (n, 3))
    for values in stage.strain.values():
        _array(values, (n,))
    assert stage.length_unit in ("mm", "px", ""), stage.length_unit
    assert stage.time is None or np.isfinite(stage.time)
    assert all(np.isfinite(value) for value, _ in stage.signals.values())


def _record(record: ChannelRecord) -> None:
    lengths = {len(values) for values in record.channels.values()}
    assert len(lengths) == 1
    assert lengths.pop() > 0
    for values in record.channels.values():
        _array(values, (len(values),))
    assert set(record.units) == set(record.channels)
    assert all(np.isfinite(value) for value in record.about.values())


def consistent(content: Content) -> None:
    """Assert that the shapes of a content fit together, that nothing is infinite and that counts are no less than zero."""
    assert content.traits.format
    assert content.traits.missing >= 0
    match content:
        case DicStage():
            _stage(content)
        case DicSequence():
            assert content.stages
            for stage in content.stages:
                _stage(stage)
        case ThermalFrames():
            assert content.values.ndim == 3
            assert content.values.size > 0
            _array(content.values, content.values.shape)
            if content.time is not None:
                _array(content.time, content.values.shape[:1])
        case ScalarField():
            assert content.values.ndim == 2
            _array(content.values, content.values.shape)
        case ChannelRecord():
            _record(content)
        case Records():
            assert content.tests
            for record in content.tests.values():
                _record(record)


def survives(read: Callable[[Path], Content], path: Path, data: bytes) -> Content | None:
    """Write `data`, read it, check the outcome: sound content (returned), or a DataError of one sentence that names the file (None)."""
    path.write_bytes(data)
    start = time.perf_counter()
    try:
        content = read(path)
    except DataError as error:
        text = str(error)
        assert path.name in text, text
        assert "\n" not in text, text
        assert len(text) < 1000, text
        return None
    finally:
        assert time.perf_counter() - start < LIMIT_SECONDS
    consistent(content)
    return content
