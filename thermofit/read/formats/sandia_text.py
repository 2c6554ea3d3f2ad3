"""Records whose first line is a Python dictionary of states, as the calibration projects of Sandia keep them; then names, then numbers.

The states go into the header; `temperature` is in degrees Rankine in these projects, `engineering_strain_rate` in 1/s. The columns
have no units in the file: the study gives them.
"""

from __future__ import annotations

import ast
import warnings
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.core.units import to_fixed
from thermofit.read.formats.contents import ChannelRecord, Head, Traits
from thermofit.read.formats.coupon_text import read_lines_as_record
from thermofit.read.formats.text import head_lines, read_text

NAME = "Sandia state file (text table below a dictionary)"
_LONGEST = 10_000


def states_of(line: str) -> dict[str, float | str] | None:
    """The dictionary of a line: names to numbers or texts; None where it is none."""
    line = line.strip()
    if not (line.startswith("{") and line.endswith("}")) or len(line) > _LONGEST:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = ast.literal_eval(line)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        return None
    if not isinstance(found, dict) or not found:
        return None
    known = all(isinstance(name, str) and isinstance(value, int | float | str) for name, value in found.items())
    return found if known else None


def recognises(head: Head) -> bool:
    """True where the first line is a dictionary and a second line follows."""
    lines = head_lines(head)
    return len(lines) > 1 and states_of(lines[0]) is not None


def read(path: Path) -> ChannelRecord:
    """The record; states in `about` (temperature K, rate 1/s) and as written in the header.

    DataError for a first line that is no dictionary, a state that is no finite number, or a table that cannot be read.
    """
    text = read_text(path, "a dictionary of states, column names and numbers")
    states = states_of(text.lines[0])
    if states is None:
        raise DataError(f"{path}, line 1: found no dictionary of states such as {{'temperature': 530.0}}, expected one; correct the line")
    about: dict[str, float] = {}
    remarks: list[str] = []
    if "temperature" in states:
        rankine = _number(states, "temperature", path)
        about["temperature"] = float(to_fixed(rankine, "degR")[0])
        remarks.append(f"state temperature {rankine:g} taken as degR, the unit of these files: {about['temperature']:.2f} K")
    rate = next((name for name in ("engineering_strain_rate", "strain_rate") if name in states), None)
    if rate is not None:
        about["rate"] = _number(states, rate, path)
    header = {name: str(value) for name, value in states.items()}
    return read_lines_as_record(text.lines, Traits(NAME, path, text.encoding, remarks=tuple(remarks), header=header), 1, about)


def _number(states: dict[str, float | str], name: str, path: Path) -> float:
    value = states[name]
    try:
        number = float(value) if not isinstance(value, str | bool) else np.nan
    except OverflowError:
        number = np.nan
    if not (np.isfinite(number) and number > 0.0):
        raise DataError(f"{path}, line 1: state {name} is {str(value)[:40]!r}, expected a positive number; correct the line")
    return number
