"""Section `coupon` of the study file: uniaxial records as testing machines export them, and which column means what.

A column is named as in the file: `time: "C_1_Temps[s]"`, or with a unit that the file does not give (or gives wrongly):
`time: {column: t, unit: min}`. Nothing here is guessed: a sign is turned only where `tension: negative` says so.
"""

from __future__ import annotations

import itertools
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StrictBool, Tag, model_validator

from thermofit.core.experiment import CELSIUS
from thermofit.core.study_errors import content_error
from thermofit.core.study_section import Count, Interval, Number, Positive, Section, Whole, number_or, word_or

Text = Annotated[str, Field(min_length=1)]
Tension = Literal["positive", "negative"]
Celsius = Annotated[Number, Field(gt=-CELSIUS, lt=3000.0)]


class ColumnSource(Section):
    """A column of the file, with the unit where the file does not give it or gives it wrongly."""

    column: Text
    unit: Text | None = None


def _exactly_one(section: Section, keys: tuple[str, ...]) -> str:
    """The one of the keys that is given; else the error."""
    given = [key for key in keys if getattr(section, key) is not None]
    if len(given) != 1:
        what = "none of them" if not given else " and ".join(given)
        raise content_error(f"gives {what}; expected exactly one of {', '.join(keys)}")
    return given[0]


def _only_with(section: Section, key: str, others: tuple[str, ...]) -> None:
    """The others are refused where `key` is absent."""
    for other in others:
        if getattr(section, key) is None and getattr(section, other) is not None:
            raise content_error(f"is given without '{key}'; expected both or none", key=other)


class StrainSource(Section):
    """Nominal strain: a column of it, true strain (converted), an elongation over the gauge length, or the plastic part of true strain."""

    column: Text | None = None
    """Nominal (engineering) strain."""
    true_strain: Text | None = None
    """Logarithmic strain; converted to nominal strain by exp(e) - 1."""
    plastic_strain: Text | None = None
    """Logarithmic plastic strain of a flow curve; the elastic strain, true stress over `parameters.E`, is added."""
    extension: Text | None = None
    """Elongation of the gauge length."""
    unit: Text | None = None
    """Unit of the column, where the file does not give it or gives it wrongly."""
    gauge_length: Positive | None = None
    """mm; absent: from the header of the file."""
    tension: Tension | None = None
    """Sign of this channel in tension; absent: that of the record."""

    @model_validator(mode="after")
    def _one_source(self) -> StrainSource:
        _exactly_one(self, ("column", "true_strain", "plastic_strain", "extension"))
        _only_with(self, "extension", ("gauge_length",))
        return self

    @property
    def name(self) -> str:
        """Name of the column."""
        return str(self.column or self.true_strain or self.plastic_strain or self.extension)


class StressSource(Section):
    """Nominal stress: a column of it, true stress (converted), or a force over the initial area."""

    column: Text | None = None
    """Nominal (engineering) stress."""
    true_stress: Text | None = None
    """Cauchy stress at constant volume; converted to nominal stress by the true strain."""
    force: Text | None = None
    unit: Text | None = None
    """Unit of the column, where the file does not give it or gives it wrongly."""
    area: Positive | None = None
    """Initial cross-section, mm^2; absent: from the lengths below, else from the header of the file."""
    diameter: Positive | None = None
    """mm, of a round bar."""
    width: Positive | None = None
    """mm, of a flat specimen; absent with a thickness: from the header of the file."""
    thickness: Positive | None = None
    """mm, of a flat specimen; absent with a width: from the header of the file."""
    tension: Tension | None = None
    """Sign of this channel in tension; absent: that of the record."""

    @model_validator(mode="after")
    def _one_source(self) -> StressSource:
        _exactly_one(self, ("column", "true_stress", "force"))
        _only_with(self, "force", ("area", "diameter", "width", "thickness"))
        flat = self.width if self.width is not None else self.thickness
        if sum(value is not None for value in (self.area, self.diameter, flat)) > 1:
            raise content_error("gives the cross-section more than once; expected area, or diameter, or width and thickness")
        return self

    @property
    def name(self) -> str:
        """Name of the column."""
        return str(self.column or self.true_stress or self.force)


class TemperatureSource(Section):
    """Temperature of a sensor on the specimen, in the same file or in one of its own with another clock."""

    column: Text
    unit: Text | None = None
    file: Text | None = None
    """A second file; its clock is joined by a channel that both repeat (the force)."""
    test: Text | None = None
    time: Text | None = None
    """Time column of the second file; absent: the only one."""
    offset_s: Annotated[Annotated[Literal["auto"], Tag("~word")] | Annotated[Number, Tag("~number")], number_or("~number")] = "auto"
    """Time of the second clock minus that of the first, s; auto: by cross-correlation of the repeated channel."""
    repeats: Text | None = None
    """Channel of the second file that repeats the force (or stress) of the first; absent: its only force."""

    @model_validator(mode="after")
    def _second_file(self) -> TemperatureSource:
        _only_with(self, "file", ("test", "time", "repeats"))
        if self.file is None and self.offset_s != "auto":
            raise content_error("is given without 'file'; expected both or none", key="offset_s")
        return self


class CouponNoise(Section):
    """Standard deviations of single values; absent: estimated from the record."""

    strain: Positive | None = None
    stress: Positive | None = None
    """MPa"""
    temperature: Positive | None = None
    """K"""


Column = Annotated[Annotated[Text, Tag("~word")] | Annotated[ColumnSource, Tag("~column")], word_or("~column")]
Strain = Annotated[Annotated[Text, Tag("~word")] | Annotated[StrainSource, Tag("~strain")], word_or("~strain")]
Stress = Annotated[Annotated[Text, Tag("~word")] | Annotated[StressSource, Tag("~stress")], word_or("~stress")]
Temperature = Annotated[Annotated[Text, Tag("~word")] | Annotated[TemperatureSource, Tag("~temperature")], word_or("~temperature")]


def _rows_increase(rows: tuple[int, ...]) -> tuple[int, ...]:
    if any(b <= a for a, b in itertools.pairwise(rows)):
        raise content_error("is not increasing; expected row numbers, each larger than the one before")
    return rows


class CouponRecordSettings(Section):
    """One record: file, columns, specimen and what of it is used."""

    file: Text
    """Relative to the study file; may hold ${VARIABLES} of the environment."""
    test: Text | None = None
    """Tag or sheet, where the file holds several tests."""
    name: Text | None = None
    """Absent: test, else the file's name."""
    time: Column | None = None
    """Column of time; absent only with `rate`."""
    rate: Positive | None = None
    """Nominal strain rate, 1/s: builds the time of a record that has none."""
    strain: Strain
    stress: Stress
    temperature: Temperature | None = None
    initial_temperature_degC: Celsius | None = None
    """Of specimen before the test; absent: from the header of the file, else the first values of the sensor."""
    air_temperature_degC: Celsius | None = None
    """Absent: the initial temperature."""
    tension: Tension = "positive"
    """Sign of the raw channels in tension."""
    window: Interval | None = None
    """First and last time used, s."""
    exclude: tuple[Interval, ...] = ()
    """Intervals left out, s."""
    strain_max: Positive | None = None
    """The record ends where the strain first exceeds this."""
    until: Literal["end", "maximum-force"] = "end"
    """maximum-force: the record ends at its largest stress, before necking."""
    jumps: Annotated[tuple[Annotated[Whole, Field(ge=1)], ...], AfterValidator(_rows_increase)] = ()
    """Data rows (first: 0) at which the extensometer slipped; the strain is shifted to continue there."""
    points: Annotated[Count, Field(ge=10)] | None = None
    """Thin to about this many samples, turning points kept; absent: all."""
    noise: CouponNoise = CouponNoise()
    held_out: StrictBool = False
    """True: predicted by `validate`, never fitted."""

    @model_validator(mode="after")
    def _one_clock(self) -> CouponRecordSettings:
        _exactly_one(self, ("time", "rate"))
        return self

    @model_validator(mode="after")
    def _true_flow_curve(self) -> CouponRecordSettings:
        if self.over_plastic and not (isinstance(self.stress, StressSource) and self.stress.true_stress is not None):
            raise content_error("is not a true stress, but the strain is a plastic_strain; expected {true_stress: COLUMN}", key="stress")
        return self

    @property
    def over_plastic(self) -> bool:
        """True for a flow curve: true stress over plastic strain."""
        return isinstance(self.strain, StrainSource) and self.strain.plastic_strain is not None

    @property
    def label(self) -> str:
        """Name of the record."""
        return self.name or self.test or self.file.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]


class Coupon(Section):
    """Uniaxial records of coupons, and what drives the model through them."""

    records: Annotated[tuple[CouponRecordSettings, ...], Field(min_length=1)]
    control: Literal["strain", "stress"] = "strain"
    """What is prescribed: the measured strain (then the stress is compared) or the measured stress."""
    heat: Literal["law", "measured-work"] = "law"
    """What heats the specimen: stress and flow of the law, or the work of the measured stress on the measured plastic strain, of which the
    share `beta` becomes heat; then no error of the hardening law reaches the temperature."""

    @model_validator(mode="after")
    def _names_differ(self) -> Coupon:
        labels = [record.label for record in self.records]
        for index, label in enumerate(labels):
            if label in labels[:index]:
                raise content_error(f"is '{label}' again; expected another name for every record", key=f"records.{index}.name")
        if all(record.held_out for record in self.records):
            raise content_error("are all held out; expected at least one that is fitted", key="records")
        return self
