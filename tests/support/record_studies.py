"""Records of virtual coupons as files, how a study names them, and the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

from thermofit.cli.app import app
from thermofit.core.experiment import CELSIUS
from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointSettings, Programme, simulate

TRUTH = {
    **{"E": 198e3, "M_y0": 310.0, "M_yinf": 560.0, "H_exp": 14.0},
    **{"alpha_exp": 11.5e-6, "beta": 0.9, "tau": 35.0, "lag": 0.8},
}
FIXED = {"nu": 0.3, "c0": 3.65}
NOISE = {"strain": 2e-7, "stress": 0.4, "temperature": 0.01}
MECHANICAL, THERMAL = ("E", "M_y0", "M_yinf", "H_exp"), ("alpha_exp", "beta", "tau", "lag")


def write_record(path: Path, corners: list[tuple[float, float]], celsius: float, seed: int) -> None:
    """A record of the truth as a laboratory would leave it: percent, MPa and degC, with noise."""
    times, strains = np.array(corners).T
    time = np.arange(0.0, times[-1], 0.1)
    strain = np.interp(time, times, strains)
    air = celsius + CELSIUS
    parameters = Parameters.of({**TRUTH, **FIXED, "theta_air": air, "theta_ref": air})
    found = simulate(parameters, Programme.by_strain(time, strain, air), PointSettings(model=1))
    noise = np.random.default_rng(seed).normal(size=(3, len(time)))
    columns = [
        time,
        100.0 * (strain + NOISE["strain"] * noise[0]),
        found.stress + NOISE["stress"] * noise[1],
        found.theta_sensor - CELSIUS + NOISE["temperature"] * noise[2],
    ]
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header="time_s,strain,stress,temp", comments="", fmt="%.9g")


def record(name: str, celsius: float) -> dict[str, Any]:
    """How the study names a record."""
    return {
        "file": f"{name}.csv",
        "time": {"column": "time_s", "unit": "s"},
        "strain": {"column": "strain", "unit": "%"},
        "stress": {"column": "stress", "unit": "MPa"},
        "temperature": {"column": "temp", "unit": "degC"},
        "initial_temperature_degC": celsius,
        "noise": NOISE,
    }


def call(*arguments: Any) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def told(*arguments: Any, code: int = 0) -> dict[str, Any]:
    """JSON that a command prints; it must end with that exit code."""
    result = call(*arguments, "--json")
    assert result.exit_code == code, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found
