"""FElupe on the bar: small-strain plasticity, mechanics alone. A child process: python scripts/bench_felupe.py '{"mesh": ...}' INCREMENTS

FElupe has no finite-strain plasticity and no plastic heating: it solves the smaller problem. Its hardening is linear, so that the
line from the yield limit to the nominal stress at the final strain takes the place of the law's curve; both ends agree by construction.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from bench_bar import MISES, SYMMETRY, Bar, bar_mesh, curve, plastic_strain
from bench_calculix import PeerRun
from bench_measure import run_child

from thermofit.law.page import law_of

MISSING = "FElupe was not measured: it is not installed here; install it with `pip install -e '.[bench]'`."


def available() -> bool:
    """Whether FElupe can be imported."""
    return importlib.util.find_spec("felupe") is not None


def solver_name() -> str:
    """The linear solver that FElupe is given: PARDISO where pypardiso is installed, else SuperLU of scipy."""
    return "PARDISO (pypardiso)" if importlib.util.find_spec("pypardiso") else "SuperLU (scipy)"


def run(bar: Bar, increments: int) -> PeerRun:
    """The first `increments` of the bar in a process of its own; CPU s are those of the increments without imports and set-up."""
    child = run_child([sys.executable, str(Path(__file__).resolve()), json.dumps(asdict(bar)), str(increments)])
    if child.code != 0:
        last = (child.stderr.strip().splitlines() or ["no message"])[-1]
        return PeerRun(child.cpu, child.peak, 0, bar.increments, 0, float("nan"), None, f"FElupe failed: {last}")
    found = json.loads(child.stdout.splitlines()[-1])
    return PeerRun(found["cpu"], child.peak, increments, bar.increments, found["iterations"], found["force"], None)


def hardening_line(bar: Bar) -> tuple[float, float]:
    """Yield limit and linear modulus, MPa, of small-strain plasticity with the nominal stress of the law at yield and at the end."""
    law = law_of(MISES)
    end_strain = plastic_strain(law, np.array([bar.strain]))
    start, end = (float(curve(law, value).stress[0]) for value in (np.zeros(1), end_strain))
    nominal = end / (1.0 + bar.strain)
    return start, (nominal - start) / (bar.strain - nominal / MISES["E"])


def model_force(bar: Bar, elongation: float) -> float:
    """Force N on the whole bar that the line gives at an elongation, a share of the length; the answer that FElupe should find."""
    limit, modulus = hardening_line(bar)
    young = MISES["E"]
    stress = min(young * elongation, (limit + modulus * elongation) / (1.0 + modulus / young))
    width, _, thickness = np.ptp(bar_mesh(bar).nodes, axis=0)
    return SYMMETRY * float(width * thickness) * stress


def _solver() -> Callable[..., np.ndarray]:
    if importlib.util.find_spec("pypardiso"):
        from pypardiso import spsolve as pardiso

        return pardiso
    from scipy.sparse.linalg import spsolve

    return spsolve


def _march(bar: Bar, increments: int) -> dict[str, Any]:
    import felupe

    source = bar_mesh(bar)
    mesh = felupe.Mesh(source.nodes, source.hexes, "hexahedron")
    field = felupe.FieldContainer([felupe.Field(felupe.RegionHexahedron(mesh), dim=3)])
    limit, modulus = hardening_line(bar)
    material = felupe.LinearElasticPlasticIsotropicHardening(E=MISES["E"], nu=MISES["nu"], sy=limit, K=modulus)
    solid = felupe.SolidBody(umat=material, field=field)
    free = {"x0": (0, 1, 1), "bottom": (1, 0, 1), "z0": (1, 1, 0), "top": (1, 0, 1)}
    boundaries = {}
    for name, skip in free.items():
        chosen = np.isin(np.arange(len(source.nodes)), source.node_sets[name])
        boundaries[name] = felupe.Boundary(field[0], mask=chosen, skip=skip)
    solve, iterations = _solver(), 0
    start = time.process_time()
    for n in range(1, increments + 1):
        boundaries["top"].value = bar.elongation * n / bar.increments
        parts = felupe.dof.partition(field, boundaries)
        dof0, dof1 = parts
        prescribed = felupe.dof.apply(field, boundaries, dof0)
        found = felupe.newtonraphson(items=[solid], dof0=dof0, dof1=dof1, ext0=prescribed, solver=solve, verbose=0)
        iterations += found.iterations
    seconds = time.process_time() - start
    reaction = felupe.tools.force(field, found.fun, boundaries["top"])
    return {"cpu": seconds, "iterations": iterations, "force": SYMMETRY * abs(float(reaction[1]))}


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    print(json.dumps(_march(Bar(**{**given, "mesh": tuple(given["mesh"])}), int(sys.argv[2]))))
