"""Statistics of residuals: known size, known memory, known places; phases named once and complete."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seen_field import case_of

from thermofit.diagnose.trace import traced
from thermofit.experiment.fields import TestPhase
from thermofit.experiment.residuals import (
    ResidualField,
    Span,
    lag_one,
    lag_ones,
    named_phases,
    node_rms,
    residual_field,
    span_of,
    statistics,
    time_rms,
)
from thermofit.observe.comparison import plain, rigid_free, temperature_change
from thermofit.observe.observation import FieldObservation
from thermofit.report.findings import lack_of_fit

RNG = np.random.default_rng(11)
X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 6), np.linspace(-20.0, 20.0, 9))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)


def field(value: np.ndarray, sigma: float = 1.0, shared: float = 0.0) -> ResidualField:
    return ResidualField("u", "mm", np.arange(len(value), dtype=float), value, np.full(value.shape, sigma), np.full(value.shape, shared))


def observation(n_components: int, n_t: int = 40) -> FieldObservation:
    shape = (n_t, len(XY), n_components)
    mask = np.ones(shape[:2], dtype=bool)
    mask[3, 5] = mask[7, :4] = False
    value, sigma = RNG.normal(size=shape), np.broadcast_to(np.linspace(0.5, 2.0, len(XY))[None, :, None], shape).copy()
    value[~mask], sigma[~mask] = np.nan, np.nan
    name, unit = ("theta", "K") if n_components == 1 else ("u", "mm")
    return FieldObservation(name, np.arange(n_t, dtype=float), XY, value, sigma, mask, unit)


def test_residual_goes_back_to_its_place() -> None:
    seen = observation(2)
    error = RNG.normal(size=seen.value.shape)
    found = residual_field(plain(seen), error, seen)
    np.testing.assert_array_equal(np.isfinite(found.value[:, :, 0]), seen.mask)
    np.testing.assert_allclose(found.value[seen.mask], error[seen.mask], rtol=1e-12)
    np.testing.assert_allclose(found.normalised[seen.mask], error[seen.mask] / seen.sigma[seen.mask])
    np.testing.assert_allclose(found.component(1).value[seen.mask][:, 0], error[seen.mask][:, 1])
    assert found.component(1).channel == "u_y"


def test_weights_do_not_change_the_error() -> None:
    """The weight of an objective is no noise: statistics refer to sigma whatever the weight."""
    seen = observation(2)
    error = RNG.normal(size=seen.value.shape)
    by_sigma = residual_field(plain(seen), error, seen)
    by_hand = residual_field(plain(seen, (4.0, 9.0)), error, seen)
    np.testing.assert_allclose(by_hand.value, by_sigma.value)
    np.testing.assert_allclose(by_hand.sigma, by_sigma.sigma)


def test_rigid_motion_leaves_no_residual() -> None:
    seen = observation(2)
    turn = 1e-3 * np.stack([-(XY[:, 1] + seen.value[:, :, 1]), XY[:, 0] + seen.value[:, :, 0]], axis=2)
    found = residual_field(rigid_free(seen), turn + np.array([0.3, -0.2]), seen)
    assert found.channel == "du" and np.nanmax(np.abs(found.value)) < 1e-12


def test_memory_of_the_reference_is_that_of_its_noise() -> None:
    """White noise in every frame: what dtheta remembers is the noise of its reference, and lag1_noise says so."""
    seen = observation(1, 400)
    before = seen.time < 2.5
    error = np.where(seen.mask[:, :, None], seen.sigma * RNG.normal(size=seen.value.shape), np.nan)
    found = residual_field(temperature_change(seen, before), error, seen)
    s = statistics(found)
    assert s is not None and s.lag1 is not None
    assert s.lag1_noise == pytest.approx(0.25, abs=1e-9)
    assert s.lag1 == pytest.approx(0.25, abs=0.08)
    assert s.chi2_reduced == pytest.approx(1.0, abs=0.1)
    assert not np.isfinite(found.value[before]).any()


def test_statistics_of_known_values() -> None:
    value = np.array([[[3.0], [np.nan]], [[-3.0], [1.0]], [[3.0], [1.0]]])
    s = statistics(field(value, sigma=2.0))
    assert s is not None and s.n == 5
    assert s.mean == pytest.approx(1.0) and s.rms == pytest.approx(np.sqrt(29.0 / 5.0)) and s.floor_rms == 2.0
    assert s.chi2_reduced == pytest.approx(29.0 / 20.0) and s.over_floor == pytest.approx(np.sqrt(29.0 / 20.0))
    # Pairs: (3, -3), (-3, 3), (1, 1) -> (-9 - 9 + 1) / sqrt(19 * 19)
    assert s.lag1 == pytest.approx(-17.0 / 19.0) and s.lag1_noise == 0.0
    assert statistics(field(np.full((2, 2, 1), np.nan))) is None
    assert lag_one(field(value[:1])) == (None, None)


@given(st.floats(-0.95, 0.95))
def test_lag_one_finds_the_memory_of_a_process(rho: float) -> None:
    noise = np.random.default_rng(5).normal(size=(600, 20, 1))
    z = np.empty_like(noise)
    z[0] = noise[0]
    for n in range(1, len(z)):
        z[n] = rho * z[n - 1] + np.sqrt(1.0 - rho**2) * noise[n]
    found, _ = lag_one(field(z))
    assert found == pytest.approx(rho, abs=0.05)


def test_constant_misfit_counts_as_memory() -> None:
    found, _ = lag_one(field(np.full((10, 3, 1), 0.7)))
    assert found == pytest.approx(1.0)
    assert lag_one(field(np.zeros((4, 3, 1)))) == (None, 0.0)


def test_maps_over_points_and_times() -> None:
    value = RNG.normal(size=(5, 4, 2))
    value[:, 2] = np.nan
    value[3] = np.nan
    by_node, by_time = node_rms(field(value, 2.0)), time_rms(field(value, 2.0))
    assert np.isnan(by_node[2]).all() and np.isnan(by_time[3])
    np.testing.assert_allclose(by_node[0], np.sqrt(np.nanmean((value[:, 0] / 2.0) ** 2, axis=0)))
    np.testing.assert_allclose(by_time[4], np.sqrt(np.nanmean((value[4] / 2.0) ** 2)))


def test_phases_are_merged_and_numbered() -> None:
    labels = ["rest", "elastic", "loading", "loading", "unloading", "loading", "unloading", "cooling"]
    phases = [TestPhase(float(n), float(n + 1), label) for n, label in enumerate(labels)]
    spans = named_phases(phases)
    assert [span.name for span in spans] == ["rest", "elastic", "loading 1", "unloading 1", "loading 2", "unloading 2", "cooling"]
    assert (spans[2].t0, spans[2].t1) == (2.0, 4.0)


@given(st.lists(st.sampled_from(["rest", "elastic", "loading", "unloading", "hold", "cooling"]), min_size=1, max_size=12))
def test_phases_cover_the_test_without_gap(labels: list[str]) -> None:
    spans = named_phases([TestPhase(float(n), float(n + 1), label) for n, label in enumerate(labels)])
    assert spans[0].t0 == 0.0 and spans[-1].t1 == len(labels)
    assert all(a.t1 == b.t0 for a, b in itertools.pairwise(spans))
    assert len({span.name for span in spans}) == len(spans)
    times = np.linspace(-1.0, len(labels) + 1.0, 50)
    index = span_of(times, spans)
    assert index.min() == 0 and index.max() == len(spans) - 1
    inside = (times > 0.0) & (times <= len(labels))
    assert all(spans[i].t0 < t <= spans[i].t1 for t, i in zip(times[inside], index[inside], strict=True))


def test_a_time_at_a_boundary_belongs_to_the_phase_that_ends_there() -> None:
    spans = (Span("rest", 0.0, 3.0), Span("elastic", 3.0, 7.0))
    assert span_of(np.array([0.0, 3.0, 3.1, 9.0]), spans).tolist() == [0, 0, 1, 1]


def test_lags_of_a_planted_ar_1_in_time_and_space() -> None:
    """Separable: rho^|i - j| over times and over points of a line; a hole in the record breaks pairs, and adds none."""
    in_time, in_space, n_t, n_s = 0.6, 0.35, 400, 80
    roots = [
        np.linalg.cholesky(rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))) for rho, n in ((in_time, n_t), (in_space, n_s))
    ]
    z = (roots[0] @ np.random.default_rng(4).normal(size=(n_t, n_s)) @ roots[1].T)[:, :, None]
    z[100:140] = np.nan
    order = np.random.default_rng(5).permutation(n_s)
    xy = np.stack([np.zeros(n_s), np.arange(n_s, dtype=float)], axis=1)
    for points in (np.arange(n_s), order):  # neighbours by place, not by number
        assert lag_ones(z[:, points], xy[points]) == pytest.approx((in_time, in_space), abs=0.03)
    assert lag_ones(z[:, :1], xy[:1])[1] is None and lag_ones(z[:1], xy)[0] is None


def test_the_lack_of_fit_tells_memory_phase_by_phase() -> None:
    """White in the first phase, one value for all times of a point in the second."""
    here = traced(case_of(1))
    random = np.random.default_rng(2)
    white = random.normal(size=len(here.rows.time))
    still = np.tile(random.normal(size=30), 80)
    residual = np.where(here.rows.phase == 0, white, still)
    rows = lack_of_fit(replace(here, columns=replace(here.columns, residual=residual)))
    first, second = ((row["lag_one_time"], row["lag_one_space"]) for row in rows)
    assert first == pytest.approx((0.0, 0.0), abs=0.1) and second[0] == pytest.approx(1.0) and abs(second[1]) < 0.5
