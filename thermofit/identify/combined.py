"""Combined uncertainty of a fit: its own noise, and everything that it takes for exact, of stages passed on from one to the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import THERMOCOUPLES, Parameters, bare_name
from thermofit.experiment.joint import FORCE_NOISE
from thermofit.experiment.model import StageModel
from thermofit.experiment.prescribed import Moved, acting, columns
from thermofit.experiment.priors import LANDMARKS, is_of_pose
from thermofit.experiment.protocol import Experiment
from thermofit.fit.budget import Budget, combined
from thermofit.fit.linear_model import LinearModel
from thermofit.identify.blocks import residual_blocks
from thermofit.identify.budget import earlier_moves
from thermofit.identify.outcome import channel_table
from thermofit.identify.solve import Solved, noise_of
from thermofit.records.artefact import Record
from thermofit.study.stages import StageSettings

ABOVE_NOISE = 1.05
"""Error of a channel over its noise, which is itself known to a few percent, from which on the residual tells of more than noise."""


def with_budget(settings: StageSettings, experiment: Experiment, solved: Solved, earlier: Mapping[str, Record]) -> Solved:
    """The same answer with the combined uncertainty of its parameters; `earlier`: records of the stages whose parameters it took.

    Where a run that tells a cause fails, the answer keeps the noise alone, and says so.
    """
    if solved.covariance is None or solved.fit.jacobian is None:
        return solved
    model, parameters = solved.model, solved.parameters
    names, passed = earlier_moves({stage: record for stage, record in earlier.items() if record.parameters})
    used = tuple(n for n in names if n not in solved.fit.names)
    try:
        told = experiment.stage_errors(settings, parameters, used)
    except NumericsError as error:
        remark = f"the uncertainty holds the noise of the data alone: a run that tells the rest failed ({error})"
        return replace(solved, remarks=(*solved.remarks, remark))
    causes = dict(told.causes)
    rows = [names.index(n) for n in used]
    for cause, moves in passed.items():
        through = told.slopes @ moves[rows]
        if not through.any():
            continue
        own = causes.get(cause)
        causes[cause] = through if own is None else _added(own, through)
    linear = LinearModel(solved.fit.residual, solved.fit.jacobian, noise_of(model, solved.fit.residual))
    budget = combined(
        linear,
        solved.covariance,
        causes,
        noise_scale=None if model.segments is not None else float(np.mean(model.spread**2)),
        groups=groups_above_noise(solved),
        channels=model.places if model.segments is None else None,
    )
    return replace(solved, budget=budget)


def joint_budget(solved: Solved, prescribed: Mapping[str, Moved], limits: Mapping[str, np.ndarray]) -> Budget:
    """Budget of a joint fit with a covariance. `prescribed`: by how much parameters move for one standard error of what the test takes for
    exact, by cause; `limits` (n,): errors of mesh and steps that may be left in the residual. NumericsError where a run fails."""
    model, fit, spread = solved.model, solved.fit, solved.covariance
    assert spread is not None and fit.jacobian is not None
    causes = taken_for_exact(model, solved.parameters.with_free(fit.names), fit.jacobian, prescribed, limits)
    records = model.segments is not None
    return combined(
        LinearModel(fit.residual, fit.jacobian, noise_of(model, fit.residual)),
        spread,
        causes,
        within={} if records else _within(model, fit.jacobian),
        noise_scale=None if records else float(np.mean(model.spread**2)),
        groups=groups_above_noise(solved),
        channels=None if records else model.places,
    )


def taken_for_exact(
    model: StageModel, parameters: Parameters, jacobian: np.ndarray, prescribed: Mapping[str, Moved], limits: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Columns (n, m) that one standard error of everything which a joint fit takes for exact makes in its residual, by cause; `jacobian`
    (n, n_p) by what is free. The rest as `joint_budget`."""
    causes = {cause: rows[:, None] / np.sqrt(3.0) for cause, rows in limits.items()}  # of a uniform distribution (JCGM 100, 4.3.7)
    if prescribed:
        asked = tuple(name for name in acting(prescribed) if name not in parameters.free)
        slopes = np.column_stack([jacobian, model.linearised(parameters, asked)[1]]) if asked else jacobian
        causes |= columns(prescribed, (*parameters.free, *asked), slopes)
    return causes


def _within(model: StageModel, jacobian: np.ndarray) -> dict[str, np.ndarray]:
    """What of the noise of the joint residual has a name: error of the smoothed force, readings of thermocouples, landmarks of the infrared
    camera of each test."""
    n, found = len(jacobian), {}
    if (shared := model.common_columns()).size:
        found[FORCE_NOISE] = shared
    begin = n - len(model.priors)
    for k, prior in enumerate(model.priors):
        if not jacobian[begin + k].any():
            continue
        own, bare = np.eye(n, 1, -(begin + k)), bare_name(prior.name)
        if bare in THERMOCOUPLES:
            found[prior.name] = own
        elif is_of_pose(bare):
            cause = LANDMARKS + prior.name.removeprefix(bare)
            found[cause] = np.column_stack([found[cause], own]) if cause in found else own
    return found


def groups_above_noise(solved: Solved) -> np.ndarray | None:
    """Numbers (n,) of blocks of time and space that a misfit has in common; None where every channel is at its noise."""
    model = solved.model
    channels = channel_table(model, model.errors(solved.parameters))
    above = max((float(c["chi2_reduced"]) for c in channels.values()), default=0.0) > ABOVE_NOISE**2
    return residual_blocks(model, solved.fit.residual).label if above and model.segments is None else None


def _added(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sum of columns of the same errors; one may lack the last ones."""
    width = max(a.shape[1], b.shape[1])
    return np.pad(a, ((0, 0), (0, width - a.shape[1]))) + np.pad(b, ((0, 0), (0, width - b.shape[1])))
