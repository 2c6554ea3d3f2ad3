"""What is prescribed and errs: its stand-ins among the parameters against runs with the wrong value itself."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from virtual_pulls import SIZE, SPECIMEN, TRUTH, data, study

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters, load_modes
from thermofit.experiment.body import BodyExperiment
from thermofit.experiment.discretisation import finer_mesh, left_by
from thermofit.experiment.fields import Measured
from thermofit.experiment.joint import Joint, coarse_mesh, joint_settings
from thermofit.experiment.prescribed import (
    CALIBRATION,
    acting,
    calibration,
    columns,
    counted_as_exact,
    not_told,
    of_records,
    of_specimen,
    of_test,
)
from thermofit.experiment.stage_errors import stage_errors
from thermofit.study.section import PRESETS
from thermofit.study.stages import ChannelSettings, PlasticStage, StageSettings, ThermalStage

STATED = "uncertainty: {force_class: 1, thickness: 0.012, width: 0.25, camera_scale: 0.001, infrared_gain: 0.02}\n"
PARAMETERS = Parameters.of(TRUTH, ("E", "M_y0"))


@pytest.mark.parametrize("cause", ["thickness", "width", "force calibration"])
def test_an_area_or_a_force_that_errs_is_what_its_stand_in_makes(cause: str) -> None:
    """One percent of it, in displacements and temperatures, by a run of its own; what is left is of second order."""
    case, measured = study(STATED), data()
    here = Joint(case, measured, joint_settings(case, ("E",), measured), SIZE)
    found = of_specimen(case, measured.specimen, PARAMETERS)
    slopes = here.model.linearised(PARAMETERS, acting(found))[1]
    told = columns(found, acting(found), slopes)[cause][:, 0]
    if cause == CALIBRATION:
        wrong, size = {name: replace(s, force=1.001 * s.force) for name, s in measured.steps.items()}, calibration(case) / 0.001
        other = replace(measured, steps=wrong)
    else:
        # The mesh of a wider gauge is another one: of the width the area is what acts, and it acts as a thickness does.
        other, size = replace(measured, specimen=replace(SPECIMEN, thickness=1.001 * SPECIMEN.thickness)), 10.0
    made = size * (replace(here, data=other).model.residual(PARAMETERS) - here.model.residual(PARAMETERS))
    near = 0.05 if cause == "width" else 0.01
    assert np.linalg.norm(told - made) < near * np.linalg.norm(made)


@pytest.mark.parametrize(
    ("said", "channels", "free", "records", "exact"),
    [
        ("", ("du", "dtheta"), ("E",), False, ("force_class", "thickness", "width", "camera_scale", "infrared_gain")),
        ("", ("du",), (), False, ("force_class", "thickness", "width", "camera_scale")),
        ("", ("dtheta@first",), (), False, ("force_class", "thickness", "width", "infrared_gain")),
        ("", ("du", "dtheta"), ("ir_gain.gain@first", "dic_scale.error"), False, ("force_class", "thickness", "width")),
        ("", ("du", "dtheta"), ("force_scale.gain",), False, ("camera_scale", "infrared_gain")),
        ("", ("stress", "dtheta"), (), True, ("force_class",)),
        ("uncertainty: {force_class: 1, width: 0.25, infrared_gain: 0.01}\n", ("du", "dtheta"), (), False, ("thickness", "camera_scale")),
        (STATED, ("du", "dtheta"), (), False, ()),
    ],
)
def test_what_a_study_does_not_state_counts_as_exact(
    said: str, channels: tuple[str, ...], free: tuple[str, ...], records: bool, exact: tuple[str, ...]
) -> None:
    """Where it acts in what is compared and nothing that stands for it is fitted; an area acts in temperatures as well. Records of coupons
    have neither cameras nor an area."""
    assert counted_as_exact(study(said), channels, free, records=records) == exact


def test_temperature_differences_that_are_too_large_by_the_gain_look_like_smaller_coefficients() -> None:
    """Two per cent of all temperatures above those of the surroundings; no other channel knows of it. A fit without it ends with capacity,
    conductivity and both films smaller by as much, and leaves less than a hundredth of it."""
    case, measured = study(STATED), data()
    names = ("kappa", "c0", "beta", "alpha_exp", "alpha_air", "alpha_clamp")
    here = Joint(case, measured, joint_settings(case, names, measured), SIZE).model
    found = of_specimen(case, measured.specimen, PARAMETERS.with_free(names))
    slopes = here.linearised(PARAMETERS, acting(found))[1]
    told = columns(found, acting(found), slopes)["infrared gain"][:, 0]
    made = here.residual(PARAMETERS.replace(**{"ir_gain.gain": 0.02})) - here.residual(PARAMETERS)
    of_heat = np.concatenate([np.full(c.n, c.channel == "dtheta") for c in here.comparisons])
    assert np.abs(made[of_heat]).max() > 0.1 and not made[~of_heat].any()
    assert np.allclose(told, made, atol=1e-6 * np.abs(made).max())
    jacobian = here.linearised(PARAMETERS, names)[1]
    moved = np.linalg.lstsq(jacobian, made, rcond=None)[0]
    by = dict(zip(names, moved / [PARAMETERS[n] for n in names], strict=True))
    of_gain = {"c0", "kappa", "alpha_air", "alpha_clamp"}
    assert by == {n: pytest.approx(-0.02, rel=0.15) if n in of_gain else pytest.approx(0.0, abs=0.002) for n in names}
    assert np.linalg.norm(made - jacobian @ moved) < 0.01 * np.linalg.norm(made)


def test_a_thicker_or_wider_specimen_has_less_surface_for_its_volume() -> None:
    """Exchange per volume is alpha_air 2 (w + t)/(w t): what the stand-in takes off is its relative slope, by differences here."""
    found, alpha = of_specimen(study(STATED), SPECIMEN, PARAMETERS), PARAMETERS["alpha_air"]
    w, t, h = SPECIMEN.gauge_width, SPECIMEN.thickness, 1e-6

    def surface(width: float, thickness: float) -> float:
        return 2.0 * (width + thickness) / (width * thickness)

    by_t = (surface(w, t + h) - surface(w, t - h)) / (2.0 * h * surface(w, t))
    by_w = (surface(w + h, t) - surface(w - h, t)) / (2.0 * h * surface(w, t))
    assert found["thickness"]["alpha_air"] == pytest.approx(0.012 * alpha * by_t, rel=1e-6)
    assert found["width"]["alpha_air"] == pytest.approx(0.25 * alpha * by_w, rel=1e-6)


def test_what_is_free_is_no_cause_and_what_is_not_stated_neither() -> None:
    plain = of_specimen(study(), SPECIMEN, PARAMETERS)
    assert set(plain) == {"theta_air", "theta_clamp"} and plain["theta_air"] == {"theta_air": 0.1}
    assert set(of_specimen(study(), SPECIMEN, PARAMETERS.with_free(("theta_air", "E")))) == {"theta_clamp"}
    stated = of_specimen(study(STATED), SPECIMEN, PARAMETERS)
    assert set(stated) - set(plain) == {"force calibration", "thickness", "width", "camera scale", "infrared gain"}
    free = of_specimen(study(STATED), SPECIMEN, PARAMETERS.with_free(("ir_gain.gain", "dic_scale.error")))
    assert set(stated) - set(free) == {"camera scale", "infrared gain"}
    assert stated[CALIBRATION]["force_scale.gain"] == pytest.approx(0.01 / np.sqrt(3.0)), "limits of a class are no standard error"
    several = of_test(stated, "second", frozenset({"force_scale.gain", "alpha_air"}))
    assert several["thickness@second"].keys() == {"force_scale.gain@second", "alpha_air@second"}


def test_a_stated_error_of_a_parameter_counts_where_nothing_tells_that_parameter() -> None:
    """Not where it is free, not where an earlier stage has told it; of a material that tests share it is one error in all of them."""
    case = study("uncertainty: {parameters: {E: 700, nu: 0.01, M_yinf: 3}}\n")
    found = of_specimen(case, SPECIMEN, PARAMETERS)
    assert found["nu"] == {"nu": 0.01} and found["M_yinf"] == {"M_yinf": 3.0} and "E" not in found, "E is free"
    assert of_records(case, PARAMETERS) == {name: found[name] for name in ("nu", "M_yinf")}
    assert set(found) - set(not_told(found, ("nu", "M_y0"))) == {"nu"}
    several = of_test(found, "second", frozenset({"theta_air", "theta_clamp"}))
    assert several["nu"] == {"nu": 0.01} and "theta_air@second" in several


def test_a_stage_tells_what_it_takes_for_exact() -> None:
    """Earlier parameters by their derivatives; the force by one column for each of its modes; a mesh as coarse as this one by much."""
    case, measured = study(STATED), data()
    modes = np.ones((len(measured.steps["all"].time), 1)) * 4.0
    measured = replace(measured, steps={name: replace(s, error=modes) for name, s in measured.steps.items()})
    experiment = BodyExperiment(case, given=measured)
    settings = PlasticStage(free=("M_y0", "F"), channels={"du": ChannelSettings()}, window=(0.0, 40.0))
    told = stage_errors(
        case, measured, settings, PARAMETERS.with_free(settings.free), ("E",), experiment.prescribed_errors(PARAMETERS),
        lambda of, own, base, size: replace(experiment, given=of).model(own, base, size),
    )  # fmt: skip
    assert {"mesh", "force noise", "force calibration", "thickness", "camera scale"} <= set(told.causes)
    assert "theta_air" not in told.causes and "time steps" not in told.causes, "displacements hardly feel them"
    model = experiment.model(settings, PARAMETERS.with_free(settings.free), case.mesh_size)
    size, finer = coarse_mesh(case), finer_mesh(coarse_mesh(case))
    coarse, fine = (experiment.model(settings, PARAMETERS.with_free(settings.free), m).residual(PARAMETERS) for m in (size, finer))
    assert left_by(size, case.mesh_size) == 1.0 and np.allclose(told.causes["mesh"][:, 0], (coarse - fine) / (1.0 - left_by(size, finer)))
    step = 50.0
    there = model.residual(PARAMETERS.replace(E=TRUTH["E"] + step)) - model.residual(PARAMETERS.replace(E=TRUTH["E"] - step))
    assert np.allclose(told.slopes[:, 0], there / (2.0 * step), atol=2e-3 * np.abs(there).max() / step)
    gain = told.causes["force calibration"][:, 0]
    noise = told.causes["force noise"][:, 0]
    flow = np.flatnonzero(np.abs(noise) > 0.1 * np.abs(noise).max())
    assert float(noise[flow] @ gain[flow]) > 0.5 * np.linalg.norm(noise[flow]) * np.linalg.norm(gain[flow]), "both pull at the specimen"


def with_modes(measured: Measured) -> Measured:
    """Four newtons throughout, a drift of as much, and a wave."""
    steps = {}
    for name, one in measured.steps.items():
        part = (one.time - one.time[0]) / np.ptp(one.time)
        steps[name] = replace(one, error=4.0 * np.stack([np.ones_like(part), part, np.sin(20.0 * part)], axis=1))
    return replace(measured, steps=steps)


PLASTIC = PlasticStage(free=("M_y0", "M_yinf", "H_exp", "F"), channels={"du": ChannelSettings()}, window=(0.0, 40.0))
THERMAL = ThermalStage(free=("alpha_exp", "kappa", "c0", "beta", "alpha_air"), channels={"dtheta": ChannelSettings()}, window=(0.0, 40.0))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [PLASTIC, THERMAL], ids=["plastic", "thermal"])
def test_what_the_error_of_the_force_does_to_parameters_is_that_on_two_layers(settings: StageSettings) -> None:
    """One layer of 6 x 40 elements against two: each mode in each parameter, within 0.2 % of what all modes do to it."""
    case, measured = study().model_copy(update={"mesh": PRESETS["coarse"]}), with_modes(data())
    experiment, free = BodyExperiment(case, given=measured), PARAMETERS.with_free(settings.free)
    model = experiment.model(settings, free, case.mesh_size)
    told = stage_errors(
        case, measured, settings, free, (), {}, lambda of, own, base, size: replace(experiment, given=of).model(own, base, size)
    ).causes["force noise"]
    # A stage of temperatures holds its motion: there the coupled run tells what the force does.
    runs = Joint(case, measured, settings, case.mesh_size).prediction if settings is THERMAL else model
    slopes = runs.linearise(free, load_modes(told.shape[1]))[1]
    on_two = model.assemble_jacobian(
        {n: np.zeros_like(o.value) for n, o in model.observations.items()}, {n: slopes[n] for n in model.observations}
    )
    columns_of_stage = model.linearised(free, settings.free)[1]
    one, two = (np.linalg.lstsq(columns_of_stage, c, rcond=None)[0] for c in (told, on_two))
    assert np.any(one != two) and np.all(np.abs(one - two) < 2e-3 * np.linalg.norm(two, axis=1, keepdims=True)), (one, two)


@pytest.mark.parametrize("carries", [True, False])
def test_the_error_of_the_force_is_asked_on_one_layer(carries: bool) -> None:
    """Over half the thickness, where what it does is that on two layers; on these where one layer does not carry the force."""
    two = SIZE.with_counts({"n_z": 2})
    case, measured = study().model_copy(update={"mesh": two}), data()
    modes = np.ones((len(measured.steps["all"].time), 1)) * 4.0
    measured = replace(measured, steps={name: replace(s, error=modes) for name, s in measured.steps.items()})
    experiment = BodyExperiment(case, given=measured)
    settings = PlasticStage(free=("M_y0",), channels={"du": ChannelSettings()}, window=(0.0, 40.0))
    free, asked = PARAMETERS.with_free(settings.free), []

    def model_of(of, own, base, size):  # type: ignore[no-untyped-def]
        model = replace(experiment, given=of).model(own, base, size)

        def linearise(parameters: Parameters, names: tuple[str, ...]):  # type: ignore[no-untyped-def]
            asked.append(size.n_z)
            if size.n_z == 1 and not carries:
                raise NumericsError("not carried")
            return model.linearise(parameters, names)

        return replace(model, linearise=linearise)

    told = stage_errors(case, measured, settings, free, (), {}, model_of).causes["force noise"]
    assert asked == ([1] if carries else [1, 2])
    on_one = case.model_copy(update={"mesh": SIZE})
    with pytest.raises(NumericsError) if not carries else nullcontext():
        asked.clear()
        stage_errors(on_one, measured, settings, free, (), {}, model_of)
    assert asked == [1], "of one layer nothing is asked twice"
    model = experiment.model(settings, free, two)
    expected = model.assemble_jacobian({"u": np.zeros_like(model.observations["u"].value)}, model.linearise(free, load_modes(1))[1])
    near = np.linalg.norm(told - expected) / np.linalg.norm(expected)
    assert near < (0.02 if carries else 1e-12) and (near > 0.0 or not carries)
