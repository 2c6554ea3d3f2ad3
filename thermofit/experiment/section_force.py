"""Force through sections: the force that the measured strain makes in the identified law, section by section, beside the load cell.

    r(y, t) = A(y) [P(strain, theta measured) - P(strain, theta predicted)] + F predicted - F measured

P is the nominal stress of the point driver with free lateral contraction along a history of strain and temperature, A the initial area
(equilibrium of a bar: the force is the same in all sections). The first bracket is what the section carries more than the model believes;
the model itself carries F predicted in every section. So what a section differs from a uniaxial bar by (shoulders, the mean over the
width) cancels to first order, and so does smoothing, which is the same on both sides.

An elastic-plastic law does not average noise: strain that jumps to and fro flows on. So the mean strain of a section is taken over a
length that brings its noise below a share of the elastic strain, and neighbouring stages are averaged until it grows by eight times its
noise. The response of P to the noise of each stage is taken over a step as large as that noise, what rare errors make beyond it is added,
and draws of the noise along the predicted history give the bias that is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.experiment.local_balance import JointErrors, LocalBalance, width
from thermofit.experiment.residuals import Span
from thermofit.law.page import in_model_axes
from thermofit.observe.profile import RowProfile, excess_noise, integrals, profile_of, spans_piece
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate, simulate_rates

QUIET = 0.1
"""Noise of a mean strain, times E, over the largest stress: sections are as short as this allows."""
SHORTEST = 4.0
"""Rows in a section at least."""
LONGEST = 0.5
"""Length of a section over that observed at most."""
GROWN = 8.0
"""Standard errors by which a strain grows from one mean of stages to the next: then noise does not turn flow into unloading."""
FEWEST = 12
"""Means of stages at least."""
CELLS_IN_TIME = 16
RARE = 6.0
"""Standard errors of a strain up to which an error may turn flow into unloading, or unloading into flow. An elastic response is fifty times
as stiff as flow: a stage where noise could decide which it is says no more than an elastic one."""
DRAWS = 48
_SEED = 20


@dataclass(frozen=True)
class SectionHistories:
    """Histories of sections at centres y (n_y,) mm: `time` s (n_t,), strain and temperature as measured and as predicted, each
    (n_t, n_y), and `known` (n_t, n_y) where they were measured."""

    y: np.ndarray
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    theta_measured: np.ndarray
    theta_predicted: np.ndarray
    known: np.ndarray


@dataclass(frozen=True)
class Predicted:
    """The state of sections at centres y (n_y,) mm as the model predicts it: Lambda, the rate of its last flow 1/s (nan before any flow),
    each (n_t, n_y), at `time` s (n_t,)."""

    y: np.ndarray
    time: np.ndarray
    accumulated: np.ndarray
    rate: np.ndarray


@dataclass(frozen=True)
class _Prepared:
    """Sections of one half length mm, with the parameters and settings of their driver and what unit noise of the rows makes of their mean
    strains (n_t, n_y, n_b)."""

    sections: SectionHistories
    parameters: Parameters
    settings: PointSettings
    of_rows: np.ndarray
    weights: np.ndarray
    groups: list[np.ndarray]
    half: float

    def history(self, strain: np.ndarray, theta: np.ndarray) -> PointHistory:
        """The point driver along strain and temperature (n_t,) of a section."""
        return _history(self.parameters, self.settings, self.sections.time, strain, theta)


@dataclass(frozen=True)
class MeasuredFlow:
    """Plastic heat so far mJ/mm^3 (n_t,) of the mean strain that was measured over that of the predicted one, at `time` s (n_t,), and what
    noise of unit variance makes of it (n_t, k)."""

    time: np.ndarray
    heat: np.ndarray
    noise: np.ndarray


def section_force(seen: JointErrors, spans: tuple[Span, ...]) -> LocalBalance | None:
    """The balance of forces; None where displacements are not compared or too few to see a strain. NumericsError where the law cannot
    follow the measured strain."""
    prepared = _prepared(seen, spans)
    return None if prepared is None else _balance(seen, prepared, spans)


def measured_flow(seen: JointErrors, spans: tuple[Span, ...]) -> MeasuredFlow | None:
    """Plastic heat of the mean strain of the observed length, as measured beside as predicted; None as `section_force`.

    A force that is smoothed a few newtons off makes flow that no law is to blame for: the displacements tell it. NumericsError where the
    law cannot follow them.
    """
    prepared = _prepared(seen, spans, whole=True)
    if prepared is None:
        return None
    one, strain = prepared.sections, prepared.sections.predicted[:, 0]
    theta, n_t = one.theta_predicted[:, 0], len(one.time)
    base = prepared.history(strain, theta).dissipated
    sigma = np.sqrt((prepared.of_rows[:, 0] ** 2).sum(axis=1))
    noise = np.zeros((n_t, n_t))
    for j in range(n_t):
        step = np.zeros(n_t)
        step[j] = sigma[j]
        noise[:, j] = 0.5 * (prepared.history(strain + step, theta).dissipated - prepared.history(strain - step, theta).dissipated)
    return MeasuredFlow(one.time, prepared.history(one.measured[:, 0], one.theta_measured[:, 0]).dissipated - base, noise)


def _prepared(seen: JointErrors, spans: tuple[Span, ...], *, whole: bool = False) -> _Prepared | None:
    """Sections as short as their noise allows, or `whole`: the observed length as one; None where a strain cannot be seen."""
    joint, channel = seen.joint, _channel(seen)
    if channel is None:
        return None
    observation, mask = joint.model.observations["u"], seen.mask(channel)
    profile = profile_of(observation.xy, mask)
    if len(profile.y) < SHORTEST:
        return None
    error = without_rotation(seen.errors["u"], observation.xy, mask)
    shown = observation.value + seen.errors["u"]
    sigma = profile.sigma(np.where(mask, observation.sigma[:, :, 1], 0.0))
    noise = sigma * excess_noise(profile.mean(error[:, :, 1]), sigma, observation.time, profile.count > 0)
    largest = float(np.abs(joint.data.force.value).max()) / (joint.data.specimen.thickness * joint.data.specimen.gauge_width)
    half = 0.5 * float(np.ptp(profile.y)) if whole else _half_length(profile, noise, seen.parameters["E"], largest)
    weights, known, y = strain_weights(profile, half)
    strain = np.where(known, np.einsum("tyb,tb->ty", weights, profile.mean(shown[:, :, 1])), np.nan)
    if not np.isfinite(strain).any():
        return None
    spread = np.where(known, np.sqrt(np.einsum("tyb,tb->ty", weights**2, noise**2)), np.nan)
    groups = _groups(observation.time, strain, spread, spans)
    sections = _sections(seen, profile, groups, weights, known, error[:, :, 1], shown[:, :, 1], y)
    settings = PointSettings(joint.study.slots, joint.study.numerics.plastic_integration == "closed-form")
    of_rows = _row_weights(weights, noise, groups)
    return _Prepared(sections, _of_point(seen, sections), settings, of_rows, weights, groups, half)


def _channel(seen: JointErrors) -> str | None:
    """The channel of displacements that is compared."""
    return next((c.channel for c in seen.joint.model.comparisons if c.channel in ("du", "u", "strain")), None)


def without_rotation(error: np.ndarray, xy: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """An error field (n_t, n_s, 2) of displacements without the best small rigid motion of the measured points at every time."""
    number = np.maximum(mask.sum(axis=1), 1)[:, None, None]
    e = np.where(mask[:, :, None], error, 0.0)
    arm = np.where(mask[:, :, None], xy[None] - (np.where(mask[:, :, None], xy[None], 0.0).sum(axis=1, keepdims=True) / number), 0.0)
    e = np.where(mask[:, :, None], e - e.sum(axis=1, keepdims=True) / number, 0.0)
    omega = (arm[:, :, 0] * e[:, :, 1] - arm[:, :, 1] * e[:, :, 0]).sum(axis=1)
    omega /= np.maximum((arm**2).sum(axis=(1, 2)), np.finfo(float).tiny)
    return np.asarray(e - omega[:, None, None] * np.stack([-arm[:, :, 1], arm[:, :, 0]], axis=-1))


def _half_length(profile: RowProfile, noise: np.ndarray, modulus: float, largest: float) -> float:
    """Half length mm of a section: the shortest whose strain is quiet, else the longest."""
    spacing, observed = float(np.median(np.diff(profile.y))), float(np.ptp(profile.y))
    shortest, longest = 0.5 * SHORTEST * spacing, 0.5 * max(LONGEST * observed, SHORTEST * spacing)
    usual = float(np.median(noise[profile.count > 0]))
    for half in np.geomspace(shortest, longest, 12):
        of_strain, _, total = _slopes(profile.y, float(profile.y.mean()), float(half))
        if modulus * usual * float(np.linalg.norm(of_strain)) / total <= QUIET * largest:
            return float(half)
    return longest


def _slopes(knots: np.ndarray, centre: float, half: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Weights of rows in int w du/dy dy = -int w' u dy, in int w theta dy, and int w dy."""
    parts = integrals(knots, centre, half)
    return -parts[1], parts[0], float(parts[0].sum())


def strain_weights(profile: RowProfile, half: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (n_t, n_y, n_b) of the rows in the mean strain of sections, where that is measured (n_t, n_y), and their centres y (n_y,)
    mm, half a length apart."""
    low, high = float(profile.y[0]), float(profile.y[-1])
    number = max(1, round((high - low - 2.0 * half) / half) + 1)
    y = np.linspace(low + half, high - half, number) if number > 1 else np.array([0.5 * (low + high)])
    there = profile.count > 0
    out, known = np.zeros((len(there), len(y), len(profile.y))), np.zeros((len(there), len(y)), dtype=bool)
    widest = max(2.5 * float(np.median(np.diff(profile.y))), 0.6 * half)
    made: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
    for n, row in enumerate(there):
        key = row.tobytes()
        if key not in made:
            w, k, knots = np.zeros((len(y), len(profile.y))), np.zeros(len(y), dtype=bool), profile.y[row]
            for i, centre in enumerate(y):
                if spans_piece(knots, float(centre), half, widest):
                    of_strain, _, total = _slopes(knots, float(centre), half)
                    w[i, row], k[i] = of_strain / total, True
            made[key] = w, k
        out[n], known[n] = made[key]
    return out, known, y


def _groups(time: np.ndarray, strain: np.ndarray, sigma: np.ndarray, spans: tuple[Span, ...]) -> list[np.ndarray]:
    """Stages that are averaged to one, in order of time: neighbours of one phase, as many as make the strain (n_t, n_y) grow by GROWN of
    its standard errors sigma (n_t, n_y) from one mean to the next, a share of the stages at most. nan: not measured."""
    used = np.flatnonzero(np.isfinite(strain).any(axis=1))
    most = max(1, len(used) // FEWEST)
    groups: list[np.ndarray] = []
    for number in range(len(spans) + 1):
        own = [k for k in used if _phase(float(time[k]), spans) == number]
        last: np.ndarray | None = None
        at = 0
        while at < len(own):
            for size in range(1, most + 1):
                group = own[at : at + size]
                mean, error = _group_mean(strain[group], sigma[group])
                grown = np.abs(mean - last) / error if last is not None else np.zeros(0)
                grown = grown[np.isfinite(grown)]
                if not grown.size or at + size >= len(own) or np.median(grown) >= GROWN:
                    break
            groups.append(np.array(group))
            last, at = mean, at + len(group)
    return sorted(groups, key=lambda g: float(time[g[0]]))


def _group_mean(strain: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (n_y,) of strains (k, n_y) where they were measured, and their standard errors; nan where none was."""
    known = np.isfinite(strain)
    number = known.sum(axis=0).astype(float)
    number[number == 0.0] = np.nan
    return np.where(known, strain, 0.0).sum(axis=0) / number, np.sqrt(np.where(known, sigma**2, 0.0).sum(axis=0)) / number


def _phase(t: float, spans: tuple[Span, ...]) -> int:
    """Number of the phase of a time; the number of phases where it lies in none."""
    return next((k for k, s in enumerate(spans) if s.t0 - 1e-9 <= t <= s.t1 + 1e-9), len(spans))


def _sections(
    seen: JointErrors,
    profile: RowProfile,
    groups: list[np.ndarray],
    weights: np.ndarray,
    known: np.ndarray,
    error: np.ndarray,
    shown: np.ndarray,
    y: np.ndarray,
) -> SectionHistories:
    """Histories of sections, neighbours averaged by `groups`; `error` and prediction `shown` (n_t, n_s) are those of u_y mm."""
    error, shown = (np.einsum("tyb,tb->ty", weights, profile.mean(f)) for f in (error, shown))
    there = np.array([known[g].all(axis=0) for g in groups])
    mean = [np.array([v[g].mean(axis=0) for g in groups]) for v in (error, shown)]
    time = np.array([float(seen.joint.model.observations["u"].time[g].mean()) for g in groups])
    # A history has no gaps: what was not measured at a stage is straight between those before and after, and makes no cell.
    off, predicted = (_bridged(time, v, there) for v in mean)
    theta, warmer = _temperatures(seen, time, y)
    return SectionHistories(y, time, predicted - off, predicted, theta - warmer, theta, there)


def _bridged(time: np.ndarray, value: np.ndarray, known: np.ndarray) -> np.ndarray:
    """A history (n_t, n_y) straight between its known times."""
    out = np.zeros_like(value)
    for i in range(value.shape[1]):
        own = known[:, i]
        if own.any():
            out[:, i] = np.interp(time, time[own], value[own, i])
    return out


def _temperatures(seen: JointErrors, time: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Temperature (n_t, n_y) K of sections as predicted, and by how much its rise is above the measured one; the reference temperature and
    zero where no camera saw it."""
    if "theta" not in seen.errors:
        return np.full((len(time), len(y)), seen.parameters["theta_ref"]), np.zeros((len(time), len(y)))
    observation = seen.joint.model.observations["theta"]
    profile = profile_of(observation.xy, observation.mask)
    rest = observation.time <= seen.joint.data.load_start + 1e-9
    error, level = profile.mean(seen.errors["theta"][:, :, 0]), profile.mean((observation.value + seen.errors["theta"])[:, :, 0])
    error = error - (error[rest].mean(axis=0) if rest.any() else error[0])
    out = []
    for value in (level, error):
        along = np.stack([np.interp(y, profile.y, row) for row in value])
        out.append(np.stack([np.interp(time, observation.time, column) for column in along.T], axis=1))
    return out[0], out[1]


def _of_point(seen: JointErrors, sections: SectionHistories) -> Parameters:
    """Parameters as the point driver reads them: free of stress at the temperature of the specimen at rest."""
    own = in_model_axes(seen.parameters, seen.joint.study.material_axes.angle, seen.joint.study.slots)
    return own.replace(theta_ref=float(np.mean(sections.theta_predicted[0])))


def _stress(parameters: Parameters, settings: PointSettings, time: np.ndarray, strain: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Nominal stress (n_t,) MPa of a section along its strain and temperature (n_t,)."""
    return _history(parameters, settings, time, strain, theta).stress


def _history(parameters: Parameters, settings: PointSettings, time: np.ndarray, strain: np.ndarray, theta: np.ndarray) -> PointHistory:
    return simulate(parameters, replace(Programme.by_strain(time, strain, float(theta[0])), theta=theta), settings)


def predicted_states(seen: JointErrors, spans: tuple[Span, ...]) -> Predicted | None:
    """Lambda and the rate of flow of sections along the predicted strain; None where displacements are not compared."""
    channel = _channel(seen)
    if channel is None:
        return None
    observation, mask = seen.joint.model.observations["u"], seen.mask(channel)
    profile = profile_of(observation.xy, mask)
    if len(profile.y) < SHORTEST:
        return None
    half = 0.5 * SHORTEST * float(np.median(np.diff(profile.y)))
    weights, known, y = strain_weights(profile, half)
    groups = [np.array([k]) for k in np.flatnonzero(known.any(axis=1))]
    shown = observation.value[:, :, 1] + seen.errors["u"][:, :, 1]
    sections = _sections(seen, profile, groups, weights, known, 0.0 * shown, shown, y)
    parameters = _of_point(seen, sections)
    settings = PointSettings(seen.joint.study.slots, seen.joint.study.numerics.plastic_integration == "closed-form")
    accumulated, rate = np.zeros(sections.predicted.shape), np.full(sections.predicted.shape, np.nan)
    for i in range(len(y)):
        found = _history(parameters, settings, sections.time, sections.predicted[:, i], sections.theta_predicted[:, i])
        accumulated[:, i], rate[:, i] = found.accumulated, last_rate(found.time, found.accumulated)
    return Predicted(y, sections.time, accumulated, rate)


def last_rate(time: np.ndarray, accumulated: np.ndarray) -> np.ndarray:
    """Rate (n_t,) 1/s at which a point flows, or flowed last; nan before any flow."""
    grown = np.append(0.0, np.diff(accumulated) / np.diff(time))
    flows = grown > 1e-3 * float(grown.max(initial=0.0))
    last = np.maximum.accumulate(np.where(flows, np.arange(len(time)), -1))
    return np.where(last >= 0, grown[np.maximum(last, 0)], np.nan)


def _balance(seen: JointErrors, prepared: _Prepared, spans: tuple[Span, ...]) -> LocalBalance:
    """The balance of sections: residual, noise and derivatives of every stage, then means over neighbouring stages of a phase."""
    sections, parameters, settings, of_rows = prepared.sections, prepared.parameters, prepared.settings, prepared.of_rows
    half, channel = prepared.half, _channel(seen) or ""
    area = width(seen.joint, sections.y) * seen.joint.data.specimen.thickness
    n_t, n_y = sections.predicted.shape
    names = seen.parameters.free
    residual, bias, fitted = np.zeros((n_t, n_y)), np.zeros((n_t, n_y)), np.zeros((n_t, n_y))
    columns, extra = np.zeros((n_t, n_y, len(names))), np.zeros((n_t, n_y))
    response, turned = np.zeros((n_y, n_t, n_t)), np.zeros((n_t, n_y))
    sigma = np.sqrt(np.einsum("tyb,tyb->ty", of_rows, of_rows))
    draws = np.random.default_rng(_SEED).normal(size=(DRAWS, n_t, of_rows.shape[2]))
    for i in range(n_y):
        path, theta = sections.predicted[:, i], sections.theta_predicted[:, i]
        known = sections.known[:, i]
        before, rates = simulate_rates(
            parameters, names, replace(Programme.by_strain(sections.time, path, float(theta[0])), theta=theta), settings
        )
        here = (parameters, settings, sections.time)
        fitted[:, i] = _stress(*here, sections.measured[:, i], sections.theta_measured[:, i])
        residual[:, i] = area[i] * (fitted[:, i] - before.stress)
        columns[:, i] = area[i] * rates["stress"]
        for j in np.flatnonzero(known):
            step = np.zeros(n_t)
            step[j] = sigma[j, i]
            down, up = (area[i] * (_stress(*here, path + k * step, theta) - before.stress) for k in (-1.0, 1.0))
            response[i, :, j] = 0.5 * (up - down)
            # Far errors that turn flow into unloading, or back: what they make beyond the usual response.
            for k in (-RARE, RARE):
                far = np.abs(area[i] * (_stress(*here, path + k * step, theta) - before.stress))
                usual = RARE * np.abs(response[i, :, j])
                turned[:, i] = np.maximum(turned[:, i], np.where(far > 2.0 * usual, far - usual, 0.0))
        drawn = np.array([_stress(*here, path + np.einsum("tb,tb->t", of_rows[:, i], d), theta) for d in draws])
        off = area[i] * (drawn - before.stress)
        bias[:, i] = off.mean(axis=0)
        # What rare errors make beyond the linear response has no sign that could be known: it counts as noise of each stage alone.
        usual = off.std(axis=0, ddof=1) / (1.0 + 3.0 / np.sqrt(2.0 * DRAWS))
        extra[:, i] = np.maximum(usual**2 - (response[i] ** 2).sum(axis=1), 0.0) + (0.5 * turned[:, i]) ** 2
    residual -= bias
    residual += _force_error(seen, sections.time)[:, None]
    per_strain = response / np.maximum(sigma, 1e-300).T[:, None, :]
    covariance = _covariance(per_strain, of_rows, extra)
    beside = _beside(seen, sections, prepared.weights, prepared.groups, per_strain)
    variance = np.diagonal(covariance.reshape(n_t * n_y, n_t * n_y)).reshape(n_t, n_y)
    gathered, row, column, time, duration = _cells(sections, spans, variance)
    every = gathered.reshape(len(row), n_t * n_y)
    total = n_y * (int(row.max(initial=-1)) + 1)
    made = LocalBalance(
        kind="force",
        channel=channel,
        unit="N",
        amount=every @ residual.ravel(),
        covariance=every @ covariance.reshape(n_t * n_y, n_t * n_y) @ every.T,
        columns=every @ columns.reshape(n_t * n_y, -1),
        names=names,
        value=seen.parameters.vector(),
        bounds=seen.bounds,
        told=np.zeros((0, len(names))),
        beside=every @ beside.reshape(n_t * n_y, -1),
        y=sections.y[column],
        time=time,
        row=row,
        column=column,
        extent=2.0 * half,
        duration=duration,
        dropped=total - len(row),
        volume=area[column],
    )

    def follow(x: np.ndarray) -> LocalBalance:
        """The balance of a law that is off by x (p,): the measured histories are run again."""
        moved = parameters.replace(**{n: parameters[n] + float(d) for n, d in zip(names, x, strict=True) if n != "theta_ref"})
        there, slopes = np.zeros((n_t, n_y)), np.zeros((n_t, n_y, len(names)))
        for i in range(n_y):
            theta = sections.theta_measured[:, i]
            programme = replace(Programme.by_strain(sections.time, sections.measured[:, i], float(theta[0])), theta=theta)
            found, rates = simulate_rates(moved, names, programme, settings)
            there[:, i], slopes[:, i] = area[i] * (found.stress - fitted[:, i]), area[i] * rates["stress"]
        return replace(made, amount=made.amount + every @ there.ravel(), columns=every @ slopes.reshape(n_t * n_y, -1))

    return replace(made, follow=follow)


def _row_weights(weights: np.ndarray, noise: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    """What unit noise of the rows makes of the mean strains (n_t, n_y, n_b): stages of a group have noise of their own, so that the size of
    their mean counts."""
    scaled = weights * noise[:, None, :]
    return np.array([np.sign(weights[g].sum(axis=0)) * np.sqrt((scaled[g] ** 2).sum(axis=0)) / len(g) for g in groups])


def _covariance(per_strain: np.ndarray, of_rows: np.ndarray, extra: np.ndarray) -> np.ndarray:
    """Covariance (n_t, n_y, n_t, n_y) N^2 of the residual: noise of every stage is independent, sections share rows. `extra` (n_t,
    n_y) N^2 is noise of each alone."""
    n_y, n_t = per_strain.shape[:2]
    shared = np.einsum("jab,jcb->jac", of_rows, of_rows)
    out = np.zeros((n_t, n_y, n_t, n_y))
    for a in range(n_y):
        for c in range(n_y):
            out[:, a, :, c] = (per_strain[a] * shared[:, a, c]) @ per_strain[c].T
    return out + np.diag(extra.ravel()).reshape(out.shape)


def _force_error(seen: JointErrors, time: np.ndarray) -> np.ndarray:
    """F predicted - F measured (n_t,) N: zero where the force drives the model."""
    if "force" not in seen.errors:
        return np.zeros(len(time))
    return np.interp(time, seen.joint.model.observations["force"].time, seen.errors["force"].ravel())


def _beside(
    seen: JointErrors, sections: SectionHistories, weights: np.ndarray, groups: list[np.ndarray], per_strain: np.ndarray
) -> np.ndarray:
    """What errors of unit variance make of the residual (n_t, n_y, k): modes of the smoothed force, noise of a compared one, and the error
    of mesh and steps that may be left in the displacements."""
    n_t, n_y = sections.predicted.shape
    parts = [np.zeros((n_t, n_y, 0))]
    steps = seen.joint.steps
    if seen.joint.study.force.drives == "force" and steps.error is not None:
        modes = np.stack([np.interp(sections.time, steps.time, mode) for mode in steps.error.T], axis=1)
        parts.append(np.repeat(modes[:, None, :], n_y, axis=1))
    elif "force" in seen.errors:
        noise = float(np.median(seen.joint.data.force.sigma))
        parts.append(np.repeat(noise * np.eye(n_t)[:, None, :], n_y, axis=1))
    if "u" in seen.left:
        channel = _channel(seen)
        assert channel is not None
        profile = profile_of(seen.joint.model.observations["u"].xy, seen.mask(channel))
        strain = np.einsum("tyb,tb->ty", weights, profile.mean(seen.left["u"][:, :, 1]))
        mean = np.array([strain[g].mean(axis=0) for g in groups])
        parts.append(np.einsum("yij,jy->iy", per_strain, mean)[:, :, None])
    return np.concatenate(parts, axis=2)


def _cells(
    sections: SectionHistories, spans: tuple[Span, ...], variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Weights (m, n_t, n_y) that make cells of stages: means of neighbours of one phase, the quiet ones most; number in time and place of
    each, its time and duration (m,)."""
    n_t, n_y = variance.shape
    size = max(1, -(-n_t // CELLS_IN_TIME))
    blocks: list[np.ndarray] = []
    for phase in range(len(spans) + 1):
        own = np.array([k for k in range(n_t) if _phase(float(sections.time[k]), spans) == phase], dtype=int)
        blocks += [own[i : i + size] for i in range(0, len(own), size)]
    blocks.sort(key=lambda b: float(sections.time[b[0]]))
    usual = float(np.median(np.diff(sections.time))) if n_t > 1 else 0.0
    weights, row, column, time, duration = [], [], [], [], []
    for r, block in enumerate(blocks):
        for c in range(n_y):
            own = block[sections.known[block, c] & (variance[block, c] > 0.0)]
            if not len(own):
                continue
            one = np.zeros((n_t, n_y))
            one[own, c] = 1.0 / variance[own, c]
            one /= one.sum()
            weights.append(one)
            row.append(r)
            column.append(c)
            time.append(float(one[:, c] @ sections.time))
            duration.append(float(np.ptp(sections.time[block])) + usual)
    if not weights:
        raise NumericsError("force through sections: no section was measured at any stage")
    return np.array(weights), np.array(row), np.array(column), np.array(time), np.array(duration)
