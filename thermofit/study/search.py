"""Sections `gridsearch` and `sensitivity` of the study file: the same stage from other starts, or with other prescribed values."""

from __future__ import annotations

import re
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, model_validator

from thermofit.core.parameters import NAMES, is_known, known_names
from thermofit.study.errors import content_error, near_miss
from thermofit.study.section import Count, Number, ParameterName, ParameterValues, Section, Whole, physical_error
from thermofit.study.stages import Channel, StageName

THICKNESS, CLOCK = "thickness", "clock"
_WEIGHT = re.compile(r"weight\.(?P<channel>[a-z]+)(\.(?P<component>[xy]))?")


class DrawnStarts(Section):
    """Starts spread over the bounds of the free parameters."""

    method: Literal["latin-hypercube", "sobol"] = "latin-hypercube"
    """Both scrambled by the seed; `sobol` fills best with a power of two."""
    number: Annotated[Count, Field(le=4096)]
    seed: Annotated[Whole, Field(ge=0)]
    within: dict[ParameterName, tuple[Number, Number]] = Field(default={})
    """Ranges to draw from, where they are not the bounds of the parameter."""

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> DrawnStarts:
        for name, (low, high) in self.within.items():
            if low >= high:
                raise content_error(f"is [{low:g}, {high:g}]; expected the lower end first, and below the upper one", f"within.{name}")
            for value in (low, high):
                if text := physical_error(name, value):
                    raise content_error(text, f"within.{name}")
        return self


class GridSearch(Section):
    """The same stage from several starts (thesis 2.8): is the optimum unique?"""

    stage: StageName
    starts: tuple[ParameterValues, ...] = ()
    """Listed starts; a parameter that is not named starts as in `parameters`."""
    draw: DrawnStarts | None = None
    """Further starts, drawn."""

    @model_validator(mode="after")
    def _has_starts(self) -> GridSearch:
        if not self.starts and self.draw is None:
            raise content_error("holds no starts; list them under 'starts', or let them be drawn: draw: {number: 10, seed: 1}")
        return self


def weight_of(quantity: str) -> tuple[str, str | None] | None:
    """Channel and component of weight.<channel> or weight.<channel>.<x or y>, None for another quantity."""
    found = _WEIGHT.fullmatch(quantity)
    return None if found is None else (found["channel"], found["component"])


def _known_quantity(name: str) -> str:
    weight = weight_of(name)
    if weight is not None and weight[0] not in get_args(Channel):
        raise content_error(f"is {name}, but there is no channel {weight[0]}{near_miss(weight[0], get_args(Channel))}")
    if weight is None and name not in (THICKNESS, CLOCK) and not is_known(name):
        raise content_error(
            f"names nothing that can be prescribed: '{name}' is not known{near_miss(name, (*known_names(), THICKNESS, CLOCK))}"
        )
    return name


_SCHEMA = {"anyOf": [{"enum": [*NAMES, THICKNESS, CLOCK]}, {"pattern": r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_.]+)?(@[A-Za-z0-9_-]+)?$"}]}
Quantity = Annotated[str, AfterValidator(_known_quantity), Field(json_schema_extra=_SCHEMA)]


class Sensitivity(Section):
    """The same stage with other prescribed values of one quantity (Tables 5.20, 5.21)."""

    stage: StageName
    quantity: Quantity
    """A parameter that the stage does not identify (theta_clamp, theta_air, ...), or `thickness` of the specimen in mm. `clock`: seconds
    added to the times of the infrared frames. `weight.<channel>`: factor on the weight of a channel. `weight.<channel>.x` or `.y`: its
    manual weight in 1/mm^2."""
    values: Annotated[tuple[Number, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _values_are_physical(self) -> Sensitivity:
        for value in self.values:
            if text := self._error(value):
                raise content_error(text, key="values")
        return self

    def _error(self, value: float) -> str | None:
        """What is wrong with a value, None where nothing is."""
        if is_known(self.quantity):
            return physical_error(self.quantity, value)
        if self.quantity != CLOCK and value <= 0.0:
            return f"is {value:g}; expected a positive number for {self.quantity}"
        return None
