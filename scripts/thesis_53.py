"""Page on section 5.3: experiment 1, model 1 with beta = 1. Tables 5.2, 5.3, 5.6; figures 5.5 to 5.11."""

from __future__ import annotations

from pathlib import Path

import thesis_figures as figures
from thesis_printed import LITERATURE, TABLE_5_2, TABLE_5_3, TABLE_5_6
from thesis_read import ONE_OPTIMUM, Statement, cell, percent, spread, value
from thesis_runs import Place
from thesis_tables import identified, largest_deviation, misfit, of_f, starts_table

from thermofit.diagnose.figures_curves import stress_stretch_figure
from thermofit.diagnose.figures_maps import residual_maps
from thermofit.diagnose.tables import table

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
    plain, relative, print_ = rows["displacements"], rows["relative displacements"], TABLE_5_2["displacements"]
    text = (
        f"Agrees: with plain displacements the material looks softer ({100.0 * (plain['E'] / relative['E'] - 1.0):+.0f} % here, "
        f"{100.0 * (print_['E'] / TABLE_5_2['relative displacements']['E'] - 1.0):+.0f} % in the thesis) and the misfit is "
        f"{plain['times noise']:.1f} times the noise; relative displacements take the rigid-body motion out. Differs: how much softer, and "
        "nu, because that is the motion of this virtual machine (compliance, slip and rotation of the jaws), not of the thesis's."
    )
    return [
        "## Table 5.2: elastic parameters",
        table(["objective", "E in MPa", "nu", "rms / noise", "E, thesis", "nu, thesis"], lines),
        text,
    ]


def table_5_3(place: Place) -> list[str]:
    """Plastic parameters."""
    record, truth = place.record(RUN, "identify-plastic"), place.record(RUN, "simulate")
    text = (
        f"Agrees within {largest_deviation(record, truth)}; {misfit(record, 'du')}. Where a deviation is many standard errors it is the "
        f"mesh: "
        "the virtual material was computed on a finer mesh than it is identified with, and standard errors know the noise only."
    )
    return ["## Table 5.3: plastic parameters", identified(record, TABLE_5_3, truth), text]


def table_5_6(place: Place) -> list[str]:
    """Thermal parameters from seven starts."""
    record, thermal = place.record(RUN, "gridsearch"), place.record(RUN, "identify-thermal")
    away = {name: percent(abs(value(thermal, name) / LITERATURE[name] - 1.0)) for name in ("kappa", "c0")}
    text = (
        f"Agrees: {record.summary['verdict']}. {of_f(thermal, TABLE_5_6['f'])} As in the thesis the optimum is verified but not valid: "
        f"kappa and "
        f"c0 are {away['kappa']} and {away['c0']} from the literature. Here that is so because the virtual material was given the "
        f"thesis's optimum; "
        "section 5.4 shows where such an optimum comes from."
    )
    return ["## Tables 5.5 and 5.6: thermal parameters from seven starts", starts_table(record, (TABLE_5_6,)), text]


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
