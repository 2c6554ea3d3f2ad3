"""docs/operating_figures.md and its plot from the runs of `operating_figures`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from thermofit.effects.catalogue import effect

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

Run = dict[str, Any]
FAR = 10.0
"""Scales beyond which it does not matter how late a time is: a drift that takes ten tests to settle is a straight line."""
AIM = 3.0
"""Hours that the whole study is to stay below on 2 cores."""
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


INTRODUCTION = """# Operating figures of the diagnosis

Written by `scripts/operating_figures.py`: virtual tests with a planted effect, the loop run without being told. Programmes and
noise stand in `scripts/operating_point.py` (coupon records) and `scripts/operating_body.py` (full fields on a small body), effects and
seeds in `DRIVERS` of `scripts/operating_figures.py`; data come from another discretisation than the fit uses. An effect counts as
named where it, or an effect of its family (|cos| > 0.9, or, where they were refitted on the known motion, predictions of held-out data
within two standard errors of each other: the test cannot tell them apart), was accepted on held-out data after a refit. The amplitude is
in units of the smallest detectable one at the true parameters, `detectable` of the ranking: that which is expected to pass, with even
odds, all that an effect has to pass to be named ([diagnosis.md](diagnosis.md), Prove). Counts are those of runs that are kept; an amplitude
beyond the bounds of its effect is not planted. The bias is that of runs whose accepted effect has its other parameters near the
planted ones; in another form (a hundred times the reference rate; heat that is missing before the window instead of released within
it, with another share of the plastic work) the same test has another amplitude. The sensor of the coupon records has a lag of 0.6 s
that the fit knows and frees; two lags in series commute, so that a planted lag that is longer is found as that of the sensor, and
0.6 s as the effect's.
"""
LEFT_OUT = """## What the runs leave out

The runs make the joint fit and call the loop as `close-loop` does, on measurements that are in memory. Steps of the command that they do
not exercise:

* **From raw files to the stages.** No files are read, no camera is calibrated, nothing is interpolated; parameters come from the study's
  start values and not from `identify-elastic`, `identify-plastic` and `identify-thermal`. For fields a first joint fit stands for the
  stages, and the loop starts from the last fit whether it settled or not; the command starts from the optimum of the stages where it
  did not.
* **When the error of the force is told.** The command takes the force of a body as exact as long as the model misses more than that error
  could explain, tells it again at later parameters, and changes to the residual that knows it ([diagnosis.md](diagnosis.md), Find).
  Here that error counts as noise from the first fit on.
* **Unlisted sources.** What the loop leaves is not asked whether it is more than noise, and no unlisted term is sought.
* **Effects taken back.** So no accepted effect is taken back because it only resembles an unlisted one; the counts of what was accepted
  are those before that.
* **Coupon records:** strains that are tried are shares of 0.1, those of the command of the largest Lambda of the records.
* **Not asked at all:** tests declared as held out, several experiments, the programmes for what is undecided, and refusals (too few
  data, two freed effects of one family).
"""


def write(runs: list[Run], folder: Path, unplanted: Mapping[str, str]) -> None:
    """Page and plots into a folder; `unplanted`: effects that no run plants, with the reason."""
    sound = [r for r in runs if "failed" not in r]
    lines = [
        INTRODUCTION,
        *_summary(sound),
        *_families(sound),
        walls(runs),
        "",
        "![Share of runs in which the planted effect was named](operating_figures.png)",
        "",
        "![Planted effect against the effect named first, number of runs](operating_confusion.png)",
        "",
        "What was planted is framed; a first one beside the frame counts as named where it is of one family with it, as in the tables.",
    ]
    for driver in dict.fromkeys(r["driver"] for r in runs):
        own = [r for r in runs if r["driver"] == driver]
        lines += ["", f"## {KINDS[driver].capitalize()}", "", *_table([r for r in own if "failed" not in r])]
        lines += [f"\nFailed: {r['kind']} x {r['times']:g}, seed {r['seed']}: {r['failed']}" for r in own if "failed" in r]
        lines += _first([r for r in own if "failed" not in r])
    lines += ["", *never_planted(unplanted), "", LEFT_OUT.rstrip()]
    folder.joinpath("operating_figures.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    _plot(sound, folder / "operating_figures.png")
    _plot_confusion(sound, folder / "operating_confusion.png")


def walls(runs: Sequence[Run]) -> str:
    """Time of all runs in sum, failed ones too, beside the aim."""
    hours = {d: sum(r["wall_s"] for r in runs if r["driver"] == d) / 3600.0 for d in dict.fromkeys(r["driver"] for r in runs)}
    total = sum(hours.values())
    each = ", ".join(f"{KINDS[d]} {h:.2f} h" for d, h in hours.items())
    said = "within" if total < AIM else "above"
    return (
        f"* Time: {len(runs)} runs took {total:.2f} h in sum ({each}), {said} the aim of under {AIM:g} hours on 2 cores. Walls are as they "
        "were, serial: one run after another, with whatever else the machine did; a run that was made twice counts once, the later one. "
        "The smallest amplitudes, one trace for each kind of test, are not in it."
    )


def _first(runs: list[Run]) -> list[str]:
    """What came first in the ranking, by what was planted; a single smallest amplitude apart."""
    lines = []
    for title, here in (
        ("3 and 10 times the smallest amplitude, and pairs", _plain(runs)),
        ("1 times the smallest amplitude", _faint(runs)),
    ):
        if here:
            lines += ["", f"What came first in the ranking ({title}):", "", "| planted | first |", "|---|---|"]
            rows, columns, count = confusion(here)
            for kind, row in zip(rows, count, strict=True):
                order = sorted((k for k in range(len(columns)) if row[k]), key=lambda k: -row[k])
                lines.append(f"| {kind} | {', '.join(f'{columns[k]} {row[k]}' for k in order)} |")
    return lines


def _plain(runs: Sequence[Run]) -> list[Run]:
    return [r for r in runs if r["times"] != 1.0]


def _faint(runs: Sequence[Run]) -> list[Run]:
    return [r for r in runs if r["times"] == 1.0]


def confusion(runs: Sequence[Run]) -> tuple[list[str], list[str], np.ndarray]:
    """What was planted, what came first in the ranking, and how often (rows, columns).

    Columns begin with what was planted, in the order of the rows; "none" ends both.
    """
    rows = sorted(dict.fromkeys(r["kind"] for r in runs), key=lambda kind: (kind == "none", "+" in kind))
    found = [r["first"] or "none" for r in runs]
    columns = [name for name in dict.fromkeys(n for kind in rows for n in kind.split("+")) if name in found and name != "none"]
    columns += sorted(set(found) - {*columns, "none"}) + (["none"] if "none" in found else [])
    count = np.zeros((len(rows), len(columns)), dtype=int)
    for r, name in zip(runs, found, strict=True):
        count[rows.index(r["kind"]), columns.index(name)] += 1
    return rows, columns, count


def never_planted(unplanted: Mapping[str, str]) -> list[str]:
    """Effects of the catalogue that no run plants, those of one reason together."""
    lines = ["## Never planted", "", "Of these effects no run says how often they are found.", ""]
    lines += ["| effects | why |", "|---|---|"]
    for reason in dict.fromkeys(unplanted.values()):
        lines.append(f"| {', '.join(name for name, why in unplanted.items() if why == reason)} | {reason} |")
    return lines


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


def _plot_confusion(runs: list[Run], path: Path) -> None:
    """One panel of counts for each kind of test, on the right that of the smallest amplitude; what was planted is framed."""
    panels = [(d, [_plain(own), _faint(own)]) for d in KINDS if (own := [r for r in runs if r["driver"] == d])]
    heights = [3.0 + max(len(confusion(part)[0]) for part in parts) for _, parts in panels]
    figure, grid = plt.subplots(
        len(panels), 2, figsize=(16.0, 0.33 * sum(heights) + 1.0), height_ratios=heights, squeeze=False, layout="constrained"
    )
    for (driver, parts), axes in zip(panels, grid, strict=True):
        for part, here, title in zip(parts, axes, ("3 and 10 times the smallest amplitude, pairs", "1 times"), strict=True):
            here.set_visible(bool(part))
            if part:
                _counts(here, *confusion(part))
                here.set_title(f"{KINDS[driver]}: {title}", fontsize=9)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _counts(axes: Axes, rows: list[str], columns: list[str], count: np.ndarray) -> None:
    axes.imshow(count / np.maximum(count.sum(axis=1, keepdims=True), 1), cmap="Blues", vmin=0.0, vmax=1.4, aspect="auto")
    for i, k in np.argwhere(count):
        axes.text(k, i, str(count[i, k]), ha="center", va="center", fontsize=8)
    for i, kind in enumerate(rows):
        for name in set(kind.split("+")) & set(columns):
            axes.add_patch(Rectangle((columns.index(name) - 0.5, i - 0.5), 1.0, 1.0, fill=False, edgecolor="tab:red", linewidth=1.0))
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), [kind.replace("+", " and ") for kind in rows], fontsize=8)
    axes.set_xlabel("first in the ranking", fontsize=8)
    axes.set_ylabel("planted", fontsize=8)
