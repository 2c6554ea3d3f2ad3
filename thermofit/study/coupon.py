"""Section `coupon` of the study file: uniaxial records as testing machines export them, and which column means what.

A column is named as in the file: `time: "C_1_Temps[s]"`, by its number (`time: 1`), or with a unit that the file does not give (or gives
wrongly): `time: {column: t, unit: min}`. Nothing here is guessed: a sign is turned only where `tension: negative` says so.
"""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PrivateAttr,
    StrictBool,
    Tag,
    WithJsonSchema,
    model_validator,
)

from thermofit.core.experiment import CELSIUS
from thermofit.study.errors import content_error, unknown_key
from thermofit.study.section import Count, Interval, Number, Positive, Section, Whole, number_or

Text = Annotated[str, Field(min_length=1)]


def _by_number(value: Any) -> Any:
    """The name of a column that is given by its number, from 1."""
    if isinstance(value, int) and not isinstance(value, bool):
        if value < 1:
            raise content_error(f"is {value}; expected the name of a column or its number, the first is 1")
        return f"column {value}"
    return value


ColumnName = Annotated[
    str,
    BeforeValidator(_by_number),
    Field(min_length=1),
    WithJsonSchema({"anyOf": [{"type": "string", "minLength": 1}, {"type": "integer", "minimum": 1}]}),
]
"""A column by its name, with or without the unit in brackets, or by its number, from 1."""


def column_or(other: str) -> Discriminator:
    """Discriminator of `name of a column | number of a column | other`."""
    return Discriminator(lambda value: "~word" if isinstance(value, str | int) and not isinstance(value, bool) else other)


Tension = Literal["positive", "negative"]
Celsius = Annotated[Number, Field(gt=-CELSIUS, lt=3000.0)]


class ColumnSource(Section):
    """A column of the file, with the unit where the file does not give it or gives it wrongly."""

    column: ColumnName
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


class SecondClock(Section):
    """What a channel says that lies in a file, a test or beside a clock of its own: how that clock is joined with the record's."""

    file: Text | None = None
    """A second file."""
    test: Text | None = None
    """Another test (sheet, clock) of that file; without `file` of the record's own."""
    time: ColumnName | None = None
    """Time column of that clock; absent: the only one. Without `file` and `test` another time column of the same table."""
    offset_s: Annotated[Annotated[Literal["auto", "dates"], Tag("~word")] | Annotated[Number, Tag("~number")], number_or("~number")] = (
        "auto"
    )
    """Time of the second clock minus that of the record, s; auto: by cross-correlation of a repeated channel; dates: by absolute dates."""
    repeats: ColumnName | None = None
    """Channel beside the second clock that repeats one of the record; absent: its only force, else its only extension or strain."""
    repeated: ColumnName | None = None
    """Channel of the record that is repeated; absent: stress for a force or stress, strain for an extension or strain."""
    date: ColumnName | None = None
    """Column of dates beside the second clock; absent: the only one, else the header of the file."""

    @model_validator(mode="after")
    def _clock_of_its_own(self) -> SecondClock:
        if not self.apart:
            for key in ("repeats", "repeated", "date"):
                if getattr(self, key) is not None:
                    raise content_error("is given without 'file', 'test' or 'time' of another clock; name one of them", key=key)
            if self.offset_s != "auto":
                raise content_error("is given without 'file', 'test' or 'time' of another clock; name one of them", key="offset_s")
        return self

    @property
    def apart(self) -> bool:
        """True where the channel has a clock of its own."""
        return self.file is not None or self.test is not None or self.time is not None


class StrainSource(SecondClock):
    """Nominal strain: a column of it, true strain (converted), an elongation over the gauge length, or the plastic part of true strain."""

    column: ColumnName | None = None
    """Nominal (engineering) strain."""
    true_strain: ColumnName | None = None
    """Logarithmic strain; converted to nominal strain by exp(e) - 1."""
    plastic_strain: ColumnName | None = None
    """Logarithmic plastic strain of a flow curve; the elastic strain, true stress over `parameters.E`, is added."""
    extension: ColumnName | None = None
    """Elongation of the gauge length."""
    unit: Text | None = None
    """Unit of the column, where the file does not give it or gives it wrongly."""
    gauge_length: Positive | None = None
    """mm; absent: from the header of the file."""
    tension: Tension | None = None
    """Sign of this channel in tension; absent: that of the record."""
    despite_name: StrictBool = False
    """True: the name of the column says true or nominal wrongly, and the study is right."""

    @model_validator(mode="after")
    def _one_source(self) -> StrainSource:
        _exactly_one(self, ("column", "true_strain", "plastic_strain", "extension"))
        _only_with(self, "extension", ("gauge_length",))
        return self

    @property
    def name(self) -> str:
        """Name of the column."""
        return str(self.column or self.true_strain or self.plastic_strain or self.extension)


class StressSource(SecondClock):
    """Nominal stress: a column of it, true stress (converted), or a force over the initial area."""

    column: ColumnName | None = None
    """Nominal (engineering) stress."""
    true_stress: ColumnName | None = None
    """Cauchy stress at constant volume; converted to nominal stress by the true strain."""
    force: ColumnName | None = None
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
    despite_name: StrictBool = False
    """True: the name of the column says true or nominal wrongly, and the study is right."""

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


class TemperatureSource(SecondClock):
    """Temperature of a sensor on the specimen, in the same file or beside another clock."""

    column: ColumnName
    unit: Text | None = None


class LateralSource(SecondClock):
    """Strain across the load: a column of it, true strain (converted), or a change of width over the width."""

    column: ColumnName | None = None
    """Nominal (engineering) strain."""
    true_strain: ColumnName | None = None
    """Logarithmic strain; converted to nominal strain by exp(e) - 1."""
    extension: ColumnName | None = None
    """Change of the width (or of the diameter)."""
    width: Positive | None = None
    """mm, over which the change is measured; absent: width or diameter of the stress, else of the header of the file."""
    unit: Text | None = None
    """Unit of the column, where the file does not give it or gives it wrongly."""
    contraction: Tension = "negative"
    """Sign of the raw channel where the specimen gets narrower."""
    despite_name: StrictBool = False
    """True: the name of the column says true or nominal wrongly, and the study is right."""

    @model_validator(mode="after")
    def _one_source(self) -> LateralSource:
        _exactly_one(self, ("column", "true_strain", "extension"))
        _only_with(self, "extension", ("width",))
        return self

    @property
    def name(self) -> str:
        """Name of the column."""
        return str(self.column or self.true_strain or self.extension)


class CouponNoise(Section):
    """Standard deviations of single values; absent: estimated from the record."""

    strain: Positive | None = None
    stress: Positive | None = None
    """MPa"""
    temperature: Positive | None = None
    """K"""
    lateral: Positive | None = None


Column = Annotated[Annotated[ColumnName, Tag("~word")] | Annotated[ColumnSource, Tag("~column")], column_or("~column")]
Strain = Annotated[Annotated[ColumnName, Tag("~word")] | Annotated[StrainSource, Tag("~strain")], column_or("~strain")]
Stress = Annotated[Annotated[ColumnName, Tag("~word")] | Annotated[StressSource, Tag("~stress")], column_or("~stress")]
Temperature = Annotated[Annotated[ColumnName, Tag("~word")] | Annotated[TemperatureSource, Tag("~temperature")], column_or("~temperature")]
Lateral = Annotated[Annotated[ColumnName, Tag("~word")] | Annotated[LateralSource, Tag("~lateral")], column_or("~lateral")]


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
    where: Annotated[dict[Text, Text | Number], Field(default_factory=dict)]
    """Rows used, where one table holds several tests: column and the text or number (in its unit) that it holds in them."""
    name: Text | None = None
    """Absent: test, else the words of `where`, else the file's name."""
    time: Column | None = None
    """Column of time; absent only with one of the next two, or where the header of the file says the strain rate."""
    rate: Positive | None = None
    """Nominal strain rate, 1/s: builds the time of a record that has none, along the path of the strain."""
    sampling_rate: Positive | None = None
    """Rows per second: builds the time of a record that has none from the number of the row."""
    date: ColumnName | None = None
    """Column of dates, by which another clock can be joined; absent: the only one, else the header of the file."""
    strain: Strain
    stress: Stress
    temperature: Temperature | None = None
    lateral: Lateral | None = None
    """Strain across the load."""
    initial_temperature_degC: Celsius | None = None
    """Of specimen before the test; absent: from header or a column that holds one value, else the first values of the sensor."""
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
    leave_out: Annotated[tuple[Annotated[Whole, Field(ge=0)], ...], AfterValidator(_rows_increase)] = ()
    """Data rows (first: 0) that are left out, such as single wild samples."""
    strain_zero: Literal["elastic-line", "as-measured"] = "elastic-line"
    """elastic-line: strain is counted from where the elastic line meets zero stress; as-measured: it is not shifted."""
    points: Annotated[Count, Field(ge=10)] | None = None
    """Thin to about this many samples, turning points kept; absent: all."""
    noise: CouponNoise = CouponNoise()
    confirmed: tuple[Literal["time", "temperature", "strain", "stress"], ...] = ()
    """Questions about the plausibility of the record whose answer is: the data are right."""
    held_out: StrictBool = False
    """True: predicted by `validate`, never fitted."""

    _origin: tuple[str, tuple[str, ...]] = PrivateAttr(default=("", ()))
    """Key of the series that the record is one of, and what was taken of its entry, in words."""

    @model_validator(mode="after")
    def _one_clock(self) -> CouponRecordSettings:
        given = [key for key in ("time", "rate", "sampling_rate") if getattr(self, key) is not None]
        if len(given) > 1:
            raise content_error(f"gives {' and '.join(given)}; expected exactly one of time, rate, sampling_rate")
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
    def place(self) -> str:
        """Key of the series that the record is one of, with its name; empty for an entry of `records`."""
        return self._origin[0]

    @property
    def taken(self) -> tuple[str, ...]:
        """What was taken from the entry of the series or the name of the file, in words."""
        return self._origin[1]

    @property
    def label(self) -> str:
        """Name of the record."""
        return (
            self.name
            or self.test
            or " ".join(f"{value}" for value in self.where.values())
            or self.file.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]
        )


class CouponSeriesSettings(CouponRecordSettings):
    """Many records alike: the files, what differs from file to file, and what all have in common (the other keys)."""

    file: Literal[""] = ""
    """Not here: see `files`."""
    files: Annotated[Text | tuple[Text, ...], Field(min_length=1)]
    """A list of files, or a pattern: * and ? as in a shell, {rate} and the like for what the name of the file says (see `each`)."""
    each: Annotated[dict[str, tuple[Number | Text | StrictBool, ...]], Field(default_factory=dict)]
    """Values for each file, in the order of `files`: rate, temperature_degC (or _K, _degF), air_temperature_degC, area, diameter, width,
    thickness, gauge_length, name, test, held_out, where.COLUMN."""

    @model_validator(mode="before")
    @classmethod
    def _files_not_file(cls, given: Any) -> Any:
        if isinstance(given, dict) and "file" in given:
            raise content_error("is given in a series; expected its files under 'files'", key="file")
        return given


class Places(Section):
    """Places along the axis that become sections, one every so many mm; a section is the mean of the points near it."""

    first: Number = Field(alias="from")
    """mm"""
    last: Number = Field(alias="to")
    """mm"""
    every: Positive
    """mm"""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, given: Any) -> Any:
        """As every section; the keys are those of the file."""
        known = ("from", "to", "every")
        if isinstance(given, dict) and (wrong := [str(key) for key in given if key not in known]):
            raise unknown_key(wrong[0], known)
        return given

    @model_validator(mode="after")
    def _several(self) -> Places:
        if self.last - self.first < 2.0 * self.every:
            raise content_error(
                f"are from {self.first:g} to {self.last:g} mm, one every {self.every:g} mm; expected three sections at least"
            )
        return self

    @property
    def y(self) -> tuple[float, ...]:
        """Places of the sections, mm."""
        count = int((self.last - self.first) / self.every + 1e-9) + 1
        return tuple(self.first + k * self.every for k in range(count))


class RowSettings(Section):
    """Strain along the axis of a strip over time, without a force: a table, places in its first row, times in its first column."""

    file: Text
    """Relative to the study file; may hold ${VARIABLES} of the environment."""
    sheet: Text | None = None
    """Of a workbook; absent: its only one."""
    name: Text | None = None
    """Absent: the file's name."""
    strain: Literal["nominal", "logarithmic"]
    """What the table holds."""
    places: Places
    temperature_degC: Celsius
    """Declared temperature of the hottest section."""
    window: Interval | None = None
    """First and last time used, s."""
    strain_max: Positive | None = None
    """The record ends where the strain of a section, as the table holds it, first exceeds this."""
    points: Annotated[Count, Field(ge=10)] | None = None
    """Means over about this many equal intervals of time; absent: every row."""
    area: tuple[Positive, ...] = ()
    """Cross-section of every section over a common one, in the order of the places; absent: all alike."""
    noise: Positive | None = None
    """Standard deviation of the strain of a section; absent: estimated from the record."""
    held_out: StrictBool = False
    """True: predicted by `validate`, never fitted."""

    @model_validator(mode="after")
    def _area_of_each(self) -> RowSettings:
        if self.area and len(self.area) != len(self.places.y):
            raise content_error(f"has {len(self.area)} values for {len(self.places.y)} places; expected one for each", key="area")
        return self

    @property
    def label(self) -> str:
        """Name of the row."""
        return self.name or self.file.replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0]


ROW = "mean-strain"
"""Control of rows: the mean strain of the sections."""


class Coupon(Section):
    """Uniaxial records of coupons, and what drives the model through them."""

    records: tuple[CouponRecordSettings, ...] = ()
    rows: tuple[RowSettings, ...] = ()
    """Strips whose strain was measured along the axis, without a force; instead of records."""
    series: tuple[CouponSeriesSettings, ...] = ()
    """Entries for many files alike; once the study is read, their records are among `records`."""
    control: Literal["strain", "stress", "mean-strain"] = "strain"
    """What is prescribed: the measured strain (then the stress is compared), the measured stress, or of rows the mean strain of all
    sections (then that of each is compared)."""
    heat: Literal["law", "measured-work"] = "law"
    """What heats the specimen: stress and flow of the law, or the work of the measured stress on the measured plastic strain. Of that work
    the share `beta` becomes heat, and no error of the hardening law reaches the temperature."""

    @model_validator(mode="before")
    @classmethod
    def _rows_have_one_control(cls, given: Any) -> Any:
        """Rows say what drives them."""
        return {"control": ROW, **given} if isinstance(given, dict) and given.get("rows") else given

    @model_validator(mode="after")
    def _rows_alone(self) -> Coupon:
        if bool(self.rows) != (self.control == ROW):
            raise content_error(f"is {self.control}; expected {ROW} for rows, strain or stress for records", key="control")
        if self.rows and (self.records or self.series):
            raise content_error("are given beside records; expected one of them in a study", key="rows")
        if self.rows and self.heat != "law":
            raise content_error("is measured-work, but a row has no measured stress; expected law", key="heat")
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> Coupon:
        kind: str = "rows" if self.rows else "records"
        members: tuple[CouponRecordSettings | RowSettings, ...] = self.rows or self.records
        labels = [record.label for record in members]
        for index, label in enumerate(labels):
            if label in labels[:index]:
                raise content_error(f"is '{label}' again; expected another name for every record", key=f"{kind}.{index}.name")
        if not members and not self.series:
            raise content_error("is missing: name the records, or many files alike under 'series'", key="records")
        if all(record.held_out for record in (*members, *self.series)):
            raise content_error("are all held out; expected at least one that is fitted", key=kind)
        return self

    @property
    def held_out(self) -> frozenset[str]:
        """Names of the records, or rows, that are never fitted."""
        every: tuple[CouponRecordSettings | RowSettings, ...] = (*self.records, *self.rows)
        return frozenset(one.label for one in every if one.held_out)
