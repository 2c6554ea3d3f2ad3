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
ONE_TEMPERATURE = 5.0
"""Kelvins within which temperatures are one. A metal loses about a thousandth of its yield stress per kelvin (Johnson and Cook 1983 with
m = 1 and melting 1000 K above the room), so that they move the stress by half a per cent: no more than rates within `ONE_RATE` do, and what
any hardening term, or another bar, takes up. A sensor on the surface and the declared temperature of a room or a furnace err by as much."""
UNLOADED, _ROWS = 0.25, 5
"""Part of the largest stress so far by which a record unloads without flow, in so many rows at least, for its elasticity after flow to be
told: over less, or in fewer rows, noise and the rounding of the curve make as much of a slope."""
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
    """Lowest and highest rate in 1/s, and told temperature in K, of the rows at which the specimens flow, without the tails; `rows` of
    them.

    `apart`: largest ratio of the rates at the same plastic strain since the flow last turned; infinite where a hold is among them.
    `span`: K, largest difference of the told temperatures at the same plastic strain. Told is what a sensor shows, and else the declared
    temperature at which a record begins. `computed`: K, the most that a record without a sensor heats up while it flows, by the model.
    `elastic`: lowest and highest told temperature in K of the elastic ranges, of a first loading or an unloading after flow; NaN where
    there is none.
    """

    rates: tuple[float, float]
    temperatures: tuple[float, float]
    rows: int
    apart: float
    span: float
    computed: float
    unloads: bool = True
    """Does a record unload after it has flowed: only then its elasticity is seen again."""
    elastic: tuple[float, float] = (np.nan, np.nan)

    @property
    def one_rate(self) -> bool:
        """True where the rates at every plastic strain lie within a factor of `ONE_RATE`."""
        return self.apart <= ONE_RATE

    def tells(self, span: float) -> bool:
        """True where an effect of the temperature on flow, which needs temperatures `span` K apart (0: any), can be told."""
        return self.span > max(span, ONE_TEMPERATURE)

    def determines_modulus(self, span: float) -> bool:
        """The same for an effect of the temperature on the elastic moduli."""
        return self.elastic[1] - self.elastic[0] > max(span, ONE_TEMPERATURE)


def flow_conditions(tests: Sequence[CouponTest], run: Callable[[CouponTest], PointHistory]) -> FlowConditions:
    """FlowConditions of records, each row of the same weight; `run` gives the history of the model on the measured strain (or stress).

    Where nothing flows there is one rate, and no span of temperatures.
    """
    rates, strains, temperatures, places, elastic = [], [], [], [], []
    computed, unloads = 0.0, False
    for test in tests:
        history = run(test)
        again = unloads_after_flow(history)
        unloads |= again
        rate, theta = rates_of_flow(test, history), known_temperature(test)
        elastic += elastic_temperatures(test, theta, again)
        used = np.isfinite(rate)
        rates.append(rate[used])
        strains.append(flow_since_turn(test, history)[used])
        used &= np.isfinite(theta)
        temperatures.append(theta[used])
        places.append(history.accumulated[used])
        if test.theta is None and used.any():
            computed = max(computed, float(np.ptp(history.theta[used])))
    rate = np.concatenate(rates)
    low, high = _within_tails(rate)
    if low > 0.0:
        apart = by_strain(strains, [np.clip(own, low, high) for own in rates])
    else:
        apart = np.inf if high > 0.0 else 1.0
    span = warmer_at_strain(places, temperatures)
    return FlowConditions(
        (low, high), _within_tails(np.concatenate(temperatures)), len(rate), apart, span, computed, unloads, _ends(elastic)
    )


def unloads_after_flow(history: PointHistory) -> bool:
    """True where the stress of a record falls by UNLOADED of its largest size so far, after flow and without it, in some rows."""
    rests = np.append(True, np.diff(history.accumulated) <= 0.0) & (history.accumulated > history.accumulated[0])
    size = np.abs(history.stress)
    return int((rests & (size < (1.0 - UNLOADED) * np.maximum.accumulate(size))).sum()) >= _ROWS


def elastic_temperatures(test: CouponTest, theta: np.ndarray, unloads: bool) -> list[float]:
    """Told temperatures in K of the elastic ranges of a record: mean of the first line, and of all rows where it unloads after flow."""
    line = test.line
    found = []
    if line is not None:
        first = test.elastic.time
        inside = np.linspace(float(first[line.begin]), float(first[line.end]), _ROWS)
        found.append(float(np.interp(inside, test.time, theta).mean()))
    return [*found, float(theta.mean())] if unloads else found


def _ends(values: Sequence[float]) -> tuple[float, float]:
    known = [value for value in values if np.isfinite(value)]
    return (min(known), max(known)) if known else (np.nan, np.nan)


def known_temperature(test: CouponTest) -> np.ndarray:
    """Temperature in K (n_t,) of a record as somebody told it: the sensor's, or else the one at which it was declared to begin."""
    return np.full(len(test.time), test.theta_start) if test.theta is None else test.theta


def warmer_at_strain(strains: Sequence[np.ndarray], temperatures: Sequence[np.ndarray]) -> float:
    """Largest difference in K of the temperatures (n,) of records at the same accumulated plastic strain Lambda (n,), from `KNEE` on; 0
    where there is none.

    The same: within `SMOOTH`, after the straight line over Lambda that each record follows there was taken out, so that what is left of a
    record are its jumps, as in a rest. Of the rows of a record the `TAIL` at either end does not count, `_LEAST` at least.
    """
    largest = 0.0
    for low, high in _places(strains):
        middle, ends = 0.5 * (low + high), []
        for strain, theta in zip(strains, temperatures, strict=True):
            here = (strain >= low) & (strain <= high)
            if not here.any():
                continue
            at, value = strain[here], theta[here]
            away = at - at.mean()
            slope = float(away @ value) / max(float(away @ away), 1e-300)
            level = np.sort(value - slope * (at - np.clip(middle, at.min(), at.max())))
            cut = min(max(int(TAIL * len(level)), _LEAST), (len(level) - 1) // 2)
            ends += [level[cut], level[-1 - cut]]
        largest = max(largest, float(max(ends) - min(ends)) if ends else 0.0)
    return largest


def _places(strains: Sequence[np.ndarray]) -> list[tuple[float, float]]:
    """Ends of the intervals of plastic strain, `SMOOTH` wide, from `KNEE` to the largest of the strains."""
    last = max((float(np.nanmax(strain, initial=0.0)) for strain in strains), default=0.0)
    if last < KNEE:
        return []
    starts = KNEE * SMOOTH ** (np.arange(int(_PLACES * np.log(last / KNEE) / np.log(SMOOTH)) + 1) / _PLACES)
    return [(float(low), SMOOTH * float(low)) for low in starts]


def by_strain(strains: Sequence[np.ndarray], rates: Sequence[np.ndarray]) -> float:
    """Largest ratio of positive rates in 1/s at the same plastic strain since the flow last turned, from `KNEE` on, of records with strains
    (n,), NaN in rows that do not count, and rates (n,); 1 where there are none.

    The same: within `SMOOTH`. Of the rows of a record there the `TAIL` at either end does not count, and where it has more than a window,
    no less than one.
    """
    largest = 1.0
    for first, last in _places(strains):
        ends = []
        for strain, rate in zip(strains, rates, strict=True):
            here = np.sort(rate[(strain >= first) & (strain <= last)])
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
