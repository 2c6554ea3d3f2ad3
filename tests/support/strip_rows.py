"""Virtual strips pulled hot: tables of strain along the axis, made by the point driver with other steps than those of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from thermofit.core.experiment import CELSIUS
from thermofit.core.parameters import Parameters
from thermofit.point.row_driver import RowProgramme, simulate_row

BASE = {"E": 50e3, "M_y0": 40.0, "theta_clamp": 293.15, "thermal_softening.slope": 4e-3, "thermal_softening.reference": 723.15}
HARDENING = {"M_yinf": 110.0, "H_exp": 5.0}
PLACE = np.arange(-6.0, 6.5, 2.0)
PLACES = {"from": -6, "to": 6, "every": 2}


def table(path: Path, on: dict[str, float], seconds: float, celsius: float, seed: int, noise: float = 3e-4, mean: float = 0.16) -> None:
    """A file of one strip: 241 steps, of which every second is written, in a shuffled order of places, some values lost."""
    rng = np.random.default_rng(seed)
    theta = celsius + CELSIUS
    values = Parameters.of({**BASE, **HARDENING, **on, "theta_air": theta, "theta_ref": theta})
    time = np.linspace(0.0, seconds, 241)
    n = len(PLACE)
    driven = RowProgramme(time, mean * time / seconds, np.full(n, 1.0 / n), PLACE, np.ones(n))
    strain = np.array([h.strain for h in simulate_row(values, (), driven, theta)[0]]).T[::2]
    strain = np.log1p(strain) + noise * rng.normal(size=strain.shape)
    lost, order = rng.random(strain.shape) < 0.02, rng.permutation(n)
    lines = [",".join(["Element", *(f"{PLACE[k]:g}" for k in order)])]
    for t, row, gone in zip(time[::2], strain, lost, strict=True):
        lines.append(",".join([f"{t:.6g}", *("???" if gone[k] else f"{row[k]:.6g}" for k in order)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def study(folder: Path, on: dict[str, float], seed: int, known: dict[str, float] | None = None) -> Path:
    """Two strips at rates 25 apart that are fitted, and one 30 K hotter that is held out; `known`: what the study says of the effects."""
    rows = []
    for k, (seconds, celsius) in enumerate(((2.0, 450.0), (0.08, 450.0), (0.3, 480.0))):
        table(folder / f"strip-{k}.csv", on, seconds, celsius, 10 * seed + k)
        rows.append(
            {
                "file": f"strip-{k}.csv", "strain": "logarithmic", "places": PLACES, "temperature_degC": celsius, "points": 24,
                "held_out": k == 2,
            }
        )  # fmt: skip
    starts = {"M_yinf": {"start": 180.0, "bounds": [41.0, 1000.0]}, "H_exp": {"start": 3.0, "bounds": [0.2, 60.0]}}
    tree: dict[str, Any] = {"name": "strips", "run_dir": str(folder / "run"), "parameters": {**BASE, **starts, **(known or {})}}
    tree["numerics"] = {"steps_per_interval": 4}  # as fine as the table: with one step M_yinf would be 4 of its errors off
    tree["coupon"] = {"rows": rows}
    path = folder / "strips.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path
