"""Effects of coupons that are planted in virtual records come back, named and with their amplitude: minutes in all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from record_studies import FIXED, MECHANICAL, NOISE, THERMAL, TRUTH, call, record

from thermofit.core.experiment import CELSIUS
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate

Corners = tuple[tuple[float, float], ...]
CYCLES: Corners = ((0.0, 0.0), (40.0, 0.01), (80.0, -0.01), (120.0, 0.012), (160.0, -0.012), (220.0, 0.03))
RESTS: Corners = ((0.0, 0.0), (100.0, 0.03), (110.0, 0.027), (300.0, 0.027), (320.0, 0.03), (400.0, 0.05))
PULL: Corners = ((0.0, 0.0), (100.0, 0.08))
STARTS = {
    "E": {"start": 190e3, "bounds": [1e5, 3e5]},
    "M_y0": {"start": 300.0, "bounds": [50.0, 1000.0]},
    "M_yinf": {"start": 580.0, "bounds": [100.0, 2000.0]},
    "H_exp": {"start": 12.0, "bounds": [0.1, 100.0]},
    "alpha_exp": {"start": 11e-6, "bounds": [0.0, 5e-5]},
    "beta": {"start": 0.8, "bounds": [0.0, 5.0]},
    "tau": {"start": 45.0, "bounds": [1.0, 1e5]},
    "lag": {"start": 0.6, "bounds": [0.0, 20.0]},
}


def planted(folder: Path, on: dict[str, float], celsius: tuple[float, ...], corners: Corners, hot: bool) -> Path:
    """A study on records of the truth with an effect, one at each temperature."""
    records = []
    times, strains = np.array(corners).T
    for k, degrees in enumerate(celsius):
        time = np.linspace(0.0, times[-1], 1500)
        strain, air = np.interp(time, times, strains), degrees + CELSIUS
        parameters = Parameters.of({**TRUTH, **FIXED, **on, "theta_air": air, "theta_ref": air})
        found = simulate(parameters, Programme.by_strain(time, strain, air), PointSettings(model=1))
        noise = np.random.default_rng(7 + k).normal(size=(3, len(time)))
        sensor = found.theta_sensor - CELSIUS + NOISE["temperature"] * noise[2]
        columns = [time, 100.0 * (strain + NOISE["strain"] * noise[0]), found.stress + NOISE["stress"] * noise[1], sensor]
        np.savetxt(
            folder / f"r{k}.csv", np.stack(columns, axis=1), delimiter=",", header="time_s,strain,stress,temp", comments="", fmt="%.9g"
        )
        own = record(f"r{k}", degrees)
        records.append(own if hot else {key: value for key, value in own.items() if key != "temperature"})
    tree: dict[str, Any] = {"name": "planted", "run_dir": str(folder / "run"), "model": 1, "coupon": {"records": records}}
    tree["parameters"] = {**STARTS, **FIXED}
    if hot:
        tree["stages"] = {"thermal": {"free": [*MECHANICAL, *THERMAL], "channels": {"stress": {}, "dtheta": {}}}}
    path = folder / "planted.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("on", "celsius", "corners", "hot"),
    [
        ({"tension_compression.difference": 0.06}, (23.0,), CYCLES, True),
        ({"air_drift.rate": 0.002, "air_drift.time": 1e6}, (23.0,), RESTS, True),
        ({"softening_power.amount": 0.04, "softening_power.exponent": 1.6}, (23.0, 150.0, 300.0, 450.0), PULL, False),
        ({"backstress_first.C": 3e5, "backstress_first.gamma": 3300.0}, (23.0,), PULL, False),
    ],
    ids=["tension and compression", "drift of the air", "softening by a power", "fast backstress"],
)
def test_a_planted_effect_is_found(tmp_path: Path, on: dict[str, float], celsius: tuple[float, ...], corners: Corners, hot: bool) -> None:
    study = planted(tmp_path, on, celsius, corners, hot)
    assert call("run", study, "--until", "identify-thermal").exit_code in (0, 5)
    result = call("close-loop", study, "--json")
    assert result.exit_code in (0, 5), result.output
    found = json.loads(result.stdout)
    amplitude = next(iter(on))
    name = amplitude.partition(".")[0]
    assert found["accepted"] == [name] and found["ranking"][0]["effect"] == name
    p = found["parameters"][amplitude]
    assert p["value"] == pytest.approx(on[amplitude], rel=0.03) and abs(p["value"] - on[amplitude]) < 5.0 * p["sigma"]
    assert found["after"]["fit"]["stress"] < 1.05 * NOISE["stress"]
