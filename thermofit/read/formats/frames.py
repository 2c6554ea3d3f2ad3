"""Files of an infrared camera -> one InfraredSequence in K: one file for each frame, or one file that holds them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.experiment import InfraredSequence
from thermofit.core.units import to_fixed
from thermofit.read.formats.clock import Member, Rules, files_of, set_clock
from thermofit.read.formats.contents import ThermalFrames
from thermofit.read.formats.naming import stage_time
from thermofit.read.formats.registry import format_of


@dataclass(frozen=True)
class _Frame:
    """One image K (n_row, n_col), its file, number and time s."""

    member: Member
    image: np.ndarray


def read_frame_files(pattern: Path, rules: Rules, side: str) -> tuple[InfraredSequence, tuple[str, ...]]:
    """All frames of the files of a pattern, a folder or one file, in the order of time, and remarks.

    DataError for every defect of a file, for several formats or sizes of frames, for units that are no temperature, for unknown times.
    """
    paths = files_of(pattern, "exports of an infrared camera")
    first = format_of(paths[0])
    contents, said = [], dict.fromkeys([f"{first.NAME}: {len(paths)} files"])
    for path in paths:
        module = format_of(path)
        if module is not first:
            raise DataError(f"{path}: this is {module.NAME}, but {paths[0].name} is {first.NAME}, expected files of one format; part them")
        content = module.read(path)
        if not isinstance(content, ThermalFrames):
            raise DataError(f"{path}: this is {module.NAME}, expected frames of an infrared camera; correct the pattern of the files")
        said |= dict.fromkeys(content.traits.remarks)
        # Single precision at once: a sequence of a thousand images in double would not fit into memory.
        contents.append(replace(content, values=_kelvin(content, rules).astype(np.float32), unit="K"))
    frames = _frames(contents)
    sizes = {frame.image.shape for frame in frames}
    if len(sizes) > 1:
        odd = next(frame for frame in frames if frame.image.shape != frames[0].image.shape)
        found, wanted = ("{} rows x {} columns".format(*image.shape) for image in (odd.image, frames[0].image))
        raise DataError(f"{odd.member.path}: the frame has {found}, expected {wanted} as in the first; export all frames with one window")
    clock = set_clock([frame.member for frame in frames], rules, "frame")
    values = np.stack([frames[k].image for k in clock.order])
    missing = int(np.isnan(values).sum())
    if missing:
        raise DataError(f"{pattern}: {missing} pixels have no temperature, expected a number in every one; export the frames again")
    if values.min() <= 0.0:
        raise DataError(f"{pattern}: found {values.min():g} K, which is no temperature; correct 'unit' or export temperatures")
    return InfraredSequence(clock.time, values, side), (*said, *clock.remarks)


def _frames(contents: Sequence[ThermalFrames]) -> list[_Frame]:
    """All images with what is known of their times: stamps inside a file, dates of several files."""
    start = _starts(contents)
    frames = []
    for k, content in enumerate(contents):
        path, n = content.traits.path, len(content.values)
        number, said = stage_time(path)
        for i in range(n):
            time = said if content.time is None else None if start[k] is None else float(content.time[i]) + float(start[k] or 0.0)
            frames.append(_Frame(Member(path, number if n == 1 else i, time), content.values[i]))
    return frames


def _starts(contents: Sequence[ThermalFrames]) -> list[float | None]:
    """Seconds from the first file's date to each file's; None where dates differ and are no dates. Zero where there is none to differ."""
    if len({content.date for content in contents}) == 1:
        return [0.0] * len(contents)
    try:
        stamps = [datetime.fromisoformat(content.date) for content in contents]
        return [(stamp - min(stamps)).total_seconds() for stamp in stamps]
    except (ValueError, TypeError):  # no dates, or some with and some without a time zone
        return [None] * len(contents)


def _kelvin(content: ThermalFrames, rules: Rules) -> np.ndarray:
    """Images in K. DataError where the unit is not known or is none of a temperature."""
    if content.unit == "K":
        return content.values
    unit = content.unit or rules.unit
    if not unit:
        raise DataError(f"{content.traits.path}: the file does not say its unit; give 'unit: degC' (or K, degF)")
    try:
        values, fixed = to_fixed(content.values, unit)
    except ValueError as error:
        raise DataError(f"{content.traits.path}: unit of the temperatures: {error}; correct 'unit'") from None
    if fixed != "K" or content.unit == "mK":
        raise DataError(
            f"{content.traits.path}: the values are in {unit}, expected temperatures (a lock-in amplitude is none); export those"
        )
    return values
