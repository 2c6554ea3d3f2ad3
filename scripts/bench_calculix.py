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
    """What a peer needed and found: CPU s, peak bytes, increments done and asked for, iterations, force N (whole bar), temperature K.

    Under a prescribed force its answer is the elongation, mm.
    """

    cpu: float
    peak: float
    increments: int
    wanted: int
    iterations: int
    force: float
    temperature: float | None
    failure: str = ""
    elongation: float | None = None

    @property
    def whole(self) -> float:
        """CPU s of all increments, extrapolated per increment where only a part was run."""
        return self.cpu * self.wanted / max(self.increments, 1)


def available() -> bool:
    """Whether there is a program `ccx`."""
    return shutil.which("ccx") is not None


def run(bar: Bar, folder: Path, *, coupled: bool, force: np.ndarray | None = None) -> PeerRun:
    """One run of the bar in `folder`: coupled with heat, or mechanics alone (static); automatic increments, one thread.

    Its end is drawn, or pulled by `force` (n + 1,) N at the times of the increments.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"{_JOB}.*"):
        old.unlink()
    (folder / f"{_JOB}.inp").write_text(deck(bar, coupled=coupled, force=force), encoding="ascii")
    child = run_child(["ccx", _JOB], cwd=folder)
    increments = converged_increments(_text(folder / f"{_JOB}.sta"))
    reaction, temperature, elongation, time = last_values(_text(folder / f"{_JOB}.dat"))
    done = time is not None and abs(time - bar.duration) < 1e-6 * bar.duration
    failure = "" if done else f"ended at t = {time} of {bar.duration:g} s: {_last_error(child.stdout)}"
    iterations = len(re.findall(r"^\s*iteration\s+\d+\s*$", child.stdout, flags=re.MULTILINE))
    # Where it ended early the rest is extrapolated over the time of the programme, not over increments whose length it chose itself.
    share = 1.0 if done else (time or 0.0) / bar.duration
    wanted = round(increments / share) if share else increments
    pulled = float("nan") if reaction is None else SYMMETRY * reaction
    return PeerRun(child.cpu, child.peak, increments, wanted, iterations, pulled, temperature, failure, elongation)


def _text(path: Path) -> str:
    return path.read_text(encoding="ascii", errors="replace") if path.exists() else ""


def _last_error(printed: str) -> str:
    lines = [line.strip() for line in printed.splitlines() if "*ERROR" in line or "diverg" in line]
    return lines[-1] if lines else "no message"


def converged_increments(sta: str) -> int:
    """Increments of a .sta file whose attempt did not fail (U): rows of step, increment, attempt, iterations, three times."""
    rows = [line.split() for line in sta.splitlines()]
    return sum(len(row) == 7 and row[0].isdigit() and not row[2].endswith("U") for row in rows)


def last_values(dat: str) -> tuple[float | None, float | None, float | None, float | None]:
    """Total reaction along y in N (model), temperature K, displacement along y mm and time s of the last increment in a .dat file; None
    where absent."""
    last: dict[str, float] = {}
    place = {"total force": 1, "temperatures": -1, "displacements": -2}
    kind = ""
    for line in dat.splitlines():
        if found := re.search(r"^\s*(total force|temperatures|displacements).*time\s+([0-9.E+-]+)", line):
            kind, last["time"] = found.group(1), float(found.group(2))
        elif line.strip() and kind:
            last[kind] = [float(number) for number in line.split()][place[kind]]
            kind = ""
    return last.get("total force"), last.get("temperatures"), last.get("displacements"), last.get("time")


def deck(bar: Bar, *, coupled: bool, force: np.ndarray | None = None) -> str:
    """Input deck in N, mm, s, K, t. C3D8: full 2 x 2 x 2 integration, the same points as thermofit's hexahedron."""
    mesh = bar_mesh(bar)
    tie = () if force is None else _tie_lines(mesh)
    return "\n".join([*_mesh_lines(mesh), *tie, *_material_lines(coupled), *_step_lines(bar, mesh, coupled, force), ""])


def _tie_lines(mesh: Mesh) -> Iterator[str]:
    """The loaded end stays plane, as thermofit's does under a force: its nodes move along y with the first of them."""
    first, *others = (mesh.node_sets["top"] + 1).tolist()
    yield "*EQUATION"
    for node in others:
        yield from ("2", f"{node}, 2, 1., {first}, 2, -1.")


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


def _step_lines(bar: Bar, mesh: Mesh, coupled: bool, force: np.ndarray | None) -> Iterator[str]:
    end = int(mesh.node_sets["top"][0]) + 1
    if force is None:
        yield from ("*AMPLITUDE, NAME=RAMP", f"0., 0., {bar.duration}, 1.")
    else:
        yield "*AMPLITUDE, NAME=PULL"
        yield from (f"{t:.9g}, {f / SYMMETRY:.9g}" for t, f in zip(bar_times(bar), force, strict=True))
        yield from ("*NSET, NSET=END", f"{end},")
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
    yield from ("*BOUNDARY", "X0, 1, 1", "BOTTOM, 2, 2", "Z0, 3, 3")
    drawn = ("*BOUNDARY, AMPLITUDE=RAMP", f"TOP, 2, 2, {bar.elongation:.9g}")
    yield from drawn if force is None else ("*CLOAD, AMPLITUDE=PULL", "END, 2, 1.")
    if coupled:
        yield from ("*DFLUX, AMPLITUDE=HEATING", "BODY, BF, 1.", "*FILM, AMPLITUDE=CONSTANT, FILM AMPLITUDE=CONSTANT")
        yield from _film_lines(mesh)
    yield from ("*NODE PRINT, NSET=TOP, TOTALS=ONLY", "RF") if force is None else ("*NODE PRINT, NSET=END", "U")
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
