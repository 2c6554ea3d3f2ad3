"""The loop on sets of coupon records as people have them: many rates and temperatures, equal specimens, terms that help only together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coupon_sets import TRUTH, cooled_record, drifting_record, equal_records, followed_record, looped, pulled_record, study_of

from thermofit.core.errors import NumericsError
from thermofit.diagnose import trace
from thermofit.diagnose.backward import held_out_of
from thermofit.diagnose.case import Case, columns_of
from thermofit.diagnose.held_out import Rows, split_by_blocks
from thermofit.effects.catalogue import Effect
from thermofit.experiment.coupon import CouponExperiment
from thermofit.experiment.coupon_records import CouponData
from thermofit.fit.result import FitResult

SOFTENING = {"thermal_softening", "softening_power"}
RATE = {"rate_power", "rate_logarithmic"}
BACKSTRESS = {"backstress_first", "backstress_second"}
"""One law: which of both comes first is no difference."""
ONE = {"diagnosis": {"max_effects": 1}}


def test_a_candidate_that_cannot_be_run_takes_no_other_down(tmp_path: Path) -> None:
    """Nine records over seven decades of rate and 700 K: a power law of the rate at 2700 1/s is hundreds of GPa of overstress, with which
    no softened specimen can be run. The softening that is judged then knows nothing of it."""
    at = [
        (1e-4, 293.0),
        (1e-4, 593.0),
        (1e-4, 993.0),
        (1e-2, 293.0),
        (1.0, 293.0),
        (1.0, 593.0),
        (100.0, 293.0),
        (2700.0, 293.0),
        (2700.0, 593.0),
    ]
    law = {"thermal_softening.slope": 9e-4, "rate_logarithmic.C": 0.012}
    tests = tuple(pulled_record(f"r{k}", rate, theta, k, 2.0, 0.4, 40, **law) for k, (rate, theta) in enumerate(at))
    found = looped(study_of(tmp_path, **ONE), tests, tmp_path)
    assert len(found.accepted) == 1 and set(found.accepted) <= SOFTENING
    before, after = (float(np.mean(t.columns.residual**2)) for t in (found.first, found.last))
    assert after < 0.1 * before, "the rate effect that is still missing leaves the rest"


def test_a_refit_begins_nearer_where_the_estimate_cannot_be_run(tmp_path: Path) -> None:
    """Monotonic records at nine temperatures over 700 K: one linear step asks for a slope at which the hot ones have no yield stress."""
    temperatures = np.linspace(293.15, 993.15, 9)
    tests = tuple(
        pulled_record(f"r{k}", 1e-3, t, k, 2.0, samples=50, **{"thermal_softening.slope": 1.35e-3}) for k, t in enumerate(temperatures)
    )
    found = looped(study_of(tmp_path, **ONE), tests, tmp_path)
    assert len(found.accepted) == 1 and set(found.accepted) <= SOFTENING
    assert float(np.sqrt(np.mean(found.last.columns.residual**2))) < 1.5
    (trial,) = [t for t in found.rounds[0].trials if t.effects == ("thermal_softening",)]
    assert trial.estimate["thermal_softening.slope"] == pytest.approx(1.35e-3, rel=0.02)


def test_of_equal_records_no_fold_holds_out_the_same_phase_of_all(tmp_path: Path) -> None:
    """Five equal records: with blocks dealt out over all of them one after another every fold held out one phase of all five."""
    found = looped(study_of(tmp_path, **ONE), equal_records(5, 2.0, **{"second_hardening.Q": 40.0, "second_hardening.b": 300.0}), tmp_path)
    rows, split = found.first.rows, found.first.split
    record = np.repeat(np.arange(5), 40)
    sample = np.tile(np.arange(40), 5)
    assert len(record) == len(rows.time)
    for held in split.held_out:
        out = [set(sample[held & (record == k)].tolist()) for k in range(5)]
        assert not set.intersection(*out), "what one record holds out another one shows"
    first, last = (float(np.sqrt(np.nanmean(held_out_of(t) ** 2))) for t in (found.first, found.last))
    fit = float(np.sqrt(np.mean(found.first.columns.residual**2)))
    assert first < 1.2 * fit and last < 0.75 * first, "folds are predicted about as well as they are fitted"
    (name,) = found.accepted
    assert name in ("second_hardening", *BACKSTRESS), "monotonic tension does not tell these apart"


def test_two_terms_that_help_only_together_are_found_as_a_pair(tmp_path: Path) -> None:
    """A plateau, and a fast backstress that bends the line before it: each alone takes little."""
    law = {"yield_plateau.share": 1.0, "yield_plateau.length": 0.013, "backstress_first.C": 200e3, "backstress_first.gamma": 3000.0}
    study = study_of(tmp_path, diagnosis={"max_effects": 2})
    found = looped(study, (pulled_record("p", 1e-3, 293.0, 3, 1.0, samples=80, **law),), tmp_path)
    assert "yield_plateau" in found.rounds[0].accepted and set(found.rounds[0].accepted) & BACKSTRESS
    singles = [t for t in found.rounds[0].trials if len(t.effects) == 1 and not t.refused]
    pair = next(t for t in found.rounds[0].trials if t.effects == found.rounds[0].accepted)
    assert all(pair.gain > t.gain for t in singles)
    assert float(np.sqrt(np.mean(found.last.columns.residual**2))) < 1.2


@pytest.mark.parametrize("unloads", [True, False])
def test_a_modulus_that_no_elastic_range_tells_is_fitted_where_unloadings_tell_it(tmp_path: Path, unloads: bool) -> None:
    """Samples 1 % of strain apart: the first one flows already. A start of E is no prescription; monotonic flow alone leaves it there."""
    up = np.concatenate([[0.0], np.linspace(0.01, 0.08, 8)])
    path = np.concatenate([up, np.linspace(0.08, 0.0785, 6)[1:], np.linspace(0.079, 0.12, 6)]) if unloads else np.linspace(0.0, 0.12, 13)
    study, test = study_of(tmp_path), followed_record("p", path, 1e-3, 293.15, 1, 1.0)
    experiment = CouponExperiment(study, given=CouponData((test,), "strain"))
    assert "E" not in experiment.joint_settings().free
    assert ("E" in experiment.widened(experiment.start()).free) is unloads


def test_what_cannot_be_run_at_all_is_said_and_is_no_trusted_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every run with a second hardening fails: the others are judged as before, and the record names it."""

    def failing(case: Case, effect: Effect, values: dict[str, float]) -> np.ndarray:
        if effect.name == "second_hardening":
            raise NumericsError("no equilibrium at 3 s")
        return columns_of(case, effect, values)

    def without(case: Case, *fit: FitResult | None) -> Any:
        found = true(case, *fit)
        found.dormant.pop("second_hardening", None)
        found.failed["second_hardening"] = "no equilibrium at 3 s"
        return found

    true = trace.linearised
    monkeypatch.setattr(trace, "columns_of", failing)
    monkeypatch.setattr(trace, "linearised", without)
    found = looped(study_of(tmp_path, **ONE), (pulled_record("p", 1e-3, 293.0, 3, 2.0),), tmp_path)
    assert found.unjudged == {"second_hardening": "no equilibrium at 3 s"}
    assert "second_hardening" not in {s.effect for s in found.first.ranking.scores} and len(found.first.ranking.scores) > 3


def test_a_block_on_which_a_parameter_rests_is_never_held_out() -> None:
    """One record of 100 samples; the second parameter is told by sample 41 alone."""
    rows = Rows(np.zeros(100, dtype=int), np.arange(100.0), np.zeros((100, 2)), np.zeros(100, dtype=int))
    fitted = np.stack([np.ones(100), (np.arange(100) == 41).astype(float)], axis=1)
    free, held = (split_by_blocks(rows, (25, 1), (0.0, 0.0), fitted=f) for f in (None, fitted))
    assert any(out[41] for out in free.held_out) and not any(out[41] for out in held.held_out)
    assert sum(int(out.sum()) for out in held.held_out) >= 92 and "1 of 25 blocks never held out" in held.by


@pytest.mark.parametrize("jumps", [False, True], ids=["drift", "jump"])
def test_a_rate_that_drifts_with_the_strain_takes_no_rate_effect(tmp_path: Path, jumps: bool) -> None:
    """Its hardening rises and falls again in the middle, as nothing of the catalogue does, and so does the rate of its machine: a law of
    the rate would explain it to the noise. A logarithm of the rate that is there is found where the rate jumps."""
    bar = drifting_record(
        "bar", 2, 1.0, jump=3.7 if jumps else 1.0, bump=0.0 if jumps else 23.0, **({"rate_logarithmic.C": 0.0137} if jumps else {})
    )
    found = looped(study_of(tmp_path), (bar,), tmp_path)
    tried = {n for r in found.rounds for t in r.trials for n in t.effects}
    assert bool(RATE & set(found.accepted)) is jumps and bool(RATE & tried) is jumps
    if not jumps:
        assert float(np.sqrt(np.mean(found.first.columns.residual**2))) > 2.0, "something is missing"


@pytest.mark.parametrize(("strain", "power", "cools"), [(0.083, 1.2, True), (0.21, 1.5, False)])
def test_flow_that_would_take_up_heat_is_no_stored_energy(tmp_path: Path, strain: float, power: float, cools: bool) -> None:
    """A coolant takes more than flow releases; the share that is stored would explain it, were it more than all. A share below one may."""
    start = {"E": [190e3, 1e5, 3e5], "M_y0": [300.0, 50.0, 1500.0], "M_yinf": [480.0, 100.0, 3000.0], "H_exp": [25.0, 0.1, 500.0]}
    free = {**start, "beta": [0.85, 0.3, 1.0]}
    study = study_of(
        tmp_path,
        parameters={
            **{name: TRUTH[name] for name in ("nu", "alpha_exp", "c0", "tau")},
            **{name: {"start": value, "bounds": bounds} for name, (value, *bounds) in free.items()},
        },
        stages={"elastic": {"free": ["E"]}, "plastic": {"free": ["M_y0", "M_yinf", "H_exp"]}, "thermal": {"free": ["beta"]}},
        **ONE,
    )
    found = looped(study, (cooled_record("a", 5, strain, power, 1.0),), tmp_path)
    (trial,) = [t for t in found.rounds[0].trials if t.effects == ("stored_energy",)]
    assert trial.gain > 0.9 and ("flow would take up heat" in trial.refused) is cools
    assert ("stored_energy" in found.accepted) is not cools
