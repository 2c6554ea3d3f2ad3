"""Over 100 repeats of a coupon test 95 % intervals hold the truth in 90 to 99 of 100 cases, with white and with correlated noise."""

from __future__ import annotations

from pathlib import Path

import pytest
from repeated_coupon import bench, coverage

REPEATS = 100


@pytest.mark.slow
def test_coverage_of_white_noise(tmp_path: Path) -> None:
    found = coverage(bench(tmp_path, 200), 0.0, REPEATS)
    assert set(found) == {"laplace", "bootstrap", "profile"}
    assert all(0.90 <= share <= 0.99 for share in found.values()), found


@pytest.mark.slow
def test_coverage_of_correlated_noise(tmp_path: Path) -> None:
    """Neighbouring samples alike by 0.8: intervals for independent samples would hold the truth far too rarely."""
    found = coverage(bench(tmp_path, 1000), 0.8, REPEATS)
    assert all(0.90 <= share <= 0.99 for share in found.values()), found
