"""Page on section 5.3: experiment 1, model 1 with beta = 1. Tables 5.2, 5.3, 5.6; figures 5.5 to 5.11."""

from __future__ import annotations

from pathlib import Path

import thesis_figures as figures
from thesis_agreement import Compared, Why, listed, noise_or_not, passes, same_answer, same_sign, same_size, same_values, same_word, signed
from thesis_before import before, foreseen, foreseen_motion
from thesis_printed import LITERATURE, TABLE_5_2, TABLE_5_3, TABLE_5_6
from thesis_read import ONE_OPTIMUM, Statement, cell, percent, spread, uniqueness, value
from thesis_runs import Place
from thesis_tables import identified, misfit, of_f, starts_table

from thermofit.report.figures_curves import stress_stretch_figure
from thermofit.report.figures_maps import residual_maps
from thermofit.report.tables import table

TITLE = "Section 5.3: identifiability of thermal model parameters"
RUN = "exp1"
ELASTIC_TRUE = 0.01
"""Deviation of E from the truth within which relative displacements recover it."""


def side_by_side(place: Place) -> dict[str, dict[str, float]]:
    """E, nu and their standard errors by the measure of the displacements."""
    rows = place.record(RUN, "identify-elastic").summary["side_by_side"]
    names = {"u": "displacements", "rigid-body": "relative displacements"}
    return {names[row["measure"]]: row for row in rows}


def statements(place: Place) -> list[Statement]:
    """What section 5.3 says, as found here."""
    rows, truth = side_by_side(place), place.record(RUN, "simulate")
    plain, relative, true = rows["displacements"]["E"], rows["relative displacements"]["E"], value(truth, "E")
    seven = spread(place.record(RUN, "gridsearch"))
    verify = place.record(RUN, "verify")
    return [
        Statement("plain displacements make the material appear softer", plain < 0.97 * true, f"E {plain:.0f} MPa, true {true:.0f} MPa"),
        Statement(
            "relative displacements recover E to 1 %",
            abs(relative / true - 1.0) < ELASTIC_TRUE,
            f"{100.0 * (relative / true - 1.0):+.2f} %",
        ),
        Statement(
            "all seven starts end in one optimum (spread of each parameter < 0.1 %)",
            max(seven.values()) < ONE_OPTIMUM,
            ", ".join(f"{name} {percent(s)}" for name, s in seven.items()),
        ),
        Statement("the optimum passes verification", bool(verify.summary["trustworthy"]), str(verify.summary["verdict"])),
        foreseen(place, "before-exp1", "model 1 with beta = 1, without cooling", uniqueness(place.record(RUN, "gridsearch"))),
        foreseen_motion(place, plain / relative - 1.0),
    ]


def page(place: Place, pages: Path) -> list[str]:
    """The parts of the page; figures are written below `pages`."""
    return [
        "Monotonic loading, no unloading; model 1 with linear hardening, beta = 1. The virtual material is what the thesis identified "
        "(Tables 5.2, 5.3, 5.6), so that an identification without error would return the thesis's figures.",
        *table_5_2(place),
        *table_5_3(place),
        *table_5_6(place),
        *pictures(place, pages),
    ]


def table_5_2(place: Place) -> list[str]:
    """Elastic parameters by displacements and by relative displacements."""
    rows, truth = side_by_side(place), place.record(RUN, "simulate")
    lines = []
    for name, printed in TABLE_5_2.items():
        found = rows[name]
        ours = [f"{found['E']:.0f} +- {found['E +-']:.0f}", f"{found['nu']:.3f} +- {found['nu +-']:.3f}"]
        lines.append([name, *ours, f"{found['times noise']:.2f}", cell("E", printed["E"]), cell("nu", printed["nu"])])
    lines.append(["virtual material; literature", cell("E", value(truth, "E")), cell("nu", value(truth, "nu")), "", "69000", "0.33"])
    return [
        "## Table 5.2: elastic parameters",
        table(["objective", "E in MPa", "nu", "rms / noise", "E, thesis", "nu, thesis"], lines),
        before(place, "before-exp1-elastic"),
        listed(*softening(rows)),
    ]


def softening(rows: dict[str, dict[str, float]]) -> list[Compared]:
    """What plain displacements do to E and nu, here and in the thesis."""
    plain, relative = rows["displacements"], rows["relative displacements"]
    thesis, ideal = TABLE_5_2["displacements"], TABLE_5_2["relative displacements"]
    change = {name: (plain[name] / relative[name] - 1.0, thesis[name] / ideal[name] - 1.0) for name in ("E", "nu")}
    noise = f"misfit {plain['times noise']:.1f} times the noise with plain, {relative['times noise']:.2f} times with relative displacements"
    motion = plain["times noise"] > 1.2 * relative["times noise"]
    why = Why(
        f"Rigid-body motion takes part in plain displacements ({noise})." if motion else "",
        "The rigid-body motion is that of the virtual machine (compliance, slip and rotation of the jaws), not that of the thesis's, "
        "which is not known.",
    )
    recovered = relative["E"] / ideal["E"] - 1.0
    return [
        same_sign("plain displacements make the material look softer, E by", *change["E"], why),
        same_size("how much softer", *change["E"], Why("", why.differs)),
        same_sign("plain displacements change nu by", *change["nu"], Why("", why.differs)),
        Compared(
            "relative displacements give E of the virtual material (within 1 %)",
            abs(recovered) < ELASTIC_TRUE,
            f"{signed(recovered)}, {abs(relative['E'] - ideal['E']) / relative['E +-']:.1f} standard errors",
            f"{ideal['E']:.0f} MPa, which is the virtual material; {signed(ideal['E'] / LITERATURE['E'] - 1.0)} against the literature",
        ),
    ]


def table_5_3(place: Place) -> list[str]:
    """Plastic parameters."""
    record, truth = place.record(RUN, "identify-plastic"), place.record(RUN, "simulate")
    found = same_values("plastic parameters", record, TABLE_5_3, 0.01, noise_or_not(record, TABLE_5_3))
    return ["## Table 5.3: plastic parameters", identified(record, TABLE_5_3, truth), listed(found), f"Left over: {misfit(record, 'du')}."]


def table_5_6(place: Place) -> list[str]:
    """Thermal parameters from seven starts."""
    record, thermal, verify = place.record(RUN, "gridsearch"), place.record(RUN, "identify-thermal"), place.record(RUN, "verify")
    away = {name: value(thermal, name) / LITERATURE[name] - 1.0 for name in ("kappa", "c0")}
    printed = {name: TABLE_5_6[name] / LITERATURE[name] - 1.0 for name in away}
    found = [
        same_word("uniqueness from seven starts", uniqueness(record), "unique"),
        same_values("thermal parameters", thermal, TABLE_5_6, 0.01, noise_or_not(thermal, TABLE_5_6)),
        same_answer("passes verification", passes(verify), (True, "error homogeneous in space and time")),
        same_answer(
            "kappa and c0 lie more than 10 % from the literature (verified, not valid)",
            (min(abs(share) for share in away.values()) > 0.1, ", ".join(f"{name} {signed(share)}" for name, share in away.items())),
            (True, ", ".join(f"{name} {signed(share)}" for name, share in printed.items())),
            Why(
                "The virtual material was given the thesis's optimum, so that this follows; section 5.4 shows where such an optimum "
                "comes from."
            ),
        ),
    ]
    return [
        "## Tables 5.5 and 5.6: thermal parameters from seven starts",
        before(place, "before-exp1"),
        starts_table(record, (TABLE_5_6,)),
        f"The program says: `{record.summary['verdict']}`.",
        listed(*found),
        of_f(thermal, TABLE_5_6["f"]),
    ]


def pictures(place: Place, pages: Path) -> list[str]:
    """Figures of the run."""
    verify = place.record(RUN, "verify")
    elastic = verify["curves/stress_stretch/time"].value
    window = (0.0, float(min(elastic[-1], 9.0)))
    made = {
        "exp1-stress-stretch": (stress_stretch_figure(verify, window), "Stress and stretch of the window, as figures 5.5 and 5.8"),
        "exp1-fields": (figures.field_maps(verify), "Fields at the largest force: measured and model"),
        "exp1-residual-u": (residual_maps(verify, "du"), "What is left of the relative displacements, as figures 5.6 and 5.9"),
        "exp1-residual-theta": (residual_maps(verify, "dtheta"), "What is left of the temperature change, as figure 5.10"),
        "exp1-temperature": (figures.temperatures({"model 1": verify}), "Temperature in the middle of the specimen, as figure 5.11"),
    }
    return ["## Figures", *(figures.saved(pages, name, figure, text) for name, (figure, text) in made.items() if figure is not None)]
