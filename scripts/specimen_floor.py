"""How much of a misfit is that of specimens and not of the law: repeats about their mean curve, beside what the loop leaves on them.

    python scripts/specimen_floor.py RUN_DIR 23C-a,23C-b ...      # records of one condition, after `thermofit close-loop`

One curve for records of one condition leaves at least their rms deviation from their mean at the same strain, whatever the law. Printed are
that floor, the rms that the loop leaves on these records, both in MPa, and the explained share

    (before - after) / (before - floor),    mean squares in MPa^2,

with a 95 % interval: the floor is that of the specimens where a group of repeats is named, else the noise. The interval is that of a
bootstrap over blocks of samples, whose misfits hang together, the same blocks before, after and for the floor. A share above one says that
the loop fits the mean of these specimens better than they agree with each other; an improvement that the floor does not allow is said so.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import h5py
import numpy as np


def noise_of(run: Path) -> dict[str, float]:
    """Noise in MPa of the difference between model and record, by record."""
    with h5py.File(run / "identify-elastic.h5") as file:
        E = float(file["parameters/E"][()])
    with h5py.File(run / "interpolate.h5") as file:
        tests = json.loads(file.attrs["summary"])["tests"]
    return {one["name"]: float(np.hypot(one["noise"]["stress"], E * one["noise"]["strain"])) for one in tests}


def records_of(run: Path) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Strain, stress in MPa, and residuals in MPa before and after the loop, each (n,), of every record by its name."""
    noises = noise_of(run)
    with h5py.File(run / "close-loop.h5") as file:
        of_stress = file["residual/channel"][()] == 0
        before, after = (file[f"residual/{n}"][()][of_stress] for n in ("before", "value"))
    found, at = {}, 0
    with h5py.File(run / "interpolate.h5") as file:
        for k, facts in enumerate(json.loads(file.attrs["summary"])["tests"]):
            strain, stress = (file[f"records/{k}/{n}"][()] for n in ("strain", "stress"))
            sigma = noises[facts["name"]]
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


def explained(
    before: np.ndarray, after: np.ndarray, floor_square: np.ndarray, blocks: int = 20, draws: int = 2000
) -> tuple[float, float, float]:
    """Explained share of residuals (n,) before and after, with the square of the floor (n,) beside each, and its 95 % interval by a
    bootstrap over blocks of neighbouring samples. nan where before is at the floor."""
    parts = np.array_split(np.arange(len(before)), min(blocks, len(before)))
    sums = np.array([[np.sum(v[p]) for p in parts] for v in (before**2, after**2, floor_square)])
    drawn = np.random.default_rng(0).integers(0, len(parts), (draws, len(parts)))
    b, a, f = sums[:, drawn].sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(b > f, (b - a) / (b - f), np.nan)
    whole = sums.sum(axis=1)
    share = (whole[0] - whole[1]) / (whole[0] - whole[2]) if whole[0] > whole[2] else float("nan")
    known = shares[np.isfinite(shares)]
    low, high = np.quantile(known, [0.025, 0.975]) if len(known) > 0.95 * draws else (float("nan"), float("nan"))
    return float(share), float(low), float(high)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("groups", nargs="*", help="names of records of one condition, joined by commas")
    chosen = parser.parse_args()
    found = records_of(chosen.run_dir)
    with h5py.File(chosen.run_dir / "close-loop.h5") as file:
        told = [float(np.mean(file[f"residual/{n}"][()] ** 2)) for n in ("before", "value")]
    noises = noise_of(chosen.run_dir)
    print(f"explained: {100.0 * (1.0 - told[1] / told[0]):.1f} % of the mean square over noise, {told[0]:.4g} -> {told[1]:.4g}")
    for name, (_, _, before, after) in found.items():
        print(f"{name}: {np.sqrt(np.mean(before**2)):.2f} -> {np.sqrt(np.mean(after**2)):.2f} MPa")
    every = [np.concatenate([found[name][k] for name in found]) for k in (2, 3)]
    noise = np.concatenate([np.full(len(found[name][2]), noises[name] ** 2) for name in found])
    print(f"all records, floor the noise: explained {said(explained(*every, noise))}")
    for group in chosen.groups:
        names = group.split(",")
        first, left = (np.concatenate([found[name][k] for name in names]) for k in (2, 3))
        least = floor([found[name][:2] for name in names])
        share = explained(first, left, np.full(len(left), least**2))
        sizes = " -> ".join(f"{np.sqrt(np.mean(v**2)):.2f}" for v in (first, left))
        print(f"{', '.join(names)}: about their mean {least:.2f} MPa, the loop {sizes} MPa; explained {said(share)}")


def said(share: tuple[float, float, float]) -> str:
    """A share with its interval in words."""
    if not np.isfinite(share[0]):
        return "nothing to explain: before is at the floor"
    return f"{100.0 * share[0]:.0f} % ({100.0 * share[1]:.0f} to {100.0 * share[2]:.0f} %)"


if __name__ == "__main__":
    main()
