"""The error of the prescribed force: what its modes make of displacements and temperatures, against runs under the force that errs."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_pulls import SIZE, TIME, TRUTH, data, study

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, load_modes
from thermofit.experiment.body_check import verification
from thermofit.experiment.channels import field_of
from thermofit.experiment.drive import with_driven_force
from thermofit.experiment.fields import LoadSteps, Measured, Stretched, force_observation
from thermofit.experiment.force_error import estimated_error, with_force_error
from thermofit.experiment.joint import Joint, joint_settings
from thermofit.experiment.verification import KnownErrors

TIMES = np.unique(np.concatenate([np.linspace(0.0, 50.0, 101), TIME]))
COURSE = np.interp(TIMES, [0.0, 2.0, 6.0, 24.0, 27.0, 30.0, 44.0, 50.0], [0.0, 0.0, 3900.0, 5000.0, 1500.0, 5000.0, 5300.0, 1000.0])
MODES = np.stack([np.exp(-(((TIMES - at) / 3.0) ** 2)) for at in (14.0, 24.0, 40.0)], axis=1)
PARAMETERS = Parameters.of({**TRUTH, "alpha_air": 15.0}, ("E",))


def loaded(force: np.ndarray, error: np.ndarray | None) -> Measured:
    """The pulled test under another force, observed at steps of that."""
    steps = LoadSteps(TIMES, force, np.zeros(len(TIMES)), None, error)
    seen = np.flatnonzero(np.isin(np.round(TIMES, 6), np.round(np.arange(2.0, 50.5, 1.0), 6)))

    def at_steps(observation):  # type: ignore[no-untyped-def]
        shape = (len(seen), *observation.value.shape[1:])
        blank = {"value": np.zeros(shape), "sigma": np.full(shape, observation.sigma.flat[0]), "mask": np.ones(shape[:2], dtype=bool)}
        return replace(observation, time=TIMES[seen], **blank)

    whole = data()
    assert whole.temperature is not None
    every = dict.fromkeys(whole.steps, steps)
    return replace(whole, displacement=at_steps(whole.displacement), temperature=at_steps(whole.temperature), steps=every)


def joint(force: np.ndarray, error: np.ndarray | None = MODES) -> Joint:
    return Joint(study(), loaded(force, error), joint_settings(study(), ("E",), data()), SIZE)


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_modes_are_what_a_force_that_errs_makes(mode: int) -> None:
    """In the first flow; at its end, where the error stays until the next flow; and near the end of the test, where it stays as well.

    The force comes back to its largest value at 30 s: whether the specimen flows there hangs on the error, and no derivative can say it.
    """
    here = joint(COURSE, MODES[:, [mode]])
    _, right = here.shown(PARAMETERS)
    found = with_force_error(here, PARAMETERS).force_error
    assert found is not None
    wrong = joint(COURSE + 0.5 * MODES[:, mode]).shown(PARAMETERS)[1]
    for name, near in (("u", 0.01), ("theta", 0.03)):  # what the step at 30 s has set free stays in the temperatures
        clear = np.abs(here.model.observations[name].time - 30.0) > 0.6
        made, told = (wrong[name] - right[name])[clear] / 0.5, found[name].turned[0, 0] * found[name].fields[clear, ..., 0]
        assert np.linalg.norm(told - made) < near * np.linalg.norm(made), (name, np.linalg.norm(told - made) / np.linalg.norm(made))


@pytest.mark.parametrize("carries", [True, False])
def test_modes_are_asked_on_one_layer(carries: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over half the thickness, where they do what they do on two layers; on these where one layer does not carry the force."""
    two, asked, whole = replace(joint(COURSE), size=SIZE.with_counts({"n_z": 2})), [], Joint.prediction.func  # type: ignore[attr-defined]
    expected = two.prediction.linearise(PARAMETERS, load_modes(MODES.shape[1]))[1]

    def watched(own: Joint) -> SimpleNamespace:
        def linearise(parameters: Parameters, names: tuple[str, ...]):  # type: ignore[no-untyped-def]
            asked.append(own.size.n_z)
            if own.size.n_z == 1 and not carries:
                raise NumericsError("not carried")
            return whole(own).linearise(parameters, names)

        return SimpleNamespace(linearise=linearise)

    monkeypatch.setattr(Joint, "prediction", property(watched))
    found = with_force_error(replace(two), PARAMETERS).force_error
    assert found is not None and asked == ([1] if carries else [1, 2])
    for name, modes in found.items():
        told, near = modes.fields @ modes.turned.T, 5e-3 if carries else 1e-3
        assert np.linalg.norm(told - expected[name]) < near * np.linalg.norm(expected[name]), name
    asked.clear()
    with pytest.raises(NumericsError) if not carries else nullcontext():
        with_force_error(joint(COURSE), PARAMETERS)
    assert asked == [1], "of one layer nothing is asked twice"


def test_the_residual_is_whitened_against_the_force() -> None:
    """Draws of force and cameras: unit variance in every channel with the modes, far from it without."""
    here, random = joint(COURSE, 40.0 * MODES), np.random.default_rng(3)
    blurred = with_force_error(here, PARAMETERS)
    assert blurred.force_error is not None
    comparisons, (common,) = blurred.model.comparisons, blurred.model.common
    plain: list[np.ndarray] = []
    white: list[np.ndarray] = []
    for _ in range(40):
        drawn, fields = random.normal(size=MODES.shape[1]), {}
        for name, modes in blurred.force_error.items():
            sigma = here.model.observations[name].sigma
            fields[name] = modes.fields @ (modes.turned.T @ drawn) + sigma * random.normal(size=sigma.shape)
        plain.append(np.array([np.mean(c.residual(fields[field_of(c)]) ** 2) for c in here.model.comparisons]))
        whitened = common.innovations([c.residual(fields[field_of(c)]) for c in comparisons])
        white.append(np.array([np.mean(r**2) for r in whitened]))
    assert len(comparisons) == 2
    assert np.all(np.mean(plain, axis=0) > 1.3)
    assert np.all(np.abs(np.mean(white, axis=0) - 1.0) < 0.1), np.mean(white, axis=0)
    assert np.all(np.std(white, axis=0) < 0.15)


def test_columns_of_a_term_are_what_it_does_to_the_residual() -> None:
    """What displacement cameras add is taken for an error of the force, and shows in the temperatures as the heat of its flow."""
    model = with_force_error(joint(COURSE, 40.0 * MODES), PARAMETERS).model
    errors = model.errors(PARAMETERS)
    drift = np.linspace(0.0, 0.02, errors["u"].shape[0])[:, None, None] * np.ones_like(errors["u"])
    warmer = np.linspace(0.0, 0.3, errors["theta"].shape[1])[None, :, None] * np.linspace(0.0, 1.0, len(errors["theta"]))[:, None, None]
    for name, added in (("u", drift * np.linspace(0.0, 1.0, drift.shape[1])[:, None]), ("theta", warmer)):
        change = model.assemble({**errors, name: errors[name] + added}) - model.assemble(errors)
        columns = model.columns({name: np.stack([added, 2.0 * added], axis=-1)})
        every = [columns.get(k, np.zeros((c.n, 2))) for k, c in enumerate(model.comparisons)]
        assert np.allclose(np.concatenate(every), np.stack([change, 2.0 * change], axis=1), atol=1e-9 * np.abs(change).max())
        felt = {field_of(model.comparisons[k]) for k, column in columns.items() if np.abs(column).max() > 1e-3}
        assert felt == ({"u", "theta"} if name == "u" else {"theta"})


def test_a_force_whose_error_is_not_known_changes_nothing() -> None:
    here = joint(COURSE, None)
    assert with_force_error(here, PARAMETERS) is here


def test_temperatures_alone_know_what_the_displacements_tell_of_the_force() -> None:
    """The heat model on the motion of a run has the rows that the whole one has there, also under another force than the right one."""
    errs = with_force_error(joint(COURSE + 4.0 * MODES[:, 1], 3.0 * MODES), PARAMETERS)
    assert errs.force_error is not None
    whole = errs.model.residual(PARAMETERS)
    n_u, n_theta = (next(c.n for c in errs.model.comparisons if c.channel == channel) for channel in ("du", "dtheta"))
    heat = errs.heat(PARAMETERS)
    assert heat is not None
    # A heat run and a coupled one differ by the tolerance of the coupling, some microkelvin of 20 mK of noise.
    np.testing.assert_allclose(heat.residual(PARAMETERS)[:n_theta], whole[n_u : n_u + n_theta], atol=1e-3)
    alone = replace(errs, settings=errs.settings.model_copy(update={"channels": {"dtheta": errs.settings.channels["dtheta"]}}))
    blind = alone.model.residual(PARAMETERS)[:n_theta]
    assert np.linalg.norm(blind - whole[n_u : n_u + n_theta]) > 0.1 * np.linalg.norm(blind)


@pytest.mark.parametrize(("scale", "low", "high"), [(1.0, 0.3, 2.0), (8.0, 9.0, np.inf)])
def test_misfit_of_the_force(scale: float, low: float, high: float) -> None:
    """About one in the mean of draws where the force errs as its modes say (less by what its temperatures may err), above the three
    standard errors that are let pass where it errs by eight times that, as a model does that misses something."""
    here, random = joint(COURSE, 20.0 * MODES), np.random.default_rng(7)
    _, right = here.shown(PARAMETERS)
    found = with_force_error(here, PARAMETERS)
    assert found.force_error is not None
    data, misfit = found.data, []
    assert data.temperature is not None
    for _ in range(8):
        drawn = scale * random.normal(size=MODES.shape[1])
        seen = {}
        for name, observation in (("u", data.displacement), ("theta", data.temperature)):
            modes, noise = found.force_error[name], observation.sigma * random.normal(size=observation.value.shape)
            made = modes.fields @ (modes.turned.T @ drawn)
            seen[name] = replace(observation, value=observation.value + right[name] + made + noise)
        misfit.append(replace(found, data=replace(data, displacement=seen["u"], temperature=seen["theta"])).force_misfit(PARAMETERS))
    assert low < np.mean(misfit) < high, misfit


def test_a_heat_that_is_missing_is_no_misfit_of_the_force() -> None:
    """Displacements at their noise say that the force is right, however far the temperatures are off; these are not asked."""
    here, random = joint(COURSE, 20.0 * MODES), np.random.default_rng(11)
    _, right = here.shown(PARAMETERS)
    found = with_force_error(here, PARAMETERS)
    data = found.data
    assert data.temperature is not None
    u, theta = (
        replace(o, value=o.value + right[o.name] + o.sigma * random.normal(size=o.value.shape))
        for o in (data.displacement, data.temperature)
    )
    warm = replace(theta, value=theta.value + 30.0 * theta.sigma * np.linspace(0.0, 1.0, len(theta.value))[:, None, None] ** 2)
    both = [replace(found, data=replace(data, displacement=u, temperature=seen)).force_misfit(PARAMETERS) for seen in (theta, warm)]
    assert both[1] == pytest.approx(both[0], rel=1e-6) and both[1] < 2.0


def test_parameters_that_follow_the_force_do_not_count_as_its_misfit() -> None:
    """A fit that took the force as exact followed its error: what a joint step of the parameters takes back is no misfit of the model."""
    here, free = joint(COURSE, 20.0 * MODES), ("E", "M_y0", "M_yinf")
    _, right = here.shown(PARAMETERS)
    found = with_force_error(here, PARAMETERS)
    data, random = found.data, np.random.default_rng(8)
    assert data.temperature is not None
    seen = {
        o.name: replace(o, value=o.value + right[o.name] + o.sigma * random.normal(size=o.value.shape))
        for o in (data.displacement, data.temperature)
    }
    holding = replace(found, data=replace(data, displacement=seen["u"], temperature=seen["theta"]))
    off = PARAMETERS.replace(M_y0=1.02 * PARAMETERS["M_y0"])
    assert holding.force_misfit(off.with_free(("nu",))) > 9.0
    assert holding.force_misfit(off.with_free(free)) < 2.0


def test_all_channels_tell_the_error_of_the_force() -> None:
    """The history of the error comes back, with its sign, where the force tells by its effect; none where it is not known."""
    _, right = joint(COURSE).shown(PARAMETERS)
    planted, random = 4.0 * MODES[:, 1] - 3.0 * MODES[:, 2], np.random.default_rng(9)
    errs = with_force_error(joint(COURSE + planted, 3.0 * MODES), PARAMETERS)
    data = errs.data
    assert data.temperature is not None
    seen = {
        o.name: replace(o, value=o.value + right[o.name] + o.sigma * random.normal(size=o.value.shape))
        for o in (data.displacement, data.temperature)
    }
    holding = replace(errs, data=replace(data, displacement=seen["u"], temperature=seen["theta"]))
    found = estimated_error(holding, PARAMETERS)
    assert found is not None
    np.testing.assert_allclose(found, planted, atol=0.2 * np.abs(planted).max())
    assert estimated_error(holding.without_force_error(), PARAMETERS) is None


def test_what_is_known_of_the_force_is_taken_off_before_a_run() -> None:
    """The check of a fit runs under the corrected force: that of the same test under the right one, to the last digits."""
    error = 5.0 * MODES[:, 1]
    right = verification(study(), loaded(COURSE, None), PARAMETERS, KnownErrors({}))
    corrected = verification(study(), loaded(COURSE + error, None), PARAMETERS, KnownErrors({"u": np.array(0.5)}, error))
    np.testing.assert_allclose(corrected.predicted["u"], right.predicted["u"] - 0.5, atol=1e-9)
    np.testing.assert_allclose(corrected.predicted["theta"], right.predicted["theta"], atol=1e-7)


NOISE = 3e-4
"""mm of one value of the elongation."""


def between_sections(noise: float = NOISE, error: np.ndarray | float = 0.0, counted: bool = True) -> Joint:
    """The same test driven by the elongation of the model, at every stage that errs by `error` (n_t,) mm."""
    given = loaded(COURSE, None)
    u = Joint(study(), given, joint_settings(study(), ("E",), given), SIZE).shown(PARAMETERS)[0].u_top
    stages = given.displacement.time  # type: ignore[union-attr]
    elongation = np.interp(stages, TIMES, u - u[0]) + error
    moved = np.where(TIMES > given.load_start, np.interp(TIMES, stages, elongation), 0.0)
    steps = {name: replace(one, elongation=moved) for name, one in given.steps.items()}
    force = force_observation(stages, next(iter(steps.values())), 4.0)
    stretched = Stretched(stages, elongation, np.full(len(stages), 15.0), noise)
    whole = replace(given, steps=steps, force=force, stretched=stretched)
    own = study("force: {drives: dic}\n")
    return Joint(own, with_driven_force(whole) if counted else whole, joint_settings(own, ("E",), whole), SIZE)


def test_noise_of_the_elongation_is_noise_of_the_force_until_it_flows_again() -> None:
    """What a stage at the largest force before an unloading errs by, all of the unloading does, and the temperatures with it. The force has
    its own noise alone then, and no error of a prescribed force is told."""
    here = between_sections()
    assert here.data.force.sigma.ravel() == pytest.approx(np.full(len(here.data.force.time), np.hypot(4.0, 15.0)))
    blurred = with_force_error(here, PARAMETERS)
    assert blurred.force_error is not None and set(blurred.force_error) == {"force", "theta"}
    assert blurred.model.observations["force"].sigma == pytest.approx(4.0)
    assert estimated_error(blurred, PARAMETERS) is None
    time = here.data.force.time
    stage = int(np.argmin(np.abs(time - 24.0)))
    number = stage - int(np.sum(time <= here.data.load_start + 1e-6))
    wrong, right = between_sections(error=NOISE * (np.arange(len(time)) == stage)).shown(PARAMETERS)[1], here.shown(PARAMETERS)[1]
    for name, near in (("force", 0.01), ("theta", 0.05)):  # what the step at 30 s has set free stays in the temperatures
        modes = blurred.force_error[name]
        one = modes.fields @ modes.turned[number]
        clear = np.abs(blurred.model.observations[name].time - 30.0) > 0.5  # whether it flows there hangs on the error
        moved = (wrong[name] - right[name])[clear]
        assert np.linalg.norm(one[clear] - moved) < near * np.linalg.norm(moved), name
    made = (wrong["force"] - right["force"]).ravel()
    unloaded = (time > 24.5) & (time < 29.5)
    assert np.ptp(made[unloaded]) < 0.01 < 4.0 < np.abs(made[unloaded]).min() and np.abs(made[time < 23.5]).max() < 0.01
    assert with_force_error(between_sections(counted=False), PARAMETERS).force_error is None
    assert with_force_error(between_sections(noise=0.0), PARAMETERS).force_error is None


def test_a_force_between_sections_that_err_is_whitened() -> None:
    """Draws of the elongation and of the load cell, by runs: unit variance with what is known of the elongation, and rows that are
    independent of each other; with their errors on their own they hang together."""
    here, random = between_sections(), np.random.default_rng(4)
    blurred = with_force_error(here, PARAMETERS).model
    (place,) = (k for k, c in enumerate(blurred.comparisons) if field_of(c) == "force")
    plain, white = [], []
    right = here.shown(PARAMETERS)[1]["force"]
    for _ in range(12):
        wrong = between_sections(error=NOISE * random.normal(size=len(right))).shown(PARAMETERS)[1]["force"]
        off = wrong - right + 4.0 * random.normal(size=right.shape)
        plain.append(here.model.comparisons[place].residual(off))
        common = blurred.common[0]
        white.append(common.innovations_of({place: blurred.comparisons[place].residual(off)})[place])
    assert 0.7 < np.mean(np.square(white)) < 1.4, np.mean(np.square(white))
    alike = [abs(np.mean(np.array(rows)[:, :-1] * np.array(rows)[:, 1:]) / np.mean(np.square(rows))) for rows in (plain, white)]
    assert alike[1] < 0.05 and alike[0] > 0.1, alike


def test_temperatures_between_sections_are_told_what_the_force_says_of_them() -> None:
    """Draws of the elongation, by runs, with noise of camera and load cell. A micrometre cools a whole frame: its mean is far from nothing
    with the errors on their own. Beside the force it is as a mean of independent noise."""
    here, random = between_sections(), np.random.default_rng(5)
    seen = here.data.temperature
    assert seen is not None
    here = replace(here, data=replace(here.data, temperature=replace(seen, sigma=0.05 * seen.sigma)))
    blurred = with_force_error(here, PARAMETERS).model
    (force,), (theta,) = ([k for k, c in enumerate(blurred.comparisons) if field_of(c) == name] for name in ("force", "theta"))
    right, plain, white = here.shown(PARAMETERS)[1], [], []
    nodes = right["theta"].shape[1]
    for _ in range(12):
        wrong = between_sections(error=NOISE * random.normal(size=len(right["force"]))).shown(PARAMETERS)[1]
        off = {name: wrong[name] - right[name] for name in ("force", "theta")}
        off["force"] = off["force"] + 4.0 * random.normal(size=off["force"].shape)
        off["theta"] = off["theta"] + blurred.observations["theta"].sigma * random.normal(size=off["theta"].shape)
        parts = {place: blurred.comparisons[place].residual(off[name]) for place, name in ((force, "force"), (theta, "theta"))}
        rows = (here.model.comparisons[theta].residual(off["theta"]), blurred.common[0].innovations_of(parts)[theta])
        for found, row in zip((plain, white), rows, strict=True):
            found.append(nodes * np.mean(row.reshape(-1, nodes), axis=1) ** 2)
    time = seen.time[1:]  # the first frame is what the others are relative to
    unloads = ((time > 24.5) & (time < 29.5)) | (time > 44.5)
    assert np.mean(plain, axis=0)[unloads].mean() > 5.0
    assert np.mean(white, axis=0)[unloads].mean() < 1.5
    assert np.mean(white) < 0.6 * np.mean(plain)


def test_a_heat_that_is_missing_is_no_misfit_of_the_elongation() -> None:
    """The force at its noise says that the elongation is right, however far the temperatures are off."""
    here, random = between_sections(), np.random.default_rng(13)
    right, found = here.shown(PARAMETERS)[1], with_force_error(here, PARAMETERS)
    seen, force = found.data.temperature, found.data.force
    assert seen is not None
    measured = replace(force, value=force.value + right["force"] + 4.0 * random.normal(size=force.value.shape))
    warm = 30.0 * seen.sigma * np.linspace(0.0, 1.0, len(seen.value))[:, None, None] ** 2
    both = [
        replace(found, data=replace(found.data, force=measured, temperature=replace(seen, value=seen.value + right["theta"] + more)))
        for more in (0.0, warm)
    ]
    misfit = [one.force_misfit(PARAMETERS) for one in both]
    assert misfit[1] == pytest.approx(misfit[0], rel=1e-6) and misfit[1] < 2.0
