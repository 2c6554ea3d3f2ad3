"""Section `stages` of the study file: what is identified from which channels, where and when, and how (thesis 5.1).

What they mean for records of coupons is said by `coupon_stage`: which parameters these determine, and from which channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, Tag, model_validator

from thermofit.core.errors import StudyError
from thermofit.core.parameters import acting
from thermofit.law.surface.catalogue import surfaces
from thermofit.study.coupon import ROW
from thermofit.study.errors import content_error
from thermofit.study.section import (
    Count,
    Interval,
    NonNegative,
    Number,
    ParameterName,
    Positive,
    Section,
    no_repeats,
    number_or,
    word_or,
)

Point = tuple[Number, Number]


class Region(Section):
    """A part of the measured face, some time or always, that is left out: a rectangle, a disc, a polygon, or a time alone."""

    x: Interval | None = None
    """mm"""
    y: Interval | None = None
    """mm"""
    centre: Point | None = None
    """mm, with `radius`: a disc."""
    radius: Positive | None = None
    polygon: Annotated[tuple[Point, ...], Field(min_length=3)] | None = None
    """Corners in mm, in order."""
    t: Interval | None = None
    """s; absent: always."""

    @model_validator(mode="after")
    def _one_shape(self) -> Region:
        if (self.centre is None) != (self.radius is None):
            given, other = ("centre", "radius") if self.radius is None else ("radius", "centre")
            raise content_error(f"is given without '{other}'; expected both for a disc", key=given)
        shapes = [self.x is not None or self.y is not None, self.centre is not None, self.polygon is not None]
        if sum(shapes) > 1:
            raise content_error("gives several shapes; expected one of x and y, centre and radius, or polygon, and another region for more")
        if not any(shapes) and self.t is None:
            raise content_error("is empty; expected x, y, centre and radius, polygon, or t")
        return self


class ChannelWindow(Section):
    """The part of the data that a channel compares; what is absent is not limited."""

    x: Interval | None = None
    """mm"""
    y: Interval | None = None
    """mm"""
    t: tuple[Interval, ...] = ()
    """Intervals of time in s; empty: the whole window of the stage."""


Mask = tuple[Region, ...]


Channel = Literal["u", "du", "theta", "dtheta", "force", "stress", "strain", "lateral"]
StageName = Literal["elastic", "plastic", "thermal"]
Method = Literal["least-squares", "trust-region", "gauss-newton", "nelder-mead", "bobyqa", "sbplx", "cobyla"]

Free = Annotated[tuple[ParameterName, ...], Field(min_length=1), AfterValidator(no_repeats)]
Window = Annotated[Annotated[Literal["auto", "all"], Tag("~word")] | Annotated[Interval, Tag("~interval")], word_or("~interval")]


class ComponentWeights(Section):
    """Weights of the x and y components, in 1/mm^2 (manual selection, thesis 2.6.3)."""

    x: NonNegative
    y: NonNegative


class ChannelSettings(Section):
    """How one channel enters the objective (2.24)."""

    weight: Annotated[
        Annotated[Positive, Tag("~number")]
        | Annotated[Literal["sigma", "balanced", "value", "max"], Tag("~word")]
        | Annotated[ComponentWeights, Tag("~components")],
        number_or("~components"),
    ] = "sigma"
    """`sigma`: 1/sigma^2. `balanced`: the same, then every balanced channel counts as much as any other, however many values it has.
    `value`: (2.25). `max`: (2.26). A number or {x: ..., y: ...}: manual, 1/unit^2."""
    window: ChannelWindow = ChannelWindow()
    """Where and when this channel is compared."""
    mask: Mask = ()
    """Regions that this channel leaves out."""


class RelativeDisplacement(Section):
    """Measure du that rigid-body motion cannot reach (2.10) to (2.17)."""

    scheme: Literal["rigid-body", "similarity", "neighbour", "gradient"] = "rigid-body"
    """`rigid-body`: best translation and rotation removed; `similarity`: a uniform scale too (a specimen that moves towards one camera);
    `neighbour`: (2.11) to (2.14); `gradient`: (2.15) to (2.17)."""
    components: Annotated[tuple[Literal["xx", "yy", "xy", "yx"], ...], Field(min_length=1), AfterValidator(no_repeats)] = ("xx", "yy")
    """Differences that `neighbour` and `gradient` use; xy of `gradient` is the mean of both shears (2.17)."""
    distance: Positive | None = None
    """Distance of the neighbour in mm; null: the next node."""
    reach: Positive | None = None
    """Largest distance of a neighbour in mm (the triangle of figure 2.12b); null: any."""

    @model_validator(mode="after")
    def _one_shear(self) -> RelativeDisplacement:
        if self.scheme == "gradient" and "yx" in self.components:
            raise content_error("holds yx, but the shear of 'gradient' is symmetric (2.17); expected xx, yy, xy", key="components")
        return self


class StrainMeasure(Section):
    """Channel strain: both sides by one scheme, from the displacements of all points near a point (least squares plane)."""

    measure: Literal["technical", "green-lagrange"] = "technical"
    """`technical`: free of small rotations; `green-lagrange`: of any rotation."""
    components: Annotated[tuple[Literal["xx", "yy", "xy"], ...], Field(min_length=1), AfterValidator(no_repeats)] = ("xx", "yy", "xy")
    radius: Positive | None = None
    """Points within this many mm take part; null: the next ring of points."""


Channels = Annotated[dict[Channel, ChannelSettings], Field(min_length=1)]


class StageSettings(Section):
    """One stage of the identification (thesis 5.1.1)."""

    free: Free
    channels: Channels
    window: Window
    """`auto`: the elastic range, found from the data; `all`; or [t0, t1] in s."""
    method: Method = "least-squares"
    """`least-squares`: `gauss-newton`; `trust-region`: scipy's; the others are NLopt's, without derivatives."""
    coupling: Literal["full", "one-way"] = "full"
    max_evaluations: Count = 2000
    tolerance: Annotated[Number, Field(gt=0, lt=1)] = 1.0e-5
    """Relative change of the parameters at which the search ends."""
    du: RelativeDisplacement = RelativeDisplacement()
    strain: StrainMeasure = StrainMeasure()

    @model_validator(mode="after")
    def _weights_fit_channels(self) -> StageSettings:
        for channel, settings in self.channels.items():
            if isinstance(settings.weight, ComponentWeights) and channel not in ("u", "du"):
                raise content_error("is {x: ..., y: ...}; expected a number: this channel has no components", f"channels.{channel}.weight")
            if isinstance(settings.weight, ComponentWeights) and settings.weight.x + settings.weight.y <= 0.0:
                raise content_error("is zero for x and y; expected at least one positive weight", f"channels.{channel}.weight")
        return self


class ElasticStage(StageSettings):
    """Elastic parameters from the elastic range of the displacements."""

    free: Free = ("E", "nu")
    channels: Channels = Field(default={"du": ChannelSettings()})
    window: Window = "auto"
    beside: Annotated[tuple[Literal["u", "rigid-body", "similarity", "neighbour", "gradient"], ...], AfterValidator(no_repeats)] = ()
    """Other measures of the displacement whose answers are shown beside that of the stage (thesis Table 5.2)."""


class PlasticStage(StageSettings):
    """Plastic parameters from the displacements."""

    free: Free = ("M_y0", "M_yinf", "H_exp", "F")
    channels: Channels = Field(default={"du": ChannelSettings()})
    window: Window = "all"


class ThermalStage(StageSettings):
    """Thermal parameters from the temperatures."""

    free: Free = (
        "alpha_exp",
        "kappa",
        "c0",
        "beta",
        "alpha_air",
        "alpha_clamp",
    )
    channels: Channels = Field(default={"dtheta": ChannelSettings()})
    window: Window = "all"
    coupling: Literal["full", "one-way"] = "one-way"


class Stages(Section):
    """The three stages of the identification; one that is not listed has these defaults."""

    elastic: ElasticStage = ElasticStage()
    plastic: PlasticStage = PlasticStage()
    thermal: ThermalStage = ThermalStage()


CHANNELS = ("stress", "strain", "lateral", "theta", "dtheta")
"""Channels of a coupon record."""
FREE: Mapping[str, tuple[str, ...]] = {
    "elastic": ("E",),
    "thermal": ("alpha_exp", "beta", "tau", "lag"),
}
"""What a stage identifies from coupons where the study does not say; stage plastic what the hardening law frees."""
ACROSS: Mapping[str, tuple[str, ...]] = {"elastic": ("nu",), "plastic": ("F",), "thermal": ()}
"""What it identifies besides from a strain across the load: the contraction, and of Hill's parameters the ratio F/H."""
BY_LATERAL = ("nu", "F")
"""Parameters that a coupon tells by its strain across the load alone."""
COUPON_CHOICES = ("E", "nu", "F")
"""Parameters that a stage identifies from coupons only where the study gives a start: what it gives as a plain number is prescribed."""
UNDETERMINED = set(acting("across", "conduction", "film")) - set(acting("coupon"))
"""Parameters that load, elongation and temperature of a coupon do not tell: they have no influence, or that of another one."""


def coupon_stage(
    source: str,
    name: str,
    settings: StageSettings,
    control: str,
    *,
    hardening: tuple[str, ...],
    wanted: tuple[str, ...] = ("E",),
    lateral: bool = False,
) -> StageSettings:
    """Settings of a stage on records of coupons, defaults filled in; `source` is the name of the study file, `hardening` what the hardening
    law frees, `wanted` are those of COUPON_CHOICES for which the study gives a start, and of
    `hardening` those that it does not prescribe, `lateral` whether a record has a strain across the
    load.

    Nothing is free in an elastic stage whose E is prescribed. StudyError for a parameter that a coupon does not determine, and for a
    channel that it does not have.
    """
    measured = "stress" if control == "strain" else "strain"
    free = settings.free
    if "free" not in settings.model_fields_set:
        across = ACROSS[name] if lateral else ()
        free = tuple(p for p in (*(hardening if name == "plastic" else FREE[name]), *across) if p not in COUPON_CHOICES or p in wanted)
        if control == ROW:  # strains alone tell the shape of the hardening; what the study prescribes gives the scale
            free = tuple(p for p in hardening if name == "plastic" and p in wanted)
    if control == ROW:
        if "E" in free:
            raise StudyError(
                f"{source}: key 'stages.{name}.free' holds E, which strains without a force do not tell; give E as a number in MPa"
            )
        if hardening and set(hardening) <= set(free):
            raise StudyError(
                f"{source}: key 'stages.{name}.free' holds all of {', '.join(hardening)}; without a force the scale of the stress is not "
                f"determined: give one of them, such as {hardening[0]}, as a number under 'parameters', and leave it out here"
            )
    channels = settings.channels
    if "channels" not in settings.model_fields_set:
        names = ["dtheta" if name == "thermal" else measured]
        names += ["lateral"] if lateral and set(free) & set(BY_LATERAL) else []
        channels = {channel: ChannelSettings() for channel in names}  # type: ignore[misc]
    told = BY_LATERAL if "lateral" in channels else ()
    of_surfaces = {p.name for one in surfaces() for p in one.own}
    seen_across = {*told, *of_surfaces} if told else set()
    if lost := [parameter for parameter in free if parameter in UNDETERMINED | of_surfaces and parameter not in seen_across]:
        also = " without the channel lateral" if set(lost) <= {*BY_LATERAL, *of_surfaces} else ""
        raise StudyError(
            f"{source}: key 'stages.{name}.free' holds {', '.join(lost)}, which records of coupons do not determine{also}: leave it out, "
            "and give its value under 'parameters'"
        )
    if unknown := [channel for channel in channels if channel not in CHANNELS]:
        raise StudyError(
            f"{source}: key 'stages.{name}.channels' holds {', '.join(unknown)}; records of coupons have {', '.join(CHANNELS)}"
        )
    if control in channels:
        raise StudyError(
            f"{source}: key 'stages.{name}.channels' holds {control}, which is prescribed (coupon.control); compare {measured} instead"
        )
    for channel, own in channels.items():
        if own.window.x or own.window.y or any(region.t is None for region in own.mask):
            raise StudyError(
                f"{source}: key 'stages.{name}.channels.{channel}' limits places, which a record does not have; expected a "
                "window or a mask in t alone"
            )
    return settings.model_copy(update={"free": free, "channels": channels})
