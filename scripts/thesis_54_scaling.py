"""Why model 1 scales: what the temperatures fix of it, along the thesis's own valley and in searches that are fully coupled."""

from __future__ import annotations

from collections.abc import Mapping

from thesis_before import before
from thesis_printed import TABLE_5_10, TABLE_5_14, TABLE_5_15
from thesis_read import percent
from thesis_runs import Place

from thermofit.core.experiment import CELSIUS
from thermofit.records.artefact import Record
from thermofit.report.tables import table

COOLING = {1: "exp2-model-1", 2: "exp2"}
COUPLED = "exp2-model-1-coupled"
"""Model 1 with cooling again, with the thermal stage fully coupled instead of one-way."""
COUPLED_MESH = "3 x 20 x 1"
ROOM = CELSIUS + 24.0
"""Temperature at which the heat capacity at constant pressure is stated, K."""


SCALES = (
    "With jaws as an ideal heat sink and no exchange with the air every term of (4.20) carries one of alpha_exp, kappa, c0 and beta as a "
    "factor. A common factor then changes no temperature."
)


def capacity_sentence() -> str:
    """Drift of c0/beta along the thesis's own valley, and what is constant instead: c0 + 9 K alpha_exp^2 theta."""
    plain, whole = [row["c0"] / row["beta"] for row in TABLE_5_10], [effective(row) / row["beta"] for row in TABLE_5_10]
    return (
        "The thesis's search is fully coupled, where heating at zero stress needs c0 + 9 K alpha_exp^2 theta: that sum over beta is what "
        "the "
        f"temperatures fix. Its own Table 5.10 shows it: c0/beta differs by {percent((max(plain) - min(plain)) / min(plain))} and falls "
        f"with "
        f"beta, (c0 + 9 K alpha_exp^2 theta)/beta differs by {percent((max(whole) - min(whole)) / min(whole))}."
    )


def effective(row: Mapping[str, float], modulus: float = 67913.0, ratio: float = 0.35) -> float:
    """Heat capacity at zero stress c0 + 9 K alpha_exp^2 theta, mJ/(mm^3 K)."""
    return row["c0"] + 9.0 * modulus / (3.0 * (1.0 - 2.0 * ratio)) * row["alpha_exp"] ** 2 * ROOM


def scaling(place: Place) -> list[str]:
    """What the temperatures of the cooled test fix of model 1: ratios to beta, here and in the thesis."""
    rows = {
        "here, one-way": best_of(place.record(COOLING[1], "gridsearch")),
        "thesis, Table 5.14 (c0 = 0 for << 1)": {"c0": 0.0, **TABLE_5_14[1]},
        "thesis, Table 5.15 (model 2)": TABLE_5_15,
    }
    rows |= {f"here, fully coupled, start {label}": row for label, row in coupled_optima(place).items()}
    lines = []
    for label, row in rows.items():
        # One-way, the deformation is that of the first parameters: c0 alone heats.
        capacity = row["c0"] if "one-way" in label else effective(row)
        parts = (1e6 * row["alpha_exp"], row["kappa"], capacity)
        lines.append([label, *(f"{part / row['beta']:.4g}" for part in parts), f"{row['beta']:.3g}", f"{row['c0']:.3g}"])
    heads = ["", "alpha_exp/beta in 1e-6/K", "kappa/beta in mW/(mm K)", "(c0 + 9 K alpha_exp^2 theta)/beta in mJ/(mm^3 K)", "beta", "c0"]
    return [table(heads, lines), coupled_sentence(place)]


def coupled_sentence(place: Place) -> str:
    """Where the fully coupled searches of model 1 end, said from their records."""
    if not place.has(COUPLED, "gridsearch"):
        return (
            "The fully coupled search of model 1 with cooling is carried out with `MESH=full` alone: every evaluation of its four starts "
            "is a coupled run."
        )
    record = place.record(COUPLED, "gridsearch")
    best = best_of(record)
    share = 1.0 - best["c0"] / effective(best)
    return (
        f"Searched fully coupled, as in the thesis, on a mesh of {COUPLED_MESH}, because every evaluation is a coupled run. "
        f"{before(place, f'before-{COUPLED}')} Of the search it says: "
        f"{record.summary['verdict']}. At its best optimum 9 K alpha_exp^2 theta is {percent(share)} of the heat capacity; in Table 5.14 "
        "it is all "
        "of it."
    )


def coupled_optima(place: Place) -> dict[str, Mapping[str, float]]:
    """Optimum of every fully coupled search of model 1 with cooling."""
    if not place.has(COUPLED, "gridsearch"):
        return {}
    starts = place.record(COUPLED, "gridsearch").summary["starts"]
    return {"ABCD"[i]: start["optimum"] for i, start in enumerate(starts) if not start["failed"]}


def best_of(record: Record) -> Mapping[str, float]:
    best = min((start for start in record.summary["starts"] if not start["failed"]), key=lambda start: start["f"])
    optimum: Mapping[str, float] = best["optimum"]
    return optimum
