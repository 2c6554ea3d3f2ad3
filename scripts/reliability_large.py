"""Long and large: many identifications in one process, and runs of growing size, with their time and memory.

`identifications`: a coupon study fitted over and over in one process; the memory after the first tenth beside that at the end.
`mesh`: one coupled run of a dogbone pulled into the plastic range, size by size, each in a process of its own.
`frames`: camera frames and DIC stages of full size through the calibration's reader and the projection (`scripts/bench_interpolation.py`).
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from reliability_study import ROOT, environment

from thermofit.core.parameters import Parameters

MESHES = ((6, 40, 2), (8, 54, 2), (12, 80, 4), (18, 120, 6), (24, 160, 8))
LARGEST_MB = 2048.0
MATERIAL = {"E": 7e4, "nu": 0.33, "M_y0": 120.0, "M_yinf": 280.0, "H_exp": 11.0, "alpha_exp": 2e-5, "kappa": 130.0, "c0": 2.3, "beta": 0.8}
AROUND = {"alpha_air": 15.0, "alpha_clamp": 240.0, "theta_air": 297.4, "theta_clamp": 296.7, "theta_ref": 296.7}


def resident() -> float:
    """Memory of this process now, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def peak() -> float:
    """Largest memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def identifications(number: int) -> dict[str, float]:
    """Fits of a coupon to other noise, with standard errors and intervals, each as a stage does it."""
    from repeated_coupon import bench, intervals  # tests/support

    begin, early = time.perf_counter(), 0.0
    with tempfile.TemporaryDirectory() as folder:
        made = bench(Path(folder), 60)
        for k in range(number):
            intervals(made, 0.0, k, profile=False)
            if k == max(number // 10, 5):
                early = resident()
    late = resident()
    return {
        "identifications": number,
        "early_MB": round(early, 1),
        "late_MB": round(late, 1),
        "growth_percent": round(100.0 * (late / early - 1.0), 2),
        "s": round(time.perf_counter() - begin, 1),
    }


def mesh(n_x: int, n_y: int, n_z: int, steps: int) -> dict[str, object]:
    """One coupled run."""
    from thermofit.body.body import tension_body
    from thermofit.body.mesh.dogbone import dogbone_mesh
    from thermofit.body.solve.history import MarchSettings
    from thermofit.body.solve.loading import Loading
    from thermofit.body.solve.march import march
    from thermofit.core.experiment import Specimen

    body = tension_body(dogbone_mesh(Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0), n_x, n_y, n_z))
    times = np.linspace(0.0, 30.0, steps + 1)
    begin, cpu = time.perf_counter(), time.process_time()
    loading = Loading(np.array([0.0, 30.0]), np.array([0.0, 5800.0]))
    history = march(body, Parameters.of({**MATERIAL, **AROUND}), loading, times, MarchSettings())
    assert np.isfinite(history.u).all() and history.u_top[-1] > 1.0
    return {
        "elements": n_x * n_y * n_z,
        "degrees_of_freedom": 4 * body.mesh.n_nodes,
        "steps": steps,
        "cpu_s": round(time.process_time() - cpu, 1),
        "wall_s": round(time.perf_counter() - begin, 1),
        "peak_MB": round(peak()),
    }


def fields() -> dict[str, object]:
    """1000 DIC stages of 20,000 points, one in a hundred lost: their noise, those out of line, the values of 1500 nodes, and the motion at
    1000 frames. The field itself takes 458 MB."""
    from bench_interpolation import LOST, NOISE

    from thermofit.core.experiment import DicField
    from thermofit.observe.noise import displacement_noise
    from thermofit.observe.projection import Patches, in_line, motion_of, project_displacements

    x, y = np.meshgrid(np.linspace(-11.5, 11.5, 100), np.linspace(-25.0, 25.0, 200))
    reference = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    draw = np.random.default_rng(1)
    u = np.empty((1000, x.size, 3))
    for n in range(len(u)):
        u[n] = n / (len(u) - 1) * (reference @ np.diag([-0.05, 0.1, 0.0])) + draw.normal(0.0, NOISE[0], reference.shape)
        u[n, draw.random(x.size) < LOST] = np.nan
    dic = DicField(np.linspace(0.0, 400.0, len(u)), np.arange(x.size), reference, u)
    targets = np.stack(np.meshgrid(np.linspace(-11.0, 11.0, 25), np.linspace(-22.0, 22.0, 60)), axis=-1).reshape(-1, 2)
    patches, begin = Patches(targets, np.zeros((0, 2))), time.process_time()
    displacement_noise(dic)
    good = in_line(dic, NOISE)
    project_displacements(dic, patches, good)
    motion_of(dic, patches, good, np.linspace(0.0, 400.0, len(u)))
    return {"stages": len(u), "points": x.size, "cpu_s": round(time.process_time() - begin, 1), "peak_MB": round(peak())}


def alone(*words: str) -> dict[str, object]:
    """A part in a process of its own."""
    done = subprocess.run([sys.executable, __file__, *words], capture_output=True, text=True, env=environment(), cwd=ROOT, check=False)
    found: dict[str, object] = json.loads(done.stdout) if done.returncode == 0 else {"error": done.stderr[-300:]}
    print(words, found, file=sys.stderr, flush=True)
    return found


def main() -> int:
    """0 where memory grows by less than 5 %, and stays below 2 GB."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fits", type=int, default=200)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--one-mesh", type=int, nargs=3, help="of one run, in this process")
    parser.add_argument("--fields", action="store_true", help="of fields alone, in this process")
    parser.add_argument("--only", choices=("fits", "meshes", "fields"))
    options = parser.parse_args()
    if options.one_mesh or options.fields:
        print(json.dumps(fields() if options.fields else mesh(*options.one_mesh, options.steps)))
        return 0
    found: dict[str, Any] = {}
    if options.only in (None, "fits"):
        found["fits"] = identifications(options.fits)
    if options.only in (None, "fields"):
        words = [sys.executable, str(ROOT / "scripts" / "bench_interpolation.py"), "memory"]
        told = subprocess.run(words, capture_output=True, text=True, env=environment(), cwd=ROOT, check=False)
        found["fields"], found["frames"] = alone("--fields"), told.stdout.strip() or told.stderr[-300:]
    if options.only in (None, "meshes"):
        found["meshes"] = [alone("--steps", str(options.steps), "--one-mesh", *map(str, size)) for size in MESHES]
    print(json.dumps(found))
    good = found.get("fits", {"growth_percent": 0.0})["growth_percent"] < 5.0
    parts = [*found.get("meshes", ()), found.get("fields", {"peak_MB": 0})]
    return 0 if good and all(part.get("peak_MB", 1e9) < LARGEST_MB for part in parts) else 1


if __name__ == "__main__":
    sys.exit(main())
