"""Print the result of `make exp1`, `make exp2` or `make exp3` beside the figures of the thesis.

Usage: python scripts/thesis_table.py exp3 [RUN_DIR]      (RUN_DIR: runs/exp3 where absent)

The experiments are virtual: their truth is what the thesis identified from its own measurements, so that an identification without
error would return the thesis's figure in every row. f is not compared: the thesis's sums of squares depend on its nodes and steps.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from thermofit.core.artefact import ParameterResult, Record, open_record
from thermofit.core.errors import DataError, StudyError, ThermofitError
from thermofit.core.parameters import NAMES

STAGES = ("identify-elastic", "identify-plastic", "identify-thermal")
THESIS: Mapping[str, Mapping[str, tuple[str, Mapping[str, float]]]] = {
    "exp1": {
        "identify-elastic": ("5.2", {"E": 67913.0, "nu": 0.35}),
        "identify-plastic": ("5.3", {"M_y0": 129.71, "M_yinf": 253.12, "H_lin": 173.30, "H_exp": 14.11, "F": 0.38}),
        "identify-thermal": ("5.6", {"alpha_exp": 25.40e-6, "kappa": 91.19, "c0": 3.10}),
    },
    "exp2": {
        "identify-elastic": ("5.12", {"E": 67026.0, "nu": 0.36}),
        "identify-plastic": ("5.13", {"M_y0": 129.28, "M_yinf": 293.36, "H_exp": 10.97, "F": 0.37}),
        "identify-thermal": ("5.15", {"alpha_exp": 19.83e-6, "kappa": 189.89, "c0": 2.21, "beta": 0.81}),
    },
    "exp3": {
        "identify-elastic": ("5.16", {"E": 68396.66, "nu": 0.34}),
        "identify-plastic": ("5.16", {"M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35}),
        "identify-thermal": (
            "5.19",
            {"alpha_exp": 20.21e-6, "kappa": 133.45, "c0": 2.22, "beta": 0.79, "alpha_air": 14.72, "alpha_clamp": 236.30},
        ),
    },
}
"""Optimal values by stage, with the number of the table."""

GRID = {"exp1": ("5.6", "seven"), "exp2": ("5.15", "four"), "exp3": ("5.19", "ten")}
"""Table and number of starts, all of which reach one optimum."""

TABLE_5_21 = {
    297.30: {"alpha_exp": 20.07e-6, "kappa": 144.83, "c0": 2.20, "beta": 0.79, "alpha_air": 13.35, "alpha_clamp": 182.78},
    297.10: {"alpha_exp": 20.17e-6, "kappa": 136.91, "c0": 2.21, "beta": 0.79, "alpha_air": 14.40, "alpha_clamp": 197.50},
    296.90: {"alpha_exp": 20.21e-6, "kappa": 133.48, "c0": 2.22, "beta": 0.79, "alpha_air": 14.79, "alpha_clamp": 217.69},
    296.80: {"alpha_exp": 20.21e-6, "kappa": 133.59, "c0": 2.22, "beta": 0.79, "alpha_air": 14.73, "alpha_clamp": 227.86},
    296.60: {"alpha_exp": 20.20e-6, "kappa": 133.43, "c0": 2.21, "beta": 0.79, "alpha_air": 14.70, "alpha_clamp": 244.26},
    296.50: {"alpha_exp": 20.16e-6, "kappa": 137.06, "c0": 2.21, "beta": 0.78, "alpha_air": 14.13, "alpha_clamp": 250.65},
    296.30: {"alpha_exp": 20.06e-6, "kappa": 146.53, "c0": 2.20, "beta": 0.78, "alpha_air": 12.64, "alpha_clamp": 264.03},
}
"""Optima for prescribed jaw temperatures in K; measured: 296.70 K."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("experiment", choices=sorted(THESIS))
    parser.add_argument("run_dir", nargs="?", type=Path)
    given = parser.parse_args(arguments)
    run_dir = given.run_dir or Path("runs") / given.experiment
    console = Console(width=None if sys.stdout.isatty() else 140)
    try:
        console.print(parameter_table(given.experiment, run_dir))
        for part in (*grid_tables(given.experiment, run_dir), *sensitivity_tables(given.experiment, run_dir)):
            console.print(part)
    except ThermofitError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def record_of(run_dir: Path, stage: str, experiment: str) -> Record:
    """Artefact of a stage; StudyError that names the command where it is missing."""
    path = run_dir / f"{stage}.h5"
    if not path.exists():
        raise StudyError(f"artefact '{path}' is missing: run `make {experiment}` first")
    return open_record(path)


def parameter_table(experiment: str, run_dir: Path) -> Table:
    """Truth, start and identified value of every parameter beside the thesis's."""
    columns = ("parameter", "unit", "truth", "start", "identified", "sigma", "deviation", "in sigma", "thesis", "table")
    table = titled(f"{experiment}: identified beside the thesis", columns)
    truth = record_of(run_dir, "simulate", experiment).parameters
    for stage in STAGES:
        record = record_of(run_dir, stage, experiment)
        number, values = THESIS[experiment][stage]
        for name, printed in values.items():
            if name not in record.parameters or not record.parameters[name].free:
                raise DataError(f"{record.path}: {name} was not identified; run `make {experiment}` with its study as it is")
            table.add_row(*row_of(name, record.parameters[name], truth[name].value), f"{printed:.6g}", number)
        table.add_section()
    return table


def row_of(name: str, found: ParameterResult, truth: float) -> tuple[str, ...]:
    """Cells of one parameter up to the deviation from the truth."""
    off = found.value - truth
    sigma, distance = ("-", "-") if found.sigma is None else (f"{found.sigma:.2g}", f"{off / found.sigma:+.1f}" if found.sigma else "-")
    share = f"{100.0 * off / truth:+.2f} %" if truth else f"{off:+.3g}"
    flag = " at bound" if found.at_bound else ""
    return (name, found.unit, f"{truth:.6g}", f"{found.start:.6g}", f"{found.value:.6g}{flag}", sigma, share, distance)


def grid_tables(experiment: str, run_dir: Path) -> Iterable[Table | str]:
    """Optimum of every start, where gridsearch was run."""
    if not (run_dir / "gridsearch.h5").exists():
        return
    record = record_of(run_dir, "gridsearch", experiment)
    names = free_names(record)
    table = titled(f"{experiment}: optimum from every start", ("start", *names, "chi2/n", "runs"))
    for number, start in enumerate(record.summary["starts"], start=1):
        table.add_row(str(number), *optimum_cells(start, names, record))
    yield table
    number, starts = GRID[experiment]
    yield f"  {record.summary['verdict']}\n  thesis, Table {number}: all {starts} starts reach one optimum"


def sensitivity_tables(experiment: str, run_dir: Path) -> Iterable[Table | str]:
    """Change of the optimum with the prescribed jaw temperature, in % of the nominal one; the thesis's in brackets."""
    if experiment != "exp3" or not (run_dir / "sensitivity.h5").exists():
        return
    record = record_of(run_dir, "sensitivity", experiment)
    names = free_names(record)
    nominal = THESIS["exp3"]["identify-thermal"][1]
    table = titled("exp3: change of the optimum in % (thesis: Table 5.21)", ("theta_clamp in K", *names))
    for row in record.summary["values"]:
        printed = TABLE_5_21.get(row["value"], {})
        cells = []
        for name in names:
            ours = "failed" if row["failed"] else f"{100.0 * row['change'][name]:+.1f}"
            theirs = f" ({100.0 * (printed[name] / nominal[name] - 1.0):+.1f})" if name in printed else ""
            cells.append(ours + theirs)
        table.add_row(f"{row['value']:.2f}", *cells)
    yield table
    yield f"  {record.summary['verdict']}"


def free_names(record: Record) -> list[str]:
    """Names of the identified parameters in the order of the law."""
    return [name for name in NAMES if name in record.parameters and record.parameters[name].free]


def optimum_cells(start: Mapping[str, Any], names: Sequence[str], record: Record) -> list[str]:
    """Cells of one start: its optimum, f per datum, forward runs."""
    if start["failed"]:
        return ["failed", *[""] * (len(names) + 1)]
    n = sum(channel["n"] for channel in record.summary["channels"].values())
    mark = "" if start["converged"] else " *"
    values = [f"{start['optimum'][name]:.5g}" for name in names]
    return [*values, f"{start['f'] / n:.5f}{mark}", f"{start['evaluations']['forward']:g}"]


def titled(title: str, columns: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, justify="left" if column in ("parameter", "unit", "table") else "right", no_wrap=True)
    return table


if __name__ == "__main__":
    raise SystemExit(main())
