"""docs/operating_figures.md and its plot from the runs of `operating_figures`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from thermofit.effects.catalogue import effect

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Run = dict[str, Any]
FAR = 10.0
"""Scales beyond which it does not matter how late a time is: a drift that takes ten tests to settle is a straight line."""
KINDS = {
    "point": "coupon records",
    "body": "full fields on a small body",
    "full": "full fields of the full mesh, fitted on the coarse one",
}


def named_first(run: Run) -> bool:
    """Whether the first in the ranking is planted, or of one family with what is planted."""
    return any(name in run["first_family"] for name in run["kind"].split("+"))


def named(run: Run, name: str) -> bool:
    """Whether an accepted effect is the planted one or of one family with it."""
    return any(name == a or name in run["families"][a] for a in run["accepted"])


def besides(run: Run) -> bool:
    """Whether something was accepted that is not of the family of anything planted."""
    names = run["kind"].split("+")
    return any(not any(n == a or n in run["families"][a] for n in names) for a in run["accepted"])


def over_floor(runs: Sequence[Run], nulls: Sequence[Run]) -> str:
    """Held-out error after the loop over that with nothing planted, median of the channel that is worst."""
    if not runs or not nulls:
        return "-"
    floor = {c: float(np.median([r["held_out"]["after"][c] for r in nulls])) for c in nulls[0]["held_out"]["after"]}
    return f"{np.median([max(r['held_out']['after'][c] / floor[c] for c in floor) for r in runs]):.3f}"


def bias(runs: Sequence[Run]) -> str:
    """Median relative error of the amplitude where the planted effect itself was accepted; "other form" where only in another one."""
    values: list[float] = []
    others = 0
    for r in runs:
        for n in r["kind"].split("+"):
            if n in r["estimates"]:
                p = effect(n).amplitude
                if as_planted(r, n):
                    values.append((r["estimates"][n][p.name] - p.neutral) / (r["planted"][p.name] - p.neutral) - 1.0)
                else:
                    others += 1
    left = f"other form in {others}" if others else "-"
    if not values:
        return left
    return f"{100 * float(np.median(values)):+.0f} %" + (f" in {len(values)}, {left}" if others else "")


def as_planted(run: Run, name: str) -> bool:
    """Whether the other Params of an accepted effect, which are planted at their neutral values, came out alike: within their scale (not
    where the order of magnitude is what counts) or a factor of four, or times that are both far beyond the scale. Amplitudes of two forms
    of an effect cannot be compared."""
    pairs = [(p, run["estimates"][name][p.name]) for p in effect(name).params if p.name != effect(name).amplitude.name]
    return all(
        (not p.logarithmic and abs(found - p.neutral) <= p.scale)
        or p.neutral <= 4.0 * found <= 16.0 * p.neutral
        or (p.unit == "s" and min(found, p.neutral) > FAR * p.scale)
        for p, found in pairs
    )


def share(part: int, whole: int) -> str:
    return f"{part} of {whole}"


def write(runs: list[Run], folder: Path) -> None:
    """Page and plot into a folder."""
    sound = [r for r in runs if "failed" not in r]
    lines = [
        "# Operating figures of the diagnosis",
        "",
        "Written by `scripts/operating_figures.py`: virtual tests with a planted effect, the loop run without being told. Programmes,",
        "noise and seeds stand in `scripts/operating_point.py` (coupon records) and `scripts/operating_body.py` (full fields on a small",
        "body); data come from another discretisation than the fit uses. An effect counts as named where it, or an effect of its family",
        "(|cos| > 0.9, or, where they were refitted on the known motion, predictions of held-out data within two standard errors of each",
        "other: the test cannot tell them apart), was accepted on held-out data after a refit. The amplitude is in units of the",
        "smallest detectable one at the true parameters, `detectable` of the ranking: that which is expected to pass, with even odds, all",
        "that an effect has to pass to be named ([diagnosis.md](diagnosis.md), Prove). Counts are those of runs that are kept: what has",
        "none, or fewer than its neighbours, has not been run to the end. The bias is that of runs whose accepted effect has its other",
        "parameters near the planted ones; in another form (a hundred times the reference rate; heat that is missing before the window",
        "instead of released within it, with another share of the plastic work) the same test has another amplitude. The sensor of the",
        "coupon records has a lag of 0.6 s that the fit knows and frees; two lags in series commute, so that a planted lag that is",
        "longer is found as that of the sensor, and 0.6 s as the effect's.",
        "",
        *_summary(sound),
        *_families(sound),
        "",
        "![Share of runs in which the planted effect was named](operating_figures.png)",
    ]
    for driver in dict.fromkeys(r["driver"] for r in runs):
        lines += [
            "",
            f"## {KINDS[driver].capitalize()}",
            "",
            *_table([r for r in sound if r["driver"] == driver]),
        ]
        failed = [r for r in runs if r["driver"] == driver and "failed" in r]
        lines += [f"\nFailed: {r['kind']} x {r['times']:g}, seed {r['seed']}: {r['failed']}" for r in failed]
        lines += [
            "",
            "What came first in the ranking (3 and 10 times the smallest amplitude, and pairs):",
            "",
            "| planted | first |",
            "|---|---|",
        ]
        for kind in dict.fromkeys(r["kind"] for r in sound if r["driver"] == driver):
            counts = Counter(str(r["first"]) for r in sound if r["driver"] == driver and r["kind"] == kind and r["times"] != 1.0)
            if counts:
                lines.append(f"| {kind} | {', '.join(f'{name} {n}' for name, n in counts.most_common())} |")
    folder.joinpath("operating_figures.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    _plot(sound, folder / "operating_figures.png")


def _summary(runs: list[Run]) -> list[str]:
    nulls = [r for r in runs if r["kind"] == "none"]
    false = sum(bool(r["accepted"]) for r in nulls)
    lines = [f"* Nothing planted: an effect was accepted in {share(false, len(nulls))} runs ({100 * false / max(len(nulls), 1):.1f} %)."]
    for times in (1.0, 3.0, 10.0):
        here = [r for r in runs if r["times"] == times]
        first, right, other = sum(map(named_first, here)), sum(named(r, r["kind"]) for r in here), sum(map(besides, here))
        lines.append(
            f"* {times:g} times the smallest amplitude: named first in {share(first, len(here))}, accepted in {share(right, len(here))}, "
            f"something else accepted besides or instead in {share(other, len(here))}."
        )
    pairs = [r for r in runs if "+" in r["kind"]]
    both = sum(all(named(r, n) for n in r["kind"].split("+")) for r in pairs)
    lines.append(f"* Two effects at once: both named in {share(both, len(pairs))}.")
    return lines


def _families(runs: list[Run]) -> list[str]:
    """How many effects the family that came first holds where one effect was planted, by amplitude: the larger, the less is told."""
    lines = []
    for times in (3.0, 10.0):
        sizes = [len(r["first_family"]) for r in runs if r["times"] == times and "+" not in r["kind"]]
        if sizes:
            lines.append(
                f"* The family named first holds {np.median(sizes):g} effects in the median at {times:g} times the smallest amplitude, "
                f"{max(sizes)} at most."
            )
    return lines


def _table(runs: list[Run]) -> list[str]:
    nulls = [r for r in runs if r["kind"] == "none"]
    lines = [
        f"Nothing planted: {share(sum(bool(r['accepted']) for r in nulls), len(nulls))} runs with an effect accepted.",
        "",
        "| planted | amplitude | named first | accepted | something else too | bias of amplitude | held-out error / with nothing planted |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(r["kind"] for r in runs if r["kind"] != "none"):
        for times in sorted({r["times"] for r in runs if r["kind"] == kind}):
            here = [r for r in runs if r["kind"] == kind and r["times"] == times]
            names = kind.split("+")
            right = sum(all(named(r, n) for n in names) for r in here)
            lines.append(
                f"| {' and '.join(names)} | {times:g} | {share(sum(map(named_first, here)), len(here))} | {share(right, len(here))} | "
                f"{share(sum(map(besides, here)), len(here))} | {bias(here)} | {over_floor([r for r in here if r['accepted']], nulls)} |"
            )
    return lines


def _plot(runs: list[Run], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 4.0), layout="constrained")
    for driver, marker in (("point", "o"), ("body", "s"), ("full", "^")):
        own = [r for r in runs if r["driver"] == driver and "+" not in r["kind"]]
        times = sorted({r["times"] for r in own})
        shares = [np.mean([bool(r["accepted"]) if t == 0.0 else named(r, r["kind"]) for r in own if r["times"] == t]) for t in times]
        axes.plot([max(t, 0.3) for t in times], shares, marker=marker, label=KINDS[driver])
    axes.set_xscale("log")
    axes.set_xticks([0.3, 1.0, 3.0, 10.0], ["none", "1", "3", "10"])
    axes.set_xlabel("planted amplitude / smallest detectable")
    axes.set_ylabel("share of runs with the effect accepted")
    axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)
