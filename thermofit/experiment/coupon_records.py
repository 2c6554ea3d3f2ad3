"""What the identification reads of coupon records: the record of `interpolate` as arrays, one entry per test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from thermofit.core.errors import DataError, StudyError
from thermofit.core.experiment import CELSIUS, CouponRecord
from thermofit.experiment.coupon_elastic import STRAIGHT, ElasticLine, elastic_line
from thermofit.experiment.fields import INTERPOLATE, TestPhase
from thermofit.observe.noise import robust_sigma, second_differences
from thermofit.read.coupon import read_coupon
from thermofit.read.row import row_record
from thermofit.records.artefact import Dataset, Record, read_current
from thermofit.records.staging import Made, artefact_path
from thermofit.study.coupon import RowSettings
from thermofit.study.section import ParameterStart
from thermofit.study.study import Study

LEAST_NOISE = {"strain": 1e-8, "stress": 1e-4, "theta": 1e-4, "lateral": 1e-8}
"""Noise of a record without noise: sigma must not vanish, because it divides the residual."""
UNITS = {"strain": "1", "stress": "MPa", "theta": "K", "lateral": "1"}
FIRST_LOADING = "first_loading"
"""Group of the artefact with all samples of the first loading of a record that was thinned."""
_SAMPLED = ("time", "strain", "stress", "theta", "lateral")
_ELASTIC = 0.5
"""Share of a prescribed E below which the slope of a straight beginning is not that of an elastic line."""
_JITTER = 0.5
"""Noise of the prescribed strain over the usual increment between samples above which the record should be thinned."""


@dataclass(frozen=True)
class StripSection:
    """Section of a strip: the name of the row, place along the axis in mm, cross-section over a common one."""

    row: str
    place: float
    area: float


@dataclass(frozen=True)
class CouponTest:
    """One record: time s, nominal strain and stress MPa, temperature K (None: not measured), each (n,); temperatures of the air and of the
    specimen at the start in K, standard deviation of one value of each, phases of the test; nominal strain across the load (n,) (None: not
    measured), and whether the elastic part of the strain was added to a flow curve."""

    name: str
    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    theta: np.ndarray | None
    theta_air: float
    theta_start: float
    noise: Mapping[str, float]
    phases: tuple[TestPhase, ...]
    lateral: np.ndarray | None = None
    """Nominal strain across the load (n,), NaN where it has gaps; None where it was not measured."""
    over_plastic: bool = False
    """Was the elastic part of the strain added to a flow curve."""
    measured_clock: bool = True
    """False where the time was built from a rate that somebody said: the record then knows nothing of its rate."""
    first_loading: CouponTest | None = None
    """All samples of the first loading, where the record itself was thinned: a range that is short against the test has few or none of the
    samples that are left."""
    section: StripSection | None = None
    """Where a record is one section of a strip: its stress was not measured (NaN), and the mean strain of all drives it."""

    @property
    def group(self) -> str:
        """Name of the row that it is a section of, else its own."""
        return self.name if self.section is None else self.section.row

    @cached_property
    def line(self) -> ElasticLine | None:
        """The elastic line of the record; None where it has none, or none of its own. Its samples are those of `elastic`."""
        return None if self.over_plastic or self.section is not None else self.elastic._own_line

    @cached_property
    def _own_line(self) -> ElasticLine | None:
        return elastic_line(self.time, self.strain, self.stress, self.noise["strain"])

    @cached_property
    def elastic(self) -> CouponTest:
        """The samples that tell the elastic constants: all of the first loading where those that thinning left tell no slope to STRAIGHT.

        Where they do, what is left is a bend of the record, which more samples tell no better. A line through it follows where they are
        dense: those that thinning left lie evenly along the record, all of them are dense where the machine was slow."""
        own = self._own_line
        return self if self.first_loading is None or (own is not None and own.error <= STRAIGHT) else self.first_loading


@dataclass(frozen=True)
class CouponData:
    """All records of a study, and whether the strain or the stress is prescribed."""

    tests: tuple[CouponTest, ...]
    control: str

    @property
    def theta_air(self) -> float:
        """Air of the first record, K; the others keep their own (`coupon_model`)."""
        return self.tests[0].theta_air

    @property
    def theta_clamp(self) -> float:
        """Start of the first record, K: a coupon rests in its jaws."""
        return self.tests[0].theta_start


def with_elastic_strain(record: CouponRecord, modulus: float) -> CouponRecord:
    """A flow curve over its total strain: e = e_p + sigma / E, logarithmic and true, then nominal strain exp(e) - 1 and nominal stress
    sigma exp(-e); `modulus` E in MPa."""
    sigma = record.stress * (1.0 + record.strain)
    total = np.log1p(record.strain) + sigma / modulus
    said = f"elastic strain of up to {np.abs(sigma).max() / modulus:.2e} added to the plastic one, by E = {modulus:g} MPa of the study"
    return replace(record, strain=np.expm1(total), stress=sigma * np.exp(-total), remarks=(*record.remarks, said))


def coupon_test(record: CouponRecord, modulus: float | None = None) -> tuple[CouponTest, tuple[str, ...]]:
    """A record ready for the fit, and remarks: noise estimated where the reader has none, strains counted from where the elastic line meets
    zero stress; `modulus` E in MPa where the study prescribes it, which a flow curve over plastic strain needs."""
    if record.over_plastic:
        if modulus is None:
            raise StudyError(f"{record.name}: a flow curve over plastic strain needs E; give parameters.E as a number in MPa")
        record = with_elastic_strain(record, modulus)
    remarks = [*record.remarks]
    values = {"strain": record.strain, "stress": record.stress, "theta": record.temperature}
    noise = {}
    for name, value in values.items():
        if value is None:
            continue
        known = np.isfinite(value)
        if known.sum() < 5 or not known.all():
            raise DataError(f"{record.name}: {name} has {int(known.sum())} of {len(value)} values, all of at least 5 are needed")
        found = record.noise.get(name)
        estimate = robust_sigma(second_differences(record.time, value[:, None]))[0] if found is None else found
        noise[name] = max(float(estimate), LEAST_NOISE[name])
    if record.lateral is not None:
        noise["lateral"] = _lateral_noise(record)
    measured = _as_measured(record, noise)
    line, first, zero, lateral_zero = measured.line, measured.elastic, 0.0, 0.0
    if line is not None and modulus is not None and line.slope < _ELASTIC * modulus:
        remarks.append(
            f"its straight beginning rises with {line.slope:.3g} MPa, E of the study is {modulus:g} MPa: that is no elastic line, and "
            "strains are left as measured"
        )
        line = None
    if line is not None and record.shift_strain and abs(line.offset) > 3.0 * noise["strain"] / line.samples**0.5:
        zero = line.offset
        remarks.append(
            f"strain is counted from where the elastic line meets zero stress: moved by {-line.offset:.2e} (strain_zero: as-measured "
            "leaves it)"
        )
    if line is not None and first.lateral is not None:
        known = np.flatnonzero(np.isfinite(first.lateral[: line.straight + 1]))
        if known.size > 2 and np.ptp(first.stress[known]) > 0.0:
            slope, at_zero = np.polyfit(first.stress[known], first.lateral[known], 1)
            if slope * line.slope > 0.0:
                remarks.append("the lateral strain rises in elastic tension, where it must fall: is its sign turned?")
            if record.shift_strain and abs(at_zero) > 3.0 * noise["lateral"] / known.size**0.5:
                lateral_zero = float(at_zero)
                remarks.append(f"lateral strain is counted from where its elastic line meets zero stress: moved by {-at_zero:.2e}")
    step = float(np.median(np.abs(np.diff(record.strain))))
    if noise["strain"] > _JITTER * step:
        remarks.append(
            f"noise of the strain ({noise['strain']:.1e}) is not small against its usual step ({step:.1e}): thin the record (key "
            "'points'), else the model flows back and forth with the noise"
        )
    return _counted(measured, zero, lateral_zero), tuple(f"{record.name}: {text}" for text in remarks)


def _as_measured(record: CouponRecord, noise: Mapping[str, float]) -> CouponTest:
    """A record with the noise of its values, strains as they were read."""
    first = record.first_loading
    return CouponTest(
        name=record.name,
        time=record.time,
        strain=record.strain,
        stress=record.stress,
        theta=record.temperature,
        theta_air=float(record.theta_air),
        theta_start=float(record.theta_air if record.theta_start is None else record.theta_start),
        noise=noise,
        phases=tuple(TestPhase(t0, t1, label) for t0, t1, label in record.phases) or whole(record.time),
        lateral=record.lateral,
        over_plastic=record.over_plastic,
        measured_clock=record.measured_clock,
        first_loading=None if first is None else _as_measured(first, noise),
    )


def _counted(test: CouponTest, zero: float, lateral_zero: float) -> CouponTest:
    """The record with strains counted from these zeros, and so its first loading."""
    first = test.first_loading
    return replace(
        test,
        strain=test.strain - zero,
        lateral=None if test.lateral is None else test.lateral - lateral_zero,
        first_loading=None if first is None else _counted(first, zero, lateral_zero),
    )


def _lateral_noise(record: CouponRecord) -> float:
    """Standard deviation of one value of the strain across the load, which may have gaps (NaN). DataError where it has no five values."""
    assert record.lateral is not None
    known = np.isfinite(record.lateral)
    if known.sum() < 5:
        raise DataError(f"{record.name}: lateral has {int(known.sum())} of {len(known)} values, at least 5 are needed")
    found = record.noise.get("lateral")
    estimate = robust_sigma(second_differences(record.time[known], record.lateral[known, None]))[0] if found is None else found
    return max(float(estimate), LEAST_NOISE["lateral"])


def whole(time: np.ndarray) -> tuple[TestPhase, ...]:
    """The test as one phase."""
    return (TestPhase(float(time[0]), float(time[-1]), "loading"),)


def read_tests(study: Study) -> list[tuple[CouponTest, tuple[str, ...]]]:
    """All records of a study from their files, ready for the fit, each with its remarks."""
    setting = study.parameters.get("E")
    modulus = None if isinstance(setting, ParameterStart) else setting
    rows = [found for k, row in enumerate(study.coupon_section.rows) for found in _sections(study, row, f"coupon.rows.{k}")]
    return rows or [coupon_test(record, modulus) for record in read_coupon(study.coupon_section, study.source.parent)]


def _sections(study: Study, settings: RowSettings, key: str) -> list[tuple[CouponTest, tuple[str, ...]]]:
    """Every section of a strip as a record, remarks at the first one."""
    read = row_record(settings, study.source.parent, key)
    theta, unknown = settings.temperature_degC + CELSIUS, np.full(len(read.time), np.nan)
    area = settings.area or (1.0,) * len(read.place)
    noise = {"strain": max(read.noise, LEAST_NOISE["strain"]), "stress": 0.0}
    tests = []
    for k, y in enumerate(read.place):
        section = StripSection(read.name, float(y), area[k])
        name = f"{read.name} at {y:g} mm"
        record = CouponTest(name, read.time, read.strain[:, k], unknown, None, theta, theta, noise, whole(read.time), section=section)
        tests.append((record, read.remarks if k == 0 else ()))
    return tests


def interpolated(study: Study) -> Made:
    """The record of `interpolate` of a study on coupons: every record in SI-like units with its noise, phases and remarks."""
    found = read_tests(study)
    datasets: dict[str, Dataset] = {}
    rows: list[dict[str, Any]] = []
    remarks: list[str] = []
    for number, (test, said) in enumerate(found):
        datasets |= _datasets(test, f"records/{number}")
        if test.first_loading is not None:
            datasets |= _datasets(test.first_loading, f"records/{number}/{FIRST_LOADING}")
        rows.append(_row(test))
        remarks += said
    phases = [
        {"record": test.name, "t0": p.t0, "t1": p.t1, "label": p.label} for test, _ in found for p in test.phases
    ]  # fmt: skip
    samples = sum(len(test.time) for test, _ in found)
    hot = sum(test.theta is not None for test, _ in found)
    line = f"{len(found)} records, {samples} samples" + (f", {hot} with temperature" if hot else "")
    measured = ("strain", "stress") if found[0][0].section is None else ("strain",)
    noise = ", ".join(f"{name} {max(t.noise[name] for t, _ in found):.2g} {UNITS[name]}" for name in measured)
    summary = {
        "verdict": f"{line}; noise at most {noise}",
        "records": rows,
        "tests": [_facts(test) for test, _ in found],
        "phases": phases,
        "remarks": remarks,
        "control": study.coupon_section.control,
    }
    return Made(datasets, summary)


def _datasets(test: CouponTest, place: str) -> dict[str, Dataset]:
    """Samples of a record at a place of the artefact."""
    units = {"time": "s", **UNITS}
    values = {name: getattr(test, name) for name in _SAMPLED}
    return {f"{place}/{name}": Dataset(value, units[name], ("sample",)) for name, value in values.items() if value is not None}


def _row(test: CouponTest) -> dict[str, Any]:
    """A record as a row of a table for the user."""
    return {
        "record": test.name,
        "n": len(test.time),
        "duration_s": float(test.time[-1] - test.time[0]),
        "strain": f"{test.strain.min():.4f} to {test.strain.max():.4f}",
        "stress_MPa": f"{test.stress.min():.1f} to {test.stress.max():.1f}" if test.section is None else "not measured",
        "start_K": test.theta_start,
        "temperature": "none" if test.theta is None else f"{np.nanmin(test.theta):.2f} to {np.nanmax(test.theta):.2f} K",
    }


def _facts(test: CouponTest) -> dict[str, Any]:
    """What of a record is no array."""
    return {
        "name": test.name,
        "theta_air": test.theta_air,
        "theta_start": test.theta_start,
        "noise": dict(test.noise),
        "over_plastic": test.over_plastic,
        "measured_clock": test.measured_clock,
        "section": None if test.section is None else asdict(test.section),
    }


def coupon_data(study: Study, *, held_out: bool = False) -> CouponData:
    """The records of a study that are fitted, or those held out, from `<run_dir>/interpolate.h5`; StudyError that names the command where
    that is missing."""
    path = artefact_path(study.run_dir, INTERPOLATE)
    data = coupon_data_of(read_current(path, INTERPOLATE, study.source.name))
    unseen = study.coupon_section.held_out
    return replace(data, tests=tuple(test for test in data.tests if (test.group in unseen) is held_out))


def coupon_data_of(record: Record) -> CouponData:
    """CouponData from an open record of `interpolate`; StudyError where that was made of fields."""
    if "tests" not in record.summary:
        raise StudyError(f"{record.path}: made of a full-field experiment; run `thermofit interpolate` again for the coupon records")
    tests = []
    for number, facts in enumerate(record.summary["tests"]):
        get, name = f"records/{number}", str(facts["name"])
        own = [p for p in record.summary["phases"] if p["record"] == name]
        phases = tuple(TestPhase(float(p["t0"]), float(p["t1"]), str(p["label"])) for p in own)
        air, start = float(facts["theta_air"]), float(facts["theta_start"])
        over_plastic, clock = bool(facts.get("over_plastic", False)), bool(facts.get("measured_clock", True))
        facts_of = {"theta_air": air, "theta_start": start, "noise": facts["noise"], "over_plastic": over_plastic, "measured_clock": clock}
        first = None
        if record.has(f"{get}/{FIRST_LOADING}/time"):
            samples = _samples(record, f"{get}/{FIRST_LOADING}")
            first = CouponTest(name=name, **samples, **facts_of, phases=whole(samples["time"]))
        section = None if facts.get("section") is None else StripSection(**facts["section"])
        tests.append(CouponTest(name=name, **_samples(record, get), **facts_of, phases=phases, first_loading=first, section=section))
    return CouponData(tuple(tests), str(record.summary["control"]))


def _samples(record: Record, place: str) -> dict[str, Any]:
    """Arrays of a CouponTest from a place of the artefact; None for what was not measured."""
    return {name: record[f"{place}/{name}"].value if record.has(f"{place}/{name}") else None for name in _SAMPLED}


def shortened(test: CouponTest, t_end: float) -> CouponTest:
    """The record up to t_end s, two samples at least."""
    n = max(int(np.searchsorted(test.time, t_end + 1e-9)), 2)
    theta, lateral = (None if value is None else value[:n] for value in (test.theta, test.lateral))
    return replace(test, time=test.time[:n], strain=test.strain[:n], stress=test.stress[:n], theta=theta, lateral=lateral)
