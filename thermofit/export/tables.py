"""Tables of a run: parameters, covariances, channels, phases, curves and every list in a summary; as CSV, Markdown and LaTeX."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.records.artefact import Record, layout
from thermofit.report.tables import table as markdown_table

Cell = Any
"""A number, a text, a truth value, or None."""
_NAMES = "evaluations/names"
"""Dataset with the names of what a stage fitted, in the order of its matrices."""
_PRINTED_ROWS, _PRINTED_COLUMNS = 40, 12
"""Larger tables are written as CSV alone."""
_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", **{sign: f"\\{sign}" for sign in "&%$#_{}"}}


@dataclass(frozen=True)
class Table:
    """Rows under columns; `units` in the order of the columns, "1" for a pure number and "" for a text."""

    name: str
    title: str
    columns: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True)
class StageCovariance:
    """Covariance (n, n) of what a stage fitted; the unit of an entry is the product of those of its parameters."""

    stage: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: np.ndarray


def covariances(records: Mapping[str, Record]) -> tuple[StageCovariance, ...]:
    """The covariance of every stage that has one."""
    found = []
    for stage, record in records.items():
        if record.has("covariance") and record.has(_NAMES):
            stored = record["covariance"]
            names = tuple(str(name) for name in record[_NAMES].value)
            found.append(StageCovariance(stage, names, stored.units, stored.value))
    return tuple(found)


def tables_of(records: Mapping[str, Record]) -> tuple[Table, ...]:
    """All tables of a run; names are those of their files."""
    made = [t for record in records.values() for t in (*_parameters(record), *_channels(record), *_lists(record), *_series(record))]
    for c in covariances(records):
        rows = tuple((name, unit, *map(float, row)) for name, unit, row in zip(c.names, c.units, c.matrix, strict=True))
        units = ("", "", *c.units)
        made.append(Table(f"{c.stage}-covariance", f"covariance, {c.stage}", ("parameter", "unit", *c.names), units, rows))
    return tuple(made)


def _parameters(record: Record) -> Iterator[Table]:
    shown = {name: p for name, p in record.parameters.items() if p.free}
    if shown:
        columns = ("parameter", "unit", "value", "sigma", "start", "lower", "upper", "at_bound")
        rows = tuple((n, p.unit, p.value, p.sigma, p.start, p.lower, p.upper, p.at_bound) for n, p in shown.items())
        yield Table(f"{record.stage}-parameters", f"parameters, {record.stage}", columns, ("",) * len(columns), rows)


def _channels(record: Record) -> Iterator[Table]:
    channels = record.summary.get("channels") or {}
    if channels:
        yield _of_rows(f"{record.stage}-channels", f"channels, {record.stage}", [{"channel": k, **v} for k, v in channels.items()])


def _lists(record: Record) -> Iterator[Table]:
    """Every list of flat objects in a summary: phases, starts, rankings."""
    for key, rows in record.summary.items():
        if isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows):
            yield _of_rows(f"{record.stage}-{key}", f"{key.replace('_', ' ')}, {record.stage}", rows)


def _of_rows(name: str, title: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    columns = tuple(dict.fromkeys(key for row in rows for key in row if not isinstance(row[key], dict | list)))
    cells = tuple(tuple(row.get(key) for key in columns) for row in rows)
    return Table(name, title, columns, ("",) * len(columns), cells)


def _series(record: Record) -> Iterator[Table]:
    """Every folder of datasets over one common axis: curves, energies, evaluations. Fields are no tables: the export `fields` has them."""
    groups: dict[tuple[str, str, int], list[str]] = {}
    described = layout(record)
    for name, data in described.items():
        folder = name.rpartition("/")[0]
        if folder and len(data.dims) == 1 and data.dims[0] not in ("parameter", "axis"):
            groups.setdefault((folder, data.dims[0], data.shape[0]), []).append(name)
    for (folder, dim, _), names in groups.items():
        columns = [name.rpartition("/")[2] for name in names]
        alike = sum(1 for other, _, _ in groups if other == folder) > 1
        label = f"{record.stage}-{folder.replace('/', '-')}" + (f"-{dim}" if alike else "")
        units = tuple(described[name].unit if described[name].dtype != "text" else "" for name in names)
        values = [record[name].value.tolist() for name in names]
        yield Table(label, f"{folder.replace('/', ', ')}, {record.stage}", tuple(columns), units, tuple(zip(*values, strict=True)))


def csv_text(table: Table) -> str:
    """Comma separated, units in brackets behind the names, numbers with all their digits; what is missing is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([f"{name} [{unit}]" if unit not in ("", "1") else name for name, unit in zip(table.columns, table.units, strict=True)])
    writer.writerows([[_whole(cell) for cell in row] for row in table.rows])
    return out.getvalue()


def _whole(cell: Cell) -> str:
    if cell is None:
        return ""
    return repr(cell) if isinstance(cell, float) else str(cell).lower() if isinstance(cell, bool) else str(cell)


def _short(cell: Cell) -> str:
    if cell is None or cell == "":
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:.5g}" if isinstance(cell, float) else str(cell)


def printed(tables: Iterable[Table]) -> tuple[Table, ...]:
    """The tables that fit on a page."""
    return tuple(t for t in tables if len(t.rows) <= _PRINTED_ROWS and len(t.columns) <= _PRINTED_COLUMNS)


def _headed(table: Table) -> list[str]:
    return [f"{name} in {unit}" if unit not in ("", "1") else name for name, unit in zip(table.columns, table.units, strict=True)]


def markdown_text(tables: Iterable[Table]) -> str:
    """All tables, each under its title."""
    parts = [f"## {t.title}\n\n{markdown_table(_headed(t), ([_short(cell) for cell in row] for row in t.rows))}" for t in tables]
    return "\n\n".join(parts) + "\n"


def latex_text(tables: Iterable[Table]) -> str:
    r"""All tables, each a `tabular` with a caption and a label; needs the package booktabs."""
    return "\n".join(["% needs \\usepackage{booktabs}", *(_latex(t) for t in tables)])


def _latex(table: Table) -> str:
    numbers = [all(isinstance(row[k], float | int) or row[k] is None for row in table.rows) for k in range(len(table.columns))]
    lines = [
        "\\begin{table}",
        f"\\caption{{{_escaped(table.title)}}}",
        f"\\label{{tab:{re.sub('[^A-Za-z0-9-]', '-', table.name)}}}",
        f"\\begin{{tabular}}{{{''.join('r' if number else 'l' for number in numbers)}}}",
        "\\toprule",
        " & ".join(_escaped(name) for name in _headed(table)) + " \\\\",
        "\\midrule",
        *(" & ".join(_latex_cell(cell) for cell in row) + " \\\\" for row in table.rows),
        "\\bottomrule",
        "\\end{tabular}",
        "\\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _latex_cell(cell: Cell) -> str:
    """A number with a power of ten as mathematics, a text with its special signs escaped."""
    text = _short(cell)
    if isinstance(cell, float) and "e" in text:
        digits, power = text.split("e")
        return f"${digits} \\times 10^{{{int(power)}}}$"
    return _escaped(text)


def _escaped(text: str) -> str:
    return "".join(_SPECIAL.get(sign, sign) for sign in text)
