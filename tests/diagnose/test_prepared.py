"""What `prepared` hands over of a joint problem, without its runs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from refits import fitted
from seen_field import case_of

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.diagnose import prepared as module
from thermofit.diagnose.prepared import Prepared, prepared
from thermofit.experiment.model import StageModel
from thermofit.experiment.protocol import JointProblem
from thermofit.fit.result import FitResult
from thermofit.records.staging import Job
from thermofit.study.section import MeshSize

STUDY = cast(Any, SimpleNamespace(source=SimpleNamespace(name="study.yaml"), bounds=lambda _: (0.0, 1.0)))


@dataclass(frozen=True)
class Refit:
    """A joint fit that ends at once."""

    end: tuple[Parameters, FitResult]
    at_most: int = 1
    both_starts: bool = False
    heated: Any = None

    def __call__(self, start: Parameters, label: str, **_: Any) -> tuple[Parameters, FitResult]:
        return self.end


def joint_of(model: StageModel, base: Parameters, **known: Any) -> JointProblem:
    settings, numerical = cast(Any, None), np.zeros(len(model.residual(base)))
    size = MeshSize(n_x=1, n_y=1, n_z=1)
    return JointProblem(settings, base, model, (), size, numerical=lambda _: numerical, **known)


def prepared_from(monkeypatch: pytest.MonkeyPatch, joint: JointProblem, end: tuple[Parameters, FitResult]) -> Prepared:
    experiment = SimpleNamespace(
        start=lambda: joint.base, diagnosed=lambda base: joint, unseen=(), fields=(), drive="force", prescribed_errors=dict
    )
    monkeypatch.setattr(module, "experiment_after", lambda *_: experiment)
    monkeypatch.setattr(module, "JointFit", lambda *_, **__: Refit(end))
    return prepared(STUDY, cast(Any, None), ())


def test_the_correlation_length_of_the_noise_reaches_the_case(monkeypatch: pytest.MonkeyPatch) -> None:
    case, fit = fitted(case_of(1))
    found = prepared_from(monkeypatch, joint_of(case.model, case.parameters, correlation_length=3.5), (case.parameters, fit))
    assert found.case.correlation_length == 3.5 and found.remarks == ()
    assert replace(found.case, correlation_length=0.0).cheap is False


def test_where_the_force_cannot_be_carried_the_diagnosis_is_driven_by_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    case, fit = fitted(case_of(1))
    joint = joint_of(case.model, case.parameters)
    other = SimpleNamespace(
        start=lambda: joint.base,
        diagnosed=lambda base: joint,
        unseen=(),
        fields=(),
        drive="sections",
        prescribed_errors=dict,
        sections="the sections y = -23 and 23 mm",
    )

    def fails(base: Parameters) -> JointProblem:
        raise NumericsError("time step to t = 60 s failed")

    first = SimpleNamespace(start=lambda: joint.base, diagnosed=fails, by_sections=other)
    monkeypatch.setattr(module, "experiment_after", lambda *_: first)
    monkeypatch.setattr(module, "JointFit", lambda *_, **__: Refit((case.parameters, fit)))
    (said,) = prepared(STUDY, Job("diagnose", Path("diagnose.h5"), {}, {}), ()).remarks
    assert "the sections y = -23 and 23 mm" in said and "time step to t = 60 s failed" in said


def test_the_pose_of_a_camera_is_of_its_own_test_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is fitted, marked in the case, and not carried to a held-out test; a family of effects that the user freed has no part of it."""
    case, fit = fitted(case_of(1))
    pose = "ir_drift.rate"
    base = case.parameters.with_free((*case.parameters.free, pose, "ir_gain.gain"))
    joint = replace(joint_of(case.model, base, told={pose: (-0.01, 0.01), "c0": (1.0, 3.0)}), settings=cast(Any, Settings(base.free)))
    seen: list[tuple[str, ...]] = []
    asked: list[dict[str, list[int]]] = []
    experiment = SimpleNamespace(
        start=lambda: base, diagnosed=lambda _: joint, unseen=("third",), fields=(), drive="force", prescribed_errors=dict
    )
    monkeypatch.setattr(module, "experiment_after", lambda *_: experiment)
    monkeypatch.setattr(module, "JointFit", lambda *_, **__: Refit((base, fit)))
    monkeypatch.setattr(module, "within", lambda study, *_: study)
    monkeypatch.setattr(module, "other_test_of", lambda test, settings, *_: seen.append(settings.free))
    families = module.freed_effects
    monkeypatch.setattr(module, "freed_effects", lambda free: asked.append(families(free)) or families(free))
    found = prepared(STUDY, cast(Any, None), ())
    assert found.case.pose == {pose} and seen == [tuple(n for n in base.free if n != pose)]
    assert [list(one) for one in asked] == [["ir_gain"]]


@dataclass(frozen=True)
class Settings:
    """Names that are fitted."""

    free: tuple[str, ...]

    def model_copy(self, update: Any) -> Settings:
        return Settings(**update)


ERRORS_NAMED, EXACT_NAMED = {"mesh": np.array([2.0]), "time steps": np.array([1.0])}, {"mesh": np.array([3.0])}


@dataclass
class Telling:
    """Stands in for the runs that tell errors: counts them, and says whether the force can be known at the parameters."""

    far: bool = False
    fails: bool = False
    at: list[float] = field(default_factory=list)

    def too_far(self, parts: Any, parameters: Parameters) -> bool:
        assert parts == "whole before" or parts.model == "model told"
        return self.far

    def told(self, plain: Any, parameters: Parameters) -> Any:
        assert plain == "plain"
        self.at.append(parameters["kappa"])
        if self.fails:
            raise NumericsError("time step to t = 7 s failed")
        return known(SimpleNamespace(model="model told", scored="scores"), far=True)


@dataclass(frozen=True)
class Known:
    """Errors of a joint problem that were told."""

    whole: Any
    far: bool = False
    left_whole: Any = 0.5
    causes_whole: Any = field(default_factory=lambda: ERRORS_NAMED)
    parts: Any = field(default_factory=lambda: SimpleNamespace(model="model of an exact force", scored="its scores"))
    left: Any = 0.7
    causes: Any = field(default_factory=lambda: EXACT_NAMED)


def known(whole: Any, far: bool = False) -> Any:
    return Known(whole, far)


@dataclass(frozen=True)
class Fitting:
    """How a problem is fitted."""

    model: Any = "model before"
    parts: Any = "parts before"
    ends: Any = None
    heated: Any = "by heat"
    moved: Any = "by motion"
    mechanically: Any = "by displacements"
    failures: list[str] = field(default_factory=list)


def at(*free: str) -> Parameters:
    return Parameters.of(
        {"kappa": 50.0, "lamp.absorbed": 0.01, "clamp_drift.rate": 0.01, "clamp_drift.time": 60.0, "air_drift.rate": 0.0}, ("kappa", *free)
    )


def telling(monkeypatch: pytest.MonkeyPatch, runs: Telling, far: bool = False) -> tuple[Any, Fitting]:
    monkeypatch.setattr(module, "told", runs.told)
    monkeypatch.setattr(module, "too_far", runs.too_far)
    fitting = Fitting()
    before = Known("whole before", far)
    return module.told_again(cast(Any, "plain"), cast(Any, before), cast(Any, fitting), frozenset({"lamp"})), fitting


def test_errors_are_told_anew_with_every_effect_that_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the study frees is no news, nor an exponent that is freed later; the next effect is. The fit, its parts and what may be left
    are those of the errors told last."""
    runs = Telling()
    sharper, _ = telling(monkeypatch, runs)
    assert sharper(at()) is None and sharper(at("lamp.absorbed")) is None and runs.at == []
    found = sharper(at("lamp.absorbed", "clamp_drift.rate"))
    assert found is not None and runs.at == [50.0]
    assert (found.model, found.scored, found.refit.model, found.nearby.parts) == ("model told", "scores", "model told", None)
    assert found.refit.parts is not None and found.numerical == 0.5 and found.doubts is ERRORS_NAMED
    assert found.again(at("lamp.absorbed", "clamp_drift.rate", "clamp_drift.time")) is None and len(runs.at) == 1
    more = found.again(at("clamp_drift.rate", "air_drift.rate"))
    assert more is not None and len(runs.at) == 2


def test_a_force_that_hides_what_is_missing_is_known_from_where_it_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any effect; and once it is known, only with a further one."""
    runs = Telling(far=True)
    sharper, _ = telling(monkeypatch, runs, far=True)
    assert sharper(at()) is None and runs.at == []
    runs.far = False
    found = sharper(at())
    assert found is not None and runs.at == [50.0] and found.model == "model told" and found.again(at()) is None
    runs.far = True
    more = found.again(at("clamp_drift.rate"))
    assert more is not None and more.model == "model told", "known once, known from then on"


def test_errors_of_the_mesh_are_told_anew_while_the_force_stays_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect was added that does not explain enough for the error of the force to be known: what is fitted next may."""
    runs = Telling(far=True)
    sharper, fitting = telling(monkeypatch, runs, far=True)
    found = sharper(at("clamp_drift.rate"))
    assert found is not None and len(runs.at) == 1
    assert (found.model, found.scored, found.numerical) == ("model of an exact force", "its scores", 0.7) and found.doubts is EXACT_NAMED
    assert found.again(at("clamp_drift.rate")) is None and len(runs.at) == 1
    runs.far = False
    known = found.again(at("clamp_drift.rate"))
    assert known is not None and known.model == "model told" and known.numerical == 0.5, "and then it is"
    assert sharper(at("clamp_drift.rate")).model == "model told", "by the errors told before, whatever those told anew say"
    runs.far, runs.fails = True, True
    assert sharper(at("clamp_drift.rate")) is None and "those told before are kept" in fitting.failures[-1]


def test_errors_are_told_beside_a_term_that_the_model_lacks_in_any_case(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though they are known and nothing was added; what the term adds to the prediction goes with the parameters."""
    beside, seen = {"theta": np.array([0.3])}, []
    runs = Telling()
    sharper, _ = telling(monkeypatch, runs)
    monkeypatch.setattr(module, "told", lambda plain, parameters, adds: seen.append(adds) or runs.told(plain, parameters))
    found = sharper(at(), beside)
    assert found is not None and found.model == "model told" and seen == [beside] and runs.at == [50.0]


def test_errors_that_cannot_be_told_anew_stay_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = Telling(fails=True)
    monkeypatch.setattr(module, "told", runs.told)
    monkeypatch.setattr(module, "too_far", lambda *_: False)
    fitting, before = Fitting(), Known(SimpleNamespace(model="model before", scored="scores before"))
    found = module.told_again(cast(Any, "plain"), cast(Any, before), cast(Any, fitting), frozenset())(at("clamp_drift.rate"))
    assert found is not None and found.model == "model before"
    (said,) = fitting.failures
    assert "those told before are kept" in said and "time step to t = 7 s failed" in said
