"""Section: whole runs of the dogbone, load, unload and cool: coupled, heat alone. As a program: one run in a process of its own.

python scripts/bench_runs.py '[n_x, n_y, n_z]' STEPS      prints JSON: CPU s of the run, peak bytes, counts
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from bench_bar import PARAMETERS
from bench_kernel import dogbone_body
from bench_measure import Child, Limits, Options, Part, Row, at_most, cpu, once, run_child

from thermofit.body.body import Body
from thermofit.body.heat.one_way import heat_problem, heat_run
from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.march import History, Loading, MarchSettings, Watch, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.core.jit import set_threads
from thermofit.core.parameters import NAMES, Parameters

IDENTIFIED = ("E", "nu", "M_y0", "M_yinf", "H_exp", "F", "alpha_exp", "c0")
LOADING = Loading(np.array([0.0, 3.0, 8.0, 150.0, 160.0, 400.0]), np.array([0.0, 0.0, 4000.0, 7100.0, 0.0, 0.0]))
"""Rest, elastic loading, plastic loading, unloading, cooling: s and N."""
_SHARE = np.array([0.0, 0.02, 0.1, 0.75, 0.85, 1.0])
"""Share of the steps at the corners of LOADING."""


def step_times(n: int) -> np.ndarray:
    """Times (n + 1,) s of n steps through LOADING."""
    return np.interp(np.linspace(0.0, 1.0, n + 1), _SHARE, LOADING.time)


TIGHT = MarchSettings(newton=NewtonSettings(tolerance=1e-9, max_iterations=80), coupling_tolerance=1e-7, keep_points=True)
"""Settings of the reference run beside which accuracy is stated."""


def forward(body: Body, steps: int, settings: MarchSettings | None = None, parameters: Parameters = PARAMETERS) -> History:
    """One coupled run, at the default accuracy or another."""
    return march(body, parameters, LOADING, step_times(steps), settings or MarchSettings(keep_points=True))


def forward_with_sensitivities(
    body: Body,
    names: Sequence[str],
    steps: int,
    settings: MarchSettings | None = None,
    tolerance: float | None = None,
    parameters: Parameters = PARAMETERS,
) -> np.ndarray:
    """One coupled run with derivatives along the named parameters; returns those of what the cameras see, the face, at all recorded times.

    (n_t, n_face, 4, n): two displacements in mm, one in depth, and the temperature in K; a name that is given twice is computed twice.
    """
    face = body.mesh.node_sets["face"]
    seen = np.empty((steps + 1, len(face), 4, len(names)))

    def collect(n: int, at: StepRates) -> None:
        seen[n, :, :3] = at.u[face][..., : len(names)]
        seen[n, :, 3] = at.theta[face][..., : len(names)]

    asked = Sensitivities(tuple(names), collect)
    asked = asked if tolerance is None else replace(asked, tolerance=tolerance)
    march(body, parameters, LOADING, step_times(steps), settings or MarchSettings(), Watch(sensitivities=asked))
    return seen


def directions(n: int) -> tuple[str, ...]:
    """n names of parameters: those that are identified first, then all of the law, in turn where n is larger than their number."""
    rest = [name for name in NAMES if name not in IDENTIFIED]
    return tuple(islice(cycle([*IDENTIFIED, *rest]), n))


def measure(options: Options, limits: Limits) -> Part:
    """CPU s of a coupled run, without and with sensitivities, of a one-way heat run on its history; memory of a process with both."""
    steps = 40 if options.quick else 200
    body = dogbone_body(options.mesh)
    forward(body, 3)
    histories: list[History] = []
    repeat = 1 if options.quick else min(3, options.repeat)

    def run() -> None:
        histories[:] = [forward(body, steps)]

    coupled = _median(run, repeat)
    (history,) = histories
    problem = heat_problem(body, history, MarchSettings(keep_points=True))
    heat = cpu(lambda: heat_run(problem, PARAMETERS), min(3, options.repeat))
    made = cpu(lambda: heat_problem(body, history, MarchSettings(keep_points=True)), 1)
    exact = forward(body, steps, TIGHT)
    off_u, off_theta = (float(np.abs(a - b).max()) for a, b in ((history.u, exact.u), (history.theta, exact.theta)))
    forward_with_sensitivities(body, directions(8), 3)
    derived = {n: _median(lambda n=n: forward_with_sensitivities(body, directions(n), steps), repeat) for n in (8, 30)}
    one_run((4, 8, 1), 1)  # compiles what this process has not called
    off_rates = _off(*(forward_with_sensitivities(body, directions(8), steps, *how) for how in ((), (TIGHT, 1e-3))))
    alone = one_run(options.mesh, steps)
    c = history.counts
    counted = "; ".join(f"{value} {name.replace('_', ' ')}" for name, value in c.items() if name != "steps")
    rows = (
        Row(f"coupled run, {steps} steps", coupled, counted),
        Row("its largest error beside tight tolerances", None, f"{off_u:.1e} mm, {off_theta:.1e} K"),
        Row("per Newton iteration", coupled / c["newton_iterations"], "all work of the run shared out"),
        *(Row(f"coupled run with {n} sensitivities", value, f"{value / coupled:.2f} coupled runs") for n, value in derived.items()),
        Row("largest error of 8 sensitivities beside tight tolerances", None, f"rms {off_rates:.1e} of the rms of a column"),
        Row("preparation of the heat runs", made, "matrices of all steps, once for each mechanical history"),
        Row(f"one-way heat run, {steps} steps", heat),
        Row("process of one coupled run", alone["cpu"], f"with start and imports; peak memory {alone['peak'] / 1e6:.0f} MB"),
    )
    n_x, n_y, n_z = options.mesh
    targets = (
        at_most(f"coupled run of {steps} steps, CPU", coupled, 10.0, "s", 8.0),
        at_most("its displacement beside a tenth of the noise", off_u, 1e-4, "mm"),
        at_most("its temperature beside a tenth of the noise", off_theta, 1e-3, "K"),
        at_most("coupled run with 8 sensitivities, CPU", derived[8], 18.0, "s"),
        at_most("coupled run with 30 sensitivities, CPU", derived[30], 35.0, "s"),
        at_most("derivatives beside those of tight tolerances, rms", off_rates, 1e-3, ""),
        at_most(f"one-way heat run of {steps} steps, CPU", heat, 0.5, "s", 0.3),
    )
    return Part(f"Whole runs, dogbone {n_x} x {n_y} x {n_z}: load, unload, cool", rows, targets)


def _off(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest relative error of a column (n_t, n_face, 4, n): root mean squares over times and points, displacement, temperature apart."""
    fields = (slice(0, 3), slice(3, 4))
    off = [np.sqrt(((found - exact)[:, :, f] ** 2).mean(axis=(0, 1, 2)) / (exact[:, :, f] ** 2).mean(axis=(0, 1, 2))) for f in fields]
    return float(np.max(off))


def _median(work: Callable[[], object], repeat: int) -> float:
    """Median CPU s of long work, which is not warmed up."""
    return float(np.median([once(work) for _ in range(repeat)]))


def one_run(mesh: Sequence[int], steps: int, extra: dict[str, str] | None = None) -> dict[str, Any]:
    """One coupled run in a process of its own: CPU s and peak bytes of the process, counts of the run. RuntimeError where it fails."""
    command = [sys.executable, str(Path(__file__).resolve()), json.dumps(list(mesh)), str(steps)]
    return _read(run_child(command, env=extra))


def _read(child: Child) -> dict[str, Any]:
    if child.code != 0:
        raise RuntimeError(f"the run in a process of its own failed with exit code {child.code}: {child.stderr.strip()[-500:]}")
    return {"cpu": child.cpu, "wall": child.wall, "peak": child.peak, **json.loads(child.stdout.splitlines()[-1])}


if __name__ == "__main__":
    set_threads(1)
    chosen = dogbone_body(tuple(json.loads(sys.argv[1])))
    done = forward(chosen, int(sys.argv[2]))
    heat_run(heat_problem(chosen, done, MarchSettings(keep_points=True)), PARAMETERS)
    print(json.dumps({"counts": done.counts}))
