"""Section: runs where an effect changes the local update, a backstress or elastic degradation, beside the run without."""

from __future__ import annotations

from bench_bar import PARAMETERS
from bench_kernel import dogbone_body
from bench_measure import Limits, Options, Part, Row, cpu
from bench_runs import IDENTIFIED, forward, forward_with_sensitivities

from thermofit.body.heat.one_way import heat_problem, heat_run, heat_run_rates
from thermofit.body.solve.march import MarchSettings

MESH = (6, 40, 2)
THERMAL = ("E", "alpha_exp", "c0", "kappa", "beta", "alpha_air", "alpha_clamp")
ON = {
    "no effect": {},
    "backstress": {"backstress_first.C": 2900.0},
    "backstress and degradation": {"backstress_first.C": 2900.0, "elastic_degradation.amount": 0.07},
}


def measure(options: Options, limits: Limits) -> Part:
    """CPU s of a coupled run, of the same with derivatives, of a heat run on its motion, and of that with derivatives."""
    mesh, steps = (options.mesh, 10) if options.quick else (MESH, 100)
    body = dogbone_body(mesh)
    repeat = 1 if options.quick else options.repeat
    settings = MarchSettings(keep_points=True)
    rows: list[Row] = []
    for name, values in ON.items():
        parameters = PARAMETERS.replace(**values)
        history = forward(body, steps, settings, parameters)
        problem, names = heat_problem(body, history, settings), (*IDENTIFIED, *values)
        plain = cpu(lambda at=parameters: forward(body, steps, settings, at), repeat)
        derived = cpu(lambda at=parameters, by=names: forward_with_sensitivities(body, by, steps, parameters=at), repeat)
        heat = cpu(lambda of=problem, at=parameters: heat_run(of, at), repeat)
        rates = cpu(lambda of=problem, at=parameters: heat_run_rates(of, at, THERMAL, lambda *_: None), repeat)
        rows += [
            Row(f"coupled run, {name}", plain, f"{steps} steps"),
            Row(f"the same with {len(names)} sensitivities", derived, f"{derived / plain:.2f} coupled runs"),
            Row(f"heat run on its motion, {name}", heat),
            Row(f"the same with {len(THERMAL)} sensitivities", rates, f"{rates / heat:.2f} heat runs"),
        ]
    n_x, n_y, n_z = mesh
    return Part(f"Effects that change the local update, dogbone {n_x} x {n_y} x {n_z}", tuple(rows), ())
