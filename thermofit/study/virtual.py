"""Section `simulate` of the study file: a virtual experiment, its testing machine and its instruments.

The virtual laboratory works by these sections as they are.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from thermofit.core.experiment import Specimen
from thermofit.study.errors import content_error
from thermofit.study.section import (
    HardeningName,
    Mesh,
    ModelNumber,
    NonNegative,
    Number,
    ParameterValues,
    Positive,
    Section,
    SurfaceName,
    Whole,
    check_law,
    law_named,
)


def _moves(rate: float) -> float:
    if rate == 0.0:
        raise content_error("is 0; expected the speed of the crosshead in mm/s, negative downwards")
    return rate


def _pulls(value: float) -> float:
    if value < 0.0:
        raise content_error(f"is {value:g}; expected a number >= 0 (a sheet buckles in compression)")
    return value


Rate = Annotated[Number, AfterValidator(_moves)]
Pulled = Annotated[Number, AfterValidator(_pulls)]


class VirtualSpecimen(Section):
    """Dogbone of the virtual experiment, mm (thesis figure 3.2)."""

    gauge_width: Positive = 25.0
    thickness: Positive = 1.2
    parallel_length: Positive = 100.0
    shoulder_radius: Positive = 25.0
    grip_width: Positive = 35.0
    total_length: Positive = 150.0
    gripped_length: Positive = 10.0

    def lengths(self) -> Specimen:
        """The specimen of these lengths."""
        return Specimen(**self.model_dump())


class Hold(Section):
    """The crosshead stands still for `hold` s."""

    kind: ClassVar[str] = "hold"
    hold: Positive


class CrossheadTo(Section):
    """The crosshead moves to `crosshead_to` mm at `rate` mm/s (negative: downwards)."""

    kind: ClassVar[str] = "crosshead_to"
    crosshead_to: Pulled
    rate: Rate


class ForceTo(Section):
    """The crosshead moves at `rate` mm/s until the force is `force_to` N."""

    kind: ClassVar[str] = "force_to"
    force_to: Pulled
    rate: Rate


class HoldForceUntil(Section):
    """The force is kept until the time `hold_force_until` s."""

    kind: ClassVar[str] = "hold_force_until"
    hold_force_until: Positive


_ACTIONS = tuple(action.kind for action in (Hold, CrossheadTo, ForceTo, HoldForceUntil))


def _action(value: Any) -> str:
    """Union member of a programme item: the action whose key it holds."""
    names = value if isinstance(value, dict) else (getattr(value, "kind", None),)
    return "~" + next((name for name in _ACTIONS if name in names), "hold")


Action = Annotated[
    Annotated[Hold, Tag("~hold")]
    | Annotated[CrossheadTo, Tag("~crosshead_to")]
    | Annotated[ForceTo, Tag("~force_to")]
    | Annotated[HoldForceUntil, Tag("~hold_force_until")],
    Discriminator(_action),
]


class Machine(Section):
    """Testing machine: what the crosshead moves besides the specimen's elongation, and how it turns the specimen."""

    compliance: NonNegative = 1.0e-4
    """mm/N"""
    slip: NonNegative = 0.3
    """Slip of the jaws at full load, mm."""
    rotation_deg: Number = 0.05
    """Rigid-body rotation at full load, degrees."""
    drift: Number = 0.1
    """Lateral shift of the specimen at full load, mm."""


class VirtualDic(Section):
    """Virtual DIC system, mm; noise is a standard deviation."""

    stages: Annotated[Whole, Field(ge=2)] = 120
    spacing: Positive = 1.0
    noise_in_plane: NonNegative = 0.002
    noise_out_of_plane: NonNegative = 0.005
    lost_fraction: Annotated[Number, Field(ge=0, lt=1)] = 0.01
    half_width: Positive = 11.5
    """Half width of the measured area, mm; 1 mm at the edge of the specimen is never measured."""
    half_height: Positive = 25.0
    """Half height of the measured area, mm; 1 mm at the ends of the parallel part is never measured."""


class VirtualIr(Section):
    """Virtual infrared camera at the back of the specimen."""

    frames: Annotated[Whole, Field(ge=2)] = 130
    pixel_size: Positive = 0.4
    """mm"""
    roll_deg: Annotated[Number, Field(gt=-45, lt=45)] = 1.1
    netd: NonNegative = 0.025
    """Standard deviation of the noise of one pixel, K."""
    offset: Number = 0.5
    """Constant error of the absolute temperature, K."""
    blur_px: NonNegative = 0.7
    landmark_noise_px: NonNegative = 0.15
    background: Annotated[Number, Field(ge=200, le=1000)] = 296.5
    """Temperature of what is seen beside the specimen, K."""
    background_spread: NonNegative = 0.15
    """By how much it differs from that over the image, K."""
    image_shape: tuple[Annotated[Whole, Field(ge=8)], Annotated[Whole, Field(ge=8)]] = (218, 90)


class VirtualForce(Section):
    """Virtual load cell: `rate` Hz, `noise` N (standard deviation)."""

    rate: Positive = 10.0
    noise: NonNegative = 4.0
    crosshead_noise: NonNegative = 0.0007
    """Standard deviation of the reading of the crosshead, mm."""


class VirtualInstruments(Section):
    """Testing machine and instruments of a virtual experiment."""

    machine: Machine = Machine()
    dic: VirtualDic = VirtualDic()
    ir: VirtualIr = VirtualIr()
    force: VirtualForce = VirtualForce()
    thermocouple_error: NonNegative = 0.05
    """Standard deviation of the thermocouples of air and jaws, K."""


_PROGRAMME: tuple[Hold | CrossheadTo | ForceTo | HoldForceUntil, ...] = (
    Hold(hold=3.0),
    CrossheadTo(crosshead_to=9.5, rate=0.14),
    ForceTo(force_to=1500.0, rate=-0.14),
    CrossheadTo(crosshead_to=19.5, rate=0.14),
    ForceTo(force_to=0.0, rate=-0.14),
    HoldForceUntil(hold_force_until=400.0),
)


class Simulate(VirtualInstruments):
    """A virtual experiment: own kernel -> raw folder. `truth` names parameters of the law."""

    seed: Annotated[Whole, Field(ge=0)] = 1
    model: ModelNumber | None = None
    """Model of the virtual material; null: the one that is identified."""
    hardening: HardeningName | None = None
    """Hardening law of the virtual material; null: that of `model`."""
    yield_surface: SurfaceName | None = None
    """Yield surface of the virtual material; null: the one that is identified."""
    truth: ParameterValues
    mesh: Mesh = "full"
    specimen: VirtualSpecimen = VirtualSpecimen()
    programme: Annotated[tuple[Action, ...], Field(min_length=1)] = _PROGRAMME
    max_time_step: Positive | None = None
    """Longest step of the run while the force changes, s; null: `numerics.max_time_step`. A fit is corrected for the errors of its steps,
    the truth is not: shorter steps leave it less of them."""

    @model_validator(mode="after")
    def _one_law(self) -> Simulate:
        check_law(self.model, self.hardening)
        return self

    @property
    def hardening_law(self) -> str | None:
        """Name of the hardening law of the virtual material, None for the one that is identified."""
        return law_named(self.model, self.hardening)
