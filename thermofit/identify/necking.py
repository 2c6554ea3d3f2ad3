"""Identification of the hardening law from equal force through all cross-sections, and its test on the frames that were not used.

Unknown are the law (`considere_strain`, `H_exp`), the offset of every section but the necking one, and the true strain of the necking
section in every frame: errors of all strains then count alike, where a residual in forces would be smallest for a material that hardens
exactly as much as its sections shrink.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.core.errors import DataError, NumericsError
from thermofit.fit.covariance import Covariance
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.memory import memories, noise_operator
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Settings
from thermofit.identify.necking_law import HardeningLaw, held_strain, section_states
from thermofit.read.section_strain import SectionStrain

LAW = ("considere_strain", "H_exp")
BOUNDS = {"considere_strain": (0.005, 0.9), "H_exp": (0.05, 300.0)}
ENDED = 3.0
"""A section no longer strains from where the mean over `_WINDOW` frames is within this many of its sigma of the final strain."""
_WINDOW = 5
_DEEPEST = -0.5


@dataclass(frozen=True)
class Sections:
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


def sections_of(strain: SectionStrain, n_fit: int) -> Sections:
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
    return Sections(strain, n_fit, neck, others, used, end)


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


def fit_sections(sections: Sections, rate: float) -> NeckingFit:
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


def predicted(sections: Sections, fit: NeckingFit) -> np.ndarray:
    """Strains (n_f, n_o) of the other sections over the whole test from the measured strain of the necking one."""
    return held_strain(fit.law, fit.offset, sections.strain.axial[:, sections.neck])


def necking_problem(sections: Sections, rate: float, factor: float, exponent: float) -> Problem:
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


def necking_linearised(sections: Sections, rate: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
