"""The residual of a stage on coupon records: one run of the point driver per record, all records in one residual (2.24).

Records follow one another on one time axis, so that a channel is one field of one point and everything that is written for fields
serves coupons as well. What is prescribed is noisy too: the stress that noise of the strain makes, E times it, counts as noise of the
compared stress, and the other way round under stress control.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import DataError, NumericsError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.effects.catalogue import effects
from thermofit.experiment.channels import balanced, field_of, weight_of
from thermofit.experiment.coupon_elastic import contradicts, slope_scatter
from thermofit.experiment.coupon_records import UNITS, CouponData, CouponTest, shortened
from thermofit.experiment.coupon_sensor import SENSOR, shown, shown_rates
from thermofit.experiment.measured_work import MeasuredCurve, with_measured_work
from thermofit.experiment.missing_coupon import CouponMissing
from thermofit.experiment.model import Prior, StageModel
from thermofit.experiment.prediction import Errors
from thermofit.experiment.priors import priors_of
from thermofit.observe.comparison import Comparison, Weight, plain
from thermofit.observe.observation import FieldObservation
from thermofit.observe.selection import selected
from thermofit.point.driver import PointHistory, PointRates, PointSettings, Programme, simulate, simulate_rates
from thermofit.point.row_driver import RowProgramme, simulate_row
from thermofit.point.step import N_STATE
from thermofit.records.staging import Note
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

HISTORY = {"stress": "stress", "strain": "strain", "lateral": "lateral_x", "theta": "theta_sensor"}
"""Channel of a PointHistory behind an observed field; the strain across the load is that along the width, axis 1 of the law."""
_CONTRACTION = 0.5
"""Strain across the load over that along it, at constant volume: what noise of a prescribed strain makes across it at most."""


_Found = tuple[PointHistory, PointRates | None]
_ROWS_KEPT = 16
ROOM = 293.15
"""K; jaws of a row where the study gives no theta_clamp."""


@dataclass(frozen=True)
class CouponRun:
    """How the records are run: settings of the driver, and the parameters that the study gives for all records alike."""

    data: CouponData
    settings: PointSettings
    common: frozenset[str]
    per_interval: int = 1
    """Steps between two samples of a record."""
    measured_work: bool = False
    """True where the measured stress on the measured strain heats the specimen, and not the law."""
    air_is_free: bool = False
    """True where the temperature of the air is fitted: all records depart from their own by as much."""
    kept: dict[Hashable, list[_Found]] = dataclasses.field(default_factory=dict, compare=False, repr=False)
    """The last run of every row: one run answers for all of its sections."""

    def parameters_of(self, parameters: Parameters, test: CouponTest) -> Parameters:
        """Parameters of a record: its own air and free of stress at its own start, unless the study says otherwise."""
        departure = parameters["theta_air"] - self.data.theta_air if self.air_is_free else 0.0
        own = {"theta_air": test.theta_air + departure, "theta_ref": test.theta_start}
        if test.section is not None:
            own["theta_clamp"] = ROOM
        return parameters.replace(**{name: value for name, value in own.items() if name not in self.common})

    def programme(self, test: CouponTest) -> Programme:
        """What drives a record."""
        start = test.theta_start
        if self.data.control == "strain":
            return Programme.by_strain(*self._refined(test.time, test.strain), start)
        return Programme.under_stress(*self._refined(test.time, test.stress), start)

    def _refined(self, time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.per_interval == 1:
            return time, value
        index = np.arange((len(time) - 1) * self.per_interval + 1) / self.per_interval
        return np.interp(index, np.arange(len(time)), time), np.interp(index, np.arange(len(time)), value)

    def _heated(self, parameters: Parameters, test: CouponTest, found: _Found) -> _Found:
        if not self.measured_work:
            return found
        (time, strain), (_, stress) = self._refined(test.time, test.strain), self._refined(test.time, test.stress)
        return with_measured_work(parameters, MeasuredCurve(time, strain, stress, test.theta_start), self.settings, found)

    def _in_row(self, parameters: Parameters, names: tuple[str, ...], test: CouponTest) -> _Found:
        """History and derivatives of one section: all of its row are run together, driven by the mean of their strains.

        The mean of n sections has the noise of one over the root of n, and grows as long as the strip is pulled: no noise turns flow into
        unloading, as it would in a section that follows its own strain. A force that is chosen at every instant for the least squares of
        all strains would be the same to first order, and is not unique beyond its maximum.
        """
        row = [one for one in self.data.tests if one.group == test.group]
        own = self.parameters_of(parameters, row[0])
        key: Hashable = (test.group, len(test.time), names, tuple(sorted(own.values.items())))
        if key not in self.kept:
            if len(self.kept) >= _ROWS_KEPT:
                self.kept.clear()
            time, mean = self._refined(test.time, np.mean([one.strain for one in row], axis=0))
            place, area = (np.array([getattr(one.section, name) for one in row]) for name in ("place", "area"))
            programme = RowProgramme(time, mean, np.full(len(row), 1.0 / len(row)), place, area)
            histories, rates = simulate_row(own, names, programme, test.theta_start, self.settings)
            self.kept[key] = list(zip(histories, rates, strict=True))
        return self.kept[key][[one.name for one in row].index(test.name)]

    def _run(self, parameters: Parameters, names: tuple[str, ...], test: CouponTest) -> _Found:
        """History of a record with its own parameters, and its derivatives."""
        if test.section is not None:
            return self._in_row(parameters, names, test)
        own = self.parameters_of(parameters, test)
        if not names:
            return self._heated(own, test, (simulate(own, self.programme(test), self.settings), None))
        return self._heated(own, test, simulate_rates(own, names, self.programme(test), self.settings))

    def history(self, parameters: Parameters, test: CouponTest) -> PointHistory:
        """The history of a record. NumericsError names the record that fails."""
        try:
            found, _ = self._run(parameters, (), test)
            return found if self.per_interval == 1 else found.every(self.per_interval)
        except NumericsError as error:
            raise NumericsError(f"{test.name}: {error}") from error

    def rates(self, parameters: Parameters, names: tuple[str, ...], test: CouponTest) -> tuple[PointHistory, PointRates]:
        """The history of a record and its derivatives by the named parameters; errors as `history`."""
        try:
            found, rates = self._run(parameters, names, test)
            if rates is None:
                rates = PointRates(names, np.zeros((len(found.time), N_STATE, 0)))
            n = self.per_interval
            return (found, rates) if n == 1 else (found.every(n), replace(rates, rates=rates.rates[::n]))
        except NumericsError as error:
            raise NumericsError(f"{test.name}: {error}") from error

    def planted(self, test: CouponTest, before: Parameters, after: Parameters) -> CouponTest:
        """A record to whose measured values the predictions with `after` less those with `before` are added; what drives it stays as it
        was measured. Work that the measured stress does heats the specimen by the stress as it then reads. Errors as `history`."""
        driven = (self.data.control, *(("stress",) if test.section is not None else ()))
        seen = {name: value for name in HISTORY if (value := getattr(test, name)) is not None and name not in driven}
        out = test
        for heated in (False, True) if self.measured_work else (True,):
            found = [(p, self.history(p, at)) for p, at in ((after, out), (before, test))]
            for name in seen if heated else [n for n in seen if n != "theta"]:
                new, old = (_shown_channel(name, history, test, p) for p, history in found)
                out = replace(out, **{name: seen[name] + (new - old)})
        first = test.first_loading
        return replace(out, first_loading=None if first is None else self.planted(first, before, after))


def _shown_channel(name: str, history: PointHistory, test: CouponTest, parameters: Parameters) -> np.ndarray:
    """What is observed (n,) of a history in a channel: a temperature as its sensor shows it."""
    value = np.asarray(getattr(history, HISTORY[name]))
    return shown(value, test, parameters) if name == "theta" else value


def point_settings(study: Study, *, plastic: bool = True) -> PointSettings:
    """Numerics of a study for the point driver."""
    return PointSettings(model=study.slots, closed_form=study.numerics.plastic_integration == "closed-form", plastic=plastic)


def coupon_run(study: Study, data: CouponData, free: Sequence[str] = (), *, plastic: bool = True) -> CouponRun:
    """CouponRun of a study; `free` parameters are common to all records."""
    departs = "theta_air" in free and "theta_air" not in study.parameters
    common = frozenset({*study.parameters, *free} - ({"theta_air"} if departs else set()))
    return CouponRun(
        data, point_settings(study, plastic=plastic), common, study.numerics.steps_per_interval, study.heated_by_measured_work, departs
    )


def offsets(tests: Sequence[CouponTest]) -> np.ndarray:
    """What is added to the time of each record (n_tests,) s so that they follow one another, a sample apart."""
    out, at = [], 0.0
    for test in tests:
        out.append(at - float(test.time[0]))
        at += float(test.time[-1] - test.time[0]) + float(np.median(np.diff(test.time)))
    return np.array(out)


def observations(
    data: CouponData, names: Sequence[str], windows: Sequence[tuple[float, float]], E: float, slopes: tuple[float, float] = (1.0, 0.0)
) -> dict[str, FieldObservation]:
    """Observed fields of all records within their windows [t0, t1] s; E in MPa turns noise of strain into noise of stress.

    `slopes`: mean in MPa of the slopes of the records and their relative standard deviation tau beyond their noise. Of a record with values
    v (n,) at the mean slope, an error tau v beside noise sigma leaves the information 1 / (sigma^2 / |v|^2 + tau^2) on a factor of v: that
    of noise with the variance sigma^2 + tau^2 |v|^2 (Sherman and Morrison).
    """
    time = np.concatenate([test.time + offset for test, offset in zip(data.tests, offsets(data.tests), strict=True)])
    inside = [(t.time >= a - 1e-9) & (t.time <= b + 1e-9) for t, (a, b) in zip(data.tests, windows, strict=True)]
    within = np.concatenate(inside)
    out = {}
    for name in names:
        measured = [{"stress": t.stress, "strain": t.strain, "theta": t.theta, "lateral": t.lateral}[name] for t in data.tests]
        value = np.concatenate([np.full(len(t.time), np.nan) if m is None else m for t, m in zip(data.tests, measured, strict=True)])
        own = [_sigma(t, name, E, data.control) for t in data.tests]
        slope, between = slopes
        if between > 0.0 and name in ("stress", "strain"):
            at_mean = [slope * t.strain if name == "stress" else t.stress / slope for t in data.tests]
            sizes = [float(np.linalg.norm(v[n])) for v, n in zip(at_mean, inside, strict=True)]
            own = [float(np.hypot(sigma, between * size)) for sigma, size in zip(own, sizes, strict=True)]
        sigma = np.concatenate([np.full(len(t.time), one) for t, one in zip(data.tests, own, strict=True)])
        mask = within & np.isfinite(value)
        if not mask.any():
            raise DataError(
                f"coupon: no record holds {name} within the window of the stage; check the window and the columns of the records"
            )
        hidden = [np.where(mask, x, np.nan)[:, None, None] for x in (value, sigma)]
        out[name] = FieldObservation(name, time, np.zeros((1, 2)), hidden[0], hidden[1], mask[:, None], UNITS[name])
    return out


def _sigma(test: CouponTest, name: str, E: float, control: str) -> float:
    """Noise of the difference between model and record: that of both strain and stress, brought to the unit of the compared one."""
    if name == "stress":
        return float(np.hypot(test.noise["stress"], E * test.noise["strain"]))
    if name == "strain":
        return float(np.hypot(test.noise["strain"], test.noise["stress"] / E))
    if name == "lateral":
        prescribed = test.noise["strain"] if control == "strain" else test.noise["stress"] / E
        return float(np.hypot(test.noise.get("lateral", np.nan), _CONTRACTION * prescribed))
    return test.noise.get("theta", np.nan)


def windows_of(window: str | tuple[float, float], data: CouponData) -> tuple[list[tuple[float, float]], str]:
    """Window [t0, t1] s of every record and a remark: its elastic range, all of it, or the given one.

    DataError where no record has an elastic range; a record without one is left out, and the remark says so.
    """
    if window == "all":
        return [(float(t.time[0]), float(t.time[-1])) for t in data.tests], ""
    if not isinstance(window, str):
        return [window for _ in data.tests], ""
    if window != "auto":
        raise StudyError(f"window '{window}' is not known; expected auto, all or [t0, t1] in s")
    found, said = [], []
    for test in data.tests:
        line = test.line
        if line is None:
            found.append((np.inf, -np.inf))
            said.append(f"{test.name} has no elastic range and is left out")
        else:
            found.append((float(test.elastic.time[line.begin]), float(test.elastic.time[line.end])))
            said.append(f"{test.name} up to {line.stress:.0f} MPa ({line.samples} samples)")
    if not any(b >= a for a, b in found):
        raise DataError("stages.elastic.window: no record begins with a straight line; give the window as [t0, t1] in s")
    whole = "elastic range: " + ", ".join(said)
    return found, whole if any(test.line is None for test in data.tests) else Note(whole)


def answerable(settings: StageSettings, data: CouponData) -> tuple[StageSettings, tuple[str, ...]]:
    """Settings of a stage without the elastic constants where it takes the elastic range of records that have none, and their names: these
    stay as the study gives them. DataError where no record has one because its stress falls with the strain."""
    elastic = tuple(name for name in settings.free if name in ("E", "nu"))
    if settings.window != "auto" or not elastic or any(test.line is not None for test in data.tests):
        return settings, ()
    if wrong := [test.name for test in data.tests if contradicts(test.strain, test.stress)]:
        raise DataError(
            f"{', '.join(wrong)}: no record begins with a straight line, for the stress falls while the strain rises; correct the key "
            "'tension' of strain or stress"
        )
    return settings.model_copy(update={"free": tuple(name for name in settings.free if name not in elastic)}), elastic


def comparison(channel: str, observation: FieldObservation, weight: Weight) -> Comparison:
    """The comparison of a channel; a record starts at its own temperature, so that dtheta is theta."""
    return replace(plain(observation, weight), channel=channel)


def segments(comparisons: Sequence[Comparison], data: CouponData) -> tuple[int, ...]:
    """Lengths of the parts of the residual that belong to one channel of one record."""
    ends = np.cumsum([len(t.time) for t in data.tests])
    out: list[int] = []
    for c in comparisons:
        counts = np.bincount(np.searchsorted(ends, c.rows[:, 0], side="right"), minlength=len(ends))
        out += [int(n) for n in counts if n]
    return tuple(out)


def coupon_model(study: Study, data: CouponData, settings: StageSettings, base: Parameters, beside: tuple[Prior, ...] = ()) -> StageModel:
    """StageModel of a stage on coupon records; the runs end where the last window ends. `beside`: priors of effects that a diagnosis may
    free."""
    windows, remark = windows_of(settings.window, data)
    kept = [n for n, (a, b) in enumerate(windows) if b >= a]
    slopes = (1.0, 0.0)
    if settings.window == "auto" and len(kept) > 1:
        slopes = slope_scatter([line for test in data.tests if (line := test.line) is not None])
    if slopes[1] > 0.0:
        remark += f"; their slopes differ by {100.0 * slopes[1]:.2g} % beyond their noise: each counts as one value of E with that error"
    taken = [test.elastic if settings.window == "auto" else test for test in data.tests]
    data = replace(data, tests=tuple(shortened(taken[n], windows[n][1]) for n in kept))
    seen = observations(data, list(dict.fromkeys(map(field_of, settings.channels))), [windows[n] for n in kept], base["E"], slopes)
    run = coupon_run(study, data, settings.free, plastic=not set(settings.free) <= {"E", "nu"})

    of_sensor = effects(SENSOR)
    stations = {name for effect in of_sensor for name in effect.names}

    def error_of(histories: Sequence[PointHistory], parameters: Parameters) -> Errors:
        pairs = list(zip(histories, data.tests, strict=True))
        return {
            n: np.concatenate([_shown_channel(n, h, t, parameters) for h, t in pairs])[:, None, None] - o.value for n, o in seen.items()
        }

    def linearise(parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        body = tuple(name for name in names if name not in stations)
        found = [run.rates(parameters, body, test) for test in data.tests]
        slopes = {}
        for field in seen:
            parts = []
            for (history, rates), test in zip(found, data.tests, strict=True):
                if field == "theta":
                    shown_by_model = np.asarray(getattr(history, HISTORY[field]))
                    parts.append(shown_rates(shown_by_model, rates[HISTORY[field]], test, parameters, names, of_sensor))
                else:
                    full = np.zeros((len(test.time), len(names)))
                    full[:, [names.index(n) for n in body]] = rates[HISTORY[field]]
                    parts.append(full)
            slopes[field] = np.concatenate(parts)[:, None, None, :]
        return error_of([history for history, _ in found], parameters), slopes

    comparisons = _comparisons(settings, seen, data)
    priors = (*priors_of(study, {n: base[n] for n in ("theta_air",) if n in settings.free}), *beside)
    return StageModel(
        errors=lambda parameters: error_of([run.history(parameters, test) for test in data.tests], parameters),
        comparisons=comparisons,
        observations=seen,
        remark=remark,
        linearise=linearise,
        segments=(*segments(comparisons, data), *(1 for _ in priors)),
        priors=priors,
        missing=CouponMissing(data.tests, offsets(data.tests), run.parameters_of, run.history, tuple(seen), study.slots),
        cheap=True,
    )


def _comparisons(settings: StageSettings, seen: Mapping[str, FieldObservation], data: CouponData) -> tuple[Comparison, ...]:
    """Comparisons of all channels; windows of a channel are in the time of each record."""
    clock, found = np.concatenate([test.time for test in data.tests]), []
    for channel, own in settings.channels.items():
        weight = weight_of(own)
        if isinstance(weight, tuple):
            raise StudyError(f"channels.{channel}.weight has components; expected a number: a coupon channel has none")
        observation = seen[field_of(channel)]
        kept = selected(replace(observation, time=clock), own.window, own.mask)
        found.append(comparison(channel, replace(observation, mask=kept.mask), weight))
    return balanced(found, [own.weight == "balanced" for own in settings.channels.values()])
