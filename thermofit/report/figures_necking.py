"""Figure of a necking test: strains of the sections with their prediction, and the identified hardening law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from thermofit.report.figures import MEASURED, NOISE, legend_below, new_figure


@dataclass(frozen=True)
class NeckingPicture:
    """What is drawn: strain of the necking section `tau` (n_f,), measured and predicted strains (n_f, n_o) of the others and their
    positions, last fitted frame, strains and laws (n_x,), (n_law, n_x) with their prescribed rates, Considere strain with error, and the
    strain seen at localisation (None: not seen)."""

    tau: np.ndarray
    measured: np.ndarray
    model: np.ndarray
    at: np.ndarray
    n_fit: int
    strain: np.ndarray
    laws: np.ndarray
    rates: tuple[float, ...]
    considere: tuple[float, float]
    seen: float | None
    unit: str


def necking_figure(picture: NeckingPicture) -> Figure:
    """Left: strain of every section over that of the neck. Right: stress over that in the first frame, for every prescribed rate."""
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    edge = float(picture.tau[picture.n_fit - 1])
    left.axvspan(0.0, edge, color="#fff1c9", linewidth=0.0, zorder=0, label="fitted frames")
    for j in range(picture.measured.shape[1]):
        left.plot(picture.tau, picture.measured[:, j], **MEASURED, label="measured" if j == 0 else None)
        left.plot(picture.tau, picture.model[:, j], color="tab:red", label="model" if j == 0 else None)
        left.annotate(f"{picture.at[j]:.0f} {picture.unit}", (picture.tau[-1], picture.model[-1, j]), fontsize=6)
    value, sigma = picture.considere
    for ax in (left, right):
        ax.axvspan(value - 2.0 * sigma, value + 2.0 * sigma, label="Considere strain +- 2 sigma", **NOISE)
        if picture.seen is not None:
            ax.axvline(picture.seen, color="black", linewidth=0.8, linestyle=":", label="far sections stop")
    limit = 1.6 * max(value, picture.seen or 0.0, edge)
    left.set_xlim(0.0, limit)
    left.set_ylim(0.0, 1.1 * float(picture.measured[picture.tau <= limit].max()))
    left.set_xlabel("logarithmic strain of the necking section")
    left.set_ylabel("logarithmic strain of a section")
    for law, rate in zip(picture.laws, picture.rates, strict=True):
        right.plot(picture.strain, law, label=f"rate {rate:.3g}")
    right.set_xlabel("logarithmic strain since the first frame")
    right.set_ylabel("stress / stress in the first frame")
    right.legend(loc="upper left")
    handles, _ = left.get_legend_handles_labels()
    legend_below(figure, handles, 5)
    return figure
