"""At which rates and temperatures the specimens of coupon records flow, as measured: what can tell effects of rate and temperature.

A record is cut where its strain turns, and each branch into windows in which the strain changes by so much more than its noise that the
rate is told. Windows count in which the model flows on the measured strain; in a hold that follows flow the rate is zero, because the
material could relax there. No declared number takes part but the clock of a record that has none of its own.

Rates tell an effect of the rate only where they differ at the same plastic strain since the flow last turned: in records at several
rates, where the rate of one record jumps, in a hold. A rate that drifts along with the strain, as under a crosshead, is a function of the
strain, and a law of the rate could stand in for any hardening.
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
KNEE = 0.002
"""Plastic strain after yield, the first one and that after each unloading, within which rates do not count: the offset by which yield
stresses are told. Between elastic and plastic deformation a machine changes its rate by itself, and always at the same strain."""
ROUND = 0.25
"""Share of the strain of a branch before the next turn within which rates do not count: a machine slows down before it turns. Up to there
a sine keeps two thirds of its largest rate."""
SMOOTH = 1.25
"""Plastic strains within this factor are the same one. Over it a rate that grows with the third power of the strain stays within
`ONE_RATE`; what changes faster is a jump."""
_PLACES = 8
"""Strains per factor of `SMOOTH` from which rates are compared."""
_LEAST = 2
"""Rows of a window at least: what one window shows alone is no rate of a record at a strain."""
_STILL = 1e-3
"""Share of the largest rate of a record below which a window is a hold."""
_PLAIN, _NOISY = 20.0, 5.0
"""Change of the strain in a window, in its noise: what tells its rate to a tenth, and below which it is a hold."""
_MOST = 200
"""Windows of a branch at most."""


@dataclass(frozen=True)
class FlowConditions:
    """Lowest and highest rate in 1/s, and temperature in K, of the rows at which the specimens flow, without the tails; `rows` of them.

    `apart`: largest ratio of the rates at the same plastic strain since the flow last turned; infinite where a hold is among them.
    """

    rates: tuple[float, float]
    temperatures: tuple[float, float]
    rows: int
    apart: float

    @property
    def one_rate(self) -> bool:
        """True where the rates at every plastic strain lie within a factor of `ONE_RATE`."""
        return self.apart <= ONE_RATE

    @property
    def span(self) -> float:
        """K between the coldest and the hottest flow."""
        return self.temperatures[1] - self.temperatures[0]


def flow_conditions(tests: Sequence[CouponTest], run: Callable[[CouponTest], PointHistory]) -> FlowConditions:
    """FlowConditions of records, each row of the same weight; `run` gives the history of the model on the measured strain (or stress).

    Where nothing flows there is one rate, and no span of temperatures.
    """
    rates, strains, temperatures = [], [], []
    for test in tests:
        history = run(test)
        rate, theta = rates_of_flow(test, history), history.theta if test.theta is None else test.theta
        used = np.isfinite(rate)
        rates.append(rate[used])
        strains.append(flow_since_turn(test, history)[used])
        temperatures.append(theta[used & np.isfinite(theta)])
    rate = np.concatenate(rates)
    low, high = _within_tails(rate)
    if low > 0.0:
        apart = by_strain(strains, [np.clip(own, low, high) for own in rates])
    else:
        apart = np.inf if high > 0.0 else 1.0
    return FlowConditions((low, high), _within_tails(np.concatenate(temperatures)), len(rate), apart)


def by_strain(strains: Sequence[np.ndarray], rates: Sequence[np.ndarray]) -> float:
    """Largest ratio of positive rates in 1/s at the same plastic strain since the flow last turned, from `KNEE` on, of records with strains
    (n,), NaN in rows that do not count, and rates (n,); 1 where there are none.

    The same: within `SMOOTH`. Of the rows of a record there the `TAIL` at either end does not count, and where it has more than a window,
    no less than one.
    """
    largest, last = 1.0, max((float(np.nanmax(strain, initial=0.0)) for strain in strains), default=0.0)
    if last < KNEE:
        return largest
    for place in KNEE * SMOOTH ** (np.arange(int(_PLACES * np.log(last / KNEE) / np.log(SMOOTH)) + 1) / _PLACES):
        ends = []
        for strain, rate in zip(strains, rates, strict=True):
            here = np.sort(rate[(strain >= place) & (strain <= SMOOTH * place)])
            cut = min(max(int(TAIL * len(here)), _LEAST), (len(here) - 1) // 2)
            ends += [here[cut], here[-1 - cut]] if len(here) else []
        largest = max(largest, float(max(ends) / min(ends)) if ends else 1.0)
    return largest


def flow_since_turn(test: CouponTest, history: PointHistory) -> np.ndarray:
    """Plastic strain Lambda (n_t,) of a record since its flow last turned, NaN within `KNEE` after yield, and within `ROUND` before
    the strain turns.

    An unloading without reverse flow is no turn of the flow.
    """
    out = np.zeros(len(test.time))
    grown = np.diff(history.accumulated, prepend=history.accumulated[0])
    along = np.diff(test.strain, prepend=test.strain[0])
    start, sense = float(history.accumulated[0]), 0.0
    turns = turning_points(test.time, test.strain).tolist()
    for a, b in pairwise(turns):
        own = slice(a + 1, b + 1)
        now = float(np.sign(np.sum(grown[own] * np.sign(along[own]))))
        if now * sense < 0.0:
            start = float(history.accumulated[a])
        sense = now or sense
        here = history.accumulated[own]
        out[own] = np.where(here - history.accumulated[a] < KNEE, np.nan, here - start)
        if b < turns[-1]:
            branch = abs(float(test.strain[b] - test.strain[a]))
            out[own][np.abs(test.strain[own] - test.strain[b]) < ROUND * branch] = np.nan
    return out


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
    number = int(np.clip(min(_MOST, (b - a) // _LEAST, change / (_PLAIN * test.noise["strain"])), 1, None))
    return list(pairwise(np.unique(np.linspace(a, b, number + 1).astype(int)).tolist()))


def _within_tails(values: np.ndarray) -> tuple[float, float]:
    if not len(values):
        return 0.0, 0.0
    low, high = np.quantile(values, (TAIL, 1.0 - TAIL))
    return float(low), float(high)
