"""A one-way stage takes its mechanics from parameters that it does not know yet: the answer must not depend on them."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import tiny

from thermofit.identify import solve
from thermofit.study.study import Study

StudyOf = Callable[..., Study]
FAR = ("parameters.alpha_exp.start=45.0e-6", "parameters.c0.start=5.0", "parameters.beta.start=0.3")


def thermal(study: Study) -> dict[str, tuple[float, float]]:
    record = tiny.stage_run("identify-thermal")(study, force=True).record
    return {name: (p.value, p.sigma_noise or 0.0) for name, p in record.parameters.items() if p.free}


def distance(study_of: StudyOf) -> float:
    """Largest distance in standard errors of noise of the optima from the usual start and from one far off."""
    near, far = thermal(study_of()), thermal(study_of(*FAR))
    return max(abs(far[name][0] - value) / sigma for name, (value, sigma) in near.items())


def test_optimum_does_not_depend_on_where_the_mechanics_was_solved(study_of: StudyOf) -> None:
    assert distance(study_of) < 0.3


def test_without_solving_the_mechanics_anew_it_does(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solve, "TURNS", 1)
    assert distance(study_of) > 2.0


def test_what_has_not_settled_is_said(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solve, "TURNS", 2)
    record = tiny.stage_run("identify-thermal")(study_of(*FAR), force=True).record
    assert any("has not settled" in remark for remark in record.summary["remarks"])


def test_forward_runs_of_all_turns_are_counted(study_of: StudyOf) -> None:
    study = study_of()
    record = tiny.stage_run("identify-thermal")(study, force=True).record
    assert record.summary["evaluations"]["forward"] > len(record["evaluations/f"].value)
    assert not list(study.run_dir.glob(".identify-thermal.*"))
