"""Section `diagnosis` of the study file: how the residual is traced to effects, and how an effect has to prove itself."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from thermofit.core.study_section import Mesh, Section, Whole, no_repeats
from thermofit.core.study_stages import Channel, Free


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
