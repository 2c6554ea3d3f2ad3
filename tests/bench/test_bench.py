"""The benchmark script: what it tells the peers, how it reads what they leave, and what it writes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from thermofit.experiment.forward import MechanicalRun
from thermofit.law.page import law_of
from thermofit.point.state import LAMBDA

SMALL = (2, 4, 2)
CALCULIX_FACES = ((1, 2, 3, 4), (5, 8, 7, 6), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 8, 4), (4, 8, 5, 1))
"""Corners of the faces F1 to F6 of C3D8 after the manual of CalculiX."""


@pytest.fixture(scope="module")
def bar(scripts: Any) -> ModuleType:
    return scripts("bench_bar")


@pytest.fixture(scope="module")
def calculix(scripts: Any) -> ModuleType:
    return scripts("bench_calculix")


@pytest.fixture(scope="module")
def measure(scripts: Any) -> ModuleType:
    return scripts("bench_measure")


def cards(deck: str) -> dict[str, list[str]]:
    """Data lines of a deck by keyword line; lines of one keyword together."""
    found: dict[str, list[str]] = {}
    name = ""
    for line in deck.splitlines():
        if line.startswith("*"):
            name = line
            found.setdefault(name, [])
        else:
            found[name].append(line)
    return found


def test_prescribed_heating_releases_the_dissipation_of_the_law(bar: ModuleType) -> None:
    problem, law = bar.Bar(SMALL), law_of(bar.MISES)
    times = np.linspace(0.0, problem.duration, 2001)
    power = bar.heating(problem, law, times)
    released = float(np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(times)))
    strain = bar.plastic_strain(law, np.array([problem.strain]))
    assert 0.1 < strain[0] < np.log1p(problem.strain)
    assert released == pytest.approx(float(bar.curve(law, strain).dissipated[0]), rel=2e-3)
    assert power[0] == 0.0


def test_curve_begins_at_the_yield_stress_along_the_load(bar: ModuleType) -> None:
    law = law_of(bar.MISES.replace(F=0.35))
    curve = bar.curve(law, np.array([0.0, 0.5]))
    assert curve.stress[0] == pytest.approx(bar.MISES["M_y0"] / np.sqrt(0.85))
    saturated = bar.MISES["M_yinf"] / np.sqrt(0.85)
    assert 0.98 * saturated < curve.stress[1] < saturated


def test_bar_films_cover_its_skin(bar: ModuleType) -> None:
    mesh = bar.bar_mesh(bar.Bar(SMALL))
    n_x, n_y, n_z = SMALL
    assert len(mesh.facets["air"]) == n_y * (n_x + n_z)
    assert len(mesh.facets["clamp"]) == 2 * n_x * n_z
    middle = mesh.nodes[bar.middle_node(mesh)]
    assert middle == pytest.approx([0.0, 50.0, 0.0])


def test_deck_holds_the_mesh_and_the_films_on_the_right_faces(bar: ModuleType, calculix: ModuleType) -> None:
    problem = bar.Bar(SMALL)
    mesh = bar.bar_mesh(problem)
    deck = cards(calculix.deck(problem, coupled=True))
    assert len(deck["*NODE, NSET=ALL"]) == mesh.n_nodes
    elements = np.array([[int(word) for word in line.split(",")] for line in deck["*ELEMENT, TYPE=C3D8, ELSET=BODY"]])
    assert np.array_equal(elements[:, 1:] - 1, mesh.hexes)
    facets = {tuple(sorted(facet)): name for name, group in mesh.facets.items() for facet in group.tolist()}
    films = deck["*FILM, AMPLITUDE=CONSTANT, FILM AMPLITUDE=CONSTANT"]
    assert len(films) == len(facets)
    for line in films:
        element, face, sink, coefficient = (word.strip() for word in line.split(","))
        corners = [mesh.hexes[int(element) - 1][corner - 1] for corner in CALCULIX_FACES[int(face[1:]) - 1]]
        name = facets[tuple(sorted(corners))]
        assert float(coefficient) == pytest.approx(1e-3 * bar.MISES[f"alpha_{name}"])
        assert float(sink) == bar.MISES[f"theta_{name}"]
    assert all(len(line) <= 132 for line in calculix.deck(problem, coupled=True).splitlines())


def test_deck_without_heat_has_none(bar: ModuleType, calculix: ModuleType) -> None:
    deck = cards(calculix.deck(bar.Bar(SMALL), coupled=False))
    assert "*STATIC" in deck and "*PLASTIC" in deck
    assert not any(name.startswith(("*FILM", "*DFLUX", "*EXPANSION", "*COUPLED")) for name in deck)
    assert float(deck["*PLASTIC"][0].split(",")[0]) == pytest.approx(bar.MISES["M_y0"])


DAT = """
 total force (fx,fy,fz) for set TOP and time  0.9800000E+02

       -2.0E-06  1.600000E+03 -2.4E-06

 temperatures for set MIDDLE and time  0.9800000E+02

       121  3.012783E+02

 total force (fx,fy,fz) for set TOP and time  0.1000000E+03

       -2.706813E-05  1.669008E+03 -2.478700E-06

 temperatures for set MIDDLE and time  0.1000000E+03

       121  3.023549E+02
"""
STA = """SUMMARY OF JOB INFORMATION
  STEP      INC     ATT  ITRS     TOT TIME     STEP TIME      INC TIME
     1          1     1U    5  0.000000E+00  0.000000E+00  0.200000E+01
     1          1     2     4  0.500000E+00  0.500000E+00  0.500000E+00
     1          2     1     3  0.100000E+01  0.100000E+01  0.500000E+00
"""


def test_files_of_calculix_are_read(calculix: ModuleType) -> None:
    assert calculix.last_values(DAT) == (1669.008, 302.3549, None, 100.0)
    assert calculix.last_values("") == (None, None, None, None)
    pulled = " displacements (vx,vy,vz) for set END and time  0.1000000E+03\n\n      1105  -1.2E-01  1.4589E+01  0.0E+00\n"
    assert calculix.last_values(pulled) == (None, None, 14.589, 100.0)
    assert calculix.converged_increments(STA) == 2
    assert calculix.converged_increments("\n".join(STA.splitlines()[:3])) == 0


def test_the_deck_under_a_force_ties_the_end_and_pulls_it(calculix: ModuleType, bar: ModuleType) -> None:
    """A quarter of the force, at the times of the increments; nothing is drawn then."""
    problem = bar.Bar(SMALL)
    force = np.linspace(0.0, 4000.0, problem.increments + 1)
    drawn, pulled = (cards(calculix.deck(problem, coupled=True, force=given)) for given in (None, force))
    top = bar.bar_mesh(problem).node_sets["top"] + 1
    assert len(pulled["*EQUATION"]) == 2 * (len(top) - 1) and "*EQUATION" not in drawn
    table = np.array([[float(v) for v in row.split(",")] for row in pulled["*AMPLITUDE, NAME=PULL"]])
    assert np.allclose(table[:, 0], bar.bar_times(problem)) and np.allclose(table[:, 1], force / bar.SYMMETRY)
    assert pulled["*CLOAD, AMPLITUDE=PULL"] == ["END, 2, 1."] and pulled["*NSET, NSET=END"] == [f"{top[0]},"]
    assert "*BOUNDARY, AMPLITUDE=RAMP" in drawn and "*BOUNDARY, AMPLITUDE=RAMP" not in pulled


def test_a_part_of_the_increments_is_extrapolated(calculix: ModuleType) -> None:
    run = calculix.PeerRun(cpu=12.0, peak=1.0, increments=12, wanted=50, iterations=48, force=0.0, temperature=None)
    assert run.whole == pytest.approx(50.0)


def test_line_of_felupe_agrees_at_both_ends(scripts: Any, bar: ModuleType) -> None:
    felupe, problem = scripts("bench_felupe"), bar.Bar(SMALL)
    limit, modulus = felupe.hardening_line(problem)
    law = law_of(bar.MISES)
    strain = bar.plastic_strain(law, np.array([problem.strain]))
    nominal = float(bar.curve(law, strain).stress[0]) / (1.0 + problem.strain)
    assert limit == bar.MISES["M_y0"] and modulus > 0.0
    assert felupe.model_force(problem, problem.strain) == pytest.approx(30.0 * nominal)
    assert felupe.model_force(problem, 1e-4) == pytest.approx(30.0 * 1e-4 * bar.MISES["E"])


def test_a_peer_that_is_missing_is_left_out_with_a_sentence(
    scripts: Any, bar: ModuleType, measure: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    peers, options = scripts("bench_peers"), measure.Options(SMALL, 1, 1, True, tmp_path)
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for peer in (peers._calculix(bar.Bar(SMALL), options, 1.0, 1.0, None, None), peers._felupe(bar.Bar(SMALL), options, 1.0)):
        assert peer.rows == () and "install it with" in peer.missing
        assert [target.met for target in peer.targets] == [None]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("piece", ["assemble", "newton_iteration"])
def test_pieces_are_timed(benchmark: Any, scripts: Any, piece: str) -> None:
    """Compare two states of the kernel: `pytest -m slow tests/bench/test_bench.py --benchmark-autosave`, then `--benchmark-compare`."""
    kernel = scripts("bench_kernel")
    pieces = kernel.Pieces(kernel.dogbone_body((6, 40, 2)))
    pieces.element_pass(1.0, tangent=True)
    benchmark(getattr(pieces, piece))
    assert np.all(pieces.state[:, :, LAMBDA] > 0.0) and np.any(pieces.data)


def test_child_is_measured_alone(measure: ModuleType) -> None:
    ballast = np.ones(20_000_000)
    child = measure.run_child([sys.executable, "-c", "import os, sys; print(os.environ['OMP_NUM_THREADS']); sys.exit(5)"])
    assert child.code == 5 and child.stdout == "1\n"
    assert 0.0 < child.cpu < 5.0 and child.wall > 0.0
    assert child.peak < 0.5 * ballast.nbytes


def test_first_words_on_a_terminal_are_timed(measure: ModuleType) -> None:
    code = r"import time; print('\x1b[1m  ready \x1b[0m', flush=True); time.sleep(60)"
    wall, words = measure.first_line([sys.executable, "-c", code])
    assert words == "ready" and wall < 30.0
    silent, nothing = measure.first_line([sys.executable, "-c", ""])
    assert silent == float("inf") and nothing == ""


def test_exponent_is_the_slope_of_the_logarithms(measure: ModuleType) -> None:
    sizes = [480.0, 960.0, 1920.0]
    assert measure.exponent(sizes, [3.0 * n**1.25 for n in sizes]) == pytest.approx(1.25)


def test_document_says_which_targets_are_met(scripts: Any, measure: ModuleType, tmp_path: Path) -> None:
    document = scripts("bench_document")
    targets = (
        measure.at_most("run", 9.0, 30.0, "s", 10.0),
        measure.at_least("ratio", 3.0, 12.0, aim=40.0),
        measure.Target("peer", ">= 6 times", "not installed", None),
    )
    rows = (measure.Row("factor", 0.02, "10 GF/s"), measure.Row("memory", None, "a | b"))
    part = measure.Part("Pieces", rows, targets, ("A remark.",))
    measured = document.Measured(part, "2030-01-01 12:00", 0.04, 50.0, 20.0, "threads 1")
    path = tmp_path / "deep" / "sections.json"
    document.save(path, {"kernel": measured})
    assert document.load(path) == {"kernel": measured}
    assert document.load(tmp_path / "none.json") == {}
    lines = document.document(document.load(path)).splitlines()
    assert "| run | <= 30 s (aim 10) | 9 s | met |" in lines
    assert "| ratio | >= 12 times (aim 40) | 3 times | not met |" in lines
    assert "| peer | >= 6 times | not installed | not measured |" in lines
    assert "| factor | 20 ms | 0.5 | 10 GF/s |" in lines
    assert "| memory |  |  | a \\| b |" in lines and "* A remark." in lines


def test_stage_is_read_from_its_command_and_its_artefact(scripts: Any, measure: ModuleType) -> None:
    chain = scripts("bench_chain")
    child = measure.Child(cpu=20.0, wall=11.0, peak=2e8, code=5, stdout="", stderr="")
    shown = {"evaluations": {"forward": 23, "failed": 1}, "trustworthy": False, "verdict": "not trustworthy: F is at its bound"}
    run = chain.stage_run("plastic", child, shown)
    assert (run.forward, run.wall, run.trustworthy) == (23, 11.0, False)
    chain.checked(child, "identify-plastic")
    with pytest.raises(RuntimeError, match="exit code 4: the step failed"):
        chain.checked(measure.Child(1.0, 1.0, 1.0, 4, "", "the step failed"), "identify-plastic")


def test_mesh_of_the_command_line(scripts: Any) -> None:
    bench = scripts("bench")
    assert bench.mesh_of("full") == bench.mesh_of("12x80x4") == (12, 80, 4)
    with pytest.raises(argparse.ArgumentTypeError, match="12x80x4"):
        bench.mesh_of("12x80")


def test_diagnosis_section_scores_the_catalogue(scripts: Any, measure: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The section runs as it is called. A joint model gives its last run again: none of the pieces that are timed is one of those."""
    options = measure.Options(mesh=(2, 12, 1), repeat=1, threads=1, quick=True, scratch=tmp_path)
    section, runs, made, run = scripts("bench_diagnosis"), [], [], MechanicalRun.__call__
    monkeypatch.setattr(MechanicalRun, "__call__", lambda *given: made.append(given) or run(*given))

    def counted(work: Any, repeat: int) -> float:
        before = len(made)
        work(), work()
        runs.append(len(made) - before)
        return 1.0

    monkeypatch.setattr(section, "cpu", counted)
    part = section.measure(options, measure.Limits(0.03, 60.0, 40.0))
    assert runs == [2, 2, 2]
    assert "dormant effects" in part.rows[-1].name and int(part.rows[-1].note.split()[3]) > 100 and part.targets[0].met


def test_structure_section_runs_with_each_effect_on(scripts: Any, measure: ModuleType, tmp_path: Path) -> None:
    options = measure.Options(mesh=(2, 8, 1), repeat=1, threads=1, quick=True, scratch=tmp_path)
    part = scripts("bench_structure").measure(options, measure.Limits(0.03, 60.0, 40.0))
    runs = [row for row in part.rows if row.name.startswith("coupled run")]
    assert len(part.rows) == 4 * len(runs) == 12 and all(row.seconds is not None and row.seconds > 0.0 for row in part.rows)


@pytest.mark.slow
def test_point_section_agrees_with_the_body(scripts: Any) -> None:
    """The deviation that the benchmark prints is that of the same bar: below the promised 1e-6, and no exact zero."""
    found = scripts("bench_point").deviations()
    assert set(found) == {"stress", "lateral strain, width", "lateral strain, thickness", "temperature"}
    assert all(0.0 < value < 1e-6 for value in found.values()), found
