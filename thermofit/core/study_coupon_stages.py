"""What the stages of the identification mean for records of coupons: which parameters they can determine, and from which channels."""

from __future__ import annotations

from collections.abc import Mapping

from thermofit.core.errors import StudyError
from thermofit.core.study_stages import ChannelSettings, StageSettings

CHANNELS = ("stress", "strain", "theta", "dtheta")
"""Channels of a coupon record."""
FREE: Mapping[str, tuple[str, ...]] = {
    "elastic": ("E",),
    "plastic": ("M_y0", "M_yinf", "H_exp"),
    "thermal": ("alpha_exp", "beta", "tau", "lag"),
}
"""What a stage identifies from coupons where the study does not say."""
UNDETERMINED = ("nu", "F", "G", "H", "L", "M", "N", "kappa", "alpha_air", "alpha_clamp", "theta_clamp")
"""Parameters that load, elongation and temperature of a coupon do not tell: they have no influence, or that of another one."""


def coupon_stage(source: str, name: str, settings: StageSettings, control: str) -> StageSettings:
    """Settings of a stage on records of coupons, defaults filled in; `source` is the name of the study file.

    StudyError for a parameter that a coupon does not determine, and for a channel that it does not have.
    """
    free = settings.free if "free" in settings.model_fields_set else FREE[name]
    if lost := [parameter for parameter in free if parameter in UNDETERMINED]:
        raise StudyError(
            f"{source}: key 'stages.{name}.free' holds {', '.join(lost)}, which records of coupons do not determine: leave it out, and "
            "give its value under 'parameters'"
        )
    measured = "stress" if control == "strain" else "strain"
    channels = settings.channels
    if "channels" not in settings.model_fields_set:
        channels = {"dtheta": ChannelSettings()} if name == "thermal" else {measured: ChannelSettings()}  # type: ignore[dict-item]
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
