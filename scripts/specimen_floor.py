"""How much of a misfit is that of specimens and not of the law: repeats about their mean curve, beside what the loop leaves on them.

    python scripts/specimen_floor.py RUN_DIR 23C-a,23C-b ...      # records of one condition, after `thermofit close-loop`

One curve for records of one condition leaves at least their rms deviation from their mean at the same strain, whatever the law. Printed are
that floor, the rms that the loop leaves on these records, both in MPa, and the share of the square sum over noise that the loop explains.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import h5py
import numpy as np


def records_of(run: Path) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Strain, stress in MPa, and residuals in MPa before and after the loop, each (n,), of every record by its name."""
    with h5py.File(run / "identify-elastic.h5") as file:
        E = float(file["parameters/E"][()])
    with h5py.File(run / "close-loop.h5") as file:
        of_stress = file["residual/channel"][()] == 0
        before, after = (file[f"residual/{n}"][()][of_stress] for n in ("before", "value"))
    found, at = {}, 0
    with h5py.File(run / "interpolate.h5") as file:
        for k, facts in enumerate(json.loads(file.attrs["summary"])["tests"]):
            strain, stress = (file[f"records/{k}/{n}"][()] for n in ("strain", "stress"))
            sigma = float(np.hypot(facts["noise"]["stress"], E * facts["noise"]["strain"]))
            rows = slice(at, at := at + len(strain))
            found[facts["name"]] = strain, stress, sigma * before[rows], sigma * after[rows]
    return found


def floor(repeats: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """rms deviation in MPa of curves (strain (n,), stress (n,)) from their mean at the same strain, as far as all of them reach."""
    end = min(float(strain.max()) for strain, _ in repeats)
    away = []
    for strain, stress in repeats:
        inside = (strain >= 0.0) & (strain <= end)
        order = [np.argsort(other) for other, _ in repeats]
        curves = [np.interp(strain[inside], other[o], s[o]) for (other, s), o in zip(repeats, order, strict=True)]
        away.append(stress[inside] - np.mean(curves, axis=0))
    return float(np.sqrt(np.mean(np.concatenate(away) ** 2)))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("groups", nargs="*", help="names of records of one condition, joined by commas")
    chosen = parser.parse_args()
    found = records_of(chosen.run_dir)
    with h5py.File(chosen.run_dir / "close-loop.h5") as file:
        told = [float(np.mean(file[f"residual/{n}"][()] ** 2)) for n in ("before", "value")]
    print(f"explained: {100.0 * (1.0 - told[1] / told[0]):.1f} % of the mean square over noise, {told[0]:.4g} -> {told[1]:.4g}")
    for name, (_, _, before, after) in found.items():
        print(f"{name}: {np.sqrt(np.mean(before**2)):.2f} -> {np.sqrt(np.mean(after**2)):.2f} MPa")
    for group in chosen.groups:
        names = group.split(",")
        left = np.concatenate([found[name][3] for name in names])
        least = floor([found[name][:2] for name in names])
        print(f"{', '.join(names)}: about their mean {least:.2f} MPa, the loop leaves {np.sqrt(np.mean(left**2)):.2f} MPa")


if __name__ == "__main__":
    main()
