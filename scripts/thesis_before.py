"""What the analysis before any data says of each experiment, beside what the identification then finds."""

from __future__ import annotations

from thesis_agreement import signed
from thesis_read import Statement
from thesis_runs import Place

from thermofit.records.artefact import Record

ARTEFACT = "identifiability-a-priori"
MOTION, JAWS, AIR = "rigid-body motion", "theta_clamp", "theta_air"


def record_before(place: Place, run: str) -> Record:
    """The analysis of a planned test."""
    return place.record(run, ARTEFACT)


def before(place: Place, run: str) -> str:
    """The verdict before the test, as a sentence of a page."""
    record = record_before(place, run)
    # Along a valley the optimum may be anywhere: how far an error moves it says nothing.
    remarks = [text for text in record.summary["remarks"] if " moves " in text and record.summary["kind"] == "unique"]
    return " ".join([f"Before any data the program says: `{record.summary['verdict']}`.", *(f"{text}." for text in remarks)])


def foreseen(place: Place, run: str, what: str, found: str) -> Statement:
    """Whether the verdict before the test is the word for what the starts then found."""
    kind = str(record_before(place, run).summary["kind"])
    told = "'weak' (one optimum, poorly determined)" if kind == "weak" else f"'{kind}'"
    return Statement(f"the analysis before any data foresees what is found: {what}", kind == found, f"foreseen {told}, found '{found}'")


def moved_by(place: Place, run: str, cause: str) -> dict[str, float]:
    """Relative change of every parameter by an error of what is prescribed, foreseen from the slopes."""
    for row in record_before(place, run).summary["moved_by"]:
        if cause in row["by"]:
            return {name: float(share) for name, share in row.items() if name != "by"}
    raise KeyError(f"{run}: nothing is foreseen of {cause}")


def foreseen_motion(place: Place, found: float) -> Statement:
    """Whether the way in which plain displacements move E is foreseen; `found` relative change."""
    share = moved_by(place, "before-exp1-elastic", MOTION)["E"]
    text = "the analysis before any data foresees that plain displacements make the material look softer"
    return Statement(text, share < 0.0 and found < 0.0, f"E by {signed(share)} foreseen, {signed(found)} found")


def foreseen_reaction(place: Place, cause: str, strong: tuple[str, ...], weak: tuple[str, ...]) -> Statement:
    """Whether it is foreseen which parameters a boundary temperature moves strongly."""
    moves = moved_by(place, "before-exp3", cause)
    least, most = min(abs(moves[name]) for name in strong), max(abs(moves[name]) for name in weak)
    text = f"the analysis before any data foresees which parameters {cause} moves strongly"
    shown = ", ".join(f"{name} {signed(moves[name])}" for name in (*strong, *weak))
    return Statement(text, least > 2.0 * most, f"by 0.1 K: {shown}")
