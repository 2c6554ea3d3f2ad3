"""Section: the sheet beside its body: a coupled run, what the one layer misses, and the identification of experiment 3 on it."""

from __future__ import annotations

import numpy as np
from bench_chain import STAGES, chain_of, compiled, stage_note
from bench_kernel import dogbone_body
from bench_measure import Limits, Options, Part, Row, at_most, once
from bench_runs import directions, forward, forward_with_sensitivities

from thermofit.body.body import Body
from thermofit.body.solve.march import History
from thermofit.study.section import SheetSize

WINDOW = 20.0
"""Half length in mm of the part of the face that the cameras compare."""


def measure(options: Options, limits: Limits) -> Part:
    """CPU s of a coupled run on the sheet and on its body in turn, without and with sensitivities; wall s of the three stages on the sheet
    from interpolated data."""
    n_x, n_y, _ = options.mesh
    size = SheetSize(n_x=n_x, n_y=n_y)
    steps, repeat = (40, 1) if options.quick else (200, min(3, options.repeat))
    sheet, body = (dogbone_body((n.n_x, n.n_y, n.n_z)) for n in (size, size.body))
    forward(sheet, 3)
    runs: dict[str, History] = {}
    seconds: dict[str, list[float]] = {"sheet": [], "body": []}
    for _ in range(repeat):
        for name, of in (("sheet", sheet), ("body", body)):
            seconds[name].append(once(lambda name=name, of=of: runs.update({name: forward(of, steps)})))  # type: ignore[misc]
    thin, whole = (float(np.median(seconds[name])) for name in ("sheet", "body"))
    off_u, off_theta = _off(sheet, body, runs)
    forward_with_sensitivities(sheet, directions(8), 3)
    derived = float(np.median([once(lambda: forward_with_sensitivities(sheet, directions(8), steps)) for _ in range(repeat)]))
    chain = chain_of(options, "sheet")
    chain.prepare()
    compiled(options)
    stages = [chain.identify(stage) for stage in STAGES]
    wall = sum(run.wall for run in stages)
    rows = (
        Row(f"coupled run on the body {size.body.words}, {steps} steps", whole),
        Row(f"coupled run on the {size.words}", thin, f"{whole / thin:.1f} times faster; off by {off_u:.1e} mm, {off_theta:.1e} K"),
        Row("the same with 8 sensitivities", derived, f"{derived / thin:.2f} coupled runs"),
        *(Row(f"identify-{run.stage} on the sheet (wall)", run.wall, stage_note(run)) for run in stages),
        Row("all three (wall)", wall, f"CPU {sum(run.cpu for run in stages):.1f} s"),
    )
    targets = (
        at_most(f"coupled run of {steps} steps on the sheet, CPU", thin, 2.0, "s"),
        at_most("identification of experiment 3 on the sheet, wall", wall, 25.0, "s"),
    )
    remarks = (
        f"Errors are the largest within {WINDOW:g} mm of the middle of the face, over all times, beside the body.",
        *(f"identify-{run.stage}: {run.verdict}." for run in stages),
    )
    return Part(f"Sheet {n_x} x {n_y} beside its body", rows, targets, remarks)


def _off(sheet: Body, body: Body, runs: dict[str, History]) -> tuple[float, float]:
    """Largest differences in displacement (mm, in the plane) and temperature (K) at the nodes of the face that the cameras compare."""
    shown = []
    for name, of in (("sheet", sheet), ("body", body)):
        face = of.mesh.node_sets["face"]
        face = face[np.abs(of.mesh.nodes[face, 1]) <= WINDOW]
        shown.append((runs[name].u[:, face, :2], runs[name].theta[:, face]))
    return float(np.abs(shown[0][0] - shown[1][0]).max()), float(np.abs(shown[0][1] - shown[1][1]).max())
