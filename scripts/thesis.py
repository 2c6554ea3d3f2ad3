"""Sections 5.3, 5.4, 5.5 of the thesis as virtual experiments: run what is not there yet, then write the tables beside the thesis's.

Usage: python scripts/thesis.py [exp1|exp2|exp3 ...] [--mesh coarse] [--jobs 2] [--pages-only]

A run that was stopped goes on where it was: finished stages are fresh, long ones keep every evaluation.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import thesis_53
import thesis_54
import thesis_55
import thesis_interpolation
from thesis_figures import styled
from thesis_read import Statement
from thesis_runs import COST, INTERPOLATED, MESHES, ROOT, SECTIONS, Place, chosen, cpu_of, execute, note_total, place_of
from thesis_tables import document

from thermofit.core.errors import ThermofitError
from thermofit.core.files import replacing

PAGES = ROOT / "docs" / "reproduction"
MODULES = {"5.3": thesis_53, "5.4": thesis_54, "5.5": thesis_55}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and write; the exit code is 0, or that of the first error."""
    given = parse(arguments)
    place = place_of(given.runs, given.mesh)
    sections = [SECTIONS[name] for name in given.experiments or SECTIONS]
    try:
        if not given.pages_only:
            carry_out(sections, place, given.jobs)
        for section in sections:
            for statement in write(section, place, given.pages):
                print(f"{section} {'holds         ' if statement.holds else 'DOES NOT HOLD '} {statement.text} ({statement.measured})")
        if all(section in sections for section in INTERPOLATED.values()):
            (given.pages / "interpolation.md").write_text(thesis_interpolation.page(place), encoding="utf-8")
    except ThermofitError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def carry_out(sections: Sequence[str], place: Place, jobs: int) -> None:
    """Carry out the runs of the sections, and keep how long that took."""
    runs, begin = chosen(sections, place.mesh), time.perf_counter()
    anew = not any((place.dir_of(run.name) / COST).exists() for run in runs)
    spent = cpu_of(runs, place)
    execute(runs, place, jobs, lambda line: print(line, flush=True))
    wall, cpu = time.perf_counter() - begin, cpu_of(runs, place) - spent
    note_total(place, {"sections": " ".join(sections), "from_nothing": anew, "jobs": jobs, "wall_s": wall, "cpu_s": cpu})
    print(f"{wall / 60.0:.1f} min, CPU time {cpu / 60.0:.1f} min")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("experiments", nargs="*", choices=[[], *SECTIONS], help="exp1: section 5.3, exp2: 5.4, exp3: 5.5; all where absent")
    parser.add_argument("--mesh", choices=tuple(MESHES), default="full")
    parser.add_argument("--jobs", type=int, default=2, help="runs side by side")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of the run folders")
    parser.add_argument("--pages", type=Path, default=PAGES, help="folder of the written pages")
    parser.add_argument("--pages-only", action="store_true", help="write the pages from the runs that are there")
    return parser.parse_args(arguments)


def write(section: str, place: Place, pages: Path) -> list[Statement]:
    """Write the page of a section with its figures; returns what was found."""
    module = MODULES[section]
    pages.mkdir(parents=True, exist_ok=True)
    found: list[Statement] = module.statements(place)
    with styled():
        text = document(module.TITLE, place, module.page(place, pages), found)
    with replacing(pages / f"section-{section.replace('.', '-')}.md", durable=False) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return found


if __name__ == "__main__":
    raise SystemExit(main())
