"""Section `diagnosis` of the study file: how the residual is traced to effects, and how an effect has to prove itself."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, field_validator

from thermofit.core.parameters import AT, param
from thermofit.core.parameters import THERMOCOUPLES as THERMOCOUPLES
from thermofit.study.errors import content_error
from thermofit.study.section import Mesh, ParameterName, Positive, Section, Whole, no_repeats
from thermofit.study.stages import Channel, Free


class Diagnosis(Section):
    """`diagnose` and `close-loop`: mesh, held-out data, number of effects."""

    channels: Annotated[tuple[Channel, ...], Field(min_length=1), AfterValidator(no_repeats)] | None = None
    """Channels of the joint model; null: all that the stages compare."""
    free: Free | None = None
    """Parameters that take part; null: all that any stage identifies, and the thermocouples with their error."""
    mesh: Mesh | None = None
    """Mesh of the joint model; null: that of the study, but not finer than `coarse`. The error of mesh and steps is measured and counts."""
    held_out: Literal["blocks", "phases"] = "blocks"
    """What the fit does not see: buffered blocks of time and length, or whole load phases."""
    max_effects: Annotated[Whole, Field(ge=0, le=20)] = 3
    """Most effects that `close-loop` adds."""
    priors: dict[ParameterName, Positive | None] = Field(default={})
    """Standard error of a declared value in the unit of the parameter; null: none. For the thermocouples `theta_air`, `theta_clamp` it is
    0.1 K where nothing is given. For an effect it is that of its amplitude about neutral (`clamp_difference.difference` 0.5 K)."""

    @field_validator("priors")
    @classmethod
    def _declared(cls, given: dict[str, float | None]) -> dict[str, float | None]:
        """Thermocouples and amplitudes of effects; what a test identifies has no declared value."""
        for name in given:
            if AT in name or (name not in THERMOCOUPLES and ("." not in name or param(name).scan)):
                expected = f"{', '.join(THERMOCOUPLES)} or the amplitude <effect>.<param> of an effect, for all experiments"
                raise content_error(f"has no declared value; expected {expected}", key=name)
        return given
