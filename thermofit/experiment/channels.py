"""Channels of the objective (2.7): which field is behind each, and its comparison as a stage asks for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermofit.experiment.fields import Measured
from thermofit.observe.comparison import Comparison, RelativeScheme, Weight, plain, relative_displacements, temperature_change
from thermofit.observe.observation import FieldObservation
from thermofit.observe.selection import selected
from thermofit.observe.strain import StrainScheme, strains
from thermofit.study.stages import ChannelSettings, StageSettings
from thermofit.study.study import Study

FIELDS = {"u": "u", "du": "u", "strain": "u", "force": "force", "stress": "force", "theta": "theta", "dtheta": "theta"}
"""The observed field behind a channel of a body; stress is force over the area, strain is made of displacements on both sides."""
_MECHANICAL = ("u", "du")


def field_of(compared: Comparison | str) -> str:
    """The observed field behind a comparison or a channel; of a coupon stress and strains are fields themselves."""
    if isinstance(compared, Comparison):
        return compared.field or field_of(compared.channel)
    if compared in ("force", "stress", "strain", "lateral"):
        return compared
    return "u" if compared in _MECHANICAL else "theta"


def reference_times(observation: FieldObservation, study: Study, load_start: float) -> np.ndarray:
    """True (n_t,) at the times that dtheta refers to: the one that the study names, else all before loading (2.22)."""
    wanted = study.evaluation.reference_time
    if wanted is None:
        return np.asarray(observation.time <= load_start + 1e-9)
    return np.asarray(np.arange(len(observation.time)) == int(np.argmin(np.abs(observation.time - wanted))))


def weight_of(settings: ChannelSettings) -> Weight:
    """The weight of a channel as a comparison takes it."""
    weight = settings.weight
    if isinstance(weight, float | str):
        return weight
    return (weight.x, weight.y)


def comparisons_of(
    settings: StageSettings, observations: Mapping[str, FieldObservation], study: Study, data: Measured
) -> tuple[Comparison, ...]:
    """The comparisons of all channels of a stage on a body, balanced ones evened out. DataError where a window leaves nothing."""
    found = tuple(comparison(channel, observations[FIELDS[channel]], settings, study, data) for channel in settings.channels)
    return balanced(found, [settings.channels[c].weight == "balanced" for c in settings.channels])


def balanced(comparisons: Sequence[Comparison], which: Sequence[bool]) -> tuple[Comparison, ...]:
    """Comparisons of which the balanced ones weigh alike: 1/sigma^2 times N/(K n) of K such channels with N values, n of them its own."""
    counts = [c.n for c, wanted in zip(comparisons, which, strict=True) if wanted]
    total, number = sum(counts), len(counts)
    return tuple(c.scaled(total / (number * c.n)) if wanted else c for c, wanted in zip(comparisons, which, strict=True))


def comparison(channel: str, observation: FieldObservation, settings: StageSettings, study: Study, data: Measured) -> Comparison:
    """The comparison of one channel of a body as a stage asks for it."""
    own = settings.channels[channel]  # type: ignore[index]
    weight = weight_of(own)
    reference = reference_times(observation, study, data.load_start) if channel == "dtheta" else None
    seen = selected(observation, own.window, own.mask, reference)
    if channel == "du":
        du = settings.du
        return relative_displacements(seen, RelativeScheme(du.scheme, du.components, du.distance, du.reach), weight)
    if channel == "strain":
        scheme = settings.strain
        return replace(strains(seen, StrainScheme(scheme.measure, scheme.components, scheme.radius), weight), field="u")
    if channel == "stress":
        return nominal_stress(seen, data.specimen.gauge_width * data.specimen.thickness, weight)
    if reference is not None:
        return temperature_change(seen, reference, weight)
    return plain(seen, weight)


def nominal_stress(force: FieldObservation, area: float, choice: Weight) -> Comparison:
    """Channel stress (2.19): force over the initial cross-section, mm^2, in MPa."""
    seen = replace(force, name="stress", value=force.value / area, sigma=force.sigma / area, unit="MPa")
    compared = plain(seen, choice)
    return replace(compared, residual=lambda e: compared.residual(e / area), field="force")
