"""Error fields of a stage, prediction minus observation, and their exact derivatives from one differentiated forward run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from thermofit.body.sensitivity.march import Sensitivities, StepRates
from thermofit.body.solve.history import History, Watch
from thermofit.core.parameters import Parameters
from thermofit.experiment.forward import Sampler
from thermofit.experiment.held import AnyRun
from thermofit.observe.observation import FieldObservation

Errors = dict[str, np.ndarray]
"""Error field prediction - observation (n_t, n_s, n_c) of "u", "theta" and "force"."""
Linearise = Callable[[Parameters, tuple[str, ...]], tuple[Errors, dict[str, np.ndarray]]]
"""Error fields and their derivatives (n_t, n_s, n_c, n_p) with respect to the named parameters, from one forward run."""


@dataclass(frozen=True)
class PlainPrediction:
    """All observed fields as they are in a run. NumericsError where it fails."""

    run: AnyRun
    samplers: dict[str, Sampler]
    observations: dict[str, FieldObservation]

    def errors(self, parameters: Parameters) -> Errors:
        """Error fields of the parameters."""
        return self._of(self.run(parameters))

    def _of(self, history: History) -> Errors:
        """Error fields of a history."""
        shown = {name: self.observations[name].averaged(sampler.observed(name, history)) for name, sampler in self.samplers.items()}
        return {name: value - self.observations[name].value for name, value in shown.items()}

    def linearise(self, parameters: Parameters, names: tuple[str, ...]) -> tuple[Errors, dict[str, np.ndarray]]:
        """Error fields and their derivatives with respect to the named parameters."""
        slopes = {name: np.zeros((*observation.value.shape, len(names))) for name, observation in self.observations.items()}
        resting: dict[str, np.ndarray] = {}

        def collect(n: int, at: StepRates) -> None:
            for name, sampler in self.samplers.items():
                here = np.flatnonzero(sampler.index == n)
                if here.size or n == sampler.reference:
                    value = sampler.observed_rates(name, at)
                    if n == sampler.reference:
                        resting[name] = value if name == "u" else np.zeros_like(value)
                    slopes[name][here] = value - resting[name]

        history = self.run(parameters, Watch(sensitivities=Sensitivities(names, collect)))
        return self._of(history), {name: self.observations[name].averaged(slope) for name, slope in slopes.items()}
