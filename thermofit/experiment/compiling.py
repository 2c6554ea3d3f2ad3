"""Kernels of both drivers compiled side by side, before the first study of an installation needs them.

numba compiles a kernel when it is first called, and keeps it (`core.jit`). A chain on a body calls those of the material point, then those
of the body. Here a child process runs a specimen of a few elements, then its derivatives. This one runs a coupon meanwhile, and the heat
of the specimen once the child has run it; what either compiles is in the cache for all that follows. Where that fails nothing is lost: a
kernel is compiled when called.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np

from thermofit.body.body import Body, tension_body
from thermofit.body.heat.one_way import heat_problem, heat_run, heat_run_rates
from thermofit.body.mesh.dogbone import dogbone_mesh
from thermofit.body.sensitivity.step_rates import Sensitivities
from thermofit.body.solve.history import MarchSettings, Watch
from thermofit.body.solve.loading import Loading
from thermofit.body.solve.march import march
from thermofit.core.experiment import Specimen
from thermofit.core.jit import CACHE_FOLDER
from thermofit.core.parameters import Parameters
from thermofit.point.driver import Programme, simulate, simulate_rates
from thermofit.records.progress import progress

DONE = CACHE_FOLDER / "compiled"
"""There once both drivers are compiled."""
_MATERIAL = {"E": 7e4, "nu": 0.3, "M_y0": 100.0, "M_yinf": 200.0, "H_exp": 20.0, "alpha_exp": 2e-5, "kappa": 130.0, "c0": 2.4, "beta": 0.9}
_AROUND = {"alpha_air": 10.0, "alpha_clamp": 500.0, "theta_air": 295.0, "theta_clamp": 296.0, "theta_ref": 296.0}
_SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
_NAMES = (*_MATERIAL, *_AROUND)


def compile_point() -> None:
    """Run a coupon into the plastic range, with and without derivatives."""
    parameters = Parameters.of({**_MATERIAL, **_AROUND})
    pull = Programme.by_strain(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.002, 0.01]))
    simulate(parameters, pull)
    simulate_rates(parameters, ("E", "M_y0"), pull)


def _specimen() -> tuple[Body, Loading, np.ndarray]:
    time = np.array([0.0, 1.0, 2.0])
    return tension_body(dogbone_mesh(_SPECIMEN, 2, 12, 1)), Loading(time, np.array([0.0, 2000.0, 4000.0])), time


def compile_body(ran: Callable[[], None] = lambda: None) -> None:
    """Run a specimen of eight elements into the plastic range, coupled and one-way, call `ran`, and run it with derivatives."""
    parameters = Parameters.of({**_MATERIAL, **_AROUND})
    body, loading, time = _specimen()
    for coupling in ("full", "one-way"):
        march(body, parameters, loading, time, MarchSettings(coupling=coupling, keep_points=True))
    ran()
    for coupling in ("full", "one-way"):
        watch = Watch(None, Sensitivities(_NAMES, lambda n, at: None))
        march(body, parameters, loading, time, MarchSettings(coupling=coupling, keep_points=True), watch)


def compile_heat() -> None:
    """Run the heat equation alone on the motion of that specimen, with and without derivatives."""
    parameters = Parameters.of({**_MATERIAL, **_AROUND})
    body, loading, time = _specimen()
    settings = MarchSettings(coupling="one-way", keep_points=True)
    problem = heat_problem(body, march(body, parameters, loading, time, settings), settings)
    heat_run(problem, parameters)
    heat_run_rates(problem, parameters, _NAMES, lambda n, theta, rates: None)


def compiled() -> None:
    """Compile both drivers side by side, once for each set of sources."""
    if DONE.exists():
        return
    with progress("compiling kernels, once", None):
        code = "from thermofit.experiment.compiling import compile_body; compile_body(lambda: print(flush=True))"
        with subprocess.Popen([sys.executable, "-P", "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
            assert child.stdout is not None
            try:
                compile_point()
                child.stdout.readline()  # the run of the specimen, or the end of the child
                compile_heat()
                if child.wait() == 0:
                    DONE.touch()
            finally:
                child.kill()
