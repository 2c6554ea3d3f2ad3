"""The exponent of an effect is looked for with everything else fitted at each of its values."""

from __future__ import annotations

import numpy as np
import pytest

from thermofit.core.parameters import Parameters, param
from thermofit.diagnose.refit import profiled

NAME = "rate_logarithmic.reference"


def searched(best: float, begin: float) -> tuple[Parameters, list[float]]:
    """The search on a bowl in the logarithm with its bottom at `best`, and the values that it tried."""
    tried: list[float] = []

    def at(value: float) -> tuple[float, Parameters]:
        tried.append(value)
        return (np.log10(value) - np.log10(best)) ** 2, Parameters.of({NAME: value})

    return profiled(at, begin, NAME), tried


@pytest.mark.parametrize(("best", "begin"), [(3e-5, 1e-2), (4e-4, 1e-4), (2e-3, 1e-6)])
def test_search_walks_down_the_scan_and_takes_the_vertex(best: float, begin: float) -> None:
    found, tried = searched(best, begin)
    assert found[NAME] == pytest.approx(best, rel=1e-6)
    assert len(tried) == len(set(tried)) <= len(param(NAME).scan) + 1


def test_search_ends_at_the_edge_of_the_scan() -> None:
    assert searched(1e-8, 1e-6)[0][NAME] == pytest.approx(1e-6)


def test_a_value_at_which_the_model_fails_is_passed_over() -> None:
    def at(value: float) -> tuple[float, Parameters]:
        return (float("inf") if value > 1e-3 else abs(np.log(value / 1e-4))), Parameters.of({NAME: value})

    assert profiled(at, 1e-3, NAME)[NAME] == pytest.approx(1e-4)
