"""The verdict on several starts, on the tables of the thesis and on made-up ones."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.identify.uniqueness import constant_ratios, relation_along, relative_spread, uniqueness

FOUR = ("alpha_exp", "kappa", "c0", "beta")
TABLE_5_10 = np.array([[28.74, 99.32, 3.68, 1.13], [37.06, 128.15, 4.68, 1.46], [30.57, 105.65, 3.90, 1.21], [18.97, 65.49, 2.46, 0.75]])
TABLE_5_19 = np.array(
    [
        [20.21, 133.45, 2.22, 0.79, 14.72, 236.30],
        [20.21, 133.41, 2.22, 0.79, 14.73, 236.04],
        [20.20, 133.32, 2.21, 0.79, 14.75, 234.92],
        [20.20, 133.37, 2.22, 0.79, 14.73, 236.46],
    ]
)
ALL = np.ones(4, dtype=bool)


def test_table_5_19_is_one_optimum() -> None:
    found = uniqueness((*FOUR, "alpha_air", "alpha_clamp"), TABLE_5_19, np.full(4, 14.97), ALL)
    assert found.kind == "unique" and found.groups == (1, 1, 1, 1)
    assert found.text == "unique: one optimum, 4 of 4 starts converge and agree within 0.65 % (alpha_clamp)"
    assert found.spread["alpha_clamp"] == pytest.approx(1.54 / 236.30) and found.spread["beta"] == 0.0


def test_table_5_10_is_a_valley_with_constant_ratios() -> None:
    found = uniqueness(FOUR, TABLE_5_10, np.full(4, 8.76), ALL)
    assert found.kind == "valley"
    # Whichever parameter is the reference, the other three keep their ratio to it; beta is printed with two digits only.
    assert list(found.ratios) == ["alpha_exp/beta", "kappa/beta", "c0/beta"] and max(r.spread for r in found.ratios.values()) < 0.03
    assert found.ratios["kappa/beta"].value == pytest.approx(87.5, rel=0.01)
    # All four in proportion: 1 % of one goes with 1 % of each other one.
    assert found.relation == pytest.approx(dict.fromkeys(FOUR, 1.0), abs=0.05)
    assert "alpha_exp/beta = 25.3" in found.text and "goes with" in found.text
    assert "beta by 63 %" in found.text and "constant within" in found.text


def test_valley_without_constant_ratio() -> None:
    x = np.array([[1.0, 5.0], [2.0, 4.0], [3.0, 3.0]])
    found = uniqueness(("a", "b"), x, np.full(3, 2.0), ALL[:3])
    assert found.kind == "valley" and not found.ratios and "no ratio of them is constant" in found.text


def test_only_the_moving_parameters_make_ratios() -> None:
    t = np.array([1.0, 1.5, 2.0])
    x = np.column_stack([t, 3.0 * t, np.full(3, 7.0)])
    ratios = constant_ratios(("a", "b", "c"), x, relative_spread(x, x[0]))
    assert list(ratios) == ["b/a"] and ratios["b/a"].spread == pytest.approx(0.0, abs=1e-12) and ratios["b/a"].value == pytest.approx(3.0)


def test_relation_along_a_valley_of_another_form() -> None:
    """A constant product is no constant ratio: b falls by 1 % where a rises by 1 %."""
    a = np.array([1.0, 1.5, 2.0, 3.0])
    found = uniqueness(("a", "b", "c"), np.column_stack([a, 6.0 / a, np.full(4, 5.0)]), np.full(4, 2.0), ALL)
    assert found.kind == "valley" and not found.ratios
    assert found.relation["a"] * found.relation["b"] == pytest.approx(-1.0) and found.relation["c"] == pytest.approx(0.0, abs=1e-9)
    x = np.array([[-1.0, 0.5], [1.0, -0.5], [0.0, 0.0]])
    assert relation_along(("a", "b"), x)["b"] / relation_along(("a", "b"), x)["a"] == pytest.approx(-1.0)  # each over its own size


def test_equal_optima_without_a_way_between_them_are_no_valley() -> None:
    """f = (x - 1)^2 (x - 2)^2 style: the curvature at both ends says that the middle lies higher."""
    x, f = np.array([[1.0, 5.0], [2.0, 5.0]]), np.array([3.0, 3.0])
    steep = np.array([np.diag([40.0, 0.1])] * 2)
    found = uniqueness(("a", "b"), x, f, ALL[:2], steep)
    assert found.kind == "several optima" and found.groups == (1, 2) and "several are as good as the lowest" in found.text
    flat = np.array([np.diag([1e-9, 40.0])] * 2)
    assert uniqueness(("a", "b"), x, f, ALL[:2], flat).kind == "valley"
    # A chain of short ways is a way, though the direct one is not.
    bent = np.array([[1.0, 1.0], [1.0, 2.0], [2.0, 2.0]])
    curvature = np.array([np.diag([1e3, 1e-9]), np.diag([1e-9, 1e-9]), np.diag([1e-9, 1e3])])
    assert uniqueness(("a", "b"), bent, np.full(3, 3.0), ALL[:3], curvature).kind == "valley"
    assert uniqueness(("a", "b"), bent[[0, 2]], np.full(2, 3.0), ALL[:2], curvature[[0, 2]]).kind == "several optima"


def test_several_optima_are_counted_and_the_lowest_named_first() -> None:
    x = np.array([[1.0, 2.0], [4.0, 9.0], [1.001, 2.0], [4.0, 9.01]])
    found = uniqueness(("a", "b"), x, np.array([5.0, 3.0, 5.0, 3.0]), ALL)
    assert found.kind == "several optima" and "to 2 optima with f = 3, 5" in found.text
    # The spread is that of the starts near the best one.
    assert found.spread == pytest.approx({"a": 0.0, "b": 0.01 / 9.0}) and found.largest > 0.7


def test_starts_that_did_not_converge_say_nothing() -> None:
    x = np.array([[1.0], [50.0], [np.nan], [1.005]])
    converged = np.array([True, False, False, True])
    f = np.array([2.0, 2.0, np.nan, 2.0])
    assert uniqueness(("a",), x, f, converged).kind == "unique"
    found = uniqueness(("a",), x, f, np.array([True, False, False, False]))
    assert found.kind == "nothing to compare" and found.text.startswith("1 of 4 starts converged")


def test_spread_of_a_parameter_on_a_bound_at_zero() -> None:
    assert relative_spread(np.array([[0.0], [0.0]]), np.array([0.0])) == pytest.approx([0.0])
    assert relative_spread(np.array([[0.0], [0.1]]), np.array([0.0])) == pytest.approx([1.0])


def test_searches_on_ratios_end_in_a_valley_and_one_more_datum_makes_it_unique() -> None:
    """Found, not assumed: least squares from four starts, r a function of alpha_exp/beta, kappa/beta, c0/beta and noise (Table 5.10)."""
    rng = np.random.default_rng(3)
    matrix, noise = rng.normal(size=(60, 3)), 0.01 * rng.normal(size=60)
    truth, scale = np.array([19.83e-6, 189.89, 2.21, 0.81]), np.array([2e-5, 150.0, 2.0, 1.0])

    def ratios(x: np.ndarray) -> np.ndarray:
        return (x[:3] / scale[:3]) / x[3]

    def search(start: np.ndarray, datum: float) -> tuple[np.ndarray, float, np.ndarray]:
        def residual(x: np.ndarray) -> np.ndarray:
            return np.append(matrix @ (ratios(x) - ratios(truth)) + noise, datum * (x[3] - truth[3]))

        fit = minimise(Problem(residual, start, 0.05 * truth, 20.0 * truth, scale, FOUR), "trust-region")
        assert fit.converged and fit.jacobian is not None
        return fit.x, fit.f, fit.jacobian.T @ fit.jacobian

    starts = [truth * factor for factor in ([1.2, 1.0, 1.1, 1.2], [1.2, 1.0, 1.1, 0.3], [0.6, 2.0, 0.5, 0.6], [2.0, 1.0, 2.0, 2.2])]
    for datum, kind in ((0.0, "valley"), (100.0, "unique")):
        x, f, curvature = (np.array(part) for part in zip(*(search(start, datum) for start in starts), strict=True))
        found = uniqueness(FOUR, x, f, ALL, curvature)
        assert found.kind == kind, found.text
        if kind == "valley":
            assert list(found.ratios) == ["alpha_exp/beta", "kappa/beta", "c0/beta"]
            assert max(ratio.spread for ratio in found.ratios.values()) < 0.01
            assert found.relation == pytest.approx(dict.fromkeys(FOUR, 1.0), abs=0.01)
        else:
            assert found.largest < 1e-3
