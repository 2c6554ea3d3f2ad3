"""Time the pieces of the kernel and of the chain, each as a ratio to a matrix product timed in the same run.

    python scripts/bench.py [--mesh full|coarse] [--repeat 5] [--threads 1]

Medians of CPU seconds (all threads). The ratio makes figures of different machines and of a busy one comparable: 1 means as long as
the product of two 1000 x 1000 matrices.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.console import Console
from rich.table import Table

from thermofit.core.experiment import Specimen
from thermofit.core.jit import set_threads
from thermofit.core.parameters import Parameters
from thermofit.core.study_section import PRESETS
from thermofit.fem.body import Body, tension_body, thermal_geometry
from thermofit.fem.conduction import heat_conditions, heat_step
from thermofit.fem.dogbone import dogbone_mesh
from thermofit.fem.element import element_pass
from thermofit.fem.linear import Factor, scatter
from thermofit.fem.march import Loading, MarchSettings, march
from thermofit.fem.newton import virgin_state
from thermofit.fem.one_way import heat_problem, heat_run
from thermofit.material.law import law_of

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
PARAMETERS = Parameters.of(
    {
        "E": 68396.66, "nu": 0.34, "M_y0": 128.92, "M_yinf": 292.73, "H_exp": 10.87, "F": 0.35, "alpha_exp": 20.21e-6, "kappa": 133.45,
        "c0": 2.22, "beta": 0.79, "alpha_air": 14.72, "alpha_clamp": 236.3, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7,
    }
)  # fmt: skip
LOADING = Loading(np.array([0.0, 3.0, 8.0, 150.0, 160.0, 400.0]), np.array([0.0, 0.0, 4000.0, 7100.0, 0.0, 0.0]))


def load_times(n: int) -> np.ndarray:
    """n steps: load, unload, cool."""
    share = np.array([0.0, 0.02, 0.1, 0.75, 0.85, 1.0])
    return np.interp(np.linspace(0.0, 1.0, n + 1), share, LOADING.time)


def cpu(work: Callable[[], object], repeat: int) -> float:
    """Median CPU seconds of `work` over `repeat` runs after one warm-up."""
    work()
    seconds = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return float(np.median(seconds))


def pieces(body: Body, repeat: int) -> dict[str, float]:
    """CPU seconds of the parts of one Newton iteration and of one heat step, homogeneous plastic state."""
    law, nodes = law_of(PARAMETERS), body.mesh.nodes
    u = np.stack([-0.0012 * nodes[:, 0], 0.003 * (nodes[:, 1] - nodes[:, 1].min()), -0.0017 * nodes[:, 2]], axis=1)
    theta, state_n = np.full(len(nodes), 297.0), virgin_state(body.mesh.n_elements)
    state, dilatation = state_n.copy(), np.empty(state_n.shape[:2])
    force, stiffness = np.empty((body.mesh.n_elements, 24)), np.empty((body.mesh.n_elements, 24, 24))

    def passing(tangent: bool, scale: float) -> Callable[[], object]:
        return lambda: element_pass(body.data, scale * u, theta, state_n, law, tangent, force, stiffness, state, dilatation)

    out = {
        "element pass, elastic, residual": cpu(passing(False, 0.3), repeat),
        "element pass, plastic, residual": cpu(passing(False, 1.0), repeat),
        "element pass, plastic, with tangent": cpu(passing(True, 1.0), repeat),
    }
    data = np.zeros(body.mechanical.n_slots)
    scatter(stiffness, body.mechanical_slot, data)
    factor = Factor(body.mechanical, data)
    right = np.random.default_rng(0).normal(size=(body.n_equations, 16))
    out["factor, mechanical"] = cpu(lambda: Factor(body.mechanical, data), repeat)
    out["solve, 1 right-hand side"] = cpu(lambda: factor.solve(right[:, 0]), repeat)
    out["solve, 16 right-hand sides"] = cpu(lambda: factor.solve(right), repeat)
    geometry, conditions = thermal_geometry(body, u), heat_conditions(PARAMETERS)
    out["thermal matrices of a step"] = cpu(lambda: thermal_geometry(body, u), repeat)
    out["heat step"] = cpu(lambda: heat_step(body, geometry, conditions, theta, np.zeros(len(nodes)), (1.0, "sdirk2")), repeat)
    return out


def runs(body: Body) -> dict[str, float]:
    """CPU seconds of a coupled run and of a one-way heat run of 200 steps (load, unload, cool)."""
    times, settings = load_times(200), MarchSettings(keep_points=True)
    start = time.process_time()
    history = march(body, PARAMETERS, LOADING, times, settings)
    forward = time.process_time() - start
    problem = heat_problem(body, history, settings)
    return {"coupled run, 200 steps": forward, "one-way heat run, 200 steps": cpu(lambda: heat_run(problem, PARAMETERS), 3)}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", choices=sorted(PRESETS), default="full")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    set_threads(options.threads)
    size = PRESETS[options.mesh]
    body = tension_body(dogbone_mesh(SPECIMEN, size.n_x, size.n_y, size.n_z))
    a = np.random.default_rng(1).normal(size=(1000, 1000))
    product = cpu(lambda: a @ a, options.repeat)
    table = Table(title=f"{size.n_x} x {size.n_y} x {size.n_z} hex8, {body.n_equations} equations, {options.threads} thread(s)")
    for column in ("piece", "CPU ms", "/ matrix product"):
        table.add_column(column, justify="left" if column == "piece" else "right")
    for name, seconds in {"matrix product 1000^3": product, **pieces(body, options.repeat), **runs(body)}.items():
        table.add_row(name, f"{1e3 * seconds:.2f}", f"{seconds / product:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
