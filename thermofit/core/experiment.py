"""What was measured: read-only containers that every reader fills and every stage receives.

Units are fixed: mm, s, N, K. Raw files hold degrees Celsius; readers convert.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

CELSIUS = 273.15
"""Zero degrees Celsius in K."""


@dataclass(frozen=True)
class Specimen:
    """Dogbone after DIN 50125-H; all lengths in mm. Origin at the centre, y along the load, z normal."""

    gauge_width: float
    thickness: float
    parallel_length: float
    shoulder_radius: float
    grip_width: float
    total_length: float
    gripped_length: float


@dataclass(frozen=True)
class ForceRecord:
    """Load cell (and crosshead) over time: `time` s (n,), `force` N (n,), `crosshead` mm (n,) or None; `remarks`: what was converted."""

    time: np.ndarray
    force: np.ndarray
    crosshead: np.ndarray | None = None
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class DicField:
    """Displacements of material points (Lagrangian).

    `time` s (n_t,), `point_id` (n_s,), `reference` mm (n_s, 3) in the unloaded specimen, `displacement` mm
    (n_t, n_s, 3) with NaN where a point is missing in a stage; `side` is "front" or "back".
    """

    time: np.ndarray
    point_id: np.ndarray
    reference: np.ndarray
    displacement: np.ndarray
    side: str = "front"


@dataclass(frozen=True)
class InfraredSequence:
    """Temperatures at fixed pixels (Eulerian): `time` s (n_f,), `frames` K (n_f, n_row, n_col) float32."""

    time: np.ndarray
    frames: np.ndarray
    side: str = "back"


@dataclass(frozen=True)
class Landmarks:
    """Points picked by hand in one infrared frame, all as (row, col) pixels, zero based, pixel centres integer.

    `length` (2, 2) two points `length_mm` apart; `edge_left` (2, 2) on the left edge as seen in the image;
    `edge_right` (2,) on the right edge; `circle` (3, 2) on a circle around the specimen centre.
    """

    frame: int
    length: np.ndarray
    length_mm: float
    edge_left: np.ndarray
    edge_right: np.ndarray
    circle: np.ndarray


@dataclass(frozen=True)
class MeasuredTest:
    """One measured test. `repairs` lists in words everything that a reader counted or mended, `confirmed` the questions about its
    plausibility that the user has answered."""

    folder: Path
    specimen: Specimen
    theta_air: float
    theta_clamp: float
    force: ForceRecord
    dic: DicField | None
    ir: InfraredSequence | None
    landmarks: Landmarks | None
    programme: tuple[str, ...] = ()
    repairs: tuple[str, ...] = field(default=())
    confirmed: tuple[str, ...] = ()


@dataclass(frozen=True)
class CouponRecord:
    """One uniaxial test of a coupon, nominal quantities, tension positive, rows in increasing time.

    `time` s (n,), `strain` (n,) elongation over gauge length, `stress` MPa (n,) force over initial area, `temperature` K (n,) of a sensor
    on the specimen, None where there is none; `theta_air` K of its surroundings, `theta_start` K before the test (None: theta_air).
    `noise`: standard deviation of "strain", "stress", "theta", "lateral" as estimated or declared. `lateral` (n,): nominal strain across
    the load, along the width of a flat specimen, NaN where it has gaps, None where it was not measured. `over_plastic`: a flow curve, whose
    strain has no elastic part; strain and stress are then what exp(e_p) - 1 and sigma exp(-e_p) make of plastic strain e_p and true stress
    sigma. `phases`: (t0, t1, label) in s. `remarks`: what a reader found, counted or mended. `shift_strain`: may the strain be counted from
    where the elastic line meets zero stress. `measured_clock`: was the time measured, and not built from a rate that somebody said.
    `first_loading`: all samples of the first loading of a record that was thinned, of which the rest may hold too few to tell a modulus.
    """

    name: str
    time: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    temperature: np.ndarray | None
    theta_air: float
    noise: dict[str, float] = field(default_factory=dict)
    phases: tuple[tuple[float, float, str], ...] = ()
    remarks: tuple[str, ...] = ()
    theta_start: float | None = None
    lateral: np.ndarray | None = None
    over_plastic: bool = False
    shift_strain: bool = True
    measured_clock: bool = True
    first_loading: CouponRecord | None = None
