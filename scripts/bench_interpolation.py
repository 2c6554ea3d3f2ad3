"""Time the interpolation of measured fields onto 1500 nodes: 150 DIC stages of 2000 points, 150 infrared frames of 640 x 512.

Prints the median of three runs in seconds. The frames are in memory, as after calibrate-ir; 1 % of the points are lost at
every stage, each time others.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from thermofit.core.experiment import DicField, InfraredSequence
from thermofit.observe.interpolation import PixelMap, displacements_at, interpolate_displacements, interpolate_temperatures

STAGES, POINTS, FRAMES, SHAPE, NODES, LOST = 150, 2000, 150, (640, 512), 1500, 0.01
RUNS = 3


def seconds(work: Callable[[], object]) -> float:
    """Median wall time of a few runs."""
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    """Make the fields, time both algorithms, print a table."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(-11.5, 11.5, 31), np.linspace(-25.0, 25.0, 65))
    points = (np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-0.2, 0.2, (x.size, 2)))[:POINTS]
    reference = np.column_stack([points, np.zeros(len(points))])
    u = np.linspace(0.0, 1.0, STAGES)[:, None, None] * (reference @ np.diag([-0.05, 0.1, 0.0]))
    u[rng.random(u.shape[:2]) < LOST] = np.nan
    dic = DicField(np.linspace(0.0, 400.0, STAGES), np.arange(len(points)), reference, u)
    targets = np.stack(np.meshgrid(np.linspace(-11.0, 11.0, 25), np.linspace(-22.0, 22.0, NODES // 25)), axis=-1).reshape(-1, 2)
    infrared = InfraredSequence(np.linspace(0.0, 400.0, FRAMES), rng.normal(297.0, 0.025, (FRAMES, *SHAPE)).astype(np.float32))
    place = PixelMap(np.array([[0.0, -10.0], [-10.0, 0.0]]), np.array([320.0, 256.0]))

    nodal = interpolate_displacements(dic, targets)
    at_frames = displacements_at(nodal, infrared.time)
    times = np.linspace(0.0, 400.0, FRAMES) * 0.999
    rows = (
        (f"displacements, {STAGES} stages x {len(points)} points", lambda: interpolate_displacements(dic, targets)),
        ("displacements at the times of the frames", lambda: displacements_at(nodal, infrared.time)),
        (f"temperatures, {FRAMES} frames x {SHAPE[0]} x {SHAPE[1]}", lambda: interpolate_temperatures(infrared, place, targets, at_frames)),
        (
            "temperatures between the frames",
            lambda: interpolate_temperatures(infrared, place, targets, displacements_at(nodal, times)),
        ),
    )
    for name, work in rows:
        print(f"{name:48s} {seconds(work):7.3f} s")
    counts = nodal.counts
    lost = int(counts.points_lost.sum())
    print(f"{len(targets)} nodes; {lost} points lost, {counts.retriangulated} node-stages retriangulated, {counts.masked} masked")


if __name__ == "__main__":
    main()
