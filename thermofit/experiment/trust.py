"""One rule for verdict and exit code: when the answer of `verify`, `validate`, `diagnose`, `close-loop` and so of `run` is trusted.

An answer is trusted where nothing speaks against it: every compared channel is at its floor, as a whole and in every phase of the test, no
declared reading is farther off than its error explains, the fit has settled, every fitted parameter has a value of its own, every
candidate could be judged, and no other effect explains the data as well as an added one. The floor of a channel is its noise and what the
error of mesh and steps that may be left would make, where that is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.parameters import Parameters, bare_name, param
from thermofit.experiment.model import Prior
from thermofit.experiment.priors import off_declared
from thermofit.fit.result import FitResult

WHOLE = 1.25
"""Times its floor from which the rms of a channel over the whole test is more than noise."""
PHASE = 1.5
"""The same of one phase of the test, in which fewer values speak."""
CHANCE = 4.0
"""Standard deviations of the rms of so few values of white noise that a phase has to exceed as well."""
READING = 3.0
"""Standard errors off its reading from which a declared value speaks against the answer."""
AT_BOUND = 0.01
"""Part of the way from neutral to a bound, and of the range between both, within which a value is at that bound."""

Bounds = Callable[[str], tuple[float, float]]
"""Lower and upper bound of a parameter by its name."""


@dataclass(frozen=True)
class ChannelLevel:
    """Rms of a channel over its floor, in the whole test or in one phase of `n` values; `largest`: time in s of the value that is farthest
    off, and how far it is, over the same floor."""

    channel: str
    over: float
    n: int
    phase: str = ""
    largest: tuple[float, float] | None = None

    @property
    def above(self) -> bool:
        """True where it is more than its floor explains."""
        return self.over > (max(PHASE, 1.0 + CHANCE / np.sqrt(2.0 * self.n)) if self.phase else WHOLE)

    @property
    def words(self) -> str:
        """How far it is above its floor, and where; whether a single value makes that, which is to be looked at before any effect."""
        where, single = f" in {self.phase}" if self.phase else "", ""
        if self.largest is not None and self.n > 1:
            time, off = self.largest
            rest = replace(self, over=float(np.sqrt(max(self.n * self.over**2 - off**2, 0.0) / (self.n - 1))), n=self.n - 1)
            single = f" (one value makes that, at {time:.4g} s, {off:.2g} times its noise)" if self.above and not rest.above else ""
        return f"{self.channel} is {self.over:.2g} times its noise{where}{single}"


def level(channel: str, chi2: float, numerical: float, n: int, phase: str = "", largest: tuple[float, float] | None = None) -> ChannelLevel:
    """Level from the mean square of whitened rows and that of what the error of mesh and steps would make of them; `largest`: time in s and
    size of the whitened row that is farthest off."""
    farthest = None if largest is None else (largest[0], largest[1] / float(np.sqrt(1.0 + numerical)))
    return ChannelLevel(channel, float(np.sqrt(chi2 / (1.0 + numerical))), n, phase, farthest)


def above_floor(levels: Iterable[ChannelLevel]) -> list[ChannelLevel]:
    """Levels that are more than noise: a channel as a whole, or else the worst of its phases, once for each channel."""
    worst: dict[str, ChannelLevel] = {}
    for one in sorted(levels, key=lambda found: (found.phase != "", -found.over)):
        if one.above:
            worst.setdefault(one.channel, one)
    return list(worst.values())


def physical(name: str) -> tuple[float, float]:
    """Physical bounds of a parameter, where no study narrows them."""
    return param(name).lower, param(name).upper


def at_bound(value: float, bounds: tuple[float, float], neutral: float = 0.0) -> bool:
    """True within AT_BOUND of the way from neutral to a bound, or of the range where that is shorter; a bound that is neutral itself is no
    such end: there the mechanism is off."""
    ends = [(bound, min(abs(bound - neutral), bounds[1] - bounds[0])) for bound in bounds]
    return any(np.isfinite(way) and way > 0.0 and abs(value - bound) <= AT_BOUND * way for bound, way in ends)


def undetermined(parameters: Parameters, fit: FitResult, bounds: Bounds = physical) -> dict[str, str]:
    """Fitted parameters that have no value of their own, each in words: at a bound, or without a standard error."""
    out = {}
    for k, name in enumerate(fit.names):
        p, value, own = param(name), parameters[name], bounds(name)
        is_amplitude = "." in bare_name(name) and not p.scan
        if not p.limiting and at_bound(value, own, p.neutral if is_amplitude else 0.0):
            out[name] = f"{name} ends at its bound: {value:.4g} {p.unit}, bounds {own[0]:g} to {own[1]:g}"
        elif fit.sigma is None or not (np.isfinite(fit.sigma[k]) or fit.at_bound[k]):
            out[name] = f"{name} = {value:.4g} {p.unit} has no standard error: the data do not determine it"
    return out


def grade(added: Mapping[str, Sequence[str]], more_than_noise: bool, unlisted: Mapping[str, object] | None) -> str:
    """What kind of answer a diagnosis is. `added`: effects that it names, each with those that the data do not tell from it; whether more
    than its floor is left in a channel; the entry `unlisted` of a result.

    `complete`: nothing is missing; `named`; `named-as-family`; `unlisted`: a term without a name, reconstructed in place and time, or over
    the state of the material;
    `unexplained`: more than noise, and no term takes it.
    """
    if unlisted is not None:
        told = unlisted.get("when_s") is not None or unlisted.get("over_state") is not None
        return "unlisted" if told else "unexplained"
    if more_than_noise:
        return "unexplained"
    if not added:
        return "complete"
    return "named-as-family" if any(added.values()) else "named"


def doubts(
    levels: Iterable[ChannelLevel],
    readings: tuple[Sequence[Prior], Parameters] | None = None,
    unjudged: Mapping[str, str] | None = None,
    unsettled: str = "",
    ends: Mapping[str, str] | None = None,
    unpredicted: Mapping[str, str] | None = None,
    alike: Mapping[str, Sequence[str]] | None = None,
) -> list[str]:
    """Sentences that speak against an answer, none where it is trusted. `readings` = (declared values, the parameters beside them),
    `unjudged` effects with the reason, `unsettled` why a fit has not come to its end, `ends` what is `undetermined`, `unpredicted` declared
    held-out tests that the model cannot be run through, with the reason, `alike` effects that the data do not tell from an added one."""
    out = [f"{one.words}: more than noise is left" for one in above_floor(levels)]
    out += [] if readings is None else off_declared(*readings, READING)
    out += list((ends or {}).values())
    out += [f"{name} could not be judged, and may be what is missing: {why}" for name, why in (unjudged or {}).items()]
    out += [f"held-out {name} was not predicted and judges nothing: {why}" for name, why in (unpredicted or {}).items()]
    out += [f"the data do not tell {name} from {', '.join(others)}" for name, others in (alike or {}).items() if others]
    return out + ([f"the last fit has not settled: {unsettled}"] if unsettled else [])
