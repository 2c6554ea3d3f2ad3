"""What `diagnose` and `close-loop` say of an unlisted effect: JSON, effect file, figure (where it is, how strong over time), datasets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thermofit.core.files import replacing
from thermofit.core.parameters import param
from thermofit.diagnose.beside_source import BesideSource, Spot
from thermofit.diagnose.held_out import Proof
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.trace import Traced
from thermofit.diagnose.unlisted import HALF, Unlisted, believed_law
from thermofit.diagnose.unlisted_effect import camera_file, heat_file, over_time_file, sensor_file, yield_file
from thermofit.diagnose.unlisted_field import MissingField
from thermofit.diagnose.unlisted_law import StateLaw
from thermofit.diagnose.unlisted_middle import about
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.channels import field_of as observed_field
from thermofit.experiment.missing import KINDS, Missing
from thermofit.experiment.trust import grade
from thermofit.law.page import law_of
from thermofit.records.artefact import Dataset
from thermofit.report.figures import NOISE, STYLE, new_figure, save_figures, shade_phases, symmetric_limit
from thermofit.report.figures_maps import Scale, draw_map
from thermofit.report.local_words import steps_in_words, with_article
from thermofit.study.study import Study

BALANCES = {"theta": "heat", "u": "motion"}
"""Balance that lacks something by the observed field that shows it; any other one shows stresses."""
FIGURE = "unlisted"


@dataclass(frozen=True)
class EffectFile:
    """Name and text of an effect file, what it holds in words, and the proof of just that."""

    name: str
    text: str
    words: str
    proof: Proof


def file_of(kind: str) -> str:
    """Name of the effect file of a kind of term."""
    return f"unlisted_{kind}"


def described(
    study: Study,
    here: Traced,
    found: Unlisted | None,
    beside: BesideSource | None = None,
    local: Mapping[str, Any] | None = None,
) -> dict[str, Any] | None:
    """The entry `unlisted` of a summary; writes the effect file and the figure into the run folder. None where there is nothing.
    `beside`: the parameters beside an unlisted heat; `local`: the entry `local_balances`."""
    if found is None:
        return None
    file = effect_file(study.name, here, found)
    path = None
    if file is not None:
        path = study.run_dir / f"{file.name}.py"
        study.run_dir.mkdir(parents=True, exist_ok=True)
        with replacing(path, durable=False) as temporary:
            Path(temporary).write_text(file.text, encoding="utf-8")
    figures: list[Path] = []
    if found.field is not None:
        with matplotlib.rc_context(STYLE):
            figures = save_figures(study.run_dir / "figures", {FIGURE: unlisted_figure(here, found)})
    made = {"effect_file": None if path is None else str(path), "figure": str(figures[0]) if figures else None}
    return {**summary_of(here, found, file), **made, "balance": _balance(found, local), "parameters": _parameters(here, beside)}


def _balance(found: Unlisted, local: Mapping[str, Any] | None) -> str:
    """The balance that lacks something: `boundary` where the local balance of heat closes, so that it comes from outside what is seen;
    `camera` where it is none, but what a camera adds."""
    alike = "" if found.field is None else KINDS[found.field.basis.kind].alike
    if alike in ("jaws", "image"):
        return "boundary" if alike == "jaws" else "camera"
    channel = found.channel
    kind = BALANCES.get(observed_field(channel), "stress")
    maps = () if local is None else local["maps"]
    outside = any(m["balance"] == kind and m["channel"] == channel and m["where"] == "outside" for m in maps)
    return "boundary" if kind == "heat" and outside else kind


def _parameters(here: Traced, beside: BesideSource | None) -> dict[str, Any] | None:
    """Parameters beside an unlisted heat, and as the joint fit has them, and the one spot that this was taken for (null: it was not, and
    `no_spot` says why; `spread_mm` null: it is less than the mesh shows; `velocity_mm_per_s` null: it is at rest). `second`: how likely
    each other kind of history is beside the one that is told; `held`: exponents of added laws that are held beside it; `untold`: what of
    the form of such laws standard errors do not hold. None where that is not asked."""
    if beside is None:
        return None
    fitted = here.case.parameters
    rows = {n: {"value": v, "sigma": beside.sigma[n], "unit": param(n).unit, "joint_fit": fitted[n]} for n, v in beside.value.items()}
    return {
        "values": rows,
        "failed": beside.failed,
        "spot": None if beside.spot is None else _spot(beside.spot),
        "no_spot": beside.no_spot,
        "second": dict(beside.second),
        "held": dict(beside.held),
        "untold": list(beside.untold),
    }


def _spot(spot: Spot) -> dict[str, Any]:
    """Where a spot is; of one that travels its velocity, and when it is there."""
    velocity, sigma = spot.velocity or (None, None)
    return {"y_mm": spot.y, "spread_mm": spot.spread, "velocity_mm_per_s": velocity, "velocity_sigma": sigma, "at_s": spot.time}


def with_unlisted(summary: dict[str, Any], said: dict[str, Any] | None) -> dict[str, Any]:
    """A summary of `diagnose` or `close-loop` with the entry `unlisted`; what leaves structure unexplained is not trusted (exit code 5)."""
    if said is None:
        return {**summary, "unlisted": None}
    graded = {"grade": grade({}, False, said)} if "grade" in summary else {}
    return {**summary, **graded, "unlisted": said, "trustworthy": False, "verdict": f"{summary['verdict']}; unlisted: {in_words(said)}"}


def with_any_form(summary: dict[str, Any], closed: Closed) -> dict[str, Any]:
    """A summary of `close-loop` that says what is known of a curve of any form among the accepted effects: such an answer has no name. The
    curve is the entry `unlisted` where nothing else is."""
    curve = next((e for e in map(effect, closed.accepted) if e.last), None)
    if curve is None:
        return summary
    told = {**summary, "hardening_curve": curve_of(closed, curve)}
    if summary["unlisted"] is not None:
        return told
    channel = next(c.channel for c in closed.first.case.model.comparisons if observed_field(c.channel) != "theta")
    rows = closed.first.rows.channel == closed.first.case.channels.index(channel)
    square, n = float(np.sum(closed.first.columns.residual[rows] ** 2)), int(rows.sum())
    said = {
        **{"channel": channel, "where": None, "when_s": None, "best_listed": None, "resembles": [], "beside": [], "other_channels": []},
        **{"hints": [], "effect_file": None, "figure": None, "balance": "stress", "parameters": None},
        **{"excess": square - n, "excess_sigma": float(np.sqrt(2.0 * n)), "excess_share": max(square - n, 0.0) / square},
        "over_state": told["hardening_curve"],
    }
    others = tuple(n for n in closed.accepted if n != curve.name)
    return with_unlisted(told, {**said, "beside": list(others)})


def curve_of(closed: Closed, curve: Effect) -> dict[str, Any]:
    """What a curve of any form adds to the yield stress over the plastic strain up to the largest, with its standard error in MPa, and its
    proof on held-out data."""
    case, fit = closed.last.case, closed.fit
    strain = np.linspace(0.0, case.largest_strain, _FINE)
    law, names = law_of(case.parameters), [p.name for p in curve.amplitudes]
    at = [case.parameters[n] for n in curve.names]

    def stress(values: Sequence[complex]) -> np.ndarray:
        return np.asarray(curve.act(strain, 0.0, case.parameters["theta_ref"], law, *values))

    slopes = [np.imag(stress([v + 1e-30j * (n == name) for n, v in zip(curve.names, at, strict=True)])) / 1e-30 for name in names]
    value, slope, place = stress(at), np.stack(slopes, axis=1), [fit.names.index(n) for n in names]
    assert fit.covariance is not None, "what has no standard errors is not accepted"
    spread = fit.covariance.matrix[np.ix_(place, place)]
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, spread, slope), 0.0))
    trial = next(t for r in reversed(closed.rounds) for t in r.trials if t.effects == (curve.name,))
    proof = {} if trial.proof is None else _proof(trial.proof)
    return {
        "variable": "accumulated plastic strain",
        "largest_MPa": float(np.max(np.abs(value))),
        **{"at": strain.tolist(), "stress_MPa": value.tolist(), "sigma_MPa": sigma.tolist()},
        **proof,
    }


def in_words(said: dict[str, Any]) -> str:
    """An unlisted effect in one clause."""
    part = f"{number(100.0 * said['excess_share'])} %"
    beside = f" beside {' and '.join(said['beside'])}" if said["beside"] else ""
    share = f"{part} of the misfit of {said['channel']}{beside} is systematic, and {of_the_catalogue(said)}"
    if said["where"] is None:
        law = said["over_state"]
        return share if law is None else f"a yield stress over {law['variable']}, up to {number(law['largest_MPa'])} MPa ({share})"
    a, b = said["when_s"]
    size = amount_in_words(said)
    steps = f", in steps of {steps_in_words(said)}" if said.get("steps") else ""
    return f"{with_article(said['kind'])} of {size} {place_in_words(said['where'])} from {a:.4g} to {b:.4g} s{steps} ({share})"


def of_the_catalogue(said: Mapping[str, Any]) -> str:
    """What the catalogue has for an unlisted effect, in words: of a listed one that would explain half of it, that it is not it."""
    best = said.get("best_listed")
    if best is None or best["explains"] < best["needed"]:
        return "no effect of the catalogue explains half of it"
    why = "only resembles it" if best["effect"] in said.get("resembles", ()) else "was not accepted"
    return f"{best['effect']}, which would explain {number(100.0 * best['explains'])} % of it, {why}"


def amount_in_words(said: Mapping[str, Any]) -> str:
    """How much it is, with its standard error."""
    amount = said["amount"]
    return f"{number(amount['value'])} +- {amount['sigma']:.1g} {amount['unit']}"


def place_in_words(where: dict[str, Any]) -> str:
    """Where it is, in words."""
    if "record" in where:
        return f"in record {where['record']}"
    if "image" in where:
        middle = f", nothing at y = {where['middle_mm']:.3g} mm," if "middle_mm" in where else ""
        return f"in {where['image']} of the image{middle}"
    if "surface" in where:
        return "the same everywhere"
    if "jaws" in where:
        return "in both" if where["jaws"] == "all" else "in one"
    side = "|x|" if where["both_sides"] else "x"
    return f"at {side} = {where['x_mm']:.3g}, y = {where['y_mm']:.3g} mm"


def number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}"


def summary_of(here: Traced, found: Unlisted, file: EffectFile | None) -> dict[str, Any]:
    """The entry `unlisted` without paths."""
    out: dict[str, Any] = {
        "channel": found.channel,
        "where": None,
        "when_s": None,
        "excess": found.structure.excess,
        "excess_sigma": found.structure.blocks.spread,
        "excess_share": found.structure.share,
        "best_listed": {"effect": found.listed[0], "explains": found.listed[1], "needed": HALF} if found.listed[0] else None,
        "resembles": list(found.resembles),
        "beside": list(found.beside),
        "over_state": _law(believed_law(found.law), found.law),
        "other_channels": list(found.others),
        "hints": [{"variable": h.variable, "frequency": h.frequency, "sign": h.sign, "correlation": h.correlation} for h in found.hints],
    }
    holds = {} if file is None else {"file_holds": _proof(file.proof) | {"words": file.words}}
    if found.field is None or found.place is None:
        return out | holds
    return out | _of_field(here, found, found.field) | holds


def _law(proof: Proof | None, law: StateLaw | None) -> dict[str, Any] | None:
    """A missing stress over a state variable, None where held-out data do not ask for it."""
    if proof is None or law is None:
        return None
    curve = np.cumsum(law.field.q)
    return {"variable": law.variable, "largest_MPa": law.size, "at": law.edges.tolist(), "stress_MPa": curve.tolist(), **_proof(proof)}


def _proof(p: Proof) -> dict[str, float]:
    return {"held_out_gain": p.gain, "held_out_sigma": p.sigma}


def _of_field(here: Traced, found: Unlisted, field: MissingField) -> dict[str, Any]:
    place, missing = found.place, here.case.model.missing
    assert place is not None and missing is not None
    when, time = np.array(place.when), place.time
    if missing.records:
        record = int(field.basis.grid.part[int(np.argmax(np.abs(place.strength)))])
        own = field.basis.grid.part == record
        when, time = when - missing.offsets[record], time[own] - missing.offsets[record]
        strength, sigma = place.strength[own], place.sigma[own]
        position: dict[str, Any] = {"record": missing.records[record].name}
    elif KINDS[field.basis.kind].alike:
        kind = KINDS[field.basis.kind]
        strength, sigma, position = place.strength, place.sigma, {kind.alike: kind.which}
        position |= {"middle_mm": float(about(field).y[0])} if kind.about else {}
    else:
        strength, sigma = place.strength, place.sigma
        position = {
            "x_mm": place.centroid[0],
            "y_mm": place.centroid[1],
            "extent_x_mm": place.extent[0],
            "extent_y_mm": place.extent[1],
            "extent_mm": place.extent[1],
            "both_sides": missing.folded and field.basis.kind == "heat",
        }
    unit = "mW" if field.basis.kind == "heat" and not missing.records else field.basis.unit
    phases = [s.name for s in here.case.spans if s.t1 > place.when[0] and s.t0 < place.when[1]]
    return {
        "kind": KINDS[field.basis.kind].words,
        "where": position,
        "when_s": [float(when[0]), float(when[1])],
        "phases": phases,
        "unit": unit,
        "amount": {"value": place.size, "sigma": place.doubt, "unit": unit},
        "mean_in_window": place.size,
        "energy_mJ": place.total if unit == "mW" else None,
        "over_time": {"time_s": time.tolist(), "value": strength.tolist(), "sigma": sigma.tolist()},
        "steps": [{"time_s": t, "amount": amount} for t, amount in field.steps],
        **_proof(field.proof),
        **errors(here, field),
    }


def errors(here: Traced, field: MissingField) -> dict[str, Any]:
    """Rms of every channel in its unit without and with the term, of the fit and held out, beside the noise."""
    pairs = {"before": (here.columns.residual, field.before), "after": (field.residual, field.after)}
    out: dict[str, Any] = {}
    for word, (fit, held) in pairs.items():
        table: dict[str, dict[str, float]] = {"fit": {}, "held_out": {}}
        for k, c in enumerate(here.case.model.comparisons):
            floor, own = float(np.sqrt(np.mean(c.sigma**2))), here.rows.channel == k
            for kind, r in (("fit", fit), ("held_out", held)):
                table[kind][c.channel] = floor * float(np.sqrt(np.nanmean(r[own] ** 2)))
        out[word] = table
    return out


def effect_file(study_name: str, here: Traced, found: Unlisted) -> EffectFile | None:
    """The effect file of a reconstructed term; None where there is none, or a law that held-out data do not ask for stands alone."""
    field, law, missing = found.field, found.law, here.case.model.missing
    source = f"{study_name}, channel {found.channel}"
    if law is not None and (field is not None or believed_law(law) is not None):
        name = file_of("stress")
        text = yield_file(name, source, law.variable, (law.edges, law.width, law.field.q))
        words = f"the part of the missing stress that is a yield stress over {law.variable}"
        return EffectFile(name, text, words, law.field.proof)
    if field is None or missing is None or field.basis.kind == "stress":
        return None
    grid, kind = field.basis.grid, field.basis.kind
    name = file_of(kind)
    if kind == "displacement":
        return EffectFile(name, camera_file(name, source, grid, field.values), "the missing displacement over place and time", field.proof)
    if missing.records:
        text = sensor_file(name, KINDS[kind].words, source, _rises(found, missing, field))
        return EffectFile(name, text, f"the temperature that the missing {KINDS[kind].words} makes, over time", field.proof)
    if KINDS[kind].alike:
        text = over_time_file(kind, name, source, about(field), field.values[:, 0, 0, 0])
        return EffectFile(name, text, f"the {KINDS[kind].words} over time", field.proof)
    text = heat_file(name, source, grid, field.values[:, :, :, 0], missing.folded)
    return EffectFile(name, text, "the missing heat source over place and time", field.proof)


def _rises(found: Unlisted, missing: Missing, field: MissingField) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Per record its times and the temperature that is missing there."""
    (warmer,) = missing.answers(field.basis.kind, found.parameters, field.basis.grid, field.basis.chosen, field.q).values()
    rise = warmer[:, 0, 0, 0]
    ends = np.cumsum([len(record.time) for record in missing.records])[:-1]
    return [(record.name, record.time, own) for record, own in zip(missing.records, np.split(rise, ends), strict=True)]


def unlisted_datasets(found: Unlisted | None) -> dict[str, Dataset]:
    """The reconstructed field in the artefact."""
    if found is None or found.field is None or found.place is None:
        return {}
    grid, place = found.field.basis.grid, found.place
    return {
        "unlisted/time": Dataset(grid.time, "s", ("knot",)),
        "unlisted/x": Dataset(grid.x, "mm", ("x",)),
        "unlisted/y": Dataset(grid.y, "mm", ("y",)),
        "unlisted/value": Dataset(found.field.values, found.field.basis.unit, ("knot", "y", "x", "component")),
        "unlisted/strength": Dataset(place.strength, "1", ("knot",)),
        "unlisted/sigma": Dataset(place.sigma, "1", ("knot",)),
    }


_FINE = 41


def unlisted_figure(here: Traced, found: Unlisted) -> Figure:
    """Map of the mean in the window (a body), and the strength over time with two standard errors."""
    field, place = found.field, found.place
    assert field is not None and place is not None
    mapped = field.basis.grid.places > 1
    figure = new_figure(7.6 if mapped else 5.2, 3.6)
    grid = figure.add_gridspec(1, 2 if mapped else 1, width_ratios=(1.0, 2.0) if mapped else None)
    over_time = figure.add_subplot(grid[0, -1])
    if mapped:
        _map(figure, figure.add_subplot(grid[0, 0]), found)
    handles = shade_phases([over_time], here.case.spans)
    lines = over_time.plot(place.time, place.strength, color="tab:red", marker="o")
    over_time.fill_between(place.time, place.strength - 2.0 * place.sigma, place.strength + 2.0 * place.sigma, **NOISE)
    for t in place.when:
        over_time.axvline(t, color="black", linewidth=0.7, linestyle="--")
    over_time.axhline(0.0, color="black", linewidth=0.6)
    unit = "mW" if mapped and field.basis.kind == "heat" else field.basis.unit
    over_time.set_xlabel("time in s")
    kind = KINDS[field.basis.kind]
    over_time.set_ylabel(f"{kind.words if kind.alike in ('image', 'jaws') else f'missing {kind.words}'} in {unit}")
    over_time.legend(handles=[*lines, *handles], labels=["reconstructed", *(h.get_label() for h in handles)], loc="best")
    return figure


def _map(figure: Figure, ax: Axes, found: Unlisted) -> None:
    """Mean of the term in its window over the face."""
    field, place = found.field, found.place
    assert field is not None and place is not None
    grid = field.basis.grid
    inside = (grid.time >= place.when[0]) & (grid.time <= place.when[1])
    values = field.values[inside] if inside.any() else field.values[[int(np.argmax(np.abs(place.strength)))]]
    mean = values.mean(axis=0)
    level = mean[:, :, 0] if grid.components == 1 else np.linalg.norm(mean, axis=2)
    x, y = np.linspace(grid.x[0], grid.x[-1], _FINE), np.linspace(grid.y[0], grid.y[-1], _FINE)
    along = np.stack([np.interp(y, grid.y, column) for column in level.T], axis=1)
    fine = np.stack([np.interp(x, grid.x, row) for row in along])
    xy = np.stack([np.tile(x, _FINE), np.repeat(y, _FINE)], axis=1)
    limit = symmetric_limit(fine, 1e-12)
    image = draw_map(ax, xy, fine.ravel(), Scale(-limit, limit, "RdBu_r"))
    ax.plot(*place.centroid, marker="+", color="black", markersize=8.0)
    ax.set_xlabel("x in mm")
    ax.set_ylabel("y in mm")
    figure.colorbar(image, ax=ax, label=f"mean in the window, {field.basis.unit}")
