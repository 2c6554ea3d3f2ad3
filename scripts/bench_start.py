"""Section: cold start, compile time, and that nothing is compiled after the first run."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from bench_chain import Chain, checked, small_chain
from bench_measure import ROOT, Limits, Options, Part, Row, Target, first_line, run_child
from bench_runs import one_run

_MESH = (6, 40, 2)
_STEPS = 10
COMMANDS = (
    "simulate", "calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal", "verify", "report", "run",
)  # fmt: skip


def measure(options: Options, limits: Limits) -> Part:
    """Compile time of a coupled run with an empty cache, files that later runs add to it, wall time to the first line of every command."""
    cache = options.scratch / "cache"
    shutil.rmtree(cache, ignore_errors=True)
    environment = {"THERMOFIT_CACHE_DIR": str(cache)}
    cold, warm = one_run(_MESH, _STEPS, environment), one_run(_MESH, _STEPS, environment)
    rows = [
        Row("small coupled run, empty cache (wall)", cold["wall"], f"CPU {cold['cpu']:.1f} s"),
        Row("small coupled run, second process (wall)", warm["wall"], f"CPU {warm['cpu']:.1f} s"),
        Row("compile time", cold["cpu"] - warm["cpu"], "CPU, difference of both"),
    ]
    chain = small_chain(options.scratch / "quickstart")
    shutil.rmtree(chain.run_dir, ignore_errors=True)
    whole = ("--json",)
    first = run_child(chain.command("run", *whole), cwd=ROOT, env=environment)
    checked(first, "run")
    before = cache_files(cache)
    second = run_child(chain.command("run", "--force", *whole), cwd=ROOT, env=environment)
    checked(second, "run --force")
    added = sorted(cache_files(cache) - before)
    rows.append(Row("chain of the quickstart, first time (wall)", first.wall, f"CPU {first.cpu:.1f} s, kernels of all stages compiled"))
    rows.append(Row("chain of the quickstart, second time (wall)", second.wall, f"CPU {second.cpu:.1f} s"))
    starts = {name: first_line_of(chain, name, cache) for name in COMMANDS}
    starts["show"] = second_start([*_PROGRAM, "show", str(chain.run_dir / "verify.h5")], cache)
    starts["--help"] = second_start([*_PROGRAM, "--help"], cache)
    said = {name: words.split(", results in")[0][:60] for name, (_, words) in starts.items()}  # without the folder, which is a scratch one
    rows += [Row(f"{name}: second start to first line (wall)", wall, f'"{said[name]}"') for name, (wall, _) in starts.items()]
    slowest = max(starts, key=lambda name: starts[name][0])
    targets = (
        Target(
            "second start of any command to the first line", "<= 2 s", f"{starts[slowest][0]:.2f} s ({slowest})", starts[slowest][0] <= 2.0
        ),
        Target("compiled anew after the first run", "nothing", f"{len(added)} cache files" if added else "nothing", not added),
    )
    remarks = tuple(f"Compiled again: {name}." for name in added[:5])
    return Part("Start and compilation", tuple(rows), targets, remarks)


_PROGRAM = (sys.executable, "-m", "thermofit.cli")


def cache_files(folder: Path) -> set[str]:
    """Compiled kernels in a cache folder with the time they were written, so that one that is written anew counts as a new one."""
    return {f"{file.name} {file.stat().st_mtime_ns}" for file in folder.rglob("*.nb[ci]")}


def first_line_of(chain: Chain, command: str, cache: Path) -> tuple[float, str]:
    """Wall s of the second start of a stage that has work to do, on a terminal, to its first words; and these."""
    return second_start(chain.command(command, "--force"), cache)


def second_start(command: list[str], cache: Path) -> tuple[float, str]:
    """The command is started twice with compiled kernels; the second time counts."""
    for _ in range(2):
        found = first_line(command, cwd=ROOT, env={"THERMOFIT_CACHE_DIR": str(cache)})
    return found
