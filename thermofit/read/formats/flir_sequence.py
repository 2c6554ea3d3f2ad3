"""FLIR Thermal Studio, Report Studio: a whole sequence in one CSV.

Line 1 is `File:,<path>`, then an optional block `Parameters:,Name:,value`. The cell `Frame n` stands in the first column of the first row
of each frame, all other rows have an empty first column; empty lines may stand anywhere. Neither unit nor time is in the file: time is
frame number by rate.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.contents import Column, Head, ThermalFrames, Traits
from thermofit.read.formats.text import Layout, detect_layout, head_lines, read_text, split_cells
from thermofit.read.formats.thermal_rows import check_some, matrix

NAME = "FLIR Thermal Studio sequence CSV"
_FIRST = re.compile(r'\s*"?File:"?\s*([,;\t])', re.IGNORECASE)
_FRAME = re.compile(r"Frame\s*(\d{1,9})", re.IGNORECASE | re.ASCII)
_WHAT = "a FLIR sequence with 'File:' in line 1 and 'Frame n' in the first column"


def recognises(head: Head) -> bool:
    """Whether line 1 names a file and a row or a parameter of the layout follows."""
    lines = head_lines(head)
    match = _FIRST.match(lines[0]) if lines else None
    if match is None:
        return False
    firsts = [line.split(match.group(1))[0].strip().strip('"') for line in lines[1:] if line.strip()]
    return any(_FRAME.fullmatch(cell) or cell.lower() == "parameters:" for cell in firsts)


def read(path: Path) -> ThermalFrames:
    """All frames in the order of their numbers, values as in the file. DataError for every defect."""
    text = read_text(path, _WHAT)
    match = _FIRST.match(text.lines[0])
    if match is None:
        raise DataError(f"{path}, line 1: found no 'File:', expected {_WHAT}; export the sequence again")
    separator = match.group(1)
    header, frames = _split(text.lines, separator, path)
    rows = [line.split(separator, 1)[1] for frame in list(frames.values())[:1] for _, line in frame if separator in line]
    layout = detect_layout(rows[:200], path, separator)
    numbers = sorted(frames)
    images = [_image(frames[number], path, layout) for number in numbers]
    wrong = next((k for k, image in enumerate(images) if image.shape != images[0].shape), None)
    if wrong is not None:
        raise DataError(
            f"{path}, line {frames[numbers[wrong]][0][0]}: frame {numbers[wrong]} has {images[wrong].shape} rows and columns, frame "
            f"{numbers[0]} has {images[0].shape}, expected the same; export the sequence again"
        )
    values = np.stack(images)
    missing = check_some(values, path)
    remarks = ["neither the unit nor the time of the frames is in the file"]
    if missing:
        remarks.append(f"{missing} pixels hold no number")
    absent = numbers[-1] - numbers[0] + 1 - len(numbers)
    if absent:
        remarks.append(f"{absent} frame numbers between {numbers[0]} and {numbers[-1]} are missing")
    if list(frames) != numbers:
        remarks.append("frames are not in order in the file: sorted by number")
    header |= {"Frames": f"{numbers[0]}..{numbers[-1]}"}
    traits = Traits(NAME, path, text.encoding, separator, layout.decimal, (Column("Frame"),), missing, tuple(remarks), header)
    return ThermalFrames(traits, values, "")


def _split(lines: list[str], separator: str, path: Path) -> tuple[dict[str, str], dict[int, list[tuple[int, str]]]]:
    """Parameters, and the numbered lines of each frame by its number. DataError where no frame is there or one occurs twice."""
    header: dict[str, str] = {}
    frames: dict[int, list[tuple[int, str]]] = {}
    current: list[tuple[int, str]] | None = None
    for number, line in enumerate(lines, start=1):
        first = line.split(separator, 1)[0].strip().strip('"')
        match = _FRAME.fullmatch(first)
        if match is not None:
            frame = int(match.group(1))
            if frame in frames:
                raise DataError(f"{path}, line {number}: frame {frame} begins a second time, expected each once; export the sequence again")
            current = frames.setdefault(frame, [])
        if not line.strip(f'{separator}" \t'):
            continue
        if current is None:
            cells = [cell for cell in split_cells(line, separator) if cell]
            header |= {cells[-2].rstrip(": "): cells[-1]} if len(cells) > 1 else {}
        elif match is None and first:
            raise DataError(f"{path}, line {number}: found {first[:30]!r} in the first column, expected 'Frame n' or nothing; export again")
        else:
            current.append((number, line))
    if not frames or not all(frames.values()):
        raise DataError(f"{path}: found no frame with values, expected {_WHAT}; export the sequence again")
    return header, frames


def _image(frame: list[tuple[int, str]], path: Path, layout: Layout) -> np.ndarray:
    return matrix(frame, path, layout, skip=1)
