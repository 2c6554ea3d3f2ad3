"""A body from raw files to the answer, its data from another mesh: a heat source that no effect has is unlisted, with what,
where, when and how strong, and nothing listed in its stead; one that the catalogue has is named and not called unlisted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny
import yaml

POWER, PLACE, WINDOW, RADIUS = 30.0, (0.0, 9.0), (38.0, 62.0), 3.0
"""mW of the whole specimen, mm from the middle, s, mm."""
THICKNESS = 1.2
LEFT = 3.4e-3
"""K beyond the noise that an answer may leave."""
LISTED = (
    {"lamp.absorbed": 0.05, "lamp.start": 40.0},
    {"latent_heat.heat": 150.0, "latent_heat.centre": 0.012, "latent_heat.width": 0.006},
)
SPOT = f'''"""A spot in the gauge that is heated for a while: slot heat_source. Off at power = 0."""

import numpy as np

from thermofit.core.parameters import Param

SLOT = "heat_source"
PARAMS = (Param("hot_spot.power", "mW", 0.0, -500.0, 500.0, 5.0, "power of the spot", probe=20.0),)
FORMULA = "r += power exp(-d^2 / (2 R^2)) / (2 pi R^2 thickness) between two times"
SOURCE = "planted by a test"


def heat_source(theta, accumulated, rate, time, x, y, power):
    shape = np.exp(-0.5 * ((x - {PLACE[0]}) ** 2 + (y - {PLACE[1]}) ** 2) / {RADIUS**2}) / (2.0 * np.pi * {RADIUS**2} * {THICKNESS})
    now = 0.5 * (np.tanh((time - {WINDOW[0]}) / 0.5) - np.tanh((time - {WINDOW[1]}) / 0.5))
    return power * shape * now + 0.0 * theta
'''


def thermofit(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, whose catalogue holds what its study names."""
    environment = {k: v for k, v in os.environ.items() if k != "THERMOFIT_EFFECTS"}
    command = [sys.executable, "-c", "from thermofit.cli import main; main()", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def virtual_test(folder: Path, planted: dict[str, float], effects: tuple[str, ...] = ()) -> Path:
    """Study of a test whose raw files hold what is planted; neither its mesh nor its catalogue are those of the virtual experiment."""
    content = tiny.tree(folder / "truth")
    content["simulate"] |= {
        "mesh": {"n_x": 3, "n_y": 38, "n_z": 1},
        "truth": {**tiny.TRUTH, **planted},
        "programme": [{"hold": 3.0}, {"crosshead_to": 3.5, "rate": 0.14}, {"force_to": 0.0, "rate": -0.14}, {"hold_force_until": 80.0}],
        "dic": {"stages": 16, "spacing": 2.0},
        "ir": {"frames": 44, "image_shape": [150, 90]},
    }
    (folder / "hot_spot.py").write_text(SPOT, encoding="utf-8")
    (folder / "truth.yaml").write_text(yaml.safe_dump({**content, "effects": list(effects)}), encoding="utf-8")
    ran = thermofit("simulate", str(folder / "truth.yaml"))
    assert ran.returncode == 0, ran.stderr
    content["stages"]["thermal"]["free"] = ["alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp"]
    content["parameters"] |= {"alpha_air": {"start": 10.0, "bounds": [0.0, 100.0]}, "alpha_clamp": {"start": 300.0, "bounds": [10.0, 2e4]}}
    fit = {k: v for k, v in content.items() if k not in ("simulate", "gridsearch", "sensitivity")}
    fit |= {"experiment": str(folder / "truth" / "raw"), "run_dir": str(folder / "run"), "mesh": {"n_x": 2, "n_y": 22, "n_z": 1}}
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(fit), encoding="utf-8")
    return path


def closed(study: Path) -> tuple[int, dict[str, Any]]:
    """Exit code and answer of the loop, after the stages."""
    ran = thermofit("run", str(study), "--until", "identify-thermal")
    assert ran.returncode in (0, 5), ran.stderr
    ran = thermofit("close-loop", str(study), "--json")
    assert ran.returncode in (0, 5), ran.stderr
    return ran.returncode, json.loads(ran.stdout)


@pytest.mark.slow
def test_a_heated_spot_is_unlisted(tmp_path: Path) -> None:
    code, found = closed(virtual_test(tmp_path, {"hot_spot.power": POWER}, ("hot_spot.py",)))
    said = found["unlisted"]
    assert said is not None and said["unit"] == "mW" and said["channel"] == "dtheta" and said["kind"] == "heat source", found["verdict"]
    assert code == 5 and "unlisted" in found["verdict"] and found["accepted"] == []
    # The model is half of the specimen: it sees |x|, over which the heat has spread long before the source ends.
    where, seen_x = said["where"], RADIUS * np.sqrt(2.0 / np.pi)
    assert where["both_sides"] and abs(where["x_mm"] - seen_x) < where["extent_x_mm"]
    assert abs(where["y_mm"] - PLACE[1]) < RADIUS
    assert np.allclose(said["when_s"], WINDOW, atol=4.0)
    assert said["mean_in_window"] == pytest.approx(POWER, rel=0.2)
    amount = said["amount"]
    assert abs(amount["value"] - POWER) < 3.0 * amount["sigma"] < POWER and said["balance"] == "heat"
    before, after = (said[word]["held_out"]["dtheta"] for word in ("before", "after"))
    floor = found["channels"]["dtheta"]["floor_rms"]
    # Hats of several millimetres leave a little of a spot of three; a nodal temperature is known to 7 mK.
    assert np.sqrt(after**2 - floor**2) < LEFT and before > 1.1 * floor
    assert Path(said["effect_file"]).is_file() and Path(said["figure"]).is_file()


@pytest.mark.slow
@pytest.mark.parametrize("planted", LISTED, ids=lambda planted: next(iter(planted)))
def test_a_source_of_the_catalogue_is_named_and_not_called_unlisted(tmp_path: Path, planted: dict[str, float]) -> None:
    amplitude, value = next(iter(planted.items()))
    code, found = closed(virtual_test(tmp_path, planted))
    assert code == 0 and found["accepted"] == [amplitude.partition(".")[0]] and found["unlisted"] is None, found["verdict"]
    said = found["parameters"][amplitude]
    assert said["value"] == pytest.approx(value, abs=4.0 * said["sigma"]) and said["sigma"] < 0.1 * value
    after, floor = found["after"]["held_out"]["dtheta"], found["channels"]["dtheta"]["floor_rms"]
    assert np.sqrt(max(after**2 - floor**2, 0.0)) < LEFT
