"""Inputs and random streams of a virtual experiment, and the rigid-body motion that all instruments share."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from thermofit.core.errors import StudyError
from thermofit.core.experiment import Specimen
from thermofit.study.virtual import Machine, VirtualInstruments
from thermofit.virtual.machine import LoadHistory

FIXED_END_SHARE = 0.5
"""Share of compliance and slip that moves the fixed end; the rest moves the end at the crosshead."""


@dataclass(frozen=True)
class VirtualFields:
    """Noise-free truth that the instruments look at.

    `face` (n_n, 2) mm: nodes of the outer face of the quarter model, any order; `top` (n_load,) mm: u_y of the pulled end
    at `load.time`; `dic_u` (n_d, n_n, 3) mm at `dic_time` (n_d,) s; `ir_u` (n_f, n_n, 3) mm and `ir_theta` (n_f, n_n) K at
    `ir_time` (n_f,) s; temperatures of air and jaws in K; `programme` in words.
    """

    specimen: Specimen
    load: LoadHistory
    top: np.ndarray
    face: np.ndarray
    dic_time: np.ndarray
    dic_u: np.ndarray
    ir_time: np.ndarray
    ir_u: np.ndarray
    ir_theta: np.ndarray
    theta_air: float
    theta_clamp: float
    programme: tuple[str, ...] = ()


STREAMS = (
    "force",
    "crosshead",
    "thermocouple",
    "motion",
    "dic.points",
    "dic.noise",
    "dic.lost",
    "dic.times",
    "ir.pose",
    "ir.landmarks",
    "ir.noise",
    "ir.background",
    "ir.times",
)
"""One random stream for each purpose: a change of one instrument leaves the noise of the others as it was. Append only."""


def stream(seed: int, name: str) -> np.random.Generator:
    """The random generator of one purpose, a child of the one seed (numpy SeedSequence)."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAMS.index(name),)))


@dataclass(frozen=True)
class RigidMotion:
    """x = R (X + u) + d: `rotation` (n_t, 3, 3) about the centre of the specimen, `shift` (n_t, 3) mm."""

    rotation: np.ndarray
    shift: np.ndarray


def rigid_motion(load: LoadHistory, machine: Machine, seed: int, time: np.ndarray) -> RigidMotion:
    """Rigid-body motion of the specimen at `time` (n_t,) s.

    Along y the fixed end gives way by its share of compliance F + slip. The rotations and the lateral shift grow with
    the load and stay for the larger part when it is taken away, because the jaws have settled; a slow drift comes on top.
    """
    rng = stream(seed, "motion")
    turn = rng.choice([-1.0, 1.0], 3) * rng.uniform(0.6, 1.4, 3)
    side = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.5, 1.5, 2)
    creep = rng.uniform(-0.15, 0.15, 2)
    largest = np.maximum.accumulate(load.force)
    full = float(largest[-1]) or 1.0
    settled = np.interp(time, load.time, (0.3 * load.force + 0.7 * largest) / full)
    slow = (time - load.time[0]) / max(float(np.ptp(load.time)), 1e-300)
    lateral = machine.drift * (settled[:, None] * side + slow[:, None] * creep)
    give = FIXED_END_SHARE * np.interp(time, load.time, machine.compliance * load.force + load.slip)
    angles = np.deg2rad(machine.rotation_deg) * settled[:, None] * turn
    shift = np.stack([lateral[:, 0], give, lateral[:, 1]], axis=1)
    return RigidMotion(Rotation.from_rotvec(angles).as_matrix(), shift)


def sampling_times(kinks: np.ndarray, end: float, n: int, rng: np.random.Generator) -> np.ndarray:
    """Unequal sampling times (n,) s from 0.0 to about `end`, strictly increasing, to the millisecond.

    Twice to three times denser around the kinks of the programme; after the last kink (start of cooling) the density
    decays, as an operator would set it. StudyError where n < 3 or too many frames for the millisecond clock.
    """
    if n < 3 or end <= 0.0 or n > 200.0 * end:
        raise StudyError(
            f"virtual experiment: {n} samples in {end:g} s are not possible, expect 3 to {200 * max(end, 0.0):.0f}; change stages or frames"
        )
    fine = np.linspace(0.0, end, 20001)
    density = np.ones_like(fine)
    for kink in kinks:
        density += 1.5 * np.exp(-np.abs(fine - kink) / max(0.01 * end, 1e-6))
    if len(kinks):
        density /= 1.0 + np.maximum(fine - kinks[-1], 0.0) / (0.05 * end)
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    # Every clock has its own phase; jitter of a tenth of the spacing on top.
    place = np.arange(n) / (n - 1.0)
    place[1:-1] += (rng.uniform(-0.3, 0.3) + rng.uniform(-0.1, 0.1, n - 2)) / (n - 1.0)
    place[-1] -= rng.uniform(0.0, 0.05) / (n - 1.0)
    time = np.round(np.interp(place * count[-1], count, fine), 3)
    time[-1] = min(time[-1], np.floor(end * 1e3) / 1e3)
    if np.diff(time).min() <= 0.0:
        raise StudyError(f"virtual experiment: {n} samples in {end:g} s fall together; take fewer stages or frames")
    return np.asarray(time)


def instrument_times(load: LoadHistory, instruments: VirtualInstruments, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times in s of the DIC stages (n_d,) and of the infrared frames (n_f,): at these the finite-element fields are needed."""
    end = float(load.time[-1])
    dic = sampling_times(load.kinks, end, instruments.dic.stages, stream(seed, "dic.times"))
    infrared = sampling_times(load.kinks, end, instruments.ir.frames, stream(seed, "ir.times"))
    return dic, infrared


def solution_times(
    load: LoadHistory, dic_time: np.ndarray, ir_time: np.ndarray, max_step: float, loaded_step: float = np.inf
) -> np.ndarray:
    """Times of stages, frames and kinks, and as many between them that no step is longer than max_step s, and none in which the force
    changes longer than loaded_step s."""
    kinks = load.kinks[(load.kinks > load.time[0]) & (load.kinks < load.time[-1])]
    fixed = np.unique(np.round(np.concatenate([load.time[[0, -1]], kinks, dic_time, ir_time]), 9))
    longest = [min(max_step, loaded_step) if load.changes(a, b) else max_step for a, b in pairwise(fixed)]
    parts = [np.linspace(a, b, int(np.ceil((b - a) / step)) + 1)[:-1] for (a, b), step in zip(pairwise(fixed), longest, strict=True)]
    return np.append(np.concatenate(parts), fixed[-1])
