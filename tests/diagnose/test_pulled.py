"""Temperatures pull parameters of the motion: told beside an added heat, where it is more than chance."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.diagnose.loop import Closed
from thermofit.diagnose.pulled import with_pulled
from thermofit.fit.budget import PULLED, Budget
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.result import FitResult

NAMES = ("E", "nu", "beta")
N_U, N_T = 400, 300
RNG = np.random.default_rng(8)
JACOBIAN = np.vstack(
    [RNG.normal(size=(N_U, 3)) * [1.0, 1.0, 0.0], RNG.normal(size=(N_T, 3)) * [1.0, 0.0, 1.0], np.array([[0.0, 0.0, 1.0]])]
)
CHANNEL = np.repeat([0, 1, -1], [N_U, N_T, 1])


def closed(
    pull: float, seed: int = 3, accepted: tuple[str, ...] = ("latent_heat",), at_bound: tuple[int, ...] = (), cheap: bool = False
) -> Closed:
    """A joint fit of E, nu (displacements) and beta, whose temperatures have E off by `pull`; at its optimum."""
    noise = np.random.default_rng(seed).normal(size=len(JACOBIAN))
    wanted = np.where(CHANNEL == 1, pull * JACOBIAN[:, 0], 0.0)
    start = LinearModel(noise - wanted, JACOBIAN)
    residual = start.residual + JACOBIAN @ start.free_step
    model = LinearModel(residual, JACOBIAN)
    held = np.isin(np.arange(3), at_bound)
    spread = model.covariance(NAMES, held)
    spread = replace(spread, matrix=spread.matrix_unit, sigma=spread.sigma_unit)
    made: dict[str, Any] = {
        "names": NAMES,
        "residual": residual,
        "jacobian": JACOBIAN,
        "covariance": spread,
        "sigma": spread.sigma,
        "at_bound": held,
    }
    fit = FitResult(**{f: made.get(f) for f in FitResult.__dataclass_fields__})  # type: ignore[arg-type]
    comparisons = ["du", "dtheta"]
    here: Any = SimpleNamespace(
        case=SimpleNamespace(cheap=cheap, model=SimpleNamespace(comparisons=comparisons)), rows=SimpleNamespace(channel=CHANNEL)
    )
    return Closed((), here, here, fit, accepted, (), None, None, budget=Budget(NAMES, {}, held))  # type: ignore[arg-type]


def test_a_pull_widens_what_is_pulled() -> None:
    before = closed(1.0)
    after = with_pulled(before)
    assert before.fit.sigma is not None and after.fit.sigma is not None and after.budget is not None
    # Displacements have E at 0, temperatures at 1; the joint fit is between them by their numbers of rows.
    rows = N_U / (N_U + N_T)
    assert after.fit.sigma[0] == pytest.approx(1.0 - rows, abs=0.12)
    assert after.fit.sigma[1:] == pytest.approx(before.fit.sigma[1:]) and list(after.budget.parts) == [PULLED]
    assert after.remarks[-1].startswith("temperatures pull E by +0.") and "most of all E +-" in after.remarks[-1]


def test_chance_is_no_pull() -> None:
    pulled = [with_pulled(closed(0.0, seed)).remarks for seed in range(100)]
    assert 1 <= sum(map(bool, pulled)) <= 20, "two standard errors of two parameters: 5 % each, of the difference and not of a sum"


def test_only_beside_an_added_heat_and_not_at_a_bound() -> None:
    for one in (closed(1.0, accepted=("rate_power",)), closed(1.0, accepted=()), closed(1.0, at_bound=(0, 1)), closed(1.0, cheap=True)):
        assert with_pulled(one) is one
    blind = replace(closed(1.0), fit=replace(closed(1.0).fit, covariance=None))
    assert with_pulled(blind) is blind
