"""Section: the point driver of coupon records, beside the finite element kernel on a homogeneous bar."""

from __future__ import annotations

import numpy as np
from bench_bar import PARAMETERS, Bar, bar_mesh
from bench_measure import Limits, Options, Part, Row, Target, cpu

from thermofit.body.body import tension_body
from thermofit.body.solve.march import Loading, MarchSettings, march
from thermofit.body.solve.newton import NewtonSettings
from thermofit.law.hardening.catalogue import hardening_laws
from thermofit.point.driver import PointSettings, Programme, simulate, simulate_rates
from thermofit.point.row_driver import RowProgramme, simulate_row

SAMPLES = 20_000
NAMES = ("E", "M_y0", "M_yinf", "H_exp", "alpha_exp", "beta", "tau", "lag")
LOSSY = PARAMETERS.replace(tau=60.0, lag=0.8, theta_air=296.7)
ADIABATIC = PARAMETERS.replace(alpha_air=0.0, alpha_clamp=0.0, theta_air=296.7)


def measure(options: Options, limits: Limits) -> Part:
    """CPU seconds of a long cyclic record, plain and with derivatives, and the deviation from the body."""
    record = cyclic(SAMPLES)
    cost = simulate(LOSSY, record).counts
    plain = cpu(lambda: simulate(LOSSY, record), options.repeat)
    exact = cpu(lambda: simulate_rates(LOSSY, NAMES, record), options.repeat)
    per_step = 1e6 * plain / cost["steps"]
    laws = {law.name: cpu(lambda law=law: simulate(LOSSY, record, PointSettings(law.name)), options.repeat) for law in hardening_laws()}
    worst = deviations()
    strip, hottest = uneven()
    alone = cpu(lambda: simulate_row(LOSSY, (), strip, hottest), options.repeat)
    derived = cpu(lambda: simulate_row(LOSSY, NAMES, strip, hottest), options.repeat)
    rows = (
        Row(f"{SAMPLES} samples, cycles", plain, f"{per_step:.1f} us per step, {cost['newton_iterations'] / cost['steps']:.1f} iterations"),
        Row(f"the same with {len(NAMES)} exact sensitivities", exact, f"{exact / plain:.1f} times the plain run"),
        *(
            Row(f"the same with hardening {name}", own, f"{own / laws['model2']:.2f} times model2")
            for name, own in laws.items()
            if name != "model2"
        ),
        Row(f"row of {len(strip.place)} sections, {len(strip.time) - 1} steps", alone, "cross-sections 2 % apart"),
        Row(f"the same with {len(NAMES)} exact sensitivities", derived, f"{derived / alone:.1f} times the plain run"),
        *(Row(f"deviation from the body: {name}", None, f"{value:.1e} of its largest value") for name, value in worst.items()),
    )
    largest = max(worst.values())
    targets = (
        Target("point driver, one step", "50 us", f"{per_step:.1f} us", per_step <= 50.0),
        Target(f"point driver, {SAMPLES} samples with {len(NAMES)} sensitivities", "3 s", f"{exact:.2f} s", exact <= 3.0),
        Target("point driver against the body", "1e-6", f"{largest:.1e}", largest <= 1e-6),
    )
    remark = "The body is an adiabatic bar under loading, unloading, reverse flow and reload, with the same steps."
    return Part("Point driver of coupon records", rows, targets, (remark,))


def cyclic(samples: int) -> Programme:
    """Strain cycles of growing amplitude, up to 3 %, in 1000 s."""
    time = np.linspace(0.0, 1000.0, samples)
    return Programme.by_strain(time, 3e-5 * time * np.sin(time / 40.0))


def uneven() -> tuple[RowProgramme, float]:
    """A strip that is narrowest in the middle, pulled to 10 % in 100 s, and its temperature in K."""
    place = np.linspace(-6.0, 6.0, 7)
    time = np.linspace(0.0, 100.0, 97)
    return RowProgramme(time, 1e-3 * time, np.full(7, 1.0 / 7.0), place, 1.0 + 0.02 * (place / 6.0) ** 2), LOSSY["theta_air"]


def deviations() -> dict[str, float]:
    """Largest difference between point and body over the largest value, of stress, lateral strain and rise of temperature."""
    time = np.linspace(0.0, 90.0, 46)
    strain = np.interp(time, [0.0, 30.0, 50.0, 90.0], [0.0, 0.02, -0.01, 0.03])
    bar = Bar((1, 2, 1), length=10.0)
    mesh = bar_mesh(bar)
    body = tension_body(mesh, control="displacement")
    settings = MarchSettings(newton=NewtonSettings(tolerance=1e-10), coupling_tolerance=1e-9)
    history = march(body, ADIABATIC, Loading(time, bar.length * strain, "displacement", from_rest=True), time, settings)
    found = simulate(ADIABATIC, Programme.by_strain(time, strain), PointSettings(max_strain=1.0))
    size = np.ptp(mesh.nodes, axis=0)
    corner = mesh.nearest_node(tuple(mesh.nodes.max(axis=0)))
    pairs = {
        "stress": (found.stress, history.force / (body.symmetry * size[0] * size[2])),
        "lateral strain, width": (found.lateral_x, history.u[:, corner, 0] / size[0]),
        "lateral strain, thickness": (found.lateral_z, history.u[:, corner, 2] / size[2]),
        "temperature": (found.theta - found.theta[0], history.theta[:, corner] - history.theta[0, corner]),
    }
    return {name: float(np.abs(a - b).max() / np.abs(b).max()) for name, (a, b) in pairs.items()}
