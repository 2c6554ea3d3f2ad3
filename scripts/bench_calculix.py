"""CalculiX on the bar: the input deck, the run, and what its files say. Debian: apt install calculix-ccx."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_bar import MISES, SYMMETRY, Bar, bar_mesh, bar_times, curve, heating, middle_node, peer_constants
from bench_measure import run_child

from thermofit.body.mesh.mesh import HEX_FACES, Mesh
from thermofit.law.page import law_of

MISSING = "CalculiX was not measured: no program `ccx` was found; install it with `apt install calculix-ccx` (Debian, Ubuntu)."
DENSITY = 2.7e-9
"""t/mm^3; only the product with the specific heat counts."""
_JOB = "bar"


@dataclass(frozen=True)
class PeerRun:
    """What a peer needed and found: CPU s, peak bytes, increments done and asked for, iterations, force N (whole bar), temperature K."""

    cpu: float
    peak: float
    increments: int
    wanted: int
    iterations: int
    force: float
    temperature: float | None
    failure: str = ""

    @property
    def whole(self) -> float:
        """CPU s of all increments, extrapolated per increment where only a part was run."""
        return self.cpu * self.wanted / max(self.increments, 1)


def available() -> bool:
    """Whether there is a program `ccx`."""
    return shutil.which("ccx") is not None


def run(bar: Bar, folder: Path, *, coupled: bool) -> PeerRun:
    """One run of the bar in `folder`: coupled with heat, or mechanics alone (static); automatic increments, one thread."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"{_JOB}.*"):
        old.unlink()
    (folder / f"{_JOB}.inp").write_text(deck(bar, coupled=coupled), encoding="ascii")
    child = run_child(["ccx", _JOB], cwd=folder)
    increments = converged_increments(_text(folder / f"{_JOB}.sta"))
    force, temperature, time = last_values(_text(folder / f"{_JOB}.dat"))
    done = time is not None and abs(time - bar.duration) < 1e-6 * bar.duration
    failure = "" if done else f"ended at t = {time} of {bar.duration:g} s: {_last_error(child.stdout)}"
    iterations = len(re.findall(r"^\s*iteration\s+\d+\s*$", child.stdout, flags=re.MULTILINE))
    # Where it ended early the rest is extrapolated over the time of the programme, not over increments whose length it chose itself.
    share = 1.0 if done else (time or 0.0) / bar.duration
    wanted = round(increments / share) if share else increments
    force = float("nan") if force is None else SYMMETRY * force
    return PeerRun(child.cpu, child.peak, increments, wanted, iterations, force, temperature, failure)


def _text(path: Path) -> str:
    return path.read_text(encoding="ascii", errors="replace") if path.exists() else ""


def _last_error(printed: str) -> str:
    lines = [line.strip() for line in printed.splitlines() if "*ERROR" in line or "diverg" in line]
    return lines[-1] if lines else "no message"


def converged_increments(sta: str) -> int:
    """Increments of a .sta file whose attempt did not fail (U): rows of step, increment, attempt, iterations, three times."""
    rows = [line.split() for line in sta.splitlines()]
    return sum(len(row) == 7 and row[0].isdigit() and not row[2].endswith("U") for row in rows)


def last_values(dat: str) -> tuple[float | None, float | None, float | None]:
    """Total reaction along y in N (model), temperature K and time s of the last increment in a .dat file; None where absent."""
    force = temperature = time = None
    kind = ""
    for line in dat.splitlines():
        if found := re.search(r"^\s*(total force|temperatures).*time\s+([0-9.E+-]+)", line):
            kind, time = found.group(1), float(found.group(2))
        elif line.strip() and kind:
            values = [float(number) for number in line.split()]
            if kind == "total force":
                force = values[1]
            else:
                temperature = values[-1]
            kind = ""
    return force, temperature, time


def deck(bar: Bar, *, coupled: bool) -> str:
    """Input deck in N, mm, s, K, t. C3D8: full 2 x 2 x 2 integration, the same points as thermofit's hexahedron."""
    mesh = bar_mesh(bar)
    return "\n".join([*_mesh_lines(mesh), *_material_lines(coupled), *_step_lines(bar, mesh, coupled), ""])


def _mesh_lines(mesh: Mesh) -> Iterator[str]:
    yield "*NODE, NSET=ALL"
    yield from (f"{n}, {x:.9g}, {y:.9g}, {z:.9g}" for n, (x, y, z) in enumerate(mesh.nodes, start=1))
    yield "*ELEMENT, TYPE=C3D8, ELSET=BODY"
    yield from (", ".join(map(str, (n, *(nodes + 1)))) for n, nodes in enumerate(mesh.hexes, start=1))
    for name, nodes in {**mesh.node_sets, "middle": np.array([middle_node(mesh)])}.items():
        yield f"*NSET, NSET={name.upper()}"
        yield from _listed(nodes + 1)


def _listed(numbers: Iterable[int]) -> Iterator[str]:
    """Eight numbers on a line."""
    numbers = list(numbers)
    for start in range(0, len(numbers), 8):
        yield ", ".join(map(str, numbers[start : start + 8])) + ","


def _material_lines(coupled: bool) -> Iterator[str]:
    c = peer_constants(MISES)
    table = curve(law_of(MISES), np.linspace(0.0, 0.25, 101))
    yield from ("*MATERIAL, NAME=ALLOY", "*ELASTIC", f"{c['E']}, {c['nu']}", "*PLASTIC")
    yield from (f"{stress:.8g}, {strain:.8g}" for stress, strain in zip(table.stress, table.strain, strict=True))
    if coupled:
        yield from (f"*EXPANSION, ZERO={c['theta_ref']}", f"{c['alpha_exp']:.8g}", "*CONDUCTIVITY", f"{c['kappa']}")
        yield from ("*DENSITY", f"{DENSITY}", "*SPECIFIC HEAT", f"{c['capacity'] / DENSITY:.9g}")
    yield "*SOLID SECTION, ELSET=BODY, MATERIAL=ALLOY"
    if coupled:
        yield from ("*INITIAL CONDITIONS, TYPE=TEMPERATURE", f"ALL, {c['theta_ref']}")


def _step_lines(bar: Bar, mesh: Mesh, coupled: bool) -> Iterator[str]:
    yield from ("*AMPLITUDE, NAME=RAMP", f"0., 0., {bar.duration}, 1.")
    if coupled:
        times = bar_times(bar)
        yield from ("*AMPLITUDE, NAME=CONSTANT", f"0., 1., {bar.duration}, 1.", "*AMPLITUDE, NAME=HEATING")
        yield from (f"{t:.9g}, {q:.9g}" for t, q in zip(times, heating(bar, law_of(MISES), times), strict=True))
    yield "*STEP, NLGEOM, INC=2000"
    yield "*COUPLED TEMPERATURE-DISPLACEMENT" if coupled else "*STATIC"
    # Automatic increments, none longer than thermofit's.
    longest = bar.duration / bar.increments
    yield f"{longest:.9g}, {bar.duration:.9g}, {1e-6 * longest:.9g}, {longest:.9g}"
    # A transient step would apply a displacement at once: it follows the amplitude.
    yield from ("*BOUNDARY", "X0, 1, 1", "BOTTOM, 2, 2", "Z0, 3, 3", "*BOUNDARY, AMPLITUDE=RAMP", f"TOP, 2, 2, {bar.elongation:.9g}")
    if coupled:
        yield from ("*DFLUX, AMPLITUDE=HEATING", "BODY, BF, 1.", "*FILM, AMPLITUDE=CONSTANT, FILM AMPLITUDE=CONSTANT")
        yield from _film_lines(mesh)
    yield from ("*NODE PRINT, NSET=TOP, TOTALS=ONLY", "RF")
    if coupled:
        yield from ("*NODE PRINT, NSET=MIDDLE", "NT")
    yield "*END STEP"


def _film_lines(mesh: Mesh) -> Iterator[str]:
    """Element, face, sink temperature and film coefficient of every facet; the faces of thermofit and of CalculiX have one order."""
    c = peer_constants(MISES)
    owner = {tuple(sorted(face)): (e, k) for e, faces in enumerate(mesh.hexes[:, HEX_FACES], 1) for k, face in enumerate(faces.tolist(), 1)}
    for name, facets in mesh.facets.items():
        for facet in facets.tolist():
            element, face = owner[tuple(sorted(facet))]
            yield f"{element}, F{face}, {c['theta_' + name]}, {c['film_' + name]:.8g}"
