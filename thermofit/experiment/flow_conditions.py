"""At which rates and temperatures the specimens of coupon records flow, as measured: what can tell effects of rate and temperature.

A record is cut where its strain turns, and each branch into windows in which the strain changes by so much more than its noise that the
rate is told. Windows count in which the model flows on the measured strain; in a hold that follows flow the rate is zero, because the
material could relax there. No declared number takes part but the clock of a record that has none of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from thermofit.experiment.coupon_records import CouponTest
from thermofit.point.driver import PointHistory
from thermofit.read.coupon_phases import turning_points

TAIL = 0.05
"""Share of the rows at either end that does not count: what fewer rows show, no held-out block of a fifth of the record can judge."""
ONE_RATE = 2.0
"""Rates within this factor are one rate. A sensitivity of 1 % per e-fold, as of metals, moves the stress by 0.7 % over it, which any
hardening term takes up; and a change of rate within a record is told from its noise only from there on."""
_STILL = 1e-3
"""Share of the largest rate of a record below which a window is a hold."""
_PLAIN, _NOISY = 20.0, 5.0
"""Change of the strain in a window, in its noise: what tells its rate to a tenth, and below which it is a hold."""
_MOST = 200
"""Windows of a branch at most."""


@dataclass(frozen=True)
class FlowConditions:
    """Lowest and highest rate in 1/s, and temperature in K, of the rows at which the specimens flow, without the tails; `rows` of them."""

    rates: tuple[float, float]
    temperatures: tuple[float, float]
    rows: int

    @property
    def one_rate(self) -> bool:
        """True where all rates lie within a factor of `ONE_RATE`."""
        return self.rates[1] <= ONE_RATE * self.rates[0]

    @property
    def span(self) -> float:
        """K between the coldest and the hottest flow."""
        return self.temperatures[1] - self.temperatures[0]


def flow_conditions(tests: Sequence[CouponTest], run: Callable[[CouponTest], PointHistory]) -> FlowConditions:
    """FlowConditions of records, each row of the same weight; `run` gives the history of the model on the measured strain (or stress).

    Where nothing flows there is one rate, and no span of temperatures.
    """
    rates, temperatures = [], []
    for test in tests:
        history = run(test)
        rate, theta = rates_of_flow(test, history), history.theta if test.theta is None else test.theta
        used = np.isfinite(rate)
        rates.append(rate[used])
        temperatures.append(theta[used & np.isfinite(theta)])
    return FlowConditions(_within_tails(np.concatenate(rates)), _within_tails(np.concatenate(temperatures)), sum(map(len, rates)))


def rates_of_flow(test: CouponTest, history: PointHistory) -> np.ndarray:
    """Rate of the strain in 1/s (n_t,) at the rows of a record where its material flows, NaN elsewhere; zero in a hold after flow."""
    out = np.full(len(test.time), np.nan)
    flows = np.append(False, np.diff(history.accumulated) > 0.0)
    windows = [window for a, b in pairwise(turning_points(test.time, test.strain).tolist()) for window in _windows(test, a, b)]
    moved = np.array([abs(float(test.strain[b] - test.strain[a])) for a, b in windows])
    rates = moved / np.array([test.time[b] - test.time[a] for a, b in windows])
    still = (rates <= _STILL * rates.max()) | (moved <= _NOISY * test.noise["strain"])
    yields = False
    for (a, b), rate, rests in zip(windows, rates, still, strict=True):
        own = slice(a + 1, b + 1)
        if not rests:
            yields = bool(flows[own].any())
        if yields:
            out[own] = 0.0 if rests else rate
    return out


def _windows(test: CouponTest, a: int, b: int) -> list[tuple[int, int]]:
    """First and last row of windows of one branch, in which the strain changes by `_PLAIN` times its noise; `_MOST` windows at most."""
    change = abs(float(test.strain[b] - test.strain[a]))
    number = int(np.clip(min(_MOST, (b - a) // 2, change / (_PLAIN * test.noise["strain"])), 1, None))
    return list(pairwise(np.unique(np.linspace(a, b, number + 1).astype(int)).tolist()))


def _within_tails(values: np.ndarray) -> tuple[float, float]:
    if not len(values):
        return 0.0, 0.0
    low, high = np.quantile(values, (TAIL, 1.0 - TAIL))
    return float(low), float(high)
