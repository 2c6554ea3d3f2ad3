"""Heat of pieces of the observed length: what heat is missing in a piece whose rims have their measured temperature.

e = theta measured - theta predicted, mean over the width. Both obey the heat equation on the known motion inside the observed field, the
prediction with the identified sources and the measurement with the true ones. So e obeys it with the missing heat q alone, and the
measured e at the rims of a piece stands for all that lies beyond them: jaws, shoulders and grips do not enter. Per length, with the
area A(y) and circumference U(y) of a section, stretch lambda(t), and c0 that of constant stress,

    c0 A de/dt = d/dy (kappa A / lambda^2 de/dy) - alpha_air U sqrt(lambda) e + A q.

Multiplied by w(y) v(t), bumps that vanish with their derivatives at the rims of the piece and at the ends of a window in time, and
integrated by parts, nothing measured is differentiated:

    q mean = int int [-c0 v' w A - kappa / lambda^2 v (A w')' + alpha_air sqrt(lambda) U v w] e dy dt / int int v w A dy dt.

The prediction holds storage, conduction, films, thermoelastic and plastic heat of the identified model; the plastic heat of the mean
strain that was measured stands for that of the predicted one. That the operator takes its
coefficients at a mean temperature and stretch is an error of second order: it acts on e alone.

What the whole model lacks at its boundaries may have driven its conductivity far off. Written with theta measured itself, the balance is
linear in kappa: it is known at any other one without a run (`LocalBalance.follow`), and so is its noise, which grows with kappa.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermofit.body.heat.conduction import expansion_capacity
from thermofit.effects.film_exchange import FILM_UNIT
from thermofit.experiment.local_balance import JointErrors, LocalBalance, width
from thermofit.experiment.section_force import MeasuredFlow
from thermofit.law.page import law_of
from thermofit.observe.profile import RowProfile, excess_noise, integrals, profile_of, spans_piece

RESOLVED = 0.05
"""Noise of the missing heat over the largest heating of the test: windows are as short as this allows."""
SHORTEST = 4.0
"""Rows in a piece, and intervals between frames in a window, at least."""
LONGEST = 0.5
"""Length of a piece over that observed at most."""
MOST_FRAMES = 0.2
"""Intervals of a window over all of the test at most."""
SCANNED = np.geomspace(1.0 / 16.0, 16.0, 33)
"""Multiples of the fitted conductivity at which the balance is asked where it does not close."""


@dataclass(frozen=True)
class _Operator:
    """Coefficients of the heat equation of e: capacity mJ/(mm^3 K), conductivity mW/(mm K), film mW/(mm^2 K), thickness mm, stretch (n_t,)
    at the frames."""

    c0: float
    kappa: float
    film: float
    thickness: float
    stretch: np.ndarray

    @property
    def coefficients(self) -> np.ndarray:
        """c0, kappa, film: the factors (3,) of the three terms."""
        return np.array([self.c0, self.kappa, self.film])


def piece_heat(seen: JointErrors, flow: MeasuredFlow | None = None) -> LocalBalance | None:
    """The balance of heat; None where temperatures are not compared as a rise, or are too few in place or time. `flow`: the plastic heat
    that the measured strain makes more than the predicted one; None: it is that of the prediction."""
    channel = next((c.channel for c in seen.joint.model.comparisons if c.channel == "dtheta"), None)
    if channel is None:
        return None
    observation, compared = seen.joint.model.observations["theta"], seen.mask("dtheta")
    rest = ~compared.any(axis=1) & (observation.time <= seen.joint.data.load_start + 1e-9)
    mask = compared | (rest[:, None] & observation.mask & compared.any(axis=0))
    if not rest.any():
        return None
    mask &= mask[rest].all(axis=0)
    profile = profile_of(observation.xy, mask)
    if len(profile.y) < SHORTEST or len(observation.time) <= SHORTEST:
        return None

    def risen(field: np.ndarray) -> np.ndarray:
        """Means (n_t, n_b) of a field over the rows, less what they were at rest."""
        mean = profile.mean(field)
        return np.asarray(mean - mean[rest].mean(axis=0))

    error = seen.errors["theta"][:, :, 0]
    sigma = profile.sigma(np.where(mask, observation.sigma[:, :, 0], 0.0))
    sigma = sigma * excess_noise(risen(-error), sigma, observation.time, profile.count > 0)
    operator = _operator(seen, observation.time)
    level = risen(observation.value[:, :, 0] + error)
    half, number = _size(seen, profile, observation.time, operator, sigma, rest, level)
    cells = _cells(seen, profile, observation.time, operator, half, number)
    if cells is None:
        return None
    terms, y, time, row, column, duration, volume, total = cells
    flat = np.tensordot(operator.coefficients, terms, axes=1).reshape(len(y), -1)
    names = seen.parameters.free
    beside = [np.zeros((len(y), 0))]
    modes = (seen.joint.force_error or {}).get("theta")
    if modes is not None:
        beside.append(np.stack([flat @ risen(modes.fields[:, :, 0, k]).ravel() for k in range(modes.fields.shape[3])], axis=1))
    if "theta" in seen.left:
        beside.append((flat @ risen(seen.left["theta"][:, :, 0]).ravel())[:, None])

    amount = flat @ risen(-error).ravel()
    if flow is not None:
        in_flow = _of_flow(observation.time, flow, row, time, duration)
        amount = amount - in_flow[:, 0]
        beside.append(in_flow[:, 1:])

    def covariance(coefficients: np.ndarray) -> np.ndarray:
        """Noise (m, m) of the cells at c0, kappa and film (3,)."""
        every = _of_noise(np.tensordot(coefficients, terms, axes=1), rest).reshape(len(y), -1)
        return np.asarray((every * sigma.ravel() ** 2) @ every.T)

    # A prediction that rises with a parameter lowers e.
    columns = np.stack([flat @ risen(-seen.slopes["theta"][:, :, 0, k]).ravel() for k in range(len(names))], axis=1)
    made = LocalBalance(
        kind="heat",
        channel=channel,
        unit="mW/mm^3",
        amount=amount,
        covariance=covariance(operator.coefficients),
        columns=columns,
        names=names,
        value=seen.parameters.vector(),
        bounds=seen.bounds,
        told=seen.known_by_motion,
        beside=np.concatenate(beside, axis=1),
        y=y,
        time=time,
        row=row,
        column=column,
        extent=2.0 * half,
        duration=duration,
        dropped=total - len(y),
        volume=volume,
    )
    if "kappa" not in names:
        return made
    k = names.index("kappa")
    exact = columns[:, k] + terms[1].reshape(len(y), -1) @ risen(-error).ravel()

    def follow(x: np.ndarray) -> LocalBalance:
        """The balance at a conductivity that is off by so much."""
        there = operator.coefficients + x[k] * np.array([0.0, 1.0, 0.0])
        own = columns.copy()
        own[:, k] = exact
        return replace(made, amount=made.amount + exact * x[k], columns=own, covariance=covariance(there))

    scan = np.zeros((len(SCANNED), len(names)))
    scan[:, k] = np.clip(operator.kappa * SCANNED, made.bounds[0][k], made.bounds[1][k]) - operator.kappa
    return replace(made, follow=follow, scan=tuple(scan))


def _operator(seen: JointErrors, time: np.ndarray) -> _Operator:
    v, data = seen.parameters.values, seen.joint.data
    law = law_of(seen.parameters, seen.joint.study.slots)
    capacity, film = v["c0"] + expansion_capacity(law), FILM_UNIT * v["alpha_air"]
    return _Operator(capacity, v["kappa"], film, data.specimen.thickness, _stretch(seen, time))


def _stretch(seen: JointErrors, time: np.ndarray) -> np.ndarray:
    """Predicted mean stretch (n_t,) along the load at times s (n_t,): of the points that DIC sees, or where there is none of those whose
    temperature is compared."""
    u = seen.joint.model.observations.get("u")
    if u is not None:
        at, xy, moved, mask = u.time, u.xy, u.value + seen.errors["u"], u.mask
    else:
        instruments, xy = seen.joint.prediction.instruments, seen.joint.model.observations["theta"].xy
        history = instruments.run(seen.parameters)
        at, moved = history.time, instruments.samplers["theta"].operator.displacement(history.u - history.u[0])
        mask = np.ones(moved.shape[:2], dtype=bool)
    y, own = xy[:, 1] - xy[:, 1].mean(), mask.any(axis=1)
    slope = [float(np.polyfit(y[m], row[m], 1)[0]) for m, row in zip(mask[own], moved[own][:, :, 1], strict=True)]
    return np.asarray(1.0 + np.interp(time, at[own], slope))


def _of_place(seen: JointErrors, knots: np.ndarray, centre: float, half: float, operator: _Operator) -> tuple[np.ndarray, float]:
    """Integrals (3, n_b) over a piece of the hats at rows against w A, (A w')' and w U, and int w A dy mm^3."""
    parts = integrals(knots, centre, half)
    area = operator.thickness * width(seen.joint, knots)
    around = 2.0 * (operator.thickness + width(seen.joint, knots))
    # (A w')' = A w'' + A' w', A straight between rows.
    rises = np.gradient(area, knots)
    return np.stack([area * parts[0], area * parts[2] + rises * parts[1], around * parts[0]]), float(parts[0] @ area)


def _of_time(time: np.ndarray, first: int, last: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Integrals (n_t,) of the hats at the frames against v and v' of the window between two of them, and int v dt s."""
    centre, half = 0.5 * float(time[first] + time[last]), 0.5 * float(time[last] - time[first])
    parts = integrals(time, centre, half)
    return parts[0], parts[1], float(parts[0].sum())


def _combined(operator: _Operator, of_time: tuple[np.ndarray, np.ndarray, float], of_place: tuple[np.ndarray, float]) -> np.ndarray:
    """Weights (3, n_t, n_b) of e in the mean missing heat of a cell for unit capacity, conductivity and film."""
    (v, v_slope, whole), (place, volume) = of_time, of_place
    stored = -v_slope[:, None] * place[0]
    conducted = -(v / operator.stretch**2)[:, None] * place[1]
    lost = (v * np.sqrt(operator.stretch))[:, None] * place[2]
    return np.stack([stored, conducted, lost]) / (whole * volume)


def _of_flow(frames: np.ndarray, flow: MeasuredFlow, row: np.ndarray, time: np.ndarray, duration: np.ndarray) -> np.ndarray:
    """Mean power mW/mm^3 (m, 1 + k) in the windows of cells of the heat of a flow, and of what noise makes of it."""
    so_far = np.column_stack([flow.heat, flow.noise])
    at_frames = np.stack([np.interp(frames, flow.time, column) for column in so_far.T], axis=1)
    each = {}
    for k in range(len(row)):
        if int(row[k]) not in each:
            parts = integrals(frames, float(time[k]), 0.5 * float(duration[k]))
            each[int(row[k])] = -parts[1] @ at_frames / parts[0].sum()
    return np.array([each[int(r)] for r in row])


def _of_noise(weights: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Weights (m, n_t, n_b) of the noise of every frame where those of e count from the mean of the frames at rest."""
    out = weights.copy()
    out[:, rest] -= weights.sum(axis=1, keepdims=True) / float(rest.sum())
    return out


def _size(
    seen: JointErrors,
    profile: RowProfile,
    time: np.ndarray,
    operator: _Operator,
    sigma: np.ndarray,
    rest: np.ndarray,
    level: np.ndarray,
) -> tuple[float, int]:
    """Half length mm of the pieces and intervals between frames in a window.

    A source that is smaller than its piece shows with q L T over its noise: of each length of window the piece is the best one, and the
    window is the shortest whose noise is resolved.
    """
    spacing, observed = float(np.median(np.diff(profile.y))), float(np.ptp(profile.y))
    lengths = np.geomspace(SHORTEST * spacing, max(LONGEST * observed, SHORTEST * spacing), 8)
    longest = max(int(MOST_FRAMES * (len(time) - 1)), int(SHORTEST))
    numbers = sorted({round(n) for n in np.geomspace(SHORTEST, longest, 8)})
    heating = operator.c0 * float(np.abs(np.diff(level, axis=0) / np.diff(time)[:, None]).max(initial=0.0))
    usual = np.nanmedian(np.where(profile.count > 0, sigma, np.nan))
    best = (0.5 * float(lengths[-1]), numbers[-1])
    for number in numbers:
        found = []
        for length in lengths:
            place = _of_place(seen, profile.y, float(profile.y.mean()), 0.5 * float(length), operator)
            errors = []
            for first in range(0, len(time) - number, max(number // 2, 1)):
                terms = _combined(operator, _of_time(time, first, first + number), place)
                weights = np.tensordot(operator.coefficients, terms, axes=1)
                errors.append(float(usual * np.linalg.norm(_of_noise(weights[None], rest))))
            found.append((float(np.median(errors)), float(length)))
        noise, length = min(found, key=lambda f: f[0] * f[1])
        best = (0.5 * length, number)
        if noise <= RESOLVED * heating:
            break
    return best


Cells = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]


def _cells(seen: JointErrors, profile: RowProfile, time: np.ndarray, operator: _Operator, half: float, number: int) -> Cells | None:
    """Weights (3, m, n_t, n_b) of the terms, place and time of cells, their numbers in time and place, duration and volume (m,), and how
    many there would be with nothing lost; pieces and windows overlap by half. None where there is no cell."""
    low, high = float(profile.y[0]), float(profile.y[-1])
    n_y = max(1, round((high - low - 2.0 * half) / half) + 1)
    y = np.linspace(low + half, high - half, n_y) if n_y > 1 else np.array([0.5 * (low + high)])
    step = max(number // 2, 1)
    firsts = [*range(0, len(time) - number, step)]
    if firsts[-1] != len(time) - 1 - number:
        firsts.append(len(time) - 1 - number)
    there, widest = profile.count > 0, max(2.5 * float(np.median(np.diff(profile.y))), 0.6 * half)
    known = [np.flatnonzero(row) for row in there]
    weights, places = [], []
    for c, centre in enumerate(y):
        covered = np.array([spans_piece(profile.y[k], float(centre), half, widest) for k in known])
        for r, first in enumerate(firsts):
            window = slice(first, first + number + 1)
            if not covered[window].all():
                continue
            of_time = _of_time(time, first, first + number)
            rows = known[first]
            if all(np.array_equal(known[k], rows) for k in range(first, first + number + 1)):
                place = _of_place(seen, profile.y[rows], float(centre), half, operator)
                one = np.zeros((3, len(time), len(profile.y)))
                one[:, :, rows] = _combined(operator, of_time, place)
            else:
                one = np.zeros((3, len(time), len(profile.y)))
                for k in range(first, first + number + 1):
                    place = _of_place(seen, profile.y[known[k]], float(centre), half, operator)
                    one[:, k, known[k]] = _combined(operator, of_time, place)[:, k]
            weights.append(one)
            _, volume = _of_place(seen, profile.y, float(centre), half, operator)
            length = float(time[first + number] - time[first])
            places.append((float(centre), 0.5 * float(time[first] + time[first + number]), r, c, length, volume))
    if not weights:
        return None
    at_y, at_t, row, column, duration, volumes = (np.array(v) for v in zip(*places, strict=True))
    return np.stack(weights, axis=1), at_y, at_t, row.astype(int), column.astype(int), duration, volumes, len(y) * len(firsts)
