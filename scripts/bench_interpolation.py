"""Time and memory of nodal values from measured fields on 1500 nodes: 150 DIC stages of 2000 points, 150 infrared frames of 640 x 512.

Prints CPU seconds, the median of three runs, by projection and by three points. The frames are in memory, as after calibrate-ir; 1 % of the
points are lost at every stage, each time others. What the patches show of 100 displacement fields is timed as well. With the
argument `memory` it projects 1000 frames once and prints the largest memory.
"""

from __future__ import annotations

import resource
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from thermofit.core.experiment import DicField, InfraredSequence
from thermofit.observe.interpolation import PixelMap, displacements_at, interpolate_displacements, interpolate_temperatures
from thermofit.observe.patches import MOMENTS, averaged
from thermofit.observe.projection import Patches, Projected, in_line, project_displacements, project_temperatures, sight_of

STAGES, POINTS, FRAMES, SHAPE, NODES, LOST = 150, 2000, 150, (640, 512), 1500, 0.01
COLUMNS, SEEN = 100, 357
"""Fields of which the means over patches are made, on as many nodes as a coarse mesh shows."""
NOISE = np.array([0.002, 0.002])
PLACE = PixelMap(np.array([[0.0, -10.0], [-10.0, 0.0]]), np.array([320.0, 256.0]))
RUNS = 3


def seconds(work: Callable[[], object]) -> float:
    """Median CPU time of a few runs."""
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def field() -> DicField:
    """Stages of a specimen that is pulled by 10 %."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(-11.5, 11.5, 31), np.linspace(-25.0, 25.0, 65))
    points = (np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-0.2, 0.2, (x.size, 2)))[:POINTS]
    reference = np.column_stack([points, np.zeros(len(points))])
    u = np.linspace(0.0, 1.0, STAGES)[:, None, None] * (reference @ np.diag([-0.05, 0.1, 0.0]))
    u[rng.random(u.shape[:2]) < LOST] = np.nan
    return DicField(np.linspace(0.0, 400.0, STAGES), np.arange(len(points)), reference, u)


def camera(frames: int) -> InfraredSequence:
    """Frames of noise."""
    rng, out = np.random.default_rng(2), np.empty((frames, *SHAPE), dtype=np.float32)
    for n in range(frames):
        out[n] = rng.normal(297.0, 0.025, SHAPE)
    return InfraredSequence(np.linspace(0.0, 400.0, frames), out)


def projected(dic: DicField, infrared: InfraredSequence, patches: Patches, good: np.ndarray) -> Projected:
    """Temperatures of all frames by projection."""
    sight = sight_of(PLACE, dic, patches, good, np.zeros(len(patches.raster().places), dtype=bool), infrared.time)
    return project_temperatures(infrared, sight, patches)


def main() -> None:
    """Make the fields, time both ways, print a table."""
    dic = field()
    targets = np.stack(np.meshgrid(np.linspace(-11.0, 11.0, 25), np.linspace(-22.0, 22.0, NODES // 25)), axis=-1).reshape(-1, 2)
    patches = Patches(targets, np.zeros((0, 2)))
    if "memory" in sys.argv[1:]:
        at = projected(dic, camera(1000), patches, in_line(dic, NOISE))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
        print(f"{len(at.time)} frames of {SHAPE[0]} x {SHAPE[1]}: {time.process_time():.1f} s of CPU in all, at most {peak:.2f} GiB")
        return
    infrared = camera(FRAMES)
    good = in_line(dic, NOISE)
    nodal = interpolate_displacements(dic, targets)
    at_frames = displacements_at(nodal, infrared.time)
    shown, moments = np.zeros((STAGES, SEEN, 2, COLUMNS)), np.full((STAGES, SEEN, MOMENTS), 0.1)
    stages, frames = f"{STAGES} stages x {len(dic.reference)} points", f"{FRAMES} frames x {SHAPE[0]} x {SHAPE[1]}"
    rows = (
        (f"points in line, {stages}", lambda: in_line(dic, NOISE)),
        (f"projected displacements, {stages}", lambda: project_displacements(dic, patches, good)),
        (f"projected temperatures, {frames}", lambda: projected(dic, infrared, patches, good)),
        (f"three-point displacements, {stages}", lambda: interpolate_displacements(dic, targets)),
        (f"three-point temperatures, {frames}", lambda: interpolate_temperatures(infrared, PLACE, targets, at_frames)),
        (f"means over {SEEN} patches, {STAGES} stages, {COLUMNS} fields", lambda: averaged(shown, moments, targets[:SEEN])),
    )
    for name, work in rows:
        print(f"{name:58s} {seconds(work):7.3f} s")
    counts = project_displacements(dic, patches, good).counts
    print(f"{len(targets)} nodes; {counts['points_lost']} points lost, {counts['masked']} node-stages masked")


if __name__ == "__main__":
    main()
