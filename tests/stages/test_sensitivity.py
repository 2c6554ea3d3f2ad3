"""`sensitivity` on a tiny virtual experiment, and its arithmetic on Table 5.21."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from thermofit.core.errors import NumericsError, StudyError
from thermofit.identify import trials
from thermofit.records.artefact import open_record
from thermofit.stages import sensitivity
from thermofit.stages.sensitivity import relative_change, sensitivity_verdict
from thermofit.study.study import Study

StudyOf = Callable[..., Study]


def test_verdict_on_table_5_21() -> None:
    names = ("alpha_exp", "kappa", "c0", "beta", "alpha_air", "alpha_clamp")
    x = np.array(
        [
            [20.21, 133.45, 2.22, 0.79, 14.72, 236.30],
            [20.07, 144.83, 2.20, 0.79, 13.35, 182.78],
            [20.06, 146.53, 2.20, 0.78, 12.64, 264.03],
        ]
    )
    change = relative_change(x)
    assert change[0] == pytest.approx(0.0) and change[1, 5] == pytest.approx(182.78 / 236.30 - 1.0)
    largest = dict(zip(names, np.abs(change).max(axis=0).tolist(), strict=True))
    text = sensitivity_verdict("theta_clamp", [296.7, 297.3, 296.3], largest)
    assert (
        text
        == "theta_clamp from 296.3 to 297.3 K (nominal 296.7): alpha_clamp reacts most, by up to 23 %; alpha_exp least, by up to 0.74 %"
    )


def test_change_against_a_zero_nominal() -> None:
    assert relative_change(np.array([[0.0, 0.0], [2.0, 0.0], [-4.0, 0.0]])) == pytest.approx(
        np.array([[0.0, 0.0], [0.5, 0.0], [-1.0, 0.0]])
    )


def test_optimum_moves_with_the_prescribed_conductivity(study_of: StudyOf) -> None:
    record = sensitivity.run(study_of()).record
    low, nominal = record.summary["values"]
    assert low["value"] == 100.0 and low["converged"] and low["f"] < record.summary["nominal"]["f"]
    # 200 is the nominal value: nothing may change there.
    assert nominal["change"] == pytest.approx({"alpha_exp": 0.0, "c0": 0.0, "beta": 0.0}, abs=1e-9)
    assert abs(low["change"]["beta"]) > 0.1 and record.summary["largest_change"]["beta"] == pytest.approx(abs(low["change"]["beta"]))
    assert record["values/value"].unit == "mW/(mm K)" and record["values/change"].value.shape == (3, 3)


def test_same_answer_as_identifying_with_that_value(study_of: StudyOf) -> None:
    """An independent way: the stage itself, with the other value in the study and the mechanics that belongs to it."""
    from thermofit.stages import identify_thermal

    study = study_of()
    low = sensitivity.run(study).record.summary["values"][0]["optimum"]
    direct = identify_thermal.run(study_of("parameters.kappa=100.0")).record
    for name, value in low.items():
        assert value == pytest.approx(direct.parameters[name].value, rel=1e-2)


def test_reference_temperature_follows_the_jaws() -> None:
    assert sensitivity.given_values(_with(()), "theta_clamp", 296.0) == {"theta_clamp": 296.0, "theta_ref": 296.0}
    assert sensitivity.given_values(_with(("theta_ref",)), "theta_clamp", 296.0) == {"theta_clamp": 296.0}
    assert sensitivity.given_values(_with(()), "theta_air", 296.0) == {"theta_air": 296.0}


def _with(names: tuple[str, ...]) -> Study:
    return Study.model_construct(parameters=dict.fromkeys(names, 297.0))


def test_jaw_temperature_of_the_thermal_stage(study_of: StudyOf) -> None:
    values = [296.5, 296.9]
    study = study_of(sensitivity={"stage": "thermal", "quantity": "theta_clamp", "values": values})
    summary = sensitivity.run(study).record.summary
    assert summary["trustworthy"] and summary["quantity"] == "theta_clamp" and len(summary["values"]) == 2
    assert 296.5 < summary["nominal"]["value"] < 296.9


def test_quantity_that_reaches_the_mechanics_is_solved_anew(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    prepared = []
    original = trials.model_on

    def counted(*args: object) -> object:
        inner = original(*args)  # type: ignore[arg-type]
        return lambda size, base: prepared.append(base["E"]) or inner(size, base)

    monkeypatch.setattr(trials, "model_on", counted)
    sensitivity.run(study_of(sensitivity={"stage": "thermal", "quantity": "E", "values": [60000.0]}))
    assert set(prepared[1:]) - {prepared[0]} == {60000.0}
    prepared.clear()
    sensitivity.run(study_of(sensitivity={"stage": "thermal", "quantity": "kappa", "values": [150.0]}))
    assert len(prepared) == 1


def test_a_value_that_fails_is_named(study_of: StudyOf, monkeypatch: pytest.MonkeyPatch) -> None:
    solve = trials.solve

    def failing(*args: object, **how: object) -> object:
        if args[2]["kappa"] == 100.0:  # type: ignore[index]
            raise NumericsError("no heat balance")
        return solve(*args, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(trials, "solve", failing)
    summary = sensitivity.run(study_of(), force=True).record.summary
    assert summary["verdict"].endswith("; 1 failed (100)") and not summary["trustworthy"]
    assert summary["values"][0]["change"] is None and summary["values"][0]["message"] == "no heat balance"


def test_missing_optimum_names_the_command(study_of: StudyOf) -> None:
    study = study_of()
    (study.run_dir / "identify-thermal.h5").unlink()
    with pytest.raises(StudyError, match=r"run `thermofit identify-thermal tiny\.yaml` first"):
        sensitivity.run(study)
    with pytest.raises(StudyError, match="key 'sensitivity' is missing"):
        sensitivity.run(study_of(sensitivity=None))


def test_fresh_until_the_stage_is_identified_anew(study_of: StudyOf) -> None:
    study = study_of()
    assert sensitivity.run(study).fresh
    from thermofit.stages import identify_thermal

    identify_thermal.run(study, force=True)
    assert not sensitivity.run(study).fresh
    assert open_record(study.run_dir / "sensitivity.h5").summary["trustworthy"]


@pytest.mark.parametrize(
    ("quantity", "values", "channels"),
    [
        ("kappa", [196.0, 204.0], {"dtheta": {}}),
        ("theta_clamp", [296.68, 296.78], {"dtheta": {}}),
        ("E", [67.0e3, 68.5e3], {"dtheta": {}}),
        ("thickness", [1.1988, 1.2012], {"dtheta": {}}),
        ("clock", [-0.05, 0.05], {"dtheta": {}}),
        ("weight.theta", [0.98, 1.02], {"theta": {}, "dtheta": {}}),
    ],
)
def test_linearised_answer_beside_the_one_identified_anew(
    study_of: StudyOf, quantity: str, values: list[float], channels: dict[str, object]
) -> None:
    """Two independent ways to the same small change of the optimum: by the sensitivities, and by solving again."""
    study = study_of(sensitivity={"stage": "thermal", "quantity": quantity, "values": values}, stages=_stages(channels))
    if len(channels) > 1:
        from thermofit.stages import identify_thermal

        identify_thermal.run(study)
    record = sensitivity.run(study).record
    assert record.summary["trustworthy"]
    nominal = record.summary["nominal"]
    sigma = nominal["sigma"]
    for row in record.summary["values"]:
        moved = {name: row["optimum"][name] - record.summary["nominal"]["optimum"][name] for name in row["optimum"]}
        straight = {
            name: s * (row["value"] - record.summary["nominal"]["value"]) for name, s in record.summary["linearised"]["slope"].items()
        }
        for name, change in moved.items():
            # 10 % of the change for the curvature, and what a search may leave at its end.
            assert abs(straight[name] - change) < 0.1 * abs(change) + 0.1 * sigma[name], (quantity, name, straight[name], change)
    assert max(abs(s) for s in record.summary["linearised"]["relative_slope"].values()) > 0.0
    assert (study.run_dir / "figures" / "sensitivity-change.png").stat().st_size > 5000


def _stages(channels: dict[str, object]) -> dict[str, object]:
    return {"thermal": {"free": ["alpha_exp", "c0", "beta"], "channels": channels}}


def test_quantities_that_the_study_does_not_have_are_refused(study_of: StudyOf) -> None:
    def run(quantity: str) -> object:
        return sensitivity.run(study_of(sensitivity={"stage": "thermal", "quantity": quantity, "values": [1.1]}))

    with pytest.raises(StudyError, match=r"'sensitivity\.quantity' is weight\.u, but the stage compares dtheta"):
        run("weight.u")
    with pytest.raises(StudyError, match=r"the stage compares dtheta alone, where a factor moves nothing"):
        run("weight.dtheta")
    with pytest.raises(StudyError, match=r"the weight of dtheta is sigma; expected manual weights"):
        run("weight.dtheta.x")
