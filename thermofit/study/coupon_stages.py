"""What the stages of the identification mean for records of coupons: which parameters they can determine, and from which channels."""

from __future__ import annotations

from collections.abc import Mapping

from thermofit.core.errors import StudyError
from thermofit.core.parameters import acting
from thermofit.study.stages import ChannelSettings, StageSettings

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
    law frees, `wanted` are those of COUPON_CHOICES for which the study gives a start, `lateral` whether a record has a strain across the
    load.

    Nothing is free in an elastic stage whose E is prescribed. StudyError for a parameter that a coupon does not determine, and for a
    channel that it does not have.
    """
    measured = "stress" if control == "strain" else "strain"
    free = settings.free
    if "free" not in settings.model_fields_set:
        across = ACROSS[name] if lateral else ()
        free = tuple(p for p in (*(hardening if name == "plastic" else FREE[name]), *across) if p not in COUPON_CHOICES or p in wanted)
    channels = settings.channels
    if "channels" not in settings.model_fields_set:
        names = ["dtheta" if name == "thermal" else measured]
        names += ["lateral"] if lateral and set(free) & set(BY_LATERAL) else []
        channels = {channel: ChannelSettings() for channel in names}  # type: ignore[misc]
    told = BY_LATERAL if "lateral" in channels else ()
    if lost := [parameter for parameter in free if parameter in UNDETERMINED and parameter not in told]:
        also = " without the channel lateral" if set(lost) <= set(BY_LATERAL) else ""
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
