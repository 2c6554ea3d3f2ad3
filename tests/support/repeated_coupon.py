"""A coupon test repeated with other noise: its intervals by every way, and how often they hold the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from scipy.signal import lfilter

from thermofit.core.parameters import Parameters
from thermofit.experiment.coupon_model import coupon_model
from thermofit.experiment.coupon_records import CouponData, CouponTest, whole
from thermofit.fit.minimise import minimise
from thermofit.fit.profile import Optimum, profile_side
from thermofit.fit.settings import Settings
from thermofit.identify.identifiability import analysed
from thermofit.identify.intervals import Interval, allowed_rises, bootstrap, laplace
from thermofit.identify.linear import linear_of
from thermofit.identify.solve import stage_problem
from thermofit.point.driver import PointSettings, Programme, simulate
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study

FREE = ("M_y0", "M_yinf", "H_exp")
TRUTH = Parameters.of({"E": 200e3, "nu": 0.3, "M_y0": 300.0, "M_yinf": 500.0, "H_exp": 30.0, "theta_air": 293.0, "theta_ref": 293.0}, FREE)
SIGMA = 3.0
"""Standard deviation of the stress, MPa."""
POINT = MeshSize(n_x=1, n_y=1, n_z=1)


@dataclass(frozen=True)
class Bench:
    """The study of a coupon, and its record without noise."""

    study: Study
    test: CouponTest


def bench(folder: Path, samples: int) -> Bench:
    """A monotonic record of that many samples."""
    tree = {
        "name": "coverage",
        "model": 1,
        "coupon": {"records": [{"file": "a.csv", "time": "t", "strain": "e", "stress": "s", "initial_temperature_degC": 19.85}]},
        "parameters": {
            **{name: TRUTH[name] for name in ("E", "nu", "theta_air", "theta_clamp")},
            "M_y0": {"start": 300.0, "bounds": [50.0, 460.0]},
            "M_yinf": {"start": 500.0, "bounds": [465.0, 900.0]},
            "H_exp": {"start": 30.0, "bounds": [1.0, 200.0]},
        },
        "stages": {"plastic": {"free": list(FREE)}},
    }
    path = folder / "coverage.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    time = np.linspace(0.0, 60.0, samples)
    strain = np.linspace(0.0, 0.06, samples)
    found = simulate(TRUTH, Programme.by_strain(time, strain, 293.0), PointSettings(model=1))
    noise = {"strain": 1e-8, "stress": SIGMA}
    return Bench(load_study(path), CouponTest("a", time, strain, found.stress, None, 293.0, 293.0, noise, whole(time)))


def coloured(n: int, memory: float, rng: np.random.Generator) -> np.ndarray:
    """Noise (n,) of variance one whose correlation falls by the factor `memory` from sample to sample."""
    white = rng.standard_normal(n + 200)
    return np.asarray(lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white)[200:])


def intervals(made: Bench, memory: float, seed: int, profile: bool = True) -> dict[str, dict[str, Interval]]:
    """Intervals of one repeat by every way."""
    noise = SIGMA * coloured(len(made.test.time), memory, np.random.default_rng(seed))
    data = CouponData((replace(made.test, stress=made.test.stress + noise),), "strain")
    settings = made.study.stage("plastic")
    model = coupon_model(made.study, data, settings, TRUTH)
    problem, _ = stage_problem(made.study, settings, TRUTH, model)
    fit = minimise(problem, "least-squares", Settings(x_tolerance=1e-6, f_tolerance=1e-4, covariance=False))
    linear = linear_of(made.study, settings, model, TRUTH.with_vector(fit.x), False)
    analysis = analysed(linear)
    found = {"laplace": laplace(linear, analysis), "bootstrap": bootstrap(linear, 400, seed)[0]}
    if profile:
        optimum = Optimum(linear.x, float(linear.residual @ linear.residual), linear.jacobian)
        rises = allowed_rises(linear, analysis)
        ends = {}
        for i, name in enumerate(FREE):
            low, high = (profile_side(problem, optimum, (i, sign), float(rises[i]), Settings(f_tolerance=1e-2)) for sign in (-1, 1))
            ends[name] = Interval(low.end, high.end, low.open, high.open)
        found["profile"] = ends
    return found


def coverage(made: Bench, memory: float, repeats: int, profile: bool = True) -> dict[str, float]:
    """Share of all intervals of a way that hold the truth, over repeats and parameters."""
    hits: dict[str, list[bool]] = {}
    for seed in range(repeats):
        for way, found in intervals(made, memory, seed, profile).items():
            hits.setdefault(way, []).extend(i.low <= TRUTH[name] <= i.high for name, i in found.items())
    return {way: float(np.mean(hit)) for way, hit in hits.items()}
