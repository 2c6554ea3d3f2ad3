"""Section: how time grows with the number of elements, by refinement and by length at constant cross-section."""

from __future__ import annotations

import numpy as np
from bench_bar import Bar, bar_body
from bench_kernel import dogbone_body
from bench_measure import Limits, Options, Part, Row, at_most, exponent, once
from bench_runs import forward

from thermofit.body.body import Body

REFINED = ((6, 40, 2), (6, 40, 4), (6, 80, 4), (12, 80, 4))
"""1, 2, 4 and 8 times the elements of the coarse mesh."""
SECTION = (12, 4)
LENGTHS = (20, 40, 80, 160)
"""Elements along bars of 1, 2, 4 and 8 times the length; n_x and n_z stay."""
STEPS = 20


def measure(options: Options, limits: Limits) -> Part:
    """CPU s of a fixed short programme on every mesh, and the exponents by least squares of the logarithms."""
    refined = REFINED[:3] if options.quick else REFINED
    lengths = LENGTHS[:3] if options.quick else LENGTHS
    repeat = 1 if options.quick else min(3, options.repeat)
    rows, finer, longer = [], [], []
    for mesh in refined:
        finer.append(_timed(dogbone_body(mesh), repeat))
        rows.append(_row(f"dogbone {mesh[0]} x {mesh[1]} x {mesh[2]}", *finer[-1]))
    for n_y in lengths:
        bar = Bar((SECTION[0], n_y, SECTION[1]), length=1.25 * n_y)
        longer.append(_timed(bar_body(bar, "force"), repeat))
        rows.append(_row(f"bar {SECTION[0]} x {n_y} x {SECTION[1]}, {bar.length:g} mm", *longer[-1]))
    targets = (
        at_most("growth of time with elements n, refined: exponent", exponent(*_columns(finer)), 1.5, ""),
        at_most("growth of time with elements n, longer at constant section: exponent", exponent(*_columns(longer)), 1.1, ""),
    )
    per_iteration = [exponent([n for n, _, _ in points], [s / i for _, s, i in points]) for points in (finer, longer)]
    refined_text, longer_text = (f"{value:.2f}" for value in per_iteration)
    remarks = (
        f"{STEPS} coupled steps each through load, unload and cool, driven by one force.",
        f"Exponents of the time per Newton iteration: {refined_text} refined, {longer_text} longer.",
    )
    return Part("Growth with the number of elements", tuple(rows), targets, remarks)


def _timed(body: Body, repeat: int) -> tuple[int, float, int]:
    """Elements, median CPU s of the programme after a run that is not counted, Newton iterations."""
    found = [forward(body, STEPS)]
    seconds = [once(lambda: found.append(forward(body, STEPS))) for _ in range(repeat)]
    return body.mesh.n_elements, float(np.median(seconds)), found[-1].counts["newton_iterations"]


def _columns(points: list[tuple[int, float, int]]) -> tuple[list[float], list[float]]:
    return [float(n) for n, _, _ in points], [seconds for _, seconds, _ in points]


def _row(name: str, elements: int, seconds: float, iterations: int) -> Row:
    each = 1e6 * seconds / elements / iterations
    return Row(name, seconds, f"{elements} elements, {iterations} iterations, {each:.1f} us per element and iteration")
