"""Identification of the hardening law from equal force through all cross-sections, and its test on the frames that were not used.

Unknown are the law (`considere_strain`, `H_exp`), the offset of every section but the necking one, and the true strain of the necking
section in every frame: errors of all strains then count alike, where a residual in forces would be smallest for a material that hardens
exactly as much as its sections shrink.

Sections of a necking specimen in equilibrium: from the strain of one to the strains of all others.

Every cross-section carries the same force at the same instant. With isochoric flow F = sigma(s + e) A exp(-e), where e counts from the
first frame, A is the area there and s the strain that the section then has more (or less) than the necking one. All flow in the first
frame, sigma(s) A = F(0), so that with g(x) = ln sigma(x) - x + const:

    g(s + e) - g(s) = g(tau) - g(0),    tau: strain of the necking section (s = 0).

g grows up to the strain x_c where d ln sigma/dx = 1 (Considere, Annales des Ponts et Chaussees 9, 1885) and falls beyond; sections with
s < 0 stop straining when tau reaches it. Only differences of g enter on both sides: the areas being unknown, g times any factor does
equally well. Therefore the rate d ln sigma/dx (0) is prescribed; x_c and the exponent are felt, the size of hardening is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from thermofit.core.errors import DataError, NumericsError
from thermofit.fit.covariance import Covariance
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import memories, noise_operator
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Settings
from thermofit.law.hardening.catalogue import hardening
from thermofit.read.section_strain import NORMAL, SectionStrain

_LAW = hardening("voce")
_GRID = 400
_NEWTON = 8


@dataclass(frozen=True)
class HardeningLaw:
    """sigma/sigma(0) = 1 + R g(x) + H x, hardening law voce with g = 1 - exp(-h x), and linear (M_yinf/M_y0 - 1 = R, H_exp = h,
    H_lin/M_y0 = H), told by the Considere strain `considere`, `exponent` h and the `rate` R h + H > 1/(1 - considere) at x = 0."""

    considere: float
    exponent: float
    rate: float

    @property
    def voce(self) -> float:
        """R = M_yinf/M_y0 - 1."""
        return float(_voce(self.considere, self.exponent, self.rate).real)

    @property
    def linear(self) -> float:
        """H = H_lin/M_y0."""
        return float(self.rate - self.voce * _shape(0.0, self.exponent)[1])

    def stress(self, x: np.ndarray) -> np.ndarray:
        """sigma/sigma(0) at strains (any shape)."""
        return np.asarray(_stress(x, self.considere, self.exponent, self.rate).real)

    def excess(self, x: np.ndarray) -> np.ndarray:
        """g = ln(sigma/sigma(0)) - x."""
        return np.asarray(np.log(self.stress(x)) - x)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """g' = d ln sigma/dx - 1."""
        return np.asarray((self.voce * _shape(x, self.exponent)[1] + self.linear) / self.stress(x) - 1.0)

    def parameter_slopes(self, x: np.ndarray) -> np.ndarray:
        """dg/d(considere, exponent) (2, ...) by complex steps."""
        tiny = 1e-30
        first = np.log(_stress(x, self.considere + 1j * tiny, self.exponent, self.rate)).imag / tiny
        second = np.log(_stress(x, self.considere, self.exponent + 1j * tiny, self.rate)).imag / tiny
        return np.stack([first, second])

    def holds(self, lowest: float) -> bool:
        """Whether the law hardens at the first frame and its stress is positive from the strain `lowest` on."""
        if not (self.considere < 1.0 and self.rate * (1.0 - self.considere) > 1.0):
            return False
        x = np.linspace(min(lowest, 0.0), self.considere, 32)
        return bool(np.all(self.stress(x) > 0.0) and np.all(self.slope(x[:-1]) > 0.0))


def _shape(x: Any, exponent: complex) -> tuple[Any, Any]:
    """g, the hardening law between limits 0 and 1, and its derivative at strains x (any shape)."""
    found: tuple[Any, Any] = _LAW.file.yield_stress(x, *_LAW.number_values({"M_y0": 0.0, "M_yinf": 1.0, "H_exp": exponent}))
    return found


def _voce(considere: complex, exponent: complex, rate: float) -> complex:
    """R such that d sigma/dx = sigma at x = considere, with R g'(0) + H = rate."""
    g, slope = _shape(considere, exponent)
    return complex((1.0 - rate * (1.0 - considere)) / (slope - g - _shape(0.0, exponent)[1] * (1.0 - considere)))


def _stress(x: np.ndarray, considere: complex, exponent: complex, rate: float) -> np.ndarray:
    voce = _voce(considere, exponent, rate)
    linear = rate - voce * _shape(0.0, exponent)[1]
    return np.asarray(1.0 + voce * _shape(x, exponent)[0] + linear * x)


def section_states(law: HardeningLaw, offset: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """x = s + e (n_f, n_s) of sections whose strain in the first frame is `offset` s (n_s,) < 0, while the necking one has tau (n_f,)."""
    target = law.excess(np.minimum(tau, law.considere))[:, None] + law.excess(offset)[None, :]
    grid = np.linspace(min(float(offset.min()), float(tau.min()), 0.0) - 0.02, law.considere, _GRID)
    grid = grid[law.stress(grid) > 0.0]
    values = law.excess(grid)
    # From the grid point below, Newton steps on a concave rising curve come from below and never pass the solution.
    x = grid[np.clip(np.searchsorted(values, target) - 1, 0, len(grid) - 1)]
    for _ in range(_NEWTON):
        slope = np.maximum(law.slope(x), 1e-9)
        x = np.minimum(x + (target - law.excess(x)) / slope, law.considere)
    return x


def held_strain(law: HardeningLaw, offset: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """e (n_f, n_s) with unloading: a section keeps its largest strain once the force has passed its maximum (elastic strain left out)."""
    largest = np.maximum.accumulate(tau)
    return np.asarray(section_states(law, offset, largest) - offset)


LAW = ("considere_strain", "H_exp")
BOUNDS = {"considere_strain": (0.005, 0.9), "H_exp": (0.05, 300.0)}
ENDED = 3.0
"""A section no longer strains from where the mean over `_WINDOW` frames is within this many of its sigma of the final strain."""
_WINDOW = 5
_DEEPEST = -0.5


@dataclass(frozen=True)
class SectionStrains:
    """Strains up to the last frame that is fitted: `neck` index of the necking section, `others` (n_o,), `used` (n_f, n_s) samples of
    sections that still strain, `end` (n_s,) the frame at which each stops (n_f of the whole test: never)."""

    strain: SectionStrain
    n_fit: int
    neck: int
    others: np.ndarray
    used: np.ndarray
    end: np.ndarray

    @property
    def excluded(self) -> int:
        """Samples of the fitted frames, but the first, left out because their sections had stopped straining."""
        return int((~self.used[1 : self.n_fit]).sum())


@dataclass(frozen=True)
class NeckingFit:
    """Law, offsets (n_o,) and true strain of the necking section (n_fit,); the fit, its covariance with correlated errors, and how many
    independent values the residual is worth."""

    law: HardeningLaw
    offset: np.ndarray
    tau: np.ndarray
    result: FitResult
    covariance: Covariance
    independent: float

    def sigma(self, name: str) -> float:
        """Standard error of a parameter, scaled with the misfit."""
        return float(self.covariance.sigma[self.covariance.names.index(name)])


def sections_of(strain: SectionStrain, n_fit: int) -> SectionStrains:
    """Which sections still strain when. DataError where fewer than two beside the necking one do."""
    neck = int(np.argmax(strain.axial[n_fit - 1]))
    end = np.array([ended(course, sigma) for course, sigma in zip(strain.axial.T, strain.sigma, strict=True)])
    end[neck] = len(strain.axial)
    used = np.arange(len(strain.axial))[:, None] < end
    used[0] = False  # zero by definition: the state that strains count from
    enough = used[:n_fit].sum(axis=0) >= 4
    used[:, ~enough] = False
    others = np.flatnonzero(enough & (np.arange(len(end)) != neck))
    if len(others) < 2 or not enough[neck]:
        raise DataError(
            f"necking: {len(others)} sections beside the necking one strain in at least 4 of the {n_fit} fitted frames, expected 2 or "
            "more; check necking.fit_frames and necking.rows"
        )
    return SectionStrains(strain, n_fit, neck, others, used, end)


def ended(course: np.ndarray, sigma: float) -> int:
    """First frame from which a section has its final strain (median of the last eighth of the test) within noise; n_f where it still
    strains then."""
    n = len(course)
    tail = course[-max(n // 8, 4) :]
    final, noise = float(np.median(tail)), max(sigma, float(np.std(np.diff(tail))) / np.sqrt(2.0))
    smooth = np.convolve(np.pad(course, _WINDOW // 2, mode="edge"), np.full(_WINDOW, 1.0 / _WINDOW), mode="valid")
    below = np.flatnonzero(smooth < final - ENDED * noise / np.sqrt(_WINDOW))
    first = int(below[-1]) + 1 if below.size else 0
    return first if first < n - len(tail) else n


def fit_sections(sections: SectionStrains, rate: float) -> NeckingFit:
    """Least squares over law, offsets and the course of the necking section. NumericsError where no start can be evaluated."""
    best: FitResult | None = None
    reason = ""
    for factor, exponent in ((1.3, 5.0), (1.8, 20.0), (3.0, 10.0)):
        try:
            problem = necking_problem(sections, rate, factor, exponent)
            found = minimise(problem, "least-squares", Settings(x_tolerance=1e-5, max_evaluations=150))
        except NumericsError as error:
            reason = str(error).split(": ")[-1]
            continue
        if best is None or found.f < best.f:
            best = found
    if best is None:
        raise NumericsError(f"necking: no start can be evaluated ({reason}); fit fewer frames or lower necking.hardening_rate")
    if best.jacobian is None:
        raise NumericsError(f"necking: {best.message or 'no derivative at the optimum'}; expected a minimum, check necking.fit_frames")
    lengths = [int(sections.used[: sections.n_fit, s].sum()) for s in (*sections.others, sections.neck)]
    found_memories = memories(best.residual, lengths)
    spread = LinearModel(best.residual, best.jacobian, noise_operator(found_memories)).covariance(best.names, best.at_bound)
    n_o = len(sections.others)
    law = HardeningLaw(float(best.x[0]), float(best.x[1]), rate)
    return NeckingFit(law, best.x[2 : 2 + n_o], best.x[2 + n_o :], best, spread, sum(m.independent for m in found_memories))


def predicted(sections: SectionStrains, fit: NeckingFit) -> np.ndarray:
    """Strains (n_f, n_o) of the other sections over the whole test from the measured strain of the necking one."""
    return held_strain(fit.law, fit.offset, sections.strain.axial[:, sections.neck])


def necking_problem(sections: SectionStrains, rate: float, factor: float, exponent: float) -> Problem:
    """Least squares of a start: onset of necking at `factor` times the largest measured strain, H_exp = `exponent` or less."""
    n, neck, others = sections.n_fit, sections.neck, sections.others
    axial = sections.strain.axial[:n]
    largest = float(axial[:, neck].max())
    highest = min(BOUNDS["considere_strain"][1], 0.999 * (1.0 - 1.0 / rate))
    start = min(factor * max(largest, 1e-3), 0.9 * highest)
    ratio = np.maximum(axial[-1, neck], 1e-4) / np.maximum(axial[-1, others], 1e-4)
    # A steep law has no stress far below the first frame: offsets of the start stay where it has.
    offset = np.clip(-0.3 * start * (ratio - 1.0), -min(0.8 * start, 0.3 / rate), -1e-3 * start)
    n_o = len(others)
    tau = np.clip(axial[1:, neck], -0.04, 0.9)
    while exponent > 1.0 and not HardeningLaw(start, exponent, rate).holds(float(offset.min())):
        exponent *= 0.7
    names = (*LAW, *(f"offset_{s}" for s in others), *(f"neck_{f}" for f in range(1, n)))
    low, high = BOUNDS["H_exp"]
    return Problem(
        residual=lambda x: necking_linearised(sections, rate, x)[0],
        start=np.concatenate([[start, exponent], offset, tau]),
        lower=np.concatenate([[BOUNDS["considere_strain"][0], low], np.full(n_o, _DEEPEST), np.full(n - 1, -0.05)]),
        upper=np.concatenate([[highest, high], np.full(n_o, -1e-7), np.full(n - 1, 1.0)]),
        scale=np.concatenate([[0.02, 5.0], np.full(n_o, 0.01), np.full(n - 1, 0.001)]),
        names=names,
        linearise=lambda x: necking_linearised(sections, rate, x),
    )


def necking_linearised(sections: SectionStrains, rate: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual, section by section, and its Jacobian. NumericsError for a law that does not harden."""
    n, neck, others = sections.n_fit, sections.neck, sections.others
    n_o = len(others)
    law, offset, tau = HardeningLaw(float(x[0]), float(x[1]), rate), x[2 : 2 + n_o], x[2 + n_o :]
    if not law.holds(min(float(offset.min()), float(tau.min()))):
        raise NumericsError(
            f"necking: no hardening law with Considere strain {x[0]:.3g} and exponent {x[1]:.3g}, expected one that hardens"
        )
    state = section_states(law, offset, tau)
    inverse = 1.0 / np.maximum(law.slope(state), 1e-6)
    before = tau < law.considere
    driver = np.minimum(tau, law.considere)
    terms = law.parameter_slopes(driver)[:, :, None] + law.parameter_slopes(offset)[:, None, :] - law.parameter_slopes(state)
    axial, sigma, used = sections.strain.axial[1:n], sections.strain.sigma, sections.used[1:n]
    residual, rows = [], []
    for j, s in enumerate(others):
        keep = used[:, s]
        block = np.zeros((n - 1, len(x)))
        block[:, :2] = terms[:, :, j].T * inverse[:, j, None]
        block[:, 2 + j] = law.slope(offset[j : j + 1]) * inverse[:, j] - 1.0
        block[np.arange(n - 1), 2 + n_o + np.arange(n - 1)] = np.where(before, law.slope(driver), 0.0) * inverse[:, j]
        residual.append((state[keep, j] - offset[j] - axial[keep, s]) / sigma[s])
        rows.append(block[keep] / sigma[s])
    residual.append((tau - axial[:, neck]) / sigma[neck])
    last = np.zeros((n - 1, len(x)))
    last[:, 2 + n_o :] = np.eye(n - 1) / sigma[neck]
    return np.concatenate(residual), np.concatenate([*rows, last])


FACTORS = (0.5, 2.0, 4.0)
"""The law is identified again with rates whose excess over 1 is this many times the prescribed one."""
_OF_MEDIAN = 1.2533
"""Standard error of the median over that of the mean, normal values."""


@dataclass(frozen=True)
class Onset:
    """Localisation as seen: frame (median over `n` sections at least one width from the neck that stop straining) and the strain of the
    necking section then, with the standard error of that median from the robust spread between sections."""

    frame: float
    strain: float
    sigma: float
    n: int


@dataclass(frozen=True)
class HeldOut:
    """Frames that were not fitted, sections at least one width from the neck: rms of predicted less measured strain, of the strain that
    those sections gain there, and of the noise; mean error of the last frame."""

    n: int
    rms: float
    gain: float
    noise: float
    final: float


@dataclass(frozen=True)
class Neck:
    """Shape of the neck at a frame: half width over the radius of curvature of its edge, a/R; a/(4R) is the size of the error of the mean
    stress (Bridgman, Studies in Large Plastic Flow, 1952, for a/R small)."""

    frame: int
    a_over_r: float

    @property
    def stress_error(self) -> float:
        """ln(1 + a/(4R)), to first order."""
        return 0.25 * self.a_over_r


def far(sections: SectionStrains) -> np.ndarray:
    """Indices of fitted sections at least one width from the necking one: beyond the reach of the stress state of the neck."""
    strain = sections.strain
    distance = np.abs(strain.at - strain.at[sections.neck])
    return np.array([s for s in sections.others if distance[s] >= strain.reference_width], dtype=int)


def onset(sections: SectionStrains) -> Onset | None:
    """When the sections far from the neck stop straining; None where fewer than two stop."""
    n_f = len(sections.strain.axial)
    ends = np.array([sections.end[s] for s in far(sections) if sections.end[s] < n_f], dtype=float)
    if ends.size < 2:
        return None
    course = sections.strain.axial[:, sections.neck]
    strains = np.interp(ends, np.arange(n_f), course)
    middle = float(np.median(strains))
    spread = NORMAL * float(np.median(np.abs(strains - middle)))
    # A frame earlier or later cannot be told apart: at least half of what the neck strains from frame to frame.
    step = 0.5 * float(np.interp(np.median(ends), np.arange(n_f - 1), np.abs(np.diff(course))))
    return Onset(float(np.median(ends)), middle, float(np.hypot(step, _OF_MEDIAN * spread / np.sqrt(len(ends)))), len(ends))


def held_out(sections: SectionStrains, fit: NeckingFit) -> HeldOut | None:
    """Prediction of the frames after the fitted ones; None where there are none or no section is far enough from the neck."""
    chosen, n = far(sections), sections.n_fit
    axial = sections.strain.axial
    if not chosen.size or n >= len(axial):
        return None
    columns = [int(np.flatnonzero(sections.others == s)[0]) for s in chosen]
    error = predicted(sections, fit)[:, columns] - axial[:, chosen]
    gain = axial[n:, chosen] - axial[n - 1, chosen]
    noise = float(np.sqrt(np.mean(sections.strain.sigma[chosen] ** 2)))
    return HeldOut(
        int(error[n:].size), float(np.sqrt(np.mean(error[n:] ** 2))), float(np.sqrt(np.mean(gain**2))), noise, float(np.mean(error[-1]))
    )


def neck_shape(sections: SectionStrains, frame: int) -> Neck:
    """a/R from a parabola through the logarithmic width strain of the sections within one width of the neck."""
    strain = sections.strain
    close = np.abs(strain.at - strain.at[sections.neck]) <= max(strain.reference_width, 2.5 * float(np.min(np.diff(strain.at))))
    if close.sum() < 4:
        return Neck(frame, 0.0)
    y = strain.at[close] - strain.at[sections.neck]
    curvature = 2.0 * float(np.polyfit(y, strain.width[frame, close], 2)[0])
    stretch = float(np.exp(strain.axial[frame, sections.neck]))
    half = 0.5 * strain.reference_width * float(np.exp(strain.width[frame, sections.neck]))
    # Edge half * exp(w(y)) at the neck, y in the reference: its curvature in the current frame is half w''/stretch^2.
    return Neck(frame, max(half * half * curvature / stretch**2, 0.0))


def other_rates(sections: SectionStrains, rate: float) -> list[dict[str, float]]:
    """The law with other prescribed rates: what does not move is determined by the kinematics."""
    rows = []
    for factor in FACTORS:
        other = 1.0 + factor * (rate - 1.0)
        fit = fit_sections(sections, other)
        rows.append(
            {
                "hardening_rate": other,
                "considere_strain": fit.law.considere,
                "sigma_considere_strain": fit.sigma("considere_strain"),
                "H_exp": fit.law.exponent,
                "M_yinf/M_y0": 1.0 + fit.law.voce,
                "H_lin/M_y0": fit.law.linear,
                "s2": fit.covariance.s2,
            }
        )
    return rows


def contraction(sections: SectionStrains, frame: int) -> tuple[float, float]:
    """Width strain over axial strain at a frame, minus the mean over all sections weighted with their strain, and its spread; 0.5 is that
    of an isotropic sheet, whose area shrinks by exp(-axial strain) if flow is isochoric."""
    axial, width = sections.strain.axial[frame], sections.strain.width[frame]
    mean = -float(axial @ width / (axial @ axial))
    strained = axial > 0.3 * float(axial.max())
    return mean, float(np.std(-width[strained] / axial[strained]))
