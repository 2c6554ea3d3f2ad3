"""What `inject` says: how often a planted effect is found, what was expected, and a map over place and time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binomtest

from thermofit.core.parameters import bare_name
from thermofit.diagnose.expected import Expected, amplitude_for
from thermofit.diagnose.injected import ANSWERS, FOUND, answer_of, impostors, off_planted
from thermofit.diagnose.planting import Planting
from thermofit.effects.catalogue import Effect
from thermofit.experiment.residuals import Span
from thermofit.records.artefact import Dataset
from thermofit.report.figures import new_figure, shade_phases

CELLS = (4, 4)
"""Cells of a map in y and time."""
NINE_OF_TEN = 0.9
HALF = 0.5
SURE = 0.95
"""Confidence of the interval beside a share."""
TWO = 1.96


@dataclass(frozen=True)
class Injected:
    """All injections of a command: the effect, how each was planted and what is expected of it, what the loop says of the data as they are
    and of each (None: not asked), and over which heights mm and times s a local effect was drawn (None: it is none)."""

    effect: Effect
    plantings: tuple[Planting, ...]
    expected: tuple[Expected, ...]
    plain: Mapping[str, Any] | None
    rows: tuple[Mapping[str, Any], ...]
    reach: tuple[tuple[float, float], tuple[float, float]] | None

    @property
    def answers(self) -> list[str]:
        """Answer of the loop to each planting that was run."""
        plain = self.plain or {}
        ones = zip(self.rows, self.expected, strict=False)
        return [answer_of(row, self.effect.name, plain, there.channel) for row, there in ones]

    @property
    def found(self) -> list[bool]:
        """Whether each counts as found."""
        return [a in FOUND for a in self.answers]


def local_params(one: Effect) -> tuple[str, str] | None:
    """Names of the Params of an effect that say where along the specimen and from when on it acts; None where it has not both."""
    found = {p.scan_of: p.name for p in one.params if p.scan_of in ("place", "time")}
    return (found["place"], found["time"]) if len(found) == 2 else None


def injection_summary(of: Injected) -> dict[str, Any]:
    """Plain types for JSON and tables."""
    one, p = of.effect, of.effect.amplitude
    expected, out = _expected(of), {"effect": one.name, "parameter": p.name, "unit": p.unit, "neutral": p.neutral}
    out |= {"predicted": expected, "found": None, "answers": [], "injections": _rows(of), "map": _map(of), "remarks": _remarks(of)}
    if of.rows:
        out |= {"found": _found(of), "answers": _answers(of)}
    return {"verdict": _verdict(of, out), **out}


def _expected(of: Injected) -> dict[str, Any]:
    n = len(of.expected)
    return {
        "completeness": sum(e.found for e in of.expected) / n,
        "in_other_noise": float(np.mean([e.chance for e in of.expected])),
        "z": float(np.median([e.size for e in of.expected])),
        "z_needed": _finite(np.median([e.needed for e in of.expected])),
        "smallest": _finite(amplitude_for(HALF, of.expected)),
        "nine_of_ten": _finite(amplitude_for(NINE_OF_TEN, of.expected)),
        "plantings": n,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _found(of: Injected) -> dict[str, Any]:
    part, n = sum(of.found), len(of.rows)
    interval = binomtest(part, n).proportion_ci(SURE, "exact")
    named = [pair for row, how in zip(of.rows, of.plantings, strict=False) if (pair := off_planted(row, of.effect.name, how.values))]
    known = [abs(z) for _, z in named]
    return {
        "runs": n,
        "found": part,
        "completeness": part / n,
        "low": float(interval.low),
        "high": float(interval.high),
        "impostors": dict(Counter(name for row in of.rows for name in impostors(row, of.effect.name, of.plain or {}))),
        "amplitude_over_planted": float(np.median([ratio for ratio, _ in named])) if named else None,
        "intervals_that_hold": {"held": sum(z < TWO for z in known), "of": len(known)},
    }


def _answers(of: Injected) -> list[dict[str, Any]]:
    counted = Counter(of.answers)
    return [{"answer": word, "what it means": said, "runs": counted[word]} for word, said in ANSWERS.items()]


def _rows(of: Injected) -> list[dict[str, Any]]:
    """A flat row for each planting."""
    out = []
    answers = of.answers
    for k, (how, there) in enumerate(zip(of.plantings, of.expected, strict=True)):
        row: dict[str, Any] = {"draw": how.number, **{bare_name(n).rpartition(".")[2]: v for n, v in how.values.items()}}
        row |= {"z": there.z, "z_needed": _finite(there.needed), "expected": "found" if there.found else "missed"}
        if k < len(of.rows):
            row |= {"answer": answers[k], "named": ", ".join(of.rows[k].get("accepted", ())) or "-", "wall_s": of.rows[k].get("wall_s")}
        out.append(row)
    return out


def _map(of: Injected) -> list[dict[str, Any]]:
    """Cells over place and time in which something was planted: how many, how many are expected, how many were found, and the smallest
    amplitude there."""
    names = local_params(of.effect)
    if names is None or of.reach is None:
        return []
    at = np.array([[how.values[n] for n in names] for how in of.plantings])
    edges = [np.linspace(*ends, count + 1) for ends, count in zip(of.reach, CELLS, strict=True)]
    cells = [_cell(values, own) for values, own in zip(at.T, edges, strict=True)]
    found, out = of.found, []
    for i, j in sorted({(int(a), int(b)) for a, b in zip(*cells, strict=True)}):
        own = [k for k in range(len(at)) if (cells[0][k], cells[1][k]) == (i, j)]
        done = [found[k] for k in own if k < len(found)]
        ends = {"y_from_mm": edges[0][i], "y_to_mm": edges[0][i + 1], "t_from_s": edges[1][j], "t_to_s": edges[1][j + 1]}
        row: dict[str, Any] = {name: float(value) for name, value in ends.items()}
        row |= {"planted": len(own), "expected": sum(of.expected[k].found for k in own)}
        row |= {"smallest": _finite(amplitude_for(HALF, [of.expected[k] for k in own]))}
        out.append(row | ({"run": len(done), "found": sum(done)} if done else {}))
    return out


def _cell(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Number of the cell between edges that each value lies in."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _remarks(of: Injected) -> list[str]:
    said = []
    plain = of.plain or {}
    if "failed" in plain:
        said.append(f"the loop failed on the data as they are, so that whatever is named counts as new: {plain['failed']}")
    if of.effect.name in plain.get("accepted", ()) or any(of.effect.name in others for others in plain.get("like", {}).values()):
        said.append(
            f"the data as they are hold {of.effect.name} or its like already: what is planted adds to it, and finding it is not counted; "
            "plant another effect, or take with-effects.yaml, which close-loop writes"
        )
    elif plain.get("accepted"):
        said.append(f"the data as they are hold {', '.join(plain['accepted'])}; these are not counted")
    failed = [row["failed"] for row in of.rows if "failed" in row]
    if failed:
        said.append(f"{len(failed)} of {len(of.rows)} runs of the loop failed, the first with: {failed[0]}")
    return said


def _verdict(of: Injected, out: Mapping[str, Any]) -> str:
    p = of.effect.amplitude
    unit = "" if p.unit == "1" else f" {p.unit}"
    off = of.plantings[0].values[p.name]
    lead = f"{of.effect.name} of {off:.3g}{unit}"
    there = out["predicted"]
    room = max(p.upper - p.neutral, p.neutral - p.lower)
    even, nine = (None if there[n] is None or there[n] > room else there[n] for n in ("smallest", "nine_of_ten"))
    smallest = "no amplitude within its bounds would be found" if even is None else f"even odds from {even:.3g}{unit} on"
    if nine is not None:
        smallest += f", nine of ten from {nine:.3g}{unit}"
    predicted = (
        f"predicted {100 * there['completeness']:.0f} % (score {there['z']:.1f}, needed {there['z_needed'] or np.inf:.1f}; {smallest})"
    )
    if out["found"] is None:
        return f"{lead}: {predicted}"
    found = out["found"]
    share = f"{found['found']} of {found['runs']} found ({100 * found['low']:.0f} to {100 * found['high']:.0f} %)"
    others = f"; something else named besides or instead in {sum(found['impostors'].values())}" if found["impostors"] else ""
    return f"{lead}: {share}{others}; {predicted}"


def injection_datasets(of: Injected) -> dict[str, Dataset]:
    """Planted values, expected scores and answers, one for each planting."""
    per = ("planting",)
    out = {
        "expected/z": Dataset(np.array([e.z for e in of.expected]), "1", per),
        "expected/size": Dataset(np.array([e.size for e in of.expected]), "1", per),
        "expected/needed": Dataset(np.array([e.needed for e in of.expected]), "1", per),
        "expected/smallest": Dataset(np.array([e.smallest for e in of.expected]), of.effect.amplitude.unit, per),
        "expected/found": Dataset(np.array([e.found for e in of.expected]), "1", per),
    }
    for q in of.effect.params:
        if q.name in of.plantings[0].values:
            out[f"planted/{q.name}"] = Dataset(np.array([how.values[q.name] for how in of.plantings]), q.unit, per)
    if of.rows:
        out["loop/answer"] = Dataset(np.array(of.answers), "1", ("run",))
        out["loop/found"] = Dataset(np.array(of.found), "1", ("run",))
    return out


def injection_map(of: Injected, spans: Sequence[Span]) -> Figure:
    """Where and when a local effect was planted, and whether it is expected to be found (ring) and was (dot)."""
    names = local_params(of.effect)
    assert names is not None
    y, t = (np.array([how.values[n] for how in of.plantings]) for n in names)
    figure = new_figure(5.2, 3.6)
    ax = figure.add_subplot()
    handles = shade_phases([ax], spans)
    good = np.array([e.found for e in of.expected])
    marks = []
    for own, colour, word in ((good, "tab:blue", "expected to be found"), (~good, "tab:gray", "expected to be missed")):
        if own.any():
            marks.append(ax.scatter(t[own], y[own], s=60, facecolors="none", edgecolors=colour, label=word))
    if of.rows:
        found = np.array(of.found)
        n = len(found)
        for own, marker, word in ((found, "o", "found"), (~found, "x", "not found")):
            if own.any():
                marks.append(ax.scatter(t[:n][own], y[:n][own], s=14, c="black", marker=marker, label=word))
    ax.set_xlabel("begin in s")
    ax.set_ylabel("y in mm")
    every = [*marks, *handles]
    figure.legend(handles=every, labels=[str(h.get_label()) for h in every], loc="outside lower center", ncols=3)
    return figure
