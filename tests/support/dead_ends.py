"""Virtual bodies of random materials whose law lacks something strong, identified from random starts: does the chain come to an end?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tiny

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import Parameters
from thermofit.records.artefact import Record
from thermofit.virtual.machine import CrossheadStep, bar_of, load_history, uniaxial_law

LACKING = ("rate_logarithmic.C", "second_hardening.Q", "thermal_softening.slope")
"""One of them is on in every material, and in none of the models."""
STAGES = ("calibrate-ir", "interpolate", "identify-elastic", "identify-plastic", "identify-thermal", "verify")
_BOUNDS = {"E": (1e4, 1e6), "nu": (0.05, 0.49), "M_y0": (5.0, 2000.0), "M_yinf": (10.0, 5000.0), "H_exp": (0.1, 500.0), "F": (0.05, 5.0)}


def _material(rng: np.random.Generator) -> dict[str, float]:
    start = rng.uniform(80.0, 400.0)
    truth = {
        **tiny.TRUTH,
        "E": rng.uniform(5e4, 2.2e5),
        "M_y0": start,
        "M_yinf": start * rng.uniform(1.3, 2.5),
        "H_exp": rng.uniform(5.0, 25.0),
        "F": rng.uniform(0.3, 0.8),
    }
    lacking = LACKING[int(rng.integers(len(LACKING)))]
    if lacking == LACKING[0]:
        return {**truth, lacking: rng.uniform(0.02, 0.12)}
    if lacking == LACKING[1]:
        return {**truth, lacking: start * rng.uniform(0.3, 1.0), "second_hardening.b": rng.uniform(2.0, 200.0)}
    return {**truth, lacking: rng.uniform(-0.005, 0.01), "thermal_softening.reference": truth["theta_clamp"]}


def _starts(rng: np.random.Generator, truth: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Values that are off by up to a factor of two or three, M_y0 below M_yinf as the law wants it."""
    values = {
        "E": truth["E"] * rng.uniform(0.6, 1.6),
        "nu": rng.uniform(0.25, 0.4),
        "M_y0": truth["M_y0"] * rng.uniform(0.5, 1.2),
        "M_yinf": truth["M_yinf"] * rng.uniform(0.95, 1.8),
        "H_exp": truth["H_exp"] * rng.uniform(0.3, 3.0),
        "F": truth["F"] * rng.uniform(0.6, 1.6),
    }
    return {name: {"start": value, "bounds": list(_BOUNDS[name])} for name, value in values.items()}


def _bearable(path: Path, truth: dict[str, float]) -> float:
    """Position of the crosshead mm up to which the force grows, to 5 %, by the slices of the virtual machine."""
    study = tiny.load_study(path)
    assert study.simulate is not None
    settings = study.simulate
    specimen = study.specimen_of(settings.specimen.lengths())
    bar = bar_of(specimen, uniaxial_law(Parameters.of({**truth, "theta_ref": truth["theta_clamp"]}), study.hardening_law))
    for target in 20.0 * 0.95 ** np.arange(80):
        try:
            load_history((CrossheadStep("crosshead_to", float(target), 0.14),), bar, settings.machine, settings.force.rate)
        except StudyError:
            continue
        return float(target)
    raise AssertionError("no programme that the specimen bears was found")


def made(folder: Path, seed: int) -> tuple[Path, str]:
    """Study file of a virtual test with that seed, simulated, and what its law lacks. The test goes as far as a random share of what the
    specimen can bear."""
    rng = np.random.default_rng(seed)
    truth, share = _material(rng), rng.uniform(0.5, 0.95)
    content = tiny.tree(folder / "run")
    content["parameters"] |= _starts(rng, truth)
    content["simulate"] |= {"truth": truth, "seed": seed}
    content["simulate"]["dic"] = {"stages": 30, "spacing": 2.0}
    furthest = _bearable(tiny.write(folder, content), truth)
    for less in (1.0, 0.75, 0.5, 0.3, 0.15):  # the slices know nothing of heat and rates
        target = less * share * furthest
        programme = [{"hold": 3.0}, {"crosshead_to": target, "rate": 0.14}, {"force_to": 0.0, "rate": -0.14}]
        content["simulate"]["programme"] = [*programme, {"hold_force_until": float(np.ceil(10.0 + 2.5 * target / 0.14))}]
        path = tiny.write(folder, content)
        try:
            tiny.stage_run("simulate")(tiny.load_study(path))
        except NumericsError:
            continue
        return path, next(name for name in LACKING if name in truth)
    raise AssertionError(f"seed {seed}: the virtual body bears none of the programmes")


def ended(path: Path) -> dict[str, Record]:
    """The records of the chain. NumericsError where it is a dead end."""
    return {name: tiny.stage_run(name)(tiny.load_study(path)).record for name in STAGES}
