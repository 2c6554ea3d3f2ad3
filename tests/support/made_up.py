"""Made-up tests without finite elements: one that follows the uniaxial closed forms, and a stage whose derivatives are known."""

from __future__ import annotations

import numpy as np

from thermofit.core.experiment import Specimen
from thermofit.core.parameters import Parameters
from thermofit.experiment.fields import LoadSteps, Measured, TestPhase, force_observation
from thermofit.experiment.model import StageModel
from thermofit.observe.comparison import Comparison
from thermofit.observe.observation import FieldObservation

SPECIMEN = Specimen(25.0, 1.2, 100.0, 25.0, 35.0, 150.0, 10.0)
TRUTH = Parameters.of(
    {
        "E": 68000.0,
        "nu": 0.34,
        "M_y0": 130.0,
        "M_yinf": 290.0,
        "H_exp": 11.0,
        "F": 0.35,
        "theta_air": 297.0,
        "theta_clamp": 296.5,
        "theta_ref": 296.5,
    }
)
X, Y = np.meshgrid(np.linspace(-10.0, 10.0, 5), np.linspace(-20.0, 20.0, 5))
XY = np.stack([X.ravel(), Y.ravel()], axis=1)


def uniaxial_test(parameters: Parameters = TRUTH, noise: float = 0.0, last: float = 0.14) -> Measured:
    """Loading from 3 s: ten elastic stages, then Lambda up to `last`; sigma 2 um."""
    r = float(np.sqrt(parameters["F"] + parameters["H"]))
    multiplier = np.concatenate([np.zeros(10), np.linspace(0.0, last, 40)[1:]])
    mandel = (parameters["M_yinf"] - (parameters["M_yinf"] - parameters["M_y0"]) * np.exp(-parameters["H_exp"] * multiplier)) / r
    mandel[:10] *= np.arange(1, 11) / 10.0
    stretch_y = np.exp(mandel / parameters["E"] + r * multiplier)
    stretch_x = np.exp(-parameters["nu"] * mandel / parameters["E"] - parameters["F"] / r * multiplier)
    force = np.concatenate([[0.0, 0.0], mandel / stretch_y * 30.0])
    stretch_y, stretch_x = (np.concatenate([[1.0, 1.0], s]) for s in (stretch_y, stretch_x))
    time = np.concatenate([[0.0, 1.5], 3.0 + np.linspace(0.4, 4.0, 10), 7.0 + np.linspace(0.0, 100.0, 40)[1:]])
    value = np.stack([(stretch_x[:, None] - 1.0) * XY[:, 0], (stretch_y[:, None] - 1.0) * XY[:, 1]], axis=-1)
    value = value + noise * np.random.default_rng(1).normal(size=value.shape)
    observation = FieldObservation("u", time, XY, value, np.full(value.shape, 0.002), np.ones(value.shape[:2], dtype=bool), "mm")
    steps_time = np.sort(np.append(time, 3.0))
    steps = LoadSteps(steps_time, np.interp(steps_time, np.append(time[:2], [3.0, *time[2:]]), np.append(force[:2], [0.0, *force[2:]])))
    phases = (TestPhase(0.0, 3.0, "rest"), TestPhase(3.0, 7.0, "elastic"), TestPhase(7.0, 107.0, "loading"))
    force_seen = force_observation(time, steps, 4.0)
    return Measured(
        SPECIMEN, 297.0, 296.5, observation, None, force_seen, {"displacement": steps, "temperature": steps, "all": steps}, 3.0, phases
    )


WALL_TRUTH = Parameters.of({"E": 68000.0, "nu": 0.34, "kappa": 130.0, "alpha_clamp": 236.0})
WALL_NAMES = ("E", "nu", "kappa", "alpha_clamp")


def wall_fields(parameters: Parameters) -> dict[str, np.ndarray]:
    """Displacements of an elastic bar under growing stress, and temperature drops of a wall behind a contact under growing flux."""
    t = np.linspace(0.0, 1.0, 6)[:, None]
    u = np.stack([-parameters["nu"] / parameters["E"] * X.ravel() * 1e2 * t, 1e2 / parameters["E"] * Y.ravel() * t], axis=-1)
    theta = 300.0 * t * (Y.ravel() / 20.0 / parameters["kappa"] + 1.0 / parameters["alpha_clamp"])
    return {"u": u, "theta": theta[..., None]}


def wall_slopes(parameters: Parameters, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Derivatives of `wall_fields` with respect to the names."""
    fields, n = wall_fields(parameters), len(names)
    slopes = {name: np.zeros((*field.shape, n)) for name, field in fields.items()}
    t = np.linspace(0.0, 1.0, 6)[:, None]
    for i, name in enumerate(names):
        if name == "E":
            slopes["u"][..., i] = -fields["u"] / parameters["E"]
        elif name == "nu":
            slopes["u"][..., 0, i] = fields["u"][..., 0] / parameters["nu"]
        elif name == "kappa":
            slopes["theta"][..., 0, i] = -300.0 * t * Y.ravel() / 20.0 / parameters["kappa"] ** 2
        elif name == "alpha_clamp":
            slopes["theta"][..., 0, i] = -300.0 * t / parameters["alpha_clamp"] ** 2
    return slopes


def wall_observations(noise: float = 1.0) -> dict[str, FieldObservation]:
    """The fields at the truth with `noise` times their standard deviation added; one displacement and one temperature are missing."""
    rng = np.random.default_rng(4)
    out = {}
    for (name, field), (sigma, unit) in zip(wall_fields(WALL_TRUTH).items(), ((5e-4, "mm"), (0.02, "K")), strict=True):
        value, spread = field + noise * sigma * rng.normal(size=field.shape), np.full(field.shape, sigma)
        mask = np.ones(field.shape[:2], dtype=bool)
        mask[3, 7] = False
        value[~mask], spread[~mask] = np.nan, np.nan
        out[name] = FieldObservation(name, np.arange(6.0), XY, value, spread, mask, unit)
    return out


def wall_model(comparisons: tuple[Comparison, ...], observations: dict[str, FieldObservation], bias: float = 0.0) -> StageModel:
    """StageModel with exact derivatives; `bias` is added to the conductivity, as a coarser mesh would."""

    def errors(parameters: Parameters) -> dict[str, np.ndarray]:
        fields = wall_fields(parameters.replace(kappa=parameters["kappa"] + bias))
        return {name: field - observations[name].value for name, field in fields.items()}

    def linearise(parameters: Parameters, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        return errors(parameters), wall_slopes(parameters.replace(kappa=parameters["kappa"] + bias), names)

    return StageModel(errors, comparisons, observations, "", linearise=linearise)
