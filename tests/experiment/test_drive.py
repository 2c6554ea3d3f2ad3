"""When the motion of sections drives a specimen instead of its force, and what it does to the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_up import TRUTH, uniaxial_test
from scipy.optimize import least_squares

from thermofit.core.errors import NumericsError
from thermofit.experiment.drive import FLAT, carried, elongation_modes, last_growth, near_maximum, with_driven_force, with_force_channel
from thermofit.experiment.fields import Measured, Stretched
from thermofit.experiment.start import mean_strain
from thermofit.observe.end_motion import Gauge
from thermofit.study.stages import ElasticStage, PlasticStage, ThermalStage

LENGTH = 40.0


def pulled(last: float) -> Measured:
    """A uniaxial test up to Lambda = `last`, with the elongation of 40 mm and its error of 7 N of force."""
    data = uniaxial_test(last=last)
    e = LENGTH * mean_strain(data.displacement, 1)
    gauge = Gauge(np.array([[0.0, -20.0], [0.0, 20.0]]), np.array([-1.0, 1.0]))
    return replace(data, gauge=gauge, stretched=Stretched(data.displacement.time, e, np.full(len(e), 7.0)))


def growth(multiplier: float) -> float:
    """d ln F / d ln lambda = (dM/dLambda / r) / M - 1 of rigid plastic flow."""
    r = np.sqrt(TRUTH["F"] + TRUTH["H"])
    rest = (TRUTH["M_yinf"] - TRUTH["M_y0"]) * np.exp(-TRUTH["H_exp"] * multiplier)
    return float(TRUTH["H_exp"] * rest / (r * (TRUTH["M_yinf"] - rest)) - 1.0)


@pytest.mark.parametrize("last", [0.06, 0.14, 0.3])
def test_growth_of_the_force_is_considere(last: float) -> None:
    found = last_growth(pulled(last))
    assert found is not None and growth(last) < found < growth(0.88 * last)


def test_a_force_that_hardly_grows_or_falls_does_not_drive() -> None:
    assert near_maximum(pulled(0.06)) == ""
    assert "falls" in near_maximum(pulled(0.3))
    assert near_maximum(replace(pulled(0.3), stretched=None)) == ""


def test_the_error_of_the_elongation_is_one_of_the_force_and_counted_once() -> None:
    data = pulled(0.06)
    once = with_driven_force(data)
    assert once.force.sigma.ravel() == pytest.approx(np.full(len(data.force.time), np.hypot(4.0, 7.0)))
    assert np.array_equal(with_driven_force(once).force.sigma, once.force.sigma)
    assert once.steps["all"].error is None, "no noise of the elongation is known"


def test_every_stage_errs_on_its_own() -> None:
    """From when loading has begun, for until then the specimen rests."""
    data = pulled(0.06)
    seen = data.stretched
    assert seen is not None
    driven = with_driven_force(replace(data, stretched=replace(seen, noise=3e-4)))
    for steps in driven.steps.values():
        assert steps.error is not None
        variance = np.interp(seen.time, steps.time, np.sum(steps.error**2, axis=1))
        assert np.allclose(variance[seen.time > data.load_start + 1e-6], 9e-8) and not variance[seen.time <= data.load_start].any()
    middle = 0.5 * (seen.time[5] + seen.time[6])
    halfway = elongation_modes(replace(seen, noise=3e-4), np.array([middle]), data.load_start)
    assert sorted(halfway[0])[-3:] == pytest.approx([0.0, 1.5e-4, 1.5e-4]), "it dies away to the next stage"
    assert with_driven_force(driven) is driven


def test_the_force_joins_the_displacements_and_nothing_else() -> None:
    assert list(with_force_channel(PlasticStage()).channels) == ["du", "force"]
    assert list(with_force_channel(ElasticStage.model_validate({"channels": {"stress": {}, "du": {}}})).channels) == ["stress", "du"]
    assert list(with_force_channel(ThermalStage()).channels) == ["dtheta"]


def test_what_fails_is_tried_once_more_in_the_other_drive() -> None:
    other = SimpleNamespace(sections="the sections y = -20 and 20 mm", by_sections=None)
    first: Any = SimpleNamespace(by_sections=other)

    def attempt(experiment: Any) -> str:
        if experiment is first:
            raise NumericsError("time step to t = 3 s failed")
        return "done"

    driven, answer, said = carried(first, attempt)
    assert (driven, answer) == (other, "done")
    assert "the sections y = -20 and 20 mm" in said and "time step to t = 3 s failed" in said
    first.by_sections = None
    with pytest.raises(NumericsError, match="time step"):
        carried(first, attempt)


STRAIN = np.linspace(0.0, 1.0, 2001)


def curves(count: int) -> Iterator[tuple[np.random.Generator, np.ndarray]]:
    """Flow curves of random materials, MPa over STRAIN (logarithmic), that neck between 3 and 90 %: Voce's with and without a linear term,
    Swift's, and two of Voce's together; with the generator that drew them."""
    random = np.random.default_rng(22)
    made = 0
    while made < count:
        y, kind = random.uniform(80.0, 400.0), random.integers(4)
        if kind < 2:
            high, rate, slope = random.uniform(1.3, 3.5) * y, random.uniform(4.0, 40.0), kind * random.uniform(0.2, 1.5) * y
            flow = y + (high - y) * -np.expm1(-rate * STRAIN) + slope * STRAIN
        elif kind == 2:
            flow = y * (1.0 + STRAIN / random.uniform(1e-3, 0.02)) ** random.uniform(0.08, 0.3)
        else:
            sizes, rates = (0.3 * y, random.uniform(0.3, 1.5) * y), (random.uniform(50.0, 200.0), random.uniform(3.0, 20.0))
            flow = y + sum(q * -np.expm1(-b * STRAIN) for q, b in zip(sizes, rates, strict=True))
        if 0.03 < STRAIN[np.argmax(np.log(flow) - STRAIN)] < 0.9:
            made += 1
            yield random, flow


def headroom(flow: np.ndarray, growth: float) -> float:
    """Share by which the force can still rise where it grows at that rate."""
    force = np.log(flow) - STRAIN
    top = int(np.argmax(force))
    here = np.flatnonzero(np.gradient(force, STRAIN)[:top] > growth)
    return float(force[top] - force[here[-1]]) if len(here) else np.nan


def missed(random: np.random.Generator, flow: np.ndarray) -> float:
    """Share by which Voce's curve, fitted to a material with steps of the rate and self-heating, misses its stress at the end."""
    top = int(np.argmax(np.log(flow) - STRAIN))
    end = max(int(random.uniform(0.15, 0.98) * top), 8)
    strain, steps = STRAIN[:end], np.repeat(random.choice([0.1, 1.0, 10.0], 4), -(-end // 4))[:end]
    warmed = np.cumsum(flow[:end]) * STRAIN[1] * random.uniform(0.3, 0.9) / 2.4
    softens = random.choice([0.0, random.uniform(2e-4, 1e-3)])
    stress = flow[:end] * (1.0 + random.choice([0.0, random.uniform(2e-3, 0.015)]) * np.log(steps)) * (1.0 - softens * warmed)

    def error(p: np.ndarray) -> np.ndarray:
        return np.asarray((p[0] + (p[1] - p[0]) * -np.expm1(-p[2] * strain)) / stress - 1.0)

    start = np.array([stress[0], 1.1 * stress[-1], 10.0])
    found = least_squares(error, start, x_scale=start, bounds=([0.0, 0.0, 0.1], np.inf), max_nfev=60)
    return float(abs(error(found.x)[-1]))


def test_below_the_threshold_a_law_that_lacks_something_misses_more_than_the_specimen_could_still_carry() -> None:
    """Materials and what they lack are drawn: at the threshold the median headroom is what the better quarter to half of the fits keep."""
    drawn = list(curves(120))
    rooms = np.array([headroom(flow, FLAT) for _, flow in drawn])
    errors = np.array([missed(random, flow) for random, flow in drawn])
    errors = errors[errors > 5e-4]
    room, (quarter, half) = float(np.nanmedian(rooms)), np.quantile(errors, [0.2, 0.5])
    assert 0.002 < room < 0.005 and quarter < room < half
    g, rate = 0.3, 12.0  # Considere's curvature is that of Voce's curve
    voce = 100.0 + 200.0 * -np.expm1(-rate * STRAIN)
    assert headroom(voce, g) == pytest.approx(g**2 / (2.0 * (1.0 + 0.5 * g) * (1.0 + 0.5 * g + rate)), rel=0.1)


@pytest.mark.parametrize("every", [4, 5])
def test_where_stages_are_rare_those_before_the_last_tenth_tell_the_growth(every: int) -> None:
    """Two or three stages in the last tenth of the elongation; four tell as well how the force grows."""
    data = pulled(0.3)
    assert data.stretched is not None
    kept = np.arange(len(data.stretched.time) - 1, -1, -every)[::-1]
    own = data.stretched
    rare = replace(data, stretched=replace(own, time=own.time[kept], elongation=own.elongation[kept], force_error=own.force_error[kept]))
    assert np.sum(rare.stretched.elongation >= 0.9 * rare.stretched.elongation[-1]) < 4  # type: ignore[union-attr]
    found, all_of_them = last_growth(rare), last_growth(data)
    assert found is not None and all_of_them is not None and growth(0.3) < found < growth(0.5 * 0.3)
    assert "falls" in near_maximum(rare)


def test_stages_of_the_first_half_say_nothing_of_the_end() -> None:
    data = pulled(0.3)
    assert data.stretched is not None
    own, n = data.stretched, len(data.stretched.time)
    kept = np.array([0, 1, 12, 18, n - 2, n - 1])
    rare = replace(data, stretched=replace(own, time=own.time[kept], elongation=own.elongation[kept], force_error=own.force_error[kept]))
    assert last_growth(rare) is None
