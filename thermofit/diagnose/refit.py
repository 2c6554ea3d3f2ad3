"""The joint fit of a diagnosis: everything that any stage identified, on all channels at once, every evaluation kept on disk."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermofit.body.solve.history import History
from thermofit.core.errors import NumericsError
from thermofit.core.jsonable import json_text
from thermofit.core.parameters import Param, Parameters, param
from thermofit.core.slots import Slots
from thermofit.diagnose.case import HeatFit
from thermofit.effects.catalogue import effect, effect_of_param
from thermofit.experiment.joint import JointParts
from thermofit.experiment.known_motion import acting_on_temperatures
from thermofit.experiment.model import StageModel
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Hooks, Settings
from thermofit.identify.solve import (
    F_TOLERANCE,
    Follower,
    checkpoint_folder,
    covariance_of,
    evaluation_key,
    method_of,
    remembering,
    stage_problem,
)
from thermofit.identify.variables import fit_variables
from thermofit.law.composition import FACTORS, SUMS
from thermofit.law.page import law_of
from thermofit.records.checkpoint import Checkpoint
from thermofit.records.progress import progress
from thermofit.records.staging import Job
from thermofit.study.models import start_of
from thermofit.study.stages import StageSettings
from thermofit.study.study import Study

EXPONENTS = " exponents"
"""Ending of the label of a refit with exponents free, for whoever reads it."""
EXPONENT_EVALUATIONS = 12
REFIT_EVALUATIONS = 16
"""Evaluations after which a fit that still moves is judged where it stands: in a valley the last per mille take the longest."""
OFTEN = 4
"""Times as many where a run costs next to nothing."""
STRONGER = (1.0, 2.0, 4.0)
"""Multiples of an amplitude that are tried in turn where the force cannot be carried with it at the start."""
COARSELY = 1e-3
"""The same for one of several values of an exponent that are compared."""
VAGUE = 0.5
"""Standard error over its value of an exponent, above which the data do not determine it: two of them reach nothing."""
PART_EVALUATIONS = 12
"""Evaluations for displacements alone: what they leave, the joint fit does."""
HEAT_EVALUATIONS = 60
NEAR_EVALUATIONS = 16
"""The same from parameters that the missing heat has not driven off: what is still on its way then is no name for it."""
NEGLIGIBLE = 3e-5
"""Fall of the mean square that ends a fit of one of the fields: a hundredth of the least that is worth an effect."""
WORTH = 100.0 * NEGLIGIBLE
"""Fall of the mean square below which the evaluations left are not made: the least that is worth an effect. Where an effect makes a long
valley, a fit may crawl along it for as long as it is let."""
IN_THE_VALLEY = 1.2
"""Mean square of the temperatures over that of their noise at the end of a refit on a known motion, up to which no other start is tried.
A wrong valley (a contact that conducts nothing) leaves many times the noise."""
HALF = 0.5
"""Part of what a fit with exponents held where it began leaves beyond noise that the way of an unsettled one has to explain."""
SETTLED = 0.5
"""Fall of the objective, in units of the noise, that ends a fit of all together: it is then within a standard error of its optimum."""


@dataclass(frozen=True)
class Fitted:
    """All other parameters fitted at one value of an exponent: objective, parameters, and how far a step with the exponent free as well
    would take it, of one that is known by its order of magnitude its logarithm."""

    f: float
    parameters: Parameters
    step: float


def walked(at: Callable[[float], Fitted], value: float, name: str) -> Parameters:
    """The parameters at the value of one exponent from which a fit with it free goes on: down the hill over its scan from the given value,
    as long as the step of such a fit reaches beyond the next one. A value at which the model fails (f infinite) is passed over.
    """
    p = param(name)
    to, back = (np.log, np.exp) if p.logarithmic else (float, float)
    here = float(to(value))
    near = 1e-3 * float(np.ptp([to(v) for v in p.scan]))
    grid = sorted({here, *(x for x in (float(to(v)) for v in p.scan) if abs(x - here) > near)})
    k = grid.index(here)
    best = at(value)
    for other in sorted((i for i in range(len(grid)) if i != k), key=lambda i: abs(grid[i] - here)):
        if np.isfinite(best.f):
            break
        k, best = other, at(float(back(grid[other])))
    while np.isfinite(best.f):
        beyond = k + (1 if best.step > 0.0 else -1)
        if not 0 <= beyond < len(grid) or abs(best.step) <= abs(grid[beyond] - grid[k]):
            break
        there = at(float(back(grid[beyond])))
        if not there.f < best.f:
            break
        k, best = beyond, there
    return best.parameters


Flow = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Lambda, its rate in 1/s and the increment of Lambda at points that flow, each (n,)."""


def flow_of(histories: Sequence[History]) -> Flow:
    """Where and how fast histories that kept their points flow."""
    found = [_flow(history) for history in histories]
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found]), np.concatenate([f[2] for f in found])


def _flow(history: History) -> Flow:
    accumulated = np.array([p.accumulated for p in history.points])
    grown = np.diff(accumulated, axis=0)
    rate = grown / np.diff(history.time)[:, None, None]
    flows = grown > 0.0
    return accumulated[1:][flows], rate[flows], grown[flows]


def _scaled(start: Parameters, name: str, factor: float) -> Parameters:
    """The same with the amplitude of the effect of an exponent that many times as far off neutral."""
    p = effect_of_param(name).amplitude
    return start.replace(**{p.name: float(np.clip(p.neutral + factor * (start[p.name] - p.neutral), p.lower, p.upper))})


def as_strong(start: Parameters, name: str, value: float, flow: Flow, model: int | str | Slots) -> Parameters:
    """Parameters with an exponent of an effect at another value, and the amplitude at which the yield stress changes by about as much as
    before where the material flows; the amplitude stays where the effect is not one of the yield stress."""
    added, moved = effect_of_param(name), start.replace(**{name: value})
    if added.slot not in (*SUMS, *FACTORS) or not len(flow[0]):
        return moved
    law, p = law_of(start, model), added.amplitude
    strength = [added.act(*flow[:2], start["theta_ref"], law, *(at[n] for n in added.names)) for at in (start, moved)]
    off = added.act(*flow[:2], start["theta_ref"], law, *(p.neutral if n == p.name else start[n] for n in added.names))
    old, new = ((s - off) * np.sqrt(flow[2]) for s in strength)
    share = float(new @ old) / max(float(new @ new), 1e-300)
    return moved.replace(**{p.name: float(np.clip(p.neutral + share * (start[p.name] - p.neutral), p.lower, p.upper))})


def undetermined_exponents(parameters: Parameters, fit: FitResult) -> tuple[str, ...]:
    """Free exponents that a fit does not determine: all of them where it does not settle, else those with a size of their own (no time, no
    tilt) whose standard error is more than VAGUE of their value."""
    exponents = [name for name in parameters.free if param(name).scan]
    if not fit.converged or fit.sigma is None:
        return () if fit.converged else tuple(exponents)
    sigma = dict(zip(fit.names, fit.sigma.tolist(), strict=True))
    return tuple(n for n in exponents if has_size(param(n)) and not sigma[n] <= VAGUE * abs(parameters[n]))


def has_size(p: Param) -> bool:
    """Whether an exponent is a positive quantity whose error is told as a part of it; a moment of the test or a tilt may be anywhere."""
    return p.logarithmic or (p.lower >= 0.0 and not p.scan_of)


def failed_in_words(failures: Sequence[str]) -> list[str]:
    """A remark on starts that failed: how many, and the first of them; the record holds all."""
    if not failures:
        return []
    more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
    return [f"{len(failures)} of the starts of refits failed and the others were used: {failures[0]}{more}"]


def with_effect(parameters: Parameters, name: str, estimate: Mapping[str, float]) -> Parameters:
    """Parameters with an effect switched on at a first estimate inside its bounds; its Params are free but for scanned ones."""
    added = effect(name)
    start = {}
    for p in added.params:
        value = estimate.get(p.name, p.neutral)
        inside = 1e-6 * (p.upper - p.lower)
        start[p.name] = float(np.clip(value, p.lower + inside, p.upper - inside))
    free = (p.name for p in added.params if not p.scan)
    return parameters.replace(**start).with_free((*parameters.free, *free))


Ends = dict[str, tuple[Parameters, tuple[str, ...]]]
"""Where refits on a known motion end, by label, motion and start, and what failed on the way."""


@dataclass(frozen=True)
class JointFit:
    """Minimises the objective of a joint model; evaluations are kept beside the artefact of `job` until that is written."""

    study: Study
    settings: StageSettings
    model: StageModel
    job: Job
    at_most: int = REFIT_EVALUATIONS
    """Most evaluations of all together."""
    parts: JointParts | None = None
    """Where displacements and temperatures can be fitted on their own: both are, before all together."""
    failures: list[str] = field(default_factory=list)
    """Starts at which a model failed while others went on, each in words: they are counted and named in the record."""
    ends: Ends = field(default_factory=dict)
    """Refits on known motions that are done: the same one is not made twice, and `close-loop` takes over those of `diagnose`."""

    both_starts: bool = False
    """Whether temperatures are fitted from the study's first values as well where the first fit begins at an optimum: that of the stages
    held declared readings, and may have ended with a contact that conducts nothing, through which no reading of the jaws is felt."""
    told: set[tuple[str, float]] = field(default_factory=set)
    """Exponents and the values at which a fit with them free has ended: from there they are not looked for again."""

    def __call__(self, start: Parameters, label: str, *, exponents: bool = False) -> tuple[Parameters, FitResult]:
        """The optimum from `start` with all of `start.free` free; where `exponents` have just been freed, after few evaluations.
        NumericsError where the model fails at the start."""
        most = EXPONENT_EVALUATIONS if exponents else self.at_most
        most *= OFTEN if self.model.cheap else 1
        start = self.approached(start, label)
        # Along the valley of an exponent that is hardly determined a coupled fit may crawl for as long as it is let; it is then held.
        worth = WORTH if not self.model.cheap and any(param(n).scan for n in start.free) else 0.0
        parameters, fit = self._with_errors(*self.minimised_on(start, self.model, label, most, worth=worth))
        vague = () if self.model.cheap else undetermined_exponents(parameters, fit)
        self.told.update((n, parameters[n]) for n in parameters.free if param(n).scan)
        if vague:
            drawn = self._drawn(start, vague, fit, label, most)
            if drawn is not None:
                return drawn
            # Free exponents that the data do not determine make a valley in which every later fit crawls: they are held where they are.
            held = parameters.with_free(tuple(name for name in parameters.free if name not in vague))
            parameters, fit = self._with_errors(*self.minimised_on(held, self.model, f"{label} held", most))
        return parameters, fit

    def _drawn(
        self, start: Parameters, vague: tuple[str, ...], fit: FitResult, label: str, most: int
    ) -> tuple[Parameters, FitResult] | None:
        """The optimum with exponents that displacements show held where a fit that did not settle began: what temperatures leave besides
        has drawn them along their valley, and displacements alone had them there. None where temperatures leave little, or the way explains
        HALF of what is left from there: then it belongs to the data."""
        noise = sum(c.n for c in self.model.comparisons)
        if fit.converged or acting_on_temperatures(vague) or fit.f <= IN_THE_VALLEY * noise:
            return None
        held = start.with_free(tuple(name for name in start.free if name not in vague))
        parameters, there = self._with_errors(*self.minimised_on(held, self.model, f"{label} held at its start", most))
        self.told.update((n, start[n]) for n in vague)
        return None if there.f - fit.f > HALF * (there.f - noise) else (parameters, there)

    def _with_errors(self, parameters: Parameters, fit: FitResult) -> tuple[Parameters, FitResult]:
        """The end of a fit with standard errors that know how its noise hangs together."""
        spread, _ = covariance_of(self.model, fit)
        return parameters, fit if spread is None else replace(fit, covariance=spread, sigma=spread.sigma)

    def approached(self, start: Parameters, label: str) -> Parameters:
        """Parameters after a fit of the mechanical ones to the displacements and one of the thermal ones to the temperatures.

        The way from far off is long and bent in the thermal ones (conductivity against contact), where a heat run costs a tenth of a
        coupled one. They start once from where they are and once from the study's first values; the better end is taken.
        """
        if self.parts is None:
            return start
        thermal = acting_on_temperatures(start.free)
        mechanical = tuple(name for name in start.free if name not in thermal)
        model = self.parts.mechanics
        if model is not None and mechanical:
            start = self._moved(start, model, mechanical, label).with_free(start.free)
        model = self.parts.heat(start)
        if model is None or not thermal:
            return start
        return self._warmed(start, model, label) or start

    def heated(self, parameters: Parameters) -> HeatFit | None:
        """How the temperatures alone are fitted on the motion of given parameters; None where they are not compared."""
        model = None if self.parts is None else self.parts.heat(parameters)
        if model is None:
            return None

        def minimised(start: Parameters, label: str, alone: bool = False, to_beat: float = np.inf) -> Parameters:
            """The optimum on that motion, remembered by where it starts; `alone`: from there and from nowhere else."""
            key = json_text([label, dict(parameters.values), dict(start.values), start.free, str(to_beat)])
            if key in self.ends:
                found, said = self.ends[key]
                self.failures.extend(said)
                return found
            before = len(self.failures)
            there = self._warmed(start, model, label, alone, to_beat, IN_THE_VALLEY)
            if there is None:
                raise NumericsError(f"{label}: none of its starts can be run: {self.failures[-1]}")
            self.ends[key] = (there, tuple(self.failures[before:]))
            return there

        def from_here(start: Parameters, label: str, to_beat: float) -> Parameters:
            return minimised(start, label, alone=True, to_beat=to_beat)

        return HeatFit(model, minimised, from_here, self._first_values(acting_on_temperatures(parameters.free)))

    def moved(self, parameters: Parameters) -> Parameters:
        """The parameters with those that temperatures do not feel fitted to the displacements alone, remembered by where it starts; the
        same where these are not compared. NumericsError where it cannot be run."""
        model = None if self.parts is None else self.parts.mechanics
        thermal = acting_on_temperatures(parameters.free)
        mechanical = tuple(name for name in parameters.free if name not in thermal)
        if model is None or not mechanical:
            return parameters
        key = json_text(["motion", dict(parameters.values), parameters.free])
        if key not in self.ends:
            self.ends[key] = (self._moved(parameters, model, mechanical, "motion").with_free(parameters.free), ())
        return self.ends[key][0]

    def mechanically(self, start: Parameters, label: str, to_beat: float = np.inf) -> tuple[Parameters, FitResult]:
        """The free parameters that temperatures do not feel after a coarse fit to the displacements alone, all others as they are; given up
        where at its pace it would not come below the square sum `to_beat`. NumericsError where it cannot be run."""
        model = None if self.parts is None else self.parts.mechanics
        assert model is not None, "asked where displacements are compared"
        thermal = acting_on_temperatures(start.free)
        own = start.with_free(tuple(name for name in start.free if name not in thermal))
        return self.minimised_on(own, model, label, PART_EVALUATIONS, COARSELY, to_beat=to_beat)

    def flowing(self, parameters: Parameters) -> Flow:
        """Where and how fast the tests flow at parameters, by runs of all of them. NumericsError where one fails."""
        assert self.parts is not None
        return flow_of(self.parts.histories(parameters))

    def _first_values(self, names: Sequence[str]) -> dict[str, float]:
        """Where the study starts parameters, of those for which it says so."""
        return {name: start_of(given) for name in names if (given := self.study.setting(name)) is not None}

    def _warmed(
        self, start: Parameters, model: StageModel, label: str, alone: bool = False, to_beat: float = np.inf, good: float = 0.0
    ) -> Parameters | None:
        """Parameters after the better of two fits of the thermal ones to the temperatures, from where they are and from the study's first
        values; None where neither can be run. The second is left out where `alone` says so, where the first one leaves no more than `good`
        times the mean square of the noise, and where it begins at an optimum: that of an earlier fit on nearly the same motion (but for
        `both_starts`). `to_beat`: see `Settings`."""
        thermal = acting_on_temperatures(start.free)
        enough = good * sum(c.n for c in model.comparisons)
        ends: list[tuple[float, int, Parameters]] = []
        for turn, begin in enumerate((start, start.replace(**self._first_values(thermal)))):
            name = f"{label} temperatures {turn}"
            most = NEAR_EVALUATIONS if alone else HEAT_EVALUATIONS
            try:
                there, fit = self.minimised_on(
                    begin.with_free(thermal), model, name, most, NEGLIGIBLE, WORTH, min((f for f, *_ in ends), default=to_beat)
                )
            except NumericsError as error:
                self.failures.append(f"{name}: the start failed ({error})")
                continue
            ends.append((fit.f, turn, there))
            at_optimum = fit.converged and model.residual(start) @ model.residual(start) <= (1.0 + WORTH) * fit.f
            if alone or fit.f <= enough or (at_optimum and not self.both_starts):
                break
        return min(ends)[2].with_free(start.free) if ends else None

    def _moved(self, start: Parameters, model: StageModel, mechanical: tuple[str, ...], label: str) -> Parameters:
        """Parameters after the fit of the mechanical ones to the displacements.

        A free exponent is brought near first, with the others fitted at values of it: an amplitude that multiplies it makes a bent valley,
        in which no straight step goes far.
        """
        assert self.parts is not None
        exponents = tuple(name for name in mechanical if param(name).scan)
        others = tuple(name for name in mechanical if name not in exponents)
        unknown = tuple(name for name in exponents if (name, start[name]) not in self.told)
        flow = self.flowing(start) if unknown else None
        for name in unknown:
            tried = 0

            def at(value: float, name: str = name, start: Parameters = start) -> Fitted:
                nonlocal tried
                tried += 1
                assert flow is not None
                # Not from where the fit at the value before has ended: one that is this coarse stops there, and the search with it.
                begin = as_strong(start, name, value, flow, self.study.slots).with_free(others)
                for turn, stronger in enumerate(STRONGER):
                    try:
                        there, fit = self.minimised_on(
                            _scaled(begin, name, stronger), model, f"{label} {name} {tried}.{turn}", PART_EVALUATIONS, COARSELY
                        )
                    except NumericsError as error:
                        self.failures.append(f"{label}, {name} = {value:.3g}, amplitude times {stronger:g}: the start failed ({error})")
                        continue
                    return Fitted(fit.f, there, self._wanted(model, there, fit, name))
                return Fitted(float("inf"), begin, 0.0)

            start = walked(at, start[name], name)
        worth = WORTH if exponents else 0.0
        return self.minimised_on(start.with_free(mechanical), model, f"{label} displacements", PART_EVALUATIONS, NEGLIGIBLE, worth)[0]

    def _wanted(self, model: StageModel, there: Parameters, fit: FitResult, name: str) -> float:
        """How far a Gauss-Newton step with one exponent free beside the fitted parameters would take it; zero where none can be made."""
        if fit.jacobian is None:
            return 0.0
        try:
            _, own = model.linearised(there, (name,))
        except NumericsError as error:
            self.failures.append(f"{name} = {there[name]:.3g}: its derivative failed ({error})")
            return 0.0
        names = (*fit.names, name)
        change, x = fit_variables(names, there), np.array([there[n] for n in names])
        ends = np.array([self.study.bounds(n) for n in names])
        y, (lower, upper) = change.variables(x), change.bounds(ends[:, 0], ends[:, 1])
        columns = change.by_variables(np.column_stack([fit.jacobian, own]), x)
        return float(LinearModel(fit.residual, columns, bounds=(np.minimum(lower - y, 0.0), np.maximum(upper - y, 0.0))).step.d[-1])

    def minimised_on(
        self,
        start: Parameters,
        model: StageModel,
        label: str,
        most: int,
        negligible: float | None = None,
        worth: float = 0.0,
        to_beat: float = np.inf,
    ) -> tuple[Parameters, FitResult]:
        """The optimum of one model, up to a negligible fall of the mean square, or up to SETTLED where none is given; `worth` and
        `to_beat`: see `Settings`."""
        settings = self.settings.model_copy(update={"free": start.free})
        problem, change = stage_problem(self.study, settings, start, remembering(model))
        name = re.sub(r"[^A-Za-z0-9_-]", "_", label)
        store = Checkpoint(self.job.path.parent / checkpoint_folder(self.job, name), evaluation_key(self.job, start))
        least = SETTLED if negligible is None else max(F_TOLERANCE, negligible * sum(c.n for c in model.comparisons))
        options = Settings(x_tolerance=settings.tolerance, f_tolerance=least, max_evaluations=most, worth=worth, to_beat=to_beat)
        with progress(f"{self.job.stage} {label}", None) as advance:
            hooks = Hooks(store=store, on_evaluation=Follower(advance, settings.free, change))
            # Conductivity and contact lie in a bent valley. Where these fits go by the box of the Gauss-Newton method, the loop of the
            # tutorial names a lamp for jaws that warm up.
            method = "trust-region" if model.one_way and settings.method == "least-squares" else method_of(model, settings)
            fit = change.converted(minimise(problem, method, options, hooks))
        return start.with_vector(fit.x), fit
