"""The identified law against what was not used for it: where localisation sets in, later frames, and how far the answer may be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermofit.identify.necking import NeckingFit, Sections, fit_sections, predicted
from thermofit.read.section_strain import NORMAL

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


def far(sections: Sections) -> np.ndarray:
    """Indices of fitted sections at least one width from the necking one: beyond the reach of the stress state of the neck."""
    strain = sections.strain
    distance = np.abs(strain.at - strain.at[sections.neck])
    return np.array([s for s in sections.others if distance[s] >= strain.reference_width], dtype=int)


def onset(sections: Sections) -> Onset | None:
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


def held_out(sections: Sections, fit: NeckingFit) -> HeldOut | None:
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


def neck_shape(sections: Sections, frame: int) -> Neck:
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


def other_rates(sections: Sections, rate: float) -> list[dict[str, float]]:
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


def contraction(sections: Sections, frame: int) -> tuple[float, float]:
    """Width strain over axial strain at a frame, minus the mean over all sections weighted with their strain, and its spread; 0.5 is that
    of an isotropic sheet, whose area shrinks by exp(-axial strain) if flow is isochoric."""
    axial, width = sections.strain.axial[frame], sections.strain.width[frame]
    mean = -float(axial @ width / (axial @ axial))
    strained = axial > 0.3 * float(axial.max())
    return mean, float(np.std(-width[strained] / axial[strained]))
