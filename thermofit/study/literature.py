"""Sections `literature` and `compare` of the study file: what others found, and other models of the same data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from thermofit.core.parameters import is_known, known_names
from thermofit.study.errors import content_error, near_miss
from thermofit.study.section import HardeningName, Interval, NonNegative, Number, ParameterSettings, Section, SurfaceName, check_law
from thermofit.study.stages import Free

PRESSURE = "c_p"
"""Heat capacity at constant pressure, mJ/(mm^3 K): what tables give; c0 is that at constant elastic deformation (errata 6)."""


class Literature(Section):
    """A published value with its error, or a range, and where it is from."""

    value: Number | None = None
    sigma: NonNegative = 0.0
    """Standard error of the value."""
    range: Interval | None = None
    source: str = ""

    @model_validator(mode="after")
    def _one(self) -> Literature:
        if (self.value is None) == (self.range is None):
            raise content_error("gives both or neither of value and range; expected one of them")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper end: the range, or two standard errors about the value."""
        if self.range is not None:
            return self.range
        assert self.value is not None
        return self.value - 2.0 * self.sigma, self.value + 2.0 * self.sigma


def _form(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "~interval"
    return "~number" if isinstance(value, int | float) and not isinstance(value, bool) else "~published"


Published = Annotated[
    Annotated[Interval, Tag("~interval")] | Annotated[Number, Tag("~number")] | Annotated[Literature, Tag("~published")],
    Discriminator(_form),
]
LiteratureValues = Annotated[dict[str, Published], Field(default={})]


def published(value: Literature | float | tuple[float, float]) -> Literature:
    """A value of the section in its full form."""
    if isinstance(value, Literature):
        return value
    return Literature(range=value) if isinstance(value, tuple) else Literature(value=value)


def check_literature(values: dict[str, Any]) -> None:
    """Every name is a parameter, or c_p."""
    for name in values:
        if name != PRESSURE and not is_known(name):
            raise content_error(f"names no parameter: '{name}' is not known{near_miss(name, (*known_names(), PRESSURE))}", "literature")


class Candidate(Section):
    """A model that competes with that of the study on the same data; what is absent is that of the study."""

    model: Literal[1, 2] | None = None
    hardening: HardeningName | None = None
    """Hardening law; what it frees takes the place of what that of the study frees, and starts on the same curve."""
    yield_surface: SurfaceName | None = None
    """Yield surface; where that of the study has a free parameter, what this one frees takes its place."""
    parameters: ParameterSettings = Field(default={})
    """Starts, or fixed values, that differ, such as the amplitude of an effect."""
    free: Free | None = None
    """All that is fitted; absent: what the stages identify, and `add`."""
    add: tuple[str, ...] = ()
    """Effects, or parameters, that are fitted as well: [rate_power] or [H_lin]."""

    @model_validator(mode="after")
    def _one_law(self) -> Candidate:
        check_law(self.model, self.hardening)
        return self


CandidateName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
Candidates = Annotated[dict[CandidateName, Candidate], Field(default={})]
