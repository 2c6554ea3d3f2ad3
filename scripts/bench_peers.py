"""Section: thermofit, CalculiX and FElupe on one bar, one mesh, one thread, side by side."""

from __future__ import annotations

from dataclasses import dataclass

import bench_calculix as calculix
import bench_felupe as felupe
import numpy as np
from bench_bar import MISES, Bar, bar_body, bar_loading, bar_times, middle_node
from bench_calculix import PeerRun
from bench_measure import Limits, Options, Part, Row, Target, at_least, once

from thermofit.body.solve.march import History, Loading, MarchSettings, march
from thermofit.body.solve.newton import NewtonSettings

FELUPE_SHARE = 12
"""Increments of 50 that FElupe is given on the full mesh; it needs the same number of iterations in each."""


@dataclass(frozen=True)
class Peer:
    """What a peer adds to the section."""

    rows: tuple[Row, ...] = ()
    targets: tuple[Target, ...] = ()
    missing: str = ""
    agreement: tuple[str, ...] = ()


def measure(options: Options, limits: Limits) -> Part:
    """The bar by all codes that are installed; a sentence for each that is not."""
    bar = Bar(options.mesh)
    seconds, found = thermofit_run(bar, "displacement", bar_loading(bar), options.repeat)
    by_force, forced = thermofit_run(bar, "force", Loading(found.time, found.force), options.repeat)
    ours, middle = float(found.force[-1]), float(found.theta[-1][middle_node(bar_body(bar).mesh)])
    peers = (_calculix(bar, options, seconds, by_force, found, forced), _felupe(bar, options, seconds))
    agreement = [f"thermofit {ours:.1f} N, {middle:.2f} K in the middle of the bar"]
    agreement += [text for peer in peers for text in peer.agreement]
    missing = [peer.missing for peer in peers if peer.missing]
    n_x, n_y, n_z = bar.mesh
    return Part(
        title=f"Straight bar to {100.0 * bar.strain:g} %, {n_x} x {n_y} x {n_z}, beside other codes",
        rows=(
            Row("thermofit, coupled, driven by the displacement", seconds, _counts(found)),
            Row("thermofit, coupled, driven by the force of that run", by_force, _counts(forced)),
            *(row for peer in peers for row in peer.rows),
        ),
        targets=tuple(target for peer in peers for target in peer.targets),
        remarks=(*missing, f"Force on the whole bar at the end. {'. '.join(agreement)}.", *_conditions(bar)),
    )


def _calculix(bar: Bar, options: Options, seconds: float, by_force: float, drawn: History, pulled: History) -> Peer:
    """CalculiX drawn and pulled by the force of thermofit, whose CPU s are `seconds` and `by_force`, whose runs `drawn` and `pulled`."""
    name = "coupled bar pulled by a force: CPU of CalculiX coupled / thermofit"
    if not calculix.available():
        return Peer((), (Target(name, ">= 60 times", "not installed", None),), calculix.MISSING)
    forced = calculix.run(bar, options.scratch / "calculix-force", coupled=True, force=drawn.force)
    coupled = calculix.run(bar, options.scratch / "calculix-coupled", coupled=True)
    static = calculix.run(bar, options.scratch / "calculix-static", coupled=False)
    rows = (
        _row("CalculiX, coupled, pulled by the same force", forced, by_force),
        _row("CalculiX, coupled, drawn", coupled, seconds),
        _row("CalculiX, static (mechanics alone), drawn", static, seconds),
    )
    targets = (at_least(name, forced.whole / by_force, 60.0),) if forced.increments else ()
    force, end = float(drawn.force[-1]), bar_body(bar).mesh.node_sets["top"][0]
    temperature = "no temperature" if coupled.temperature is None else f"{coupled.temperature:.2f} K"
    share = f"{100.0 * (coupled.force / force - 1.0):+.2f} %"
    agreement = [f"CalculiX {coupled.force:.1f} N ({share}), {temperature}", f"CalculiX without heat {static.force:.1f} N"]
    if forced.elongation is not None:
        agreement.append(f"Pulled, CalculiX grows by {forced.elongation:.3f} mm and thermofit by {pulled.u[-1, end, 1]:.3f} mm")
    return Peer(rows, targets, "", tuple(agreement))


def _felupe(bar: Bar, options: Options, seconds: float) -> Peer:
    name = "coupled bar: CPU of FElupe (mechanics alone) / thermofit"
    if not felupe.available():
        return Peer((), (Target(name, ">= 35 times", "not installed", None),), felupe.MISSING)
    part = felupe.run(bar, bar.increments if options.quick else FELUPE_SHARE)
    rows = (_row(f"FElupe, small-strain plasticity, {felupe.solver_name()}", part, seconds),)
    if not part.increments:
        return Peer(rows)
    share = bar.strain * part.increments / bar.increments
    expected, end = felupe.model_force(bar, share), felupe.model_force(bar, bar.strain)
    agreement = f"FElupe {part.force:.1f} N at {100.0 * share:.3g} %, where its material gives {expected:.1f} N ({end:.1f} N at the end)"
    return Peer(rows, (at_least(name, part.whole / seconds, 35.0),), "", (agreement,))


def thermofit_run(bar: Bar, control: str, loading: Loading, repeat: int) -> tuple[float, History]:
    """Median CPU s of the coupled bar after one run that is not counted, and its history."""
    body, times = bar_body(bar, control), bar_times(bar)
    found = [march(body, MISES, loading, times, MarchSettings())]
    seconds = [once(lambda: found.append(march(body, MISES, loading, times, MarchSettings()))) for _ in range(min(repeat, 3))]
    return float(np.median(seconds)), found[-1]


def _counts(found: History) -> str:
    c = found.counts
    return f"{c['steps']} increments, {c['newton_iterations']} iterations with {c['factorisations']} factorisations, plastic heating"


def _row(name: str, run: PeerRun, seconds: float) -> Row:
    if not run.increments:
        return Row(name, None, run.failure or "no increment converged")
    whole = f"{run.increments} increments, {run.iterations} iterations"
    if run.failure:
        whole += f"; {run.failure}; extrapolated to the whole programme from {run.cpu:.1f} s"
    elif run.increments < run.wanted:
        whole += f" run in {run.cpu:.1f} s, extrapolated per increment to {run.wanted}"
    return Row(name, run.whole, f"{whole}; {run.whole / seconds:.1f} times thermofit; {run.peak / 1e6:.0f} MB")


def _conditions(bar: Bar) -> tuple[str, ...]:
    end = f"{100.0 * bar.strain:g} %"
    return (
        f"The upper end is drawn by {bar.elongation:g} mm in {bar.duration:g} s, or pulled by the force that this took thermofit. It stays "
        "plane; surface of von Mises; films at sides and ends. Same nodes and one thread for all; ratios are to thermofit driven alike. "
        "CPU s of CalculiX are those of its process. Those of thermofit and FElupe are those of the increments without imports, of "
        "thermofit with compiled kernels.",
        "CalculiX: C3D8, which integrates at the same 2 x 2 x 2 points as thermofit's hexahedron (C3D8R has one point, C3D8I further "
        "unknowns). NLGEOM, automatic increments, none longer than thermofit's. Where its end is drawn it puts each increment on the last "
        f"layer of elements and cuts it back. Its own tolerance is 0.5 % of the mean force, against {NewtonSettings().tolerance:g} here, "
        "which is in its favour. It has no plastic heating: the dissipation of the law in the evenly drawn bar is prescribed as a body "
        "flux. That saves CalculiX this part of the work. It has no Gough-Joule effect, which cools the bar by at most 0.7 K; its specific "
        "heat is that at constant stress.",
        "FElupe has neither finite-strain plasticity nor plastic heating. It solves the mechanics alone at small strain, driven by the "
        f"displacement in equal increments, with a hardening line between the nominal stresses at yield and at {end}.",
    )
