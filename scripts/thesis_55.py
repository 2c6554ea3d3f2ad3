"""Page on section 5.5: thermal parameters and boundary coefficients. Tables 5.16 to 5.22, figures 5.30 to 5.34."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import thesis_figures as figures
from scipy.interpolate import PchipInterpolator
from thesis_54_scaling import effective
from thesis_agreement import (
    Compared,
    Why,
    listed,
    noise_or_not,
    passes,
    same_answer,
    same_place,
    same_sign,
    same_size,
    same_values,
    same_word,
    signed,
)
from thesis_before import AIR as AIR_BEFORE
from thesis_before import JAWS, before, foreseen, foreseen_reaction
from thesis_printed import TABLE_5_16, TABLE_5_17, TABLE_5_19, TABLE_5_20, TABLE_5_21, TABLE_5_22, Values
from thesis_read import ONE_OPTIMUM, Statement, cell, free_names, headings, left_over, percent, spread, squared_error, uniqueness, value
from thesis_runs import Place
from thesis_tables import identified, of_f, starts_table

from thermofit.records.artefact import Record
from thermofit.report.figures_curves import stress_stretch_figure
from thermofit.report.figures_maps import residual_maps
from thermofit.report.tables import table

TITLE = "Section 5.5: identifiability of thermal boundary coefficients"
RUN, AIR, ISOTHERMAL, LITERATURE = "exp3", "exp3-air", "exp3-isothermal", "exp3-literature"
STRONG, WEAK = ("kappa", "alpha_air", "alpha_clamp"), ("alpha_exp", "c0", "beta")
MUCH, LITTLE = 0.10, 0.05
"""A parameter reacts strongly where its largest change is above the first, little where it is below the second."""
AIR_MEASURED, JAWS_MEASURED = 297.40, 296.70
"""Boundary temperatures of Table 3.2 in K."""


def statements(place: Place) -> list[Statement]:
    """What section 5.5 says, as found here."""
    ten = spread(place.record(RUN, "gridsearch"))
    free, fixed, literature = (left_over(place.record(run, "identify-thermal"))[0] for run in (RUN, ISOTHERMAL, LITERATURE))
    kappa = [value(place.record(run, "identify-thermal"), "kappa") for run in (ISOTHERMAL, RUN)]
    return [
        Statement(
            "all ten starts end in one optimum (spread of each parameter < 0.1 %)",
            max(ten.values()) < ONE_OPTIMUM,
            ", ".join(f"{name} {percent(s)}" for name, s in ten.items()),
        ),
        Statement(
            "identifying the boundary coefficients lowers the squared error, literature values raise it",
            free < fixed and free < literature,
            f"rms {1e3 * free:.1f} mK, {1e3 * fixed:.1f} mK with prescribed coefficients, {1e3 * literature:.1f} mK with literature values",
        ),
        Statement(
            "prescribed coefficients mean a higher kappa", kappa[0] > 1.05 * kappa[1], f"{kappa[0]:.1f} against {kappa[1]:.1f} mW/(mm K)"
        ),
        *_reactions(place),
        foreseen(place, "before-exp3", "six parameters of model 2", uniqueness(place.record(RUN, "gridsearch"))),
        *(foreseen_reaction(place, cause, STRONG, WEAK) for cause in (AIR_BEFORE, JAWS)),
    ]


def _reactions(place: Place) -> list[Statement]:
    out = []
    for run, what in ((AIR, "air"), (RUN, "jaws")):
        largest = place.record(run, "sensitivity").summary["largest_change"]
        words = ", ".join(f"{name} {percent(largest[name])}" for name in (*STRONG, *WEAK))
        strong, weak = min(largest[name] for name in STRONG), max(largest[name] for name in WEAK)
        text = f"with another temperature of the {what} kappa, alpha_air and alpha_clamp move strongly, alpha_exp, c0 and beta little"
        out.append(Statement(text, strong > MUCH and weak < LITTLE, words))
    same = equal_differences(place)
    text = "only the difference of air and jaws matters"
    out.append(Statement(text, max(same.values()) < 0.02, ", ".join(f"{name} {percent(share)}" for name, share in same.items())))
    return out


def measured_temperatures(place: Place) -> dict[str, float]:
    """Temperatures of air and jaws in K as the virtual thermocouples gave them: the nominal values of both sensitivities."""
    return {what: float(place.record(run, "sensitivity").summary["nominal"]["value"]) for what, run in (("air", AIR), ("jaws", RUN))}


def by_difference(place: Place, what: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Differences of air and jaws in K, growing, and the optima for them, where the temperature of one of both is varied."""
    summary, at = place.record(AIR if what == "air" else RUN, "sensitivity").summary, measured_temperatures(place)
    rows = [row for row in (summary["nominal"], *summary["values"]) if not row["failed"]]
    difference = np.array([row["value"] - at["jaws"] if what == "air" else at["air"] - row["value"] for row in rows])
    order = np.argsort(difference)
    return difference[order], {name: np.array([rows[i]["optimum"][name] for i in order]) for name in (*STRONG, *WEAK)}


def equal_differences(place: Place) -> dict[str, float]:
    """Largest relative difference of an optimum between both sensitivities at equal differences of air and jaws (cubics between)."""
    (x, air), (at, jaws) = (by_difference(place, what) for what in ("air", "jaws"))
    inside = (x >= at[0]) & (x <= at[-1])
    return {
        name: float(np.max(np.abs(air[name][inside] / PchipInterpolator(at, jaws[name])(x[inside]) - 1.0))) for name in (*STRONG, *WEAK)
    }


def page(place: Place, pages: Path) -> list[str]:
    """The parts of the page; figures are written below `pages`."""
    return [
        "Loading, unloading, cooling; model 2. The virtual material is what the thesis identified (Tables 5.16, 5.19).",
        *mechanical(place),
        *prescribed(place),
        *ten_starts(place),
        *sensitivities(place, pages),
        *literature(place),
        *pictures(place, pages),
    ]


def mechanical(place: Place) -> list[str]:
    """Table 5.16."""
    truth = place.record(RUN, "simulate")
    elastic, plastic = (place.record(RUN, f"identify-{stage}") for stage in ("elastic", "plastic"))
    tables = (identified(record, TABLE_5_16, truth) for record in (elastic, plastic))
    found = [
        same_values(f"{what} parameters", record, TABLE_5_16, within, noise_or_not(record, TABLE_5_16))
        for what, record, within in (("elastic", elastic, 0.05), ("plastic", plastic, 0.01))
    ]
    return ["## Table 5.16: mechanical parameters", *tables, listed(*found)]


WRONG_BOUNDARY = Why(
    "",
    "The virtual data hold nothing but noise beside the model, so that a wrong boundary stands out. The thesis's f falls further beyond "
    "the measured temperatures (Table 5.20): its optimum leaves over more than noise, beside which the same error is a smaller share.",
)


def prescribed(place: Place) -> list[str]:
    """Table 5.17."""
    record, full = place.record(ISOTHERMAL, "identify-thermal"), place.record(RUN, "identify-thermal")
    ours, theirs = squared_error(record) / squared_error(full) - 1.0, TABLE_5_17["f"] / TABLE_5_19["f"] - 1.0
    moved = {
        n: (value(record, n) / value(full, n) - 1.0, TABLE_5_17[n] / TABLE_5_19[n] - 1.0) for n in ("alpha_exp", "kappa", "c0", "beta")
    }
    weak = [max((pair[k] for name, pair in moved.items() if name != "kappa"), key=abs) for k in (0, 1)]
    found = [
        same_sign("prescribed coefficients change kappa by", *moved["kappa"]),
        same_size("size of that change", *moved["kappa"]),
        same_answer(
            "alpha_exp, c0 and beta stay within 10 %",
            (abs(weak[0]) < 0.1, f"largest change {signed(weak[0])}"),
            (abs(weak[1]) < 0.1, f"largest change {signed(weak[1])}"),
        ),
        same_sign("they change the squared error by", ours, theirs),
        same_size("size of that change", ours, theirs, WRONG_BOUNDARY),
    ]
    return ["## Table 5.17: boundary coefficients prescribed (alpha_air = 0, alpha_clamp = 1e8)", rows(record, TABLE_5_17), listed(*found)]


def rows(record: Record, printed: Values) -> str:
    """Free parameters here and in the thesis, two rows, with the unweighted squared error."""
    names = free_names(record)
    here = [cell(name, value(record, name)) + (" (bound)" if record.parameters[name].at_bound else "") for name in names]
    lines = [
        ["here", *here, f"{squared_error(record):.2f}"],
        ["thesis", *(cell(name, printed.get(name)) for name in names), f"{printed['f']:.2f}"],
    ]
    return table(["", *headings(names), "f_theta in K^2"], lines)


def ten_starts(place: Place) -> list[str]:
    """Table 5.19."""
    record, thermal = place.record(RUN, "gridsearch"), place.record(RUN, "identify-thermal")
    worst = max(spread(record).values())
    found = [
        same_word("uniqueness from ten starts", uniqueness(record), "unique"),
        same_answer(
            "the starts agree within 0.1 %",
            (worst < ONE_OPTIMUM, f"largest spread {percent(worst)}"),
            (SPREAD_5_19 < ONE_OPTIMUM, f"largest spread {percent(SPREAD_5_19)} (alpha_clamp)"),
            Why(
                "",
                "The thesis's search (Nelder and Mead) ends where it makes little progress; with exact derivatives it ends at the minimum.",
            ),
        ),
        same_answer("passes verification (temperature)", passes(place.record(RUN, "verify")), (True, "error without structure")),
        same_values("all six parameters", thermal, TABLE_5_19, 0.05, noise_or_not(thermal, TABLE_5_19)),
    ]
    return [
        "## Tables 5.18 and 5.19: all six parameters from ten starts",
        before(place, "before-exp3"),
        starts_table(record, (TABLE_5_19,)),
        f"The program says: `{record.summary['verdict']}`.",
        listed(*found),
        of_f(thermal, TABLE_5_19["f"]),
        identified(thermal, TABLE_5_19, place.record(RUN, "simulate")),
    ]


SPREAD_5_19 = (236.46 - 234.92) / 236.30
"""Spread of alpha_clamp over the ten optima that Table 5.19 prints."""


def sensitivities(place: Place, pages: Path) -> list[str]:
    """Tables 5.20 and 5.21, figure 5.33."""
    parts = []
    for number, run, printed, what in (("5.20", AIR, TABLE_5_20, "air"), ("5.21", RUN, TABLE_5_21, "jaws")):
        record = place.record(run, "sensitivity")
        parts += [
            f"## Table {number}: another temperature of the {what}",
            change_table(record, printed),
            f"The program says: `{record.summary['verdict']}`.",
        ]
        values = [row for row in record.summary["values"] if not row["failed"] and row["value"] in printed]
        # Of the thesis's temperatures: those of the virtual thermocouples are a few hundredths of a kelvin off.
        difference = [row["value"] - JAWS_MEASURED if what == "air" else AIR_MEASURED - row["value"] for row in values]
        ours = {name: [100.0 * row["change"][name] for row in values] for name in (*STRONG, *WEAK)}
        linear = {name: [100.0 * row["linearised_change"][name] for row in values] for name in ours}
        theirs = {name: [100.0 * (printed[row["value"]][name] / TABLE_5_19[name] - 1.0) for row in values] for name in ours}
        caption = f"Relative change of the optimum over the prescribed difference (temperature of the {what} varied), as figure 5.33"
        parts.append(figures.saved(pages, f"exp3-{what}", figures.reactions(difference, ours, theirs, linear), caption))
        parts.append(listed(*reactions_agree(record, printed, what)))
    same = equal_differences(place)
    worst = max(same, key=lambda name: same[name])
    theirs = max(
        abs(TABLE_5_20[air][name] / TABLE_5_21[jaws][name] - 1.0)
        for air in TABLE_5_20
        for jaws in TABLE_5_21
        if round(air - JAWS_MEASURED, 2) == round(AIR_MEASURED - jaws, 2)
        for name in same
    )
    parts.append(
        listed(
            same_answer(
                "only the difference of air and jaws matters (optima of both tables at equal differences within 2 %)",
                (same[worst] < 0.02, f"largest {percent(same[worst])} ({worst})"),
                (theirs < 0.02, f"largest {percent(theirs)}"),
            )
        )
    )
    return parts


def reactions_agree(record: Record, printed: Mapping[float, Values], what: str) -> list[Compared]:
    """How the optimum follows a boundary temperature: strong and weak parameters, signs where the difference grows, where f is lowest."""
    rows_here = [row for row in record.summary["values"] if not row["failed"] and row["value"] in printed]
    sign = 1.0 if what == "air" else -1.0
    nominal = AIR_MEASURED if what == "air" else JAWS_MEASURED
    largest = [
        {name: max(abs(of(row, name)) for row in rows_here) for name in (*STRONG, *WEAK)}
        for of in (lambda row, name: row["change"][name], lambda row, name: printed[row["value"]][name] / TABLE_5_19[name] - 1.0)
    ]
    out = [
        same_answer(
            f"{', '.join(STRONG)} move strongly (more than {percent(MUCH)})",
            *((min(of[n] for n in STRONG) > MUCH, _list(of, STRONG)) for of in largest),
        ),
        same_answer(
            f"{', '.join(WEAK)} move little (less than {percent(LITTLE)})",
            *((max(of[n] for n in WEAK) < LITTLE, _list(of, WEAK)) for of in largest),
        ),
    ]
    ends = [which(rows_here, key=lambda row: sign * row["value"]) for which in (min, max)]
    for row in ends:
        difference = sign * (row["value"] - nominal) + AIR_MEASURED - JAWS_MEASURED
        for name in STRONG:
            theirs = printed[row["value"]][name] / TABLE_5_19[name] - 1.0
            out.append(
                same_sign(f"air - jaws = {difference:.1f} K instead of 0.7 K changes {name} by", row["change"][name], theirs, UNKNOWN_REST)
            )
    nominal_row = record.summary["nominal"]
    here = [row["value"] for row in rows_here] + [nominal_row["value"]], [row["f"] for row in rows_here] + [nominal_row["f"]]
    thesis = [*printed, nominal], [*(row["f"] for row in printed.values()), TABLE_5_19["f"]]
    return [*out, same_place(f"temperature of the {what} at which f is lowest", here, thesis, UNKNOWN_REST)]


UNKNOWN_REST = Why(
    "",
    "The virtual data hold noise beside the model and nothing else. The thesis's f goes on falling beyond the measured temperatures. "
    "So its data hold what its model does not, and its optima follow that too.",
)


def _list(of: Mapping[str, float], names: tuple[str, ...]) -> str:
    return ", ".join(f"{name} {percent(of[name])}" for name in names)


def change_table(record: Record, printed: Mapping[float, Values]) -> str:
    """Optimum for every prescribed value, the thesis's in brackets, with chi2 over that of the nominal value."""
    names, nominal = free_names(record), record.summary["nominal"]
    lines = [[f"{nominal['value']:.2f}", *(_both(name, nominal, TABLE_5_19) for name in names), "1.000"]]
    for row in record.summary["values"]:
        theirs = printed.get(row["value"], {})
        lines.append(
            [
                f"{row['value']:.2f}",
                *(_both(name, row, theirs) for name in names),
                "-" if row["failed"] else f"{row['f'] / nominal['f']:.3f}",
            ]
        )
    return table(["prescribed, K", *headings(names), "f / f nominal"], sorted(lines))


def _both(name: str, row: Mapping[str, Any], theirs: Values) -> str:
    ours = "failed" if row["failed"] else cell(name, row["optimum"][name])
    return ours + (f" ({cell(name, theirs[name])})" if name in theirs else "")


def literature(place: Place) -> list[str]:
    """Table 5.22."""
    record, full = place.record(LITERATURE, "identify-thermal"), place.record(RUN, "identify-thermal")
    ours, theirs = squared_error(record) / squared_error(full) - 1.0, TABLE_5_22["f"] / TABLE_5_19["f"] - 1.0
    changes = {
        n: (value(record, n) / value(full, n) - 1.0, TABLE_5_22[n] / TABLE_5_19[n] - 1.0) for n in ("beta", "alpha_air", "alpha_clamp")
    }
    found = [
        *(same_sign(f"{name} changes by", *pair) for name, pair in changes.items()),
        same_sign("the squared error changes by", ours, theirs),
        same_size("size of that change", ours, theirs, WRONG_BOUNDARY),
    ]
    known = {"c0": TABLE_5_19["c0"], "alpha_exp": TABLE_5_19["alpha_exp"]}
    text = (
        "The literature's c0 is at constant pressure, the model's at constant elastic deformation: c0 + 9 K alpha_exp^2 theta is "
        f"{percent(effective(known) / known['c0'] - 1.0)} more at the optimum of Table 5.19."
    )
    head = "## Table 5.22: literature values prescribed (alpha_exp = 23e-6, kappa = 200, c0 = 2.43)"
    return [head, rows(record, TABLE_5_22), listed(*found), text]


def pictures(place: Place, pages: Path) -> list[str]:
    """Figures of the run."""
    verify = place.record(RUN, "verify")
    sets = {
        "prescribed coefficients": place.record(ISOTHERMAL, "verify"),
        "all six identified": verify,
        "literature values": place.record(LITERATURE, "verify"),
    }
    made = {
        "exp3-stress-stretch": (stress_stretch_figure(verify, (0.0, 9.0)), "Stress and stretch of the window, as figure 5.30"),
        "exp3-fields": (figures.field_maps(verify), "Fields at the largest force: measured and model"),
        "exp3-residual-u": (residual_maps(verify, "du"), "What is left of the relative displacements, as figure 5.30"),
        "exp3-residual-theta": (residual_maps(verify, "dtheta"), "What is left of the temperature change, as figure 5.31"),
        "exp3-temperature": (
            figures.temperatures(sets, (330.0, 400.0)),
            "Temperature in the middle by three sets, as figures 5.32 and 5.34",
        ),
    }
    return ["## Figures", *(figures.saved(pages, name, figure, text) for name, (figure, text) in made.items() if figure is not None)]
