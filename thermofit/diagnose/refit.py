"""The joint fit of a diagnosis: everything that any stage identified, on all channels at once, every evaluation kept on disk."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from thermofit.core.checkpoint import Checkpoint
from thermofit.core.parameters import Parameters
from thermofit.core.progress import progress
from thermofit.core.staging import Job
from thermofit.core.study import Study
from thermofit.core.study_stages import StageSettings
from thermofit.fit.minimise import minimise
from thermofit.fit.result import FitResult
from thermofit.fit.settings import Hooks, Settings
from thermofit.identify.model import StageModel
from thermofit.identify.solve import F_TOLERANCE, checkpoint_folder, covariance_of, evaluation_key, remembering, stage_problem

EXPONENTS = " exponents"
"""Ending of the label of a refit with exponents free: it is given up early where a run is dear, because they often lie in a valley."""
EXPONENT_EVALUATIONS = 8
NEGLIGIBLE = 3e-5
"""Fall of the mean square that ends a joint fit: a thirtieth of the least that is worth an effect."""


@dataclass(frozen=True)
class JointFit:
    """Minimises the objective of a joint model; evaluations are kept beside the artefact of `job` until that is written."""

    study: Study
    settings: StageSettings
    model: StageModel
    job: Job
    at_most: int | None = None
    """Most evaluations; None: those of the settings."""

    def __call__(self, start: Parameters, label: str) -> tuple[Parameters, FitResult]:
        """The optimum from `start` with all of `start.free` free. NumericsError where the model fails at the start."""
        settings = self.settings.model_copy(update={"free": start.free})
        problem, change = stage_problem(self.study, settings, start, remembering(self.model))
        name = re.sub(r"[^A-Za-z0-9_-]", "_", label)
        store = Checkpoint(self.job.path.parent / checkpoint_folder(self.job, name), evaluation_key(self.job, start))
        brief = label.endswith(EXPONENTS) and self.study.coupon is None
        most = EXPONENT_EVALUATIONS if brief else self.at_most or settings.max_evaluations
        least = max(F_TOLERANCE, NEGLIGIBLE * sum(c.n for c in self.model.comparisons))
        options = Settings(x_tolerance=settings.tolerance, f_tolerance=least, max_evaluations=most)
        with progress(f"{self.job.stage} {label}", None) as advance:

            def follow(evaluation: object, residual: object) -> None:
                advance(1, "failed" if residual is None else f"f {getattr(evaluation, 'f', float('nan')):.6g}")

            fit = change.converted(minimise(problem, settings.method, options, Hooks(store=store, on_evaluation=follow)))
        spread, _ = covariance_of(self.model, fit)
        return start.with_vector(fit.x), fit if spread is None else replace(fit, covariance=spread, sigma=spread.sigma)
