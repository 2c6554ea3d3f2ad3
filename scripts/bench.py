"""Time the pieces of the kernel and of the chain beside the limits of the machine and beside other codes.

    python scripts/bench.py [--quick] [--only SECTION ...] [--mesh full|coarse|12x80x4] [--repeat 5] [--threads 1]
                            [--write docs/performance.md] [--resume]

Every section is kept in .benchmarks/full/sections.json (quick: .benchmarks/quick) as soon as it is measured: `--resume` skips those that
are there, `--only` measures the named ones anew, and the document is written from all. Sections that fail are named at the end; the
others are measured.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

# Before numpy loads its BLAS.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import bench_chain
import bench_diagnosis
import bench_growth
import bench_kernel
import bench_machine
import bench_peers
import bench_point
import bench_runs
import bench_sheet
import bench_start
import bench_structure
from bench_document import Measured, document, load, save, show
from bench_measure import ROOT, Limits, Options, Part

from thermofit.core.jit import set_threads
from thermofit.study.section import PRESETS

SECTIONS: dict[str, Callable[[Options, Limits], Part]] = {
    "machine": bench_machine.measure,
    "kernel": bench_kernel.measure,
    "runs": bench_runs.measure,
    "structure": bench_structure.measure,
    "sheet": bench_sheet.measure,
    "growth": bench_growth.measure,
    "point": bench_point.measure,
    "diagnosis": bench_diagnosis.measure,
    "peers": bench_peers.measure,
    "start": bench_start.measure,
    "chain": bench_chain.measure,
    "nelder-mead": bench_chain.measure_nelder_mead,
    "search": bench_chain.measure_search,
}
"""Sections in the order of the document."""


def mesh_of(text: str) -> tuple[int, int, int]:
    """Elements of a preset's name or of a text such as 12x80x4."""
    if text in PRESETS:
        size = PRESETS[text]
        return size.n_x, size.n_y, size.n_z
    numbers = text.split("x")
    if len(numbers) != 3 or not all(number.isdigit() and int(number) > 0 for number in numbers):
        raise argparse.ArgumentTypeError(f"'{text}' found; expected {', '.join(sorted(PRESETS))} or three numbers such as 12x80x4")
    return int(numbers[0]), int(numbers[1]), int(numbers[2])


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small meshes and few repetitions: does every section run?")
    parser.add_argument("--only", nargs="+", choices=tuple(SECTIONS), metavar="SECTION", help=f"some of: {', '.join(SECTIONS)}")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the document, such as docs/performance.md")
    parser.add_argument("--mesh", type=mesh_of, help="full, coarse or 12x80x4")
    parser.add_argument("--repeat", type=int, default=5, help="repetitions of short pieces of work")
    parser.add_argument("--threads", type=int, default=1, help="threads of the kernels")
    parser.add_argument("--resume", action="store_true", help="skip sections that an earlier run has measured")
    return parser.parse_args()


def main() -> int:
    """Measure, keep, print, write; exit code 1 where a section failed."""
    given = arguments()
    mesh = given.mesh or mesh_of("coarse" if given.quick else "full")
    set_threads(given.threads)
    scratch = ROOT / ".benchmarks" / ("quick" if given.quick else "full")
    options = Options(mesh, 1 if given.quick else given.repeat, given.threads, given.quick, scratch)
    store = scratch / "sections.json"
    parts, failed = load(store), []
    for name in given.only or SECTIONS:
        if given.resume and name in parts:
            continue
        try:
            found = measured(name, options)
        except Exception:
            # Hours may lie in the other sections: they go on, and the exit code tells.
            failed.append(name)
            traceback.print_exc()
            print(f"section {name} failed, the others go on", file=sys.stderr)
            continue
        # What another run has measured meanwhile is kept.
        parts = {**load(store), name: found}
        parts = {key: parts[key] for key in SECTIONS if key in parts}
        save(store, parts)
        show(found)
    if given.write:
        given.write.write_text(document(parts), encoding="utf-8")
        print(f"written: {given.write}")
    if failed:
        print(f"failed: {', '.join(failed)}; run again with --only {' '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def measured(name: str, options: Options) -> Measured:
    """One section with the limits of the machine measured right before it."""
    limits = bench_machine.limits(options.repeat)
    n_x, n_y, n_z = options.mesh
    quick = "quick, " if options.quick else ""
    settings = f"{quick}mesh {n_x} x {n_y} x {n_z}, threads {options.threads}, repetitions {options.repeat}"
    part = SECTIONS[name](options, limits)
    when = time.strftime("%Y-%m-%d %H:%M")
    return Measured(part, when, limits.product, limits.gflops, limits.bandwidth, settings)


if __name__ == "__main__":
    raise SystemExit(main())
