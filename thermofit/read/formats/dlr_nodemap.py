"""Nodemap text of the DLR exporter for ARAMIS Professional, one file for each stage.

All header lines begin with `#`: process data, stage, SIGNALS; the last names the columns. x_undef, y_undef, z_undef are REFERENCE
coordinates, each column has its own unit (strains in % beside shears in 1). A companion `..._connections.txt` lists triangles and
holds no field.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from thermofit.core.errors import DataError
from thermofit.read.formats.aramis_csv import header_pairs
from thermofit.read.formats.contents import Column, DicStage, Head
from thermofit.read.formats.table import StageFacts, make_stage, read_named
from thermofit.read.formats.text import head_lines, parse_number, read_text, whole_number

NAME = "DLR nodemap text (ARAMIS Professional, one stage)"
WHAT = "a nodemap: a header of '#' lines whose last names the columns ID; x_undef [mm]; ...; u [mm]; ..."
_MEANINGS = {
    **{"id": "id", "x_undef": "x", "y_undef": "y", "z_undef": "z", "u": "u", "v": "v", "w": "w"},
    **{"epsx": "exx", "epsy": "eyy", "epsxy": "exy", "epseqv": "mises"},
}


def _header_line(lines: list[str]) -> int | None:
    """Index of the line of column names, None where there is none."""
    return next((k for k, line in enumerate(lines) if line.lstrip().startswith("#") and "x_undef" in line and ";" in line), None)


def _is_connections(lines: list[str]) -> bool:
    """Whether the file is the list of triangles that accompanies a nodemap."""
    return any("element #" in line.lower() and "node 1" in line.lower() for line in lines[:20])


def recognises(head: Head) -> bool:
    """A comment line with the columns ID and x_undef, or the companion list of connections."""
    lines = head_lines(head)
    return _header_line(lines) is not None or _is_connections(lines)


def _signals(lines: list[str]) -> dict[str, tuple[float, str]]:
    """Lines `# name : value_element : number` and `# name : analog_input : number`; the file writes no units."""
    found = {}
    for line in lines:
        pieces = [piece.strip() for piece in line.lstrip("# ").split(" : ")]
        if len(pieces) == 3 and pieces[1] in ("value_element", "analog_input") and not np.isnan(value := parse_number(pieces[2])):
            found[pieces[0]] = (value, "")
    return found


def _number(pairs: dict[str, str], key: str) -> float | None:
    """Number of a header line, None where it is absent or no number."""
    value = parse_number(pairs.get(key, "").split(" ")[0])
    return None if np.isnan(value) else value


def read(path: Path) -> DicStage:
    """One stage. Signals are without unit, as in the file. DataError for every defect, with line."""
    text = read_text(path, WHAT)
    header = _header_line(text.lines)
    if header is None:
        if _is_connections(text.lines):
            raise DataError(f"{path}: this is the list of triangles beside a nodemap, expected {WHAT}; give the nodemap itself")
        raise DataError(f"{path}: no line with the columns ID; x_undef [mm]; ... found, expected {WHAT}; export it again")

    def describe(name: str, written: str) -> Column:
        meaning = _MEANINGS.get(name.lower(), "")
        return Column(name, meaning, "" if meaning == "id" else written, "file" if written else "unknown")

    named = read_named(text, path, header, ";", describe)
    pairs = header_pairs(text.lines[:header])
    named = replace(named, traits=replace(named.traits, header=pairs))
    time, stage = _number(pairs, "current_stage_relative_date"), _number(pairs, "current_stage_index")
    facts = StageFacts(False, time, whole_number(stage), None, (), _signals(text.lines[:header]))
    return make_stage(named, NAME, facts)
