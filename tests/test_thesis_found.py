"""What sections 5.3 to 5.5 of the thesis say, found on the coarse mesh. Minutes; `THERMOFIT_RUNS` names a folder where runs are kept."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow
LARGEST_PICTURE = 150_000


@pytest.fixture(scope="module")
def place(scripts: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """All runs on the coarse mesh, carried out by the script of `make thesis`."""
    runs = scripts("thesis_runs")
    kept = os.environ.get("THERMOFIT_RUNS")
    where = runs.place_of(Path(kept) if kept else tmp_path_factory.mktemp("runs"), "coarse")
    runs.execute(runs.chosen(list(runs.SECTIONS.values()), "coarse"), where, 2, print)
    return where


def optima(place: Any, run: str, names: tuple[str, ...]) -> np.ndarray:
    """Optimum of every start (n, n_p); all of them converged."""
    starts = place.record(run, "gridsearch").summary["starts"]
    assert all(start["converged"] for start in starts), run
    return np.array([[start["optimum"][name] for name in names] for start in starts])


def width(values: np.ndarray) -> np.ndarray:
    """(largest - smallest)/mean of every column."""
    return (values.max(axis=0) - values.min(axis=0)) / values.mean(axis=0)


@pytest.mark.parametrize(("run", "count", "names"), [
    ("exp1", 7, ("alpha_exp", "kappa", "c0")),
    ("exp3", 10, ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp")),
    ("exp1-model-2", 4, ("alpha_exp", "kappa", "c0", "beta")),
    ("exp2", 4, ("alpha_exp", "kappa", "c0", "beta")),
])  # fmt: skip
def test_starts_end_in_one_optimum(place: Any, run: str, count: int, names: tuple[str, ...]) -> None:
    x = optima(place, run, names)
    assert x.shape == (count, len(names))
    assert width(x).max() < 1e-3
    assert place.record(run, "gridsearch").summary["uniqueness"] == "unique"


def test_model_1_without_cooling_ends_in_a_valley_of_constant_ratios(place: Any) -> None:
    record = place.record("exp1-models", "gridsearch")
    x = optima(place, "exp1-models", ("alpha_exp", "kappa", "c0", "beta"))
    f = np.array([start["f"] for start in record.summary["starts"]])
    assert width(x).min() > 0.1 and f.max() / f.min() - 1.0 < 1e-3
    assert width(x[:, :3] / x[:, 3:]).max() < 0.01
    assert record.summary["uniqueness"] == "valley"
    assert set(record.summary["constant_ratios"]) == {"alpha_exp/beta", "kappa/beta", "c0/beta"}
    assert "kappa/beta" in record.summary["verdict"]


def test_model_1_with_cooling_is_unique_only_where_something_sets_the_scale(place: Any) -> None:
    """With ideal jaws every term of its heat balance has one of four factors, with cooling as without; a known film has none."""
    assert place.record("exp2-model-1", "gridsearch").summary["uniqueness"] == "valley"
    record = place.record("exp3-model-1", "gridsearch")
    assert record.summary["uniqueness"] == "unique"
    assert width(optima(place, "exp3-model-1", ("alpha_exp", "kappa", "c0", "beta"))).max() < 1e-3


@pytest.mark.parametrize("run", ["exp1", "exp1-models", "exp1-model-2", "exp2-model-1", "exp2", "exp3-model-1", "exp3"])
def test_verdict_is_foreseen_before_any_data(place: Any, run: str) -> None:
    foreseen = place.record(f"before-{run}", "identifiability-a-priori").summary
    assert foreseen["kind"] == place.record(run, "gridsearch").summary["uniqueness"]
    if foreseen["kind"] == "valley":
        assert all(ratio in foreseen["verdict"] for ratio in ("alpha_exp/beta", "kappa/beta", "c0/beta"))


def test_before_a_coupled_search_of_model_1_a_weak_optimum_is_foreseen(place: Any) -> None:
    """Only 9 K alpha_exp^2 theta, some 4 % of the heat capacity of aluminium, parts it from a valley. Searched on the full mesh only."""
    assert place.record("before-exp2-model-1-coupled", "identifiability-a-priori").summary["kind"] == "weak"


def test_reactions_and_softening_are_foreseen_before_any_data(place: Any, scripts: Any) -> None:
    before, five = scripts("thesis_before"), scripts("thesis_55")
    assert before.moved_by(place, "before-exp1-elastic", before.MOTION)["E"] < -0.01
    assert all(before.foreseen_reaction(place, cause, five.STRONG, five.WEAK).holds for cause in (before.AIR, before.JAWS))


def test_relative_displacements_recover_what_plain_ones_soften(place: Any) -> None:
    rows = {row["measure"]: row for row in place.record("exp1", "identify-elastic").summary["side_by_side"]}
    true = place.record("exp1", "simulate").parameters["E"].value
    assert rows["rigid-body"]["E"] == pytest.approx(true, rel=0.01)
    assert rows["u"]["E"] < 0.95 * true and rows["u"]["times noise"] > 1.5


@pytest.mark.parametrize("run", ["exp3-air", "exp3"])
def test_what_carries_heat_reacts_strongly_to_the_boundary_temperatures(place: Any, run: str) -> None:
    record = place.record(run, "sensitivity")
    assert not any(row["failed"] for row in record.summary["values"])
    largest = record.summary["largest_change"]
    assert min(largest[name] for name in ("kappa", "alpha_air", "alpha_clamp")) > 2.0 * max(
        largest[name] for name in ("alpha_exp", "c0", "beta")
    )


def test_model_1_fails_verification_with_cooling_and_model_2_passes(place: Any) -> None:
    """The virtual material is neither; without cooling the temperatures tell the models apart less."""
    over = {}
    for run in ("exp1-models", "exp2-model-1", "exp2"):
        row = place.record(run, "verify").summary["channels"]["dtheta"]
        over[run] = row["rms"] / row["floor_rms"]
    assert over["exp2-model-1"] > 1.5 > over["exp2"]
    assert over["exp1-models"] < over["exp2-model-1"]
    assert not place.record("exp2-model-1", "verify").summary["trustworthy"]


def test_every_table_is_written_beside_the_thesis(place: Any, scripts: Any, tmp_path: Path) -> None:
    main = scripts("thesis")
    tables = {"5.3": ("5.2", "5.3", "5.6"), "5.4": ("5.8", "5.10", "5.11", "5.13", "5.14", "5.15")}
    tables["5.5"] = ("5.16", "5.17", "5.19", "5.20", "5.21", "5.22")
    for section, numbers in tables.items():
        main.write(section, place, tmp_path)
        text = (tmp_path / f"section-{section.replace('.', '-')}.md").read_text(encoding="utf-8")
        headings = " ".join(line for line in text.splitlines() if line.startswith("## "))
        assert all(number in headings for number in numbers) and "virtual" in text
        for picture in (part.split(")")[0] for part in text.split("](")[1:]):
            assert 1000 < (tmp_path / picture).stat().st_size < LARGEST_PICTURE
