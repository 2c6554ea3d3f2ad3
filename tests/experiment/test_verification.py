"""The verdict and what it rests on, without a run of the model."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.experiment.body_check import followed_points, moments
from thermofit.experiment.fields import LoadSteps
from thermofit.experiment.residuals import ResidualField, Span
from thermofit.experiment.trust import PHASE, WHOLE
from thermofit.experiment.verification import channel_table, judge, phase_table

SPANS = (Span("elastic", 0.0, 10.0), Span("loading", 10.0, 20.0))
TIME = np.arange(1.0, 21.0)


def channel(name: str, elastic: float, loading: float) -> ResidualField:
    """Residuals of alternating sign, so many times the noise in both phases."""
    size = np.where(TIME <= 10.0, elastic, loading) * (-1.0) ** np.arange(20)
    value = 2e-3 * np.repeat(size[:, None, None], 3, axis=1)
    return ResidualField(name, "mm", TIME, value, np.full(value.shape, 2e-3), np.zeros(value.shape))


def test_noise_is_verified_and_information_is_not_judged() -> None:
    fields = (channel("du", 1.0, 1.0), channel("u", 90.0, 90.0))
    rows = phase_table(fields, SPANS)
    found = judge(fields, rows)
    assert found.line == "verified: du 1.00 times the noise" and found.outside == () and found.within == ("du",)
    assert [row["channel"] for row in rows] == ["du", "du"] and not channel_table(fields)["u"]["judged"]


def test_what_stands_out_is_named_with_its_phase_and_size() -> None:
    fields = (channel("du", 1.0, 1.0), channel("dtheta", 1.0, 4.0))
    found = judge(fields, phase_table(fields, SPANS))
    assert found.outside == ("dtheta",) and found.within == ("du",)
    assert found.line.startswith("not verified: dtheta is 2.9 times its noise") and "most in loading (4 times)" in found.line


@pytest.mark.parametrize(("size", "outside"), [(WHOLE - 1e-3, ()), (WHOLE + 1e-3, ("du",))])
def test_limit(size: float, outside: tuple[str, ...]) -> None:
    fields = (channel("du", size, size),)
    assert judge(fields, phase_table(fields, SPANS)).outside == outside


def test_one_phase_that_stands_out_is_not_verified_though_the_channel_as_a_whole_does_not() -> None:
    """30 values in a phase: chance alone goes beyond PHASE by little."""
    for size, outside in ((PHASE, ()), (1.7, ("du",))):
        fields = (channel("du", size, 0.5),)
        found = judge(fields, phase_table(fields, SPANS))
        assert found.outside == outside
    assert found.line == "not verified: du is 1.3 times its noise (rms 0.00251 mm, noise 0.002), most in elastic (1.7 times)"


def test_moments_of_a_test() -> None:
    spans = (Span("rest", 0.0, 1.0), Span("elastic", 1.0, 2.0), Span("loading 1", 2.0, 4.0), Span("unloading 1", 4.0, 5.0),
             Span("loading 2", 5.0, 7.0), Span("unloading 2", 7.0, 8.0), Span("cooling", 8.0, 9.0))  # fmt: skip
    steps = LoadSteps(np.arange(10.0), np.array([0.0, 0.0, 3.0, 4.0, 5.0, 1.0, 4.0, 6.0, 0.0, 0.0]))
    assert [(m.name, m.time) for m in moments(spans, steps)] == [
        ("end of elastic range", 2.0), ("largest force", 7.0), ("end of unloading", 8.0), ("end", 9.0),
    ]  # fmt: skip
    # Elastic loading only: the largest force comes at its end, and nothing is shown twice.
    assert [m.name for m in moments(spans[:2], LoadSteps(np.arange(3.0), np.array([0.0, 0.0, 3.0])))] == ["end of elastic range"]


def test_followed_points_are_on_the_axis_and_observed() -> None:
    xy = np.array([[0.0, -20.0], [0.0, 0.0], [5.0, 0.0], [0.0, 20.0], [4.0, 20.0]])
    assert followed_points(xy, np.array([9, 9, 9, 9, 9])).tolist() == [0, 1, 3]
    assert followed_points(xy, np.array([9, 2, 9, 9, 9])).tolist() == [0, 2, 3]
