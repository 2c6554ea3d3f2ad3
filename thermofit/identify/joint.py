"""All stages at once: every free parameter, every channel, both fields coupled, and the instruments that look at them.

The stages of the identification fit one group of parameters after the other. What they leave is judged here with all of them together:
a parameter that an earlier stage froze still takes part, else its error would look like an effect that the model lacks. Readings of
thermocouples are data with an error (errata 13): their parameters are free, held by a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from thermofit.core.study import Study
from thermofit.core.study_section import MeshSize
from thermofit.core.study_stages import ChannelSettings, StageSettings
from thermofit.identify.forward import march_settings, run_of, sampler
from thermofit.identify.inputs import LoadSteps, Measured
from thermofit.identify.instruments import Instruments, JointPrediction, station_names
from thermofit.identify.missing_body import BodyMissing
from thermofit.identify.model import Prior, StageModel, comparison, field_of, steps_for
from thermofit.measure.observation import FieldObservation

THERMOCOUPLE = 0.1
"""Standard error of a declared temperature of air or jaws, K."""
__all__ = ["NUISANCES", "joint_free", "joint_model", "joint_settings", "priors_of", "station_names"]
NUISANCES = ("theta_air", "theta_clamp")


def joint_free(study: Study) -> tuple[str, ...]:
    """What all stages of a study identify, each once."""
    names = (*study.stages.elastic.free, *study.stages.plastic.free, *study.stages.thermal.free)
    return tuple(dict.fromkeys(names))


def joint_settings(study: Study, free: Sequence[str], data: Measured) -> StageSettings:
    """Settings of the joint stage: du, the force where it does not drive the model, and dtheta where there are frames."""
    channels: dict[str, ChannelSettings] = {"du": ChannelSettings()}
    if study.force.drives != "force":
        channels["force"] = ChannelSettings()
    if data.temperature is not None:
        channels["dtheta"] = ChannelSettings()
    if study.diagnosis.channels is not None:
        channels = {c: ChannelSettings() for c in study.diagnosis.channels}
    return StageSettings.model_construct(
        **{**study.stages.plastic.__dict__, "free": tuple(free), "channels": channels, "window": "all", "coupling": "full"}
    )


def priors_of(data: Measured, free: Sequence[str]) -> tuple[Prior, ...]:
    """Priors of the thermocouple readings that are free."""
    values = {"theta_air": data.theta_air, "theta_clamp": data.theta_clamp}
    return tuple(Prior(name, values[name], THERMOCOUPLE) for name in NUISANCES if name in free)


def joint_model(study: Study, data: Measured, settings: StageSettings, size: MeshSize) -> StageModel:
    """StageModel of the joint stage on a mesh: all observations, one coupled run."""
    observations: dict[str, FieldObservation] = {"u": data.displacement}
    if data.temperature is not None:
        observations["theta"] = data.temperature
    if "force" in settings.channels:
        observations["force"] = data.force
    steps: LoadSteps = steps_for(data, set(observations))
    run = run_of(study, data, size, steps, march_settings(study, "full"))
    samplers = {name: sampler(run.body, o, steps) for name, o in observations.items()}
    comparisons = tuple(comparison(c, observations[field_of(c)], settings, study, data.load_start) for c in settings.channels)
    prediction = JointPrediction(Instruments(run, samplers, observations, data.theta_air))
    model = StageModel(prediction.errors, comparisons, observations, "", False, prediction.linearise)
    return replace(model, priors=priors_of(data, settings.free), missing=BodyMissing(prediction.instruments, {}))
