"""What is diagnosed: the joint model of all channels at its optimum, and where every row of its residual is from."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import AT, Param, Parameters, bare_name
from thermofit.diagnose.held_out import Rows
from thermofit.effects.catalogue import Effect, effects
from thermofit.effects.catalogue import effect as effect_named
from thermofit.experiment.channels import field_of
from thermofit.experiment.flow_conditions import ONE_RATE, ONE_TEMPERATURE, FlowConditions
from thermofit.experiment.known_motion import Direction, acts_in_heat
from thermofit.experiment.missing import MissingTerm
from thermofit.experiment.model import StageModel
from thermofit.experiment.protocol import Carried
from thermofit.experiment.residuals import Span, span_of
from thermofit.experiment.trust import Bounds, physical
from thermofit.fit.result import FitResult
from thermofit.law.page import law_of
from thermofit.records.progress import progress

TINY = 1e-3
"""Part of its probe at which a dormant effect of the body is asked for its influence. At neutral itself a point that rests on the yield
surface does not flow, with the least overstress it does. Only effects of the overstress are asked so."""
NEARER = (1.0, 1e-3, 1e-6)
"""Parts of that at which an effect is asked in turn where the model cannot run with it."""
_RATE, _STEP = 1e-3, 1e-30
"""1/s, and the imaginary step of a derivative by it."""
_WARMER = 11.7
"""K"""
ELASTICITY = "free_energy"
"""Slot of effects that change the elastic constants with flow."""
WARM_ELASTICITY = "elasticity"
"""Slot of those that change them with temperature."""
_STRAINS = 201
"""Values of Lambda at which a body is asked."""


Scored = Callable[[Parameters, tuple[str, ...], Sequence[Direction]], tuple[np.ndarray, np.ndarray, np.ndarray]]


Moved = Callable[[Parameters], Parameters]
Mechanics = Callable[[Parameters, str, float], tuple[Parameters, FitResult]]
"""A coarse fit of the free parameters that temperatures do not feel to the displacements alone, from where they are; given up where at its
pace it would not come below a square sum. NumericsError where it cannot be run."""


class Refit(Protocol):
    """The optimum from `start` with all of `start.free` free; `exponents`: some of these have just been freed, see `JointFit`."""

    def __call__(self, start: Parameters, label: str, *, exponents: bool = False) -> tuple[Parameters, FitResult]: ...


@dataclass(frozen=True)
class HeatFit:
    """The model of the temperatures alone on a motion that is known, and its optimum from given parameters, by all that temperatures feel;
    the text names the fit, NumericsError where no start can be run.

    `first`: the study's first values of the parameters that temperatures feel. `minimised` begins there as well, `from_here` does not; its
    number is a square sum, and it is given up where at its pace it would not come below that."""

    model: StageModel
    minimised: Callable[[Parameters, str], Parameters]
    from_here: Callable[[Parameters, str, float], Parameters] | None = None
    first: Mapping[str, float] = field(default_factory=dict)


class Sharper(Protocol):
    """How the errors of a problem are told at parameters; None where it knows them. `beside`: a term that the model lacks,
    whose own errors are among them; where it is given, the errors are told in any case."""

    def __call__(self, parameters: Parameters, beside: MissingTerm | None = None) -> RefinedProblem | None: ...


@dataclass(frozen=True)
class RefinedProblem:
    """The problem of a case with what the error of its prescribed force makes counted as noise: model, scores, how to fit it, also from
    close to its optimum, the error (n,) of the mesh that is left in its residual, and how to fit the temperatures alone and the motion."""

    model: StageModel
    scored: Scored | None
    refit: Refit
    nearby: Refit
    numerical: np.ndarray
    heated: Callable[[Parameters], HeatFit | None] | None = None
    moved: Moved | None = None
    mechanics: Mechanics | None = None
    doubts: Mapping[str, np.ndarray] = field(default_factory=dict)
    """What (n,) of the errors of mesh and steps is in doubt in its residual, by cause."""
    again: Sharper | None = None
    """The same problem with its errors told anew, for parameters with an effect that was added since; None where they are told once."""


@dataclass(frozen=True)
class OtherTest:
    """A held-out test: the case that parameters of the fit make of it, how fitted names are carried there, the names of effects that it
    can judge, and its own parameters that are fitted on its own data."""

    name: str
    case: Callable[[Parameters], Case]
    carried: Callable[[Sequence[str]], Carried]
    judges: frozenset[str]
    own: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """A model with the parameters at its optimum (`free` names the fitted ones), the effects that its driver knows, the phases of the
    test, and the names of the Params that change what is seen and not what happens."""

    model: StageModel
    parameters: Parameters
    known: tuple[Effect, ...]
    spans: tuple[Span, ...]
    instruments: frozenset[str]
    cheap: bool = False
    """True where a run costs next to nothing: exponents are scanned when effects are ranked, not only when one is tried."""
    scored: Scored | None = None
    """Residual, Jacobian by names and columns along directions of the heat equation, where the driver tells the two fields apart."""
    other_tests: tuple[OtherTest, ...] = ()
    """Held-out tests, which no fit sees."""
    placed: Rows | None = None
    """Where the rows of the residual are from; None: what `rows_of` says."""
    largest_strain: float = 0.1
    """Largest Lambda of the test, of which strains that are tried are shares."""
    refined_at: Sharper | None = None
    """The problem that knows its errors as they are at given parameters: that of the force from where it could explain what it would hide,
    those of mesh and steps anew where an effect was added since they were told. It gives None where this one knows them; None: there are
    none."""
    heated: Callable[[Parameters], HeatFit | None] | None = None
    """How the temperatures alone are fitted on the motion of given parameters; None where there are none, or where that spares nothing."""
    moved: Moved | None = None
    """Parameters with those that temperatures do not feel fitted to the displacements alone, NumericsError where that cannot be run; None
    where the driver does not tell the two fields apart."""
    mechanics: Mechanics | None = None
    """The same coarsely, with what effects have free but their exponents; None where the driver does not tell the two fields apart."""
    flowing: Callable[[Parameters], tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None
    """Lambda, its rate in 1/s and its increment where a body flows, each (n,), by a run (NumericsError where it fails); None of coupons,
    where `flow` tells them."""
    correlation_length: float = 0.0
    """Distance in mm over which the noise of neighbouring points hangs together; 0: it is not known, or there is one point."""
    bounds: Bounds = physical
    """Bounds of every fitted parameter: the study's, or else the physical ones."""
    pose: frozenset[str] = frozenset()
    """Fitted parameters that stand for an error of a camera's landmarks: no effect, as long as they stay within these bounds."""
    doubts: Mapping[str, np.ndarray] = field(default_factory=dict)
    """What (n,) of the errors of mesh and steps is in doubt in the residual, by cause: limits of a uniform distribution."""
    prescribed: Callable[[Parameters], Mapping[str, Mapping[str, float]]] | None = None
    """By how much parameters move for one standard error of what the test prescribes, by cause (`experiment.prescribed`)."""

    def reach(self, name: str) -> tuple[float, float]:
        """Bounds that a linear step keeps to: the physical ones, but those of an error of its landmarks for the pose of a camera."""
        return self.bounds(name) if name in self.pose else physical(name)

    @property
    def rows(self) -> Rows:
        """Where the rows of the residual are from."""
        return rows_of(self.model, self.spans) if self.placed is None else self.placed

    @property
    def channels(self) -> tuple[str, ...]:
        """Compared channels in the order of the residual."""
        return tuple(c.channel for c in self.model.comparisons)

    def flow(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lambda, its rate in 1/s and the temperature in K wherever the model flows, each (n,): of coupons in all records; of a body every
        Lambda up to the largest, at a usual rate and near the reference temperature."""
        terms = None if self.model.missing is None else self.model.missing.of_yield
        if terms is not None:
            of = ("accumulated plastic strain", "plastic strain rate", "temperature")
            accumulated, log_rate, theta = (terms.yield_variables(self.parameters, name) for name in of)
            return accumulated, np.exp(log_rate), theta
        accumulated = np.linspace(0.0, self.largest_strain, _STRAINS)
        return accumulated, np.full(_STRAINS, _RATE), np.full(_STRAINS, self.parameters["theta_ref"] + _WARMER)

    def flows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Lambda, its rate in 1/s, temperature in K and the increment of Lambda where the model flows, each (n,); of a body by a run."""
        if self.flowing is None:
            accumulated, rate, theta = self.flow()
            return accumulated, rate, theta, np.maximum(np.diff(accumulated, prepend=0.0), 0.0)
        accumulated, rate, grown = self.flowing(self.parameters)
        return accumulated, rate, np.full(len(rate), self.parameters["theta_ref"] + _WARMER), grown

    def dormant(self) -> tuple[Effect, ...]:
        """Effects that are off and may be the name of what is missing: none of their Params is free and the amplitudes are neutral."""
        free = set(self.parameters.free)
        return tuple(e for e in self.known if not e.last and not free & set(e.names) and not e.is_on(self.parameters))

    def not_asked(self) -> tuple[str, ...]:
        """Effects of the catalogue that the driver at hand, or its channels, do not have: no data of this test speak of them."""
        known = {bare_name(e.name) for e in self.known}
        return tuple(e.name for e in effects() if e.name not in known)


def rows_of(model: StageModel, spans: Sequence[Span]) -> Rows:
    """Where the rows of a residual are from; the rows of priors have channel and phase -1 and are never held out."""
    channel, time, xy, phase = [], [], [], []
    for k, c in enumerate(model.comparisons):
        observation = model.observations[field_of(c)]
        t = observation.time[c.rows[:, 0]]
        channel.append(np.full(c.n, k))
        time.append(t)
        xy.append(observation.xy[c.rows[:, 1]])
        phase.append(span_of(t, spans))
    n = len(model.priors)
    channel.append(np.full(n, -1))
    phase.append(np.full(n, -1))
    time.append(np.full(n, time[0].min()))
    xy.append(np.zeros((n, 2)))
    return Rows(np.concatenate(channel), np.concatenate(time), np.concatenate(xy), np.concatenate(phase))


def scans(effect: Effect, case: Case) -> tuple[dict[str, float], ...]:
    """Sets of values to try for the Params of an effect that cannot be felt while it is off: every combination, the neutral one first."""
    tried = [p for p in effect.params if p.scan]
    sets = [dict(zip((p.name for p in tried), values, strict=True)) for values in itertools.product(*(tried_of(p, case) for p in tried))]
    neutral = {p.name: p.neutral for p in tried}
    return (neutral, *(s for s in sets if s != neutral))


def tried_of(p: Param, case: Case) -> tuple[float, ...]:
    """Values to try for one Param: those of its scan, or the shares of the test that they are."""
    if not p.scan_of:
        return p.scan
    if p.scan_of == "strain":
        first, last = 0.0, case.largest_strain
    elif p.scan_of in ("place", "length"):
        first, last = _height(p, case)
    else:
        own = [s for s in case.spans if s.experiment == p.name.partition(AT)[2]] or case.spans
        first, last = min(s.t0 for s in own), max(s.t1 for s in own)
    begin, whole = first if p.scan_of in ("time", "place") else 0.0, last - first
    return tuple(float(np.clip(begin + share * whole, p.lower, p.upper)) for share in p.scan)


def _height(p: Param, case: Case) -> tuple[float, float]:
    """The lowest and the highest y in mm that is observed, by the experiment of a Param where it has one."""
    own = [k for k, s in enumerate(case.spans) if s.experiment == p.name.partition(AT)[2]]
    rows = case.rows
    seen = np.isin(rows.phase, own) & (rows.channel >= 0)
    y = rows.xy[seen if seen.any() else rows.channel >= 0, 1]
    return float(y.min()), float(y.max())


def nowhere(case: Case, names: Sequence[str]) -> tuple[str, ...]:
    """Remarks on effects with a place that are as wide as what is observed: the data show them even, and no place of theirs."""
    out = []
    for name in names:
        for p in (p for p in effect_named(name).params if p.scan_of == "length"):
            low, high = _height(p, case)
            if case.parameters[p.name] > high - low:
                out.append(
                    f"{name}: {p.name} is {case.parameters[p.name]:.3g} {p.unit}, more than the {high - low:.3g} mm that are observed; it "
                    "is even there, and its place is not told"
                )
    return tuple(out)


def columns_of(case: Case, effect: Effect, values: dict[str, float]) -> np.ndarray:
    """Columns (n, k) of a dormant effect whose other Params have the given values, from one differentiated run.

    Where the model cannot run with the effect so far on, it is asked nearer to neutral: a power law of the rate that is harmless at one
    rate is hundreds of GPa at another. NumericsError where it cannot at any of NEARER.
    """
    names = _felt(effect)
    error: NumericsError | None = None
    for nearer in (1.0,) if effect.amplitude.name in case.instruments else NEARER:
        tiny = {} if effect.amplitude.name in case.instruments else {effect.amplitude.name: _tiny(effect, nearer)}
        try:
            return case.model.linearised(case.parameters.replace(**values, **tiny), names)[1]
        except NumericsError as failed:
            error = failed
    assert error is not None
    raise error


def _tiny(effect: Effect, nearer: float = 1.0) -> float:
    return effect.amplitude.neutral + nearer * TINY * float(effect.amplitude.probe or 0.0)


def feels_rate(effect: Effect, parameters: Parameters) -> bool:
    """True for an effect of the yield stress that depends on the rate of flow, by complex step at its probe."""
    return _feels(effect, parameters, (1j * _STEP, 0.0))


def feels_temperature(effect: Effect, parameters: Parameters) -> bool:
    """The same for the temperature of flow."""
    return _feels(effect, parameters, (0.0, 1j * _STEP))


def _feels(effect: Effect, parameters: Parameters, step: tuple[complex, complex]) -> bool:
    if effect.slot not in ("yield_stress", "yield_factor"):
        return False
    values = [effect.amplitude.probe, *(p.neutral for p in effect.params[1:])]
    # Beside the reference temperature, where an effect that grows with the distance from it would be none.
    found = effect.act(0.01, _RATE + step[0], parameters["theta_ref"] + _WARMER + step[1], law_of(parameters), *values)
    return bool(np.imag(found) != 0.0)


def not_identifiable(known: Sequence[Effect], parameters: Parameters, there: FlowConditions) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """Those of the known effects that coupon records can tell, and why the others are not asked: where the rate is one, or a function of
    the plastic strain, an overstress is hardening by another name, and so is a softening where the temperature is one, a function of the
    strain, or only computed; where no record unloads after flow its elasticity is not seen again, and where no elastic ranges lie apart in
    temperature one E says the same. An effect that the study switches on or frees stays."""
    dormant = [e for e in known if not set(parameters.free) & set(e.names) and not e.is_on(parameters)]
    narrow = [e for e in dormant if feels_temperature(e, parameters) and not there.tells(e.span)]
    steady = [e for e in dormant if there.one_rate and e not in narrow and feels_rate(e, parameters)]
    said = []
    if steady:
        names, (low, high) = ", ".join(e.name for e in steady), there.rates
        said.append(
            f"not asked for {names}: as measured, the records flow at one rate at each plastic strain ({low:.2g} to {high:.2g} 1/s in all, "
            f"a factor of {there.apart:.2g} at the same strain since the flow last turned, expected more than {ONE_RATE:g}), so that "
            "hardening would explain the same; a record or a phase at another rate, or a hold, would tell"
        )
    if narrow:
        names, (cold, hot) = ", ".join(e.name for e in narrow), there.temperatures
        least = min(max(e.span, ONE_TEMPERATURE) for e in narrow)
        only = f"; {there.computed:.2g} K of self-heating are computed, not measured, and do not count" if there.computed >= 1.0 else ""
        said.append(
            f"not asked for {names}: as measured or declared, the records flow at {cold:.0f} to {hot:.0f} K, {round(there.span, 1):g} K "
            f"apart at the same plastic strain, expected more than {least:g} K{only}; hardening would explain the same, a record at "
            "another temperature would tell"
        )
    unseen = [] if there.unloads else [e for e in dormant if e.slot == ELASTICITY]
    if unseen:
        said.append(
            f"not asked for {', '.join(e.name for e in unseen)}: no record unloads after flow, by a quarter of its stress at least, so "
            "that its elasticity is not seen again; an unloading would tell"
        )
    alike = [e for e in dormant if e.slot == WARM_ELASTICITY and not there.determines_modulus(e.span)]
    if alike:
        (cold, hot), least = there.elastic, min(max(e.span, ONE_TEMPERATURE) for e in alike)
        found = f"lie at {cold:.0f} to {hot:.0f} K" if np.isfinite(cold) else "are not seen in any record"
        said.append(
            f"not asked for {', '.join(e.name for e in alike)}: elastic ranges {found}, expected more than {least:g} K apart, as measured "
            "or declared; one E would explain the same, the elastic range of a record at another temperature would tell"
        )
    return tuple(e for e in known if e not in (*steady, *narrow, *unseen, *alike)), tuple(said)


def _beside_neutral(effect: Effect, case: Case) -> bool:
    """Whether an effect is asked beside its neutral value: one of the overstress."""
    return effect.amplitude.name not in case.instruments and feels_rate(effect, case.parameters)


@dataclass(frozen=True)
class Linearised:
    """Residual (n,) at the optimum, columns (n, p) of the fitted parameters, and per dormant effect those of the Params it is felt by.

    `scanned`: of effects whose columns come from a heat run, those at every set of values of `scans`. `failed`: effects with which the
    model cannot run at all, with the reason; the others do not know of them.
    """

    residual: np.ndarray
    fitted: np.ndarray
    dormant: dict[str, tuple[tuple[str, ...], np.ndarray]]
    scanned: dict[str, tuple[np.ndarray, ...]]
    failed: dict[str, str] = field(default_factory=dict)


def linearised(case: Case, fit: FitResult | None = None) -> Linearised:
    """All columns from one differentiated run; effects of the heat problem from a heat run on its motion. `fit`: the one that ends at the
    parameters of the case, whose residual and columns are not made again.

    Where the run fails with the effects of the overstress a little on, all are asked nearer to neutral, then each on its own.
    NumericsError where it fails without any.
    """
    known = at_its_end(case, fit)
    dormant = case.dormant()
    heated = [e for e in dormant if case.scored is not None and acts_in_heat(e)]
    coupled = [e for e in dormant if e not in heated]
    # Where an overstress is on already, what rests flows by that one.
    flows = any(feels_rate(e, case.parameters) for e in case.known if e not in dormant)
    beside = [] if flows else [e for e in coupled if _beside_neutral(e, case)]
    felt = {e.name: _felt(e) for e in coupled}
    if known is not None and not dormant:
        return Linearised(*known, {}, {})
    fitted = case.parameters.free if known is None or not coupled else ()
    names = (*fitted, *(name for group in felt.values() for name in group))
    directions = [(name, values) for e in heated for values in scans(e, case) for name in _felt(e)]
    along, failed = np.zeros((0, 0)), {}
    at = {name: k for k, name in enumerate(names)}
    for nearer in (*(NEARER if beside else ()), 0.0):
        tiny = {e.amplitude.name: _tiny(e, nearer) for e in beside} if nearer else {}
        there = case.parameters.replace(**tiny)
        try:
            if case.scored is None:
                residual, columns = case.model.linearised(there, names)
            else:
                with progress("influence of the effects", None) as advance:
                    residual, columns, along = case.scored(there, names, directions)
                    advance(1, f"{len(dormant)} effects, {len(names) + len(directions)} columns")
        except NumericsError:
            if not nearer:
                raise
            continue
        for name, value in tiny.items() if known is None else ():
            residual = residual - columns[:, at[name]] * (value - case.parameters[name])
        break
    blocks = {effect: (group, columns[:, [at[name] for name in group]]) for effect, group in felt.items()}
    for e in beside if not nearer else ():
        # At neutral itself the column is wrong where the material rests.
        try:
            blocks[e.name] = (_felt(e), columns_of(case, e, {}))
        except NumericsError as error:
            del blocks[e.name]
            failed[e.name] = str(error)
    scanned, k = {}, 0
    for e in heated:
        width, count = len(_felt(e)), len(scans(e, case))
        scanned[e.name] = tuple(along[:, k + n * width : k + (n + 1) * width] for n in range(count))
        blocks[e.name] = (_felt(e), scanned[e.name][0])
        k += width * count
    found = (residual, columns[:, : len(fitted)]) if known is None else known
    return Linearised(*found, blocks, scanned, failed)


def at_its_end(case: Case, fit: FitResult | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Residual (n,) and columns (n, p) of the fitted parameters where the fit ends at the parameters of the case; None elsewhere."""
    if fit is None or fit.jacobian is None or fit.names != case.parameters.free or not np.array_equal(fit.x, case.parameters.vector()):
        return None
    return fit.residual, fit.jacobian


def _felt(effect: Effect) -> tuple[str, ...]:
    """Names of the Params of an effect that can be felt while it is off."""
    return tuple(p.name for p in effect.amplitudes)


def rows_of_tests(models: Mapping[str, StageModel], spans: Sequence[Span]) -> Rows:
    """Rows of a joint problem from the models of the tests in it by name; that of a test which is alone has none."""
    return rows_of(models[""], spans) if set(models) == {""} else joined_rows(models, spans)


def joined_rows(models: Mapping[str, StageModel], spans: Sequence[Span]) -> Rows:
    """Rows of a joined model from the models of its experiments: all data, then all priors; times follow one another."""
    data, channel, phase = [], 0, 0
    priors = 0
    for name, model in models.items():
        own = [s for s in spans if s.experiment == name]
        here = rows_of(model, own)
        used = here.channel >= 0
        data.append(Rows(here.channel[used] + channel, here.time[used], here.xy[used], here.phase[used] + phase))
        channel, phase, priors = channel + len(model.comparisons), phase + len(own), priors + int((~used).sum())
    rows = stacked(data)
    return Rows(
        np.append(rows.channel, np.full(priors, -1)),
        np.append(rows.time, np.full(priors, rows.time.min())),
        np.concatenate([rows.xy, np.zeros((priors, 2))]),
        np.append(rows.phase, np.full(priors, -1)),
    )


def stacked(rows: Sequence[Rows]) -> Rows:
    """Rows of several experiments, one after the other in time, so that their groups stay apart."""
    time, at = [], 0.0
    for one in rows:
        time.append(one.time - one.time.min() + at)
        at = float(time[-1].max()) + 1.0
    return Rows(
        np.concatenate([one.channel for one in rows]),
        np.concatenate(time),
        np.concatenate([one.xy for one in rows]),
        np.concatenate([one.phase for one in rows]),
    )
