"""A stage with exact derivatives: assembled as its residual is, solved in few runs, resumed, from coarse to fine."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from jacobian_check import check_jacobian
from made_up import WALL_NAMES, WALL_TRUTH, wall_fields, wall_model, wall_observations, wall_slopes

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.experiment.model import StageModel
from thermofit.identify.outcome import made
from thermofit.identify.solve import NotCarriedError, Solved, at_rounding, remembering, solve, stage_problem
from thermofit.observe.comparison import Comparison, RelativeScheme, plain, relative_displacements, temperature_change
from thermofit.records.staging import Job
from thermofit.study.section import MeshSize
from thermofit.study.study import Study, load_study

START = WALL_TRUTH.replace(E=50000.0, nu=0.2, kappa=200.0, alpha_clamp=4e5).with_free(WALL_NAMES)
OBSERVATIONS = wall_observations()
REFERENCE = np.arange(6) < 2


def comparisons() -> tuple[Comparison, ...]:
    return (relative_displacements(OBSERVATIONS["u"], RelativeScheme()), temperature_change(OBSERVATIONS["theta"], REFERENCE))


def study(folder: Path, *extra: str, mesh: str = "{n_x: 2, n_y: 8, n_z: 1}") -> Study:
    free = ", ".join(WALL_NAMES)
    starts = ", ".join(f"{name}: {START[name]}" for name in WALL_NAMES)
    path = folder / "study.yaml"
    path.write_text(
        f"name: wall\nexperiment: raw\nmesh: {mesh}\nparameters: {{{starts}, theta_air: 297, theta_clamp: 297}}\n"
        f"stages:\n  thermal: {{free: [{free}], channels: {{du: {{}}, dtheta: {{}}}}}}\n",
        encoding="utf-8",
    )
    return load_study(path, [f"run_dir={folder}", *extra])


class Counted:
    """A model that counts its runs, plain and linearised, and dies or fails on request."""

    def __init__(self, model: StageModel, last: int = 1000) -> None:
        self.plain, self.linearised, self.last, self.inner = 0, 0, last, model
        self.model = dataclasses.replace(model, errors=self.errors, linearise=self.linearise)

    def errors(self, parameters: Parameters) -> dict[str, np.ndarray]:
        self.plain += 1
        return self.inner.errors(parameters)

    def linearise(self, parameters: Parameters, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        if self.linearised == self.last:
            raise KeyboardInterrupt
        self.linearised += 1
        assert self.inner.linearise is not None
        return self.inner.linearise(parameters, names)


def solved(case: Study, counted: Counted, start: Parameters = START) -> Solved:
    task = Job("identify-thermal", case.run_dir / "identify-thermal.h5", {}, {})
    return solve(case, case.stage("thermal"), start, lambda size, base: counted.model, task, scalable=True)


@pytest.mark.parametrize(
    "parts",
    [
        (plain(OBSERVATIONS["u"]), plain(OBSERVATIONS["theta"], "max")),
        (temperature_change(OBSERVATIONS["theta"], REFERENCE), relative_displacements(OBSERVATIONS["u"], RelativeScheme())),
        (relative_displacements(OBSERVATIONS["u"], RelativeScheme("neighbour")), plain(OBSERVATIONS["theta"], "value")),
        (relative_displacements(OBSERVATIONS["u"], RelativeScheme("gradient", ("xx", "yy", "xy"))), plain(OBSERVATIONS["u"], (1.0, 2.0))),
    ],
)
def test_jacobian_is_assembled_as_the_residual_is(parts: tuple[Comparison, ...]) -> None:
    """A comparison is linear in the error field, so that a derivative passes through it as a difference of two errors does."""
    model = wall_model(parts, OBSERVATIONS)
    slopes = wall_slopes(START, WALL_NAMES)
    residual, jacobian = model.linearised(START, WALL_NAMES)
    errors = model.errors(START)
    assert np.array_equal(residual, model.assemble(errors)) and jacobian.shape == (residual.size, 4)
    for i in range(4):
        step = 1.0 / max(np.abs(slope[..., i]).max() for slope in slopes.values())
        shifted = {name: field + step * slopes[name][..., i] for name, field in errors.items()}
        difference = (model.assemble(shifted) - residual) / step
        assert jacobian[:, i] == pytest.approx(difference, rel=1e-9, abs=1e-9 * np.abs(jacobian[:, i]).max())
    thermal = any(c.channel in ("theta", "dtheta") for c in parts)
    assert list(np.abs(jacobian).max(axis=0) > 0.0) == [True, True, thermal, thermal]


def test_model_without_derivatives_says_so() -> None:
    model = dataclasses.replace(wall_model(comparisons(), OBSERVATIONS), linearise=None)
    with pytest.raises(ValueError, match="no exact derivatives"):
        model.linearised(START, WALL_NAMES)


@pytest.mark.parametrize("alpha", [236.0, 4e5])
def test_derivatives_reach_the_variables_of_the_fit(tmp_path: Path, alpha: float) -> None:
    """Through the comparisons, and through 1/alpha_clamp: a Taylor test in the variables that the optimiser sees."""
    case = study(tmp_path)
    problem, _ = stage_problem(case, case.stage("thermal"), START.replace(alpha_clamp=alpha), wall_model(comparisons(), OBSERVATIONS))
    found = check_jacobian(problem)
    assert found.passed.all(), found.text()


def test_optimum_counts_and_record(tmp_path: Path) -> None:
    """Every run is a linearised one, and the record of the stage needs none."""
    case, counted = study(tmp_path), Counted(wall_model(comparisons(), OBSERVATIONS))
    found = solved(case, counted)
    fit = found.fit
    assert fit.converged and fit.algorithm == "gauss-newton, exact derivatives"
    assert found.covariance is not None and found.covariance.identifiable
    truth = WALL_TRUTH.with_free(WALL_NAMES).vector()
    assert (np.abs(fit.x - truth) < 4.0 * found.covariance.sigma).all()
    record = made(case, START, found)
    assert counted.plain == 0 and counted.linearised == fit.counts.forward == fit.counts.linearised < 12
    assert record.summary["evaluations"]["linearised"] == record.summary["evaluations"]["forward"] == counted.linearised
    assert record.summary["algorithm"] == fit.algorithm
    assert set(record.datasets["evaluations/purpose"].value) == {"linearise"}
    predicted, measured = record.datasets["theta/predicted"].value, OBSERVATIONS["theta"].mask
    assert predicted[measured] == pytest.approx(wall_fields(found.parameters)["theta"][measured], rel=1e-12)


def test_errors_are_those_of_finite_differences(tmp_path: Path) -> None:
    case = study(tmp_path)
    exact = solved(case, Counted(wall_model(comparisons(), OBSERVATIONS)))
    (tmp_path / "b").mkdir()
    bare = Counted(wall_model(comparisons(), OBSERVATIONS))
    bare.model = dataclasses.replace(bare.model, linearise=None)
    differences = solved(study(tmp_path / "b"), bare)
    assert differences.fit.algorithm == "gauss-newton, forward differences" and bare.linearised == 0
    assert exact.covariance is not None and differences.covariance is not None
    assert (np.abs(exact.fit.x - differences.fit.x) < 0.15 * exact.covariance.sigma).all()
    assert exact.covariance.sigma == pytest.approx(differences.covariance.sigma, rel=2e-3)


@pytest.mark.parametrize("method", ["nelder-mead", "bobyqa", "gauss-newton", "trust-region"])
def test_every_method_finds_the_same(tmp_path: Path, method: str) -> None:
    start = WALL_TRUTH.replace(E=60000.0, nu=0.3, kappa=150.0, alpha_clamp=300.0).with_free(WALL_NAMES)
    default = solved(study(tmp_path), Counted(wall_model(comparisons(), OBSERVATIONS)), start)
    (tmp_path / "b").mkdir()
    case = study(tmp_path / "b", f"stages.thermal.method={method}")
    other = solved(case, Counted(wall_model(comparisons(), OBSERVATIONS)), start)
    assert other.fit.converged and other.fit.method == method
    assert default.covariance is not None and other.covariance is not None
    assert (np.abs(other.fit.x - default.fit.x) < 0.15 * default.covariance.sigma).all()
    assert other.covariance.sigma == pytest.approx(default.covariance.sigma, rel=0.01)


def test_killed_stage_resumes(tmp_path: Path) -> None:
    whole = Counted(wall_model(comparisons(), OBSERVATIONS))
    (tmp_path / "b").mkdir()
    expected = solved(study(tmp_path / "b"), whole)
    case, dying = study(tmp_path), Counted(wall_model(comparisons(), OBSERVATIONS), last=3)
    with pytest.raises(KeyboardInterrupt):
        solved(case, dying)
    rest = Counted(wall_model(comparisons(), OBSERVATIONS))
    found = solved(case, rest)
    assert found.fit.counts.replayed == 3 and rest.linearised == whole.linearised - 3 and rest.plain == 0
    assert np.array_equal(found.fit.x, expected.fit.x)


def test_fine_mesh_starts_at_the_coarse_optimum(tmp_path: Path) -> None:
    """Few runs are left for the fine mesh: one at the optimum of the coarse one, whose derivatives lead on, and those with its own. A
    coarse model that is off costs no accuracy."""
    case = study(tmp_path, mesh="full")
    sizes: list[int] = []
    models = {}

    def model_on(size: MeshSize, base: Parameters) -> StageModel:
        sizes.append(size.n_x)
        models[size.n_x] = Counted(wall_model(comparisons(), OBSERVATIONS, bias=1.5 if size.n_x == 6 else 0.0))
        return models[size.n_x].model

    found = solve(
        case, case.stage("thermal"), START, model_on, Job("identify-thermal", tmp_path / "identify-thermal.h5", {}, {}), scalable=True
    )
    assert sizes == [6, 12] and len(found.earlier) == 1
    assert found.fit.log[0].x == pytest.approx(found.earlier[0].x, rel=1e-12)
    assert models[12].linearised <= 2 < models[6].linearised and (models[12].plain, models[6].plain) == (1, 0)
    (tmp_path / "b").mkdir()
    direct = solved(study(tmp_path / "b"), Counted(wall_model(comparisons(), OBSERVATIONS)))
    assert direct.covariance is not None
    assert (np.abs(found.fit.x - direct.fit.x) < 0.15 * direct.covariance.sigma).all()


def test_turns_of_a_one_way_stage_take_exact_derivatives(tmp_path: Path) -> None:
    """The mechanics is solved anew at every turn; the bias of the earlier one is forgotten."""
    case, models = study(tmp_path), []

    def model_on(size: MeshSize, base: Parameters) -> StageModel:
        models.append(Counted(wall_model(comparisons(), OBSERVATIONS, bias=0.01 * (base["kappa"] - 130.0))))
        return dataclasses.replace(models[-1].model, one_way=True)

    found = solve(
        case, case.stage("thermal"), START, model_on, Job("identify-thermal", tmp_path / "identify-thermal.h5", {}, {}), scalable=True
    )
    assert 2 <= len(models) <= 4 and not found.remarks
    assert [counted.plain for counted in models] == [0, *[1] * (len(models) - 1)] and models[-1].linearised <= 2


def test_failing_region_is_stepped_over(tmp_path: Path) -> None:
    counted = Counted(wall_model(comparisons(), OBSERVATIONS))
    linearise = counted.linearise

    def failing(parameters: Parameters, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        if 60000.0 < parameters["E"] < 64000.0:
            raise NumericsError("no convergence")
        return linearise(parameters, names)

    counted.model = dataclasses.replace(counted.model, linearise=failing)
    # Displacements go with 1/E: the full Gauss-Newton step from 50000 ends at 2 E - E^2/68000 = 63000.
    found = solved(study(tmp_path), counted, START)
    assert found.fit.converged and abs(found.parameters["E"] - 68000.0) < 1000.0
    assert found.fit.counts.failed > 0 and all(60000.0 < entry.x[0] < 64000.0 for entry in found.fit.log if entry.failed)


def test_remembered_fields_are_those_of_the_last_parameters() -> None:
    counted = Counted(wall_model(comparisons(), OBSERVATIONS))
    model = remembering(counted.model, count=2)
    first, second, third = (START.replace(E=value) for value in (5e4, 6e4, 7e4))
    model.linearised(first, WALL_NAMES)
    for parameters in (first, second, third, second, third):
        assert np.array_equal(model.errors(parameters)["u"], counted.inner.errors(parameters)["u"], equal_nan=True)
    assert counted.plain == 2
    model.errors(first)
    assert counted.plain == 3


def refusing(limit: float) -> StageModel:
    """The model of the wall that fails where kappa is above a limit, as a specimen fails that cannot carry its force."""
    inner = wall_model(comparisons(), OBSERVATIONS)
    assert inner.linearise is not None

    def errors(parameters: Parameters) -> dict[str, np.ndarray]:
        if parameters["kappa"] > limit:
            raise NumericsError("time step to t = 3 s failed")
        return inner.errors(parameters)

    def linearise(parameters: Parameters, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        errors(parameters)
        return inner.linearise(parameters, names)  # type: ignore[misc]

    return dataclasses.replace(inner, errors=errors, linearise=linearise)


def begun(case: Study, limit: float, *, to_the_end: bool = True, starts: tuple[float, ...] = (190.0, 170.0, 150.0)) -> Solved:
    """Solved from kappa = 200 with other starts in turn."""
    task = Job("identify-thermal", case.run_dir / "identify-thermal.h5", {}, {})
    model, stage = refusing(limit), case.stage("thermal")

    def again(start: Parameters) -> list[tuple[str, Parameters]]:
        return [(f"with kappa = {kappa:g}", start.replace(kappa=kappa)) for kappa in starts]

    return solve(case, stage, START, lambda size, base: model, task, scalable=False, again=again, to_the_end=to_the_end)


def test_where_a_start_fails_the_others_are_taken_in_turn(tmp_path: Path) -> None:
    """The fit ends where the one from a start that does not fail ends; the first one that runs is the one."""
    found = begun(study(tmp_path), 180.0)
    assert found.fit.converged and found.parameters["kappa"] == pytest.approx(WALL_TRUTH["kappa"], rel=0.01)
    assert [text for text in found.remarks if "started again" in text] == [
        "the mesh 2 x 8 x 1 fails at its first start; started again with kappa = 170"
    ]


def test_where_all_starts_fail_the_first_reason_is_told(tmp_path: Path) -> None:
    with pytest.raises(NumericsError, match="time step to t = 3 s failed"):
        begun(study(tmp_path), 100.0)


def test_a_fit_that_is_kept_from_its_minimum_may_be_given_up(tmp_path: Path) -> None:
    """The minimum at kappa = 130 lies where the model fails: the fit ends at the edge, or is no result at all."""
    case = study(tmp_path)
    assert begun(case, 120.0, starts=(110.0,)).fit.at_edge
    with pytest.raises(NotCarriedError, match="edge of a region"):
        begun(case, 120.0, starts=(110.0,), to_the_end=False)


def test_a_start_that_a_step_has_left_at_its_bound_lies_there() -> None:
    """A rounding error beyond is none; what lies farther off is left for the check that tells the user."""
    lower, upper = np.array([-0.007, -np.inf, 1.0, -1.0]), np.array([0.007, np.inf, 2.0, 1.0])
    y = np.array([0.007 * (1.0 + 1e-12), 1e300, 1.0 - 1e-12, 1.0 + 1e-6])
    assert at_rounding(y, lower, upper).tolist() == [0.007, 1e300, 1.0, 1.0 + 1e-6]
    assert at_rounding(-y[:1], lower[:1], upper[:1]).tolist() == [-0.007]


def test_fine_mesh_begins_with_what_the_coarse_one_knows(tmp_path: Path) -> None:
    """Derivatives in the variables of the fit: J^T J and what second derivatives add to it change alike from kappa, alpha to 1/alpha."""
    case = study(tmp_path)
    base = START.with_free(WALL_NAMES)
    jacobian = np.random.default_rng(3).normal(size=(40, len(WALL_NAMES)))
    near: Any = SimpleNamespace(jacobian=jacobian, curvature=jacobian.T @ jacobian)
    problem, _ = stage_problem(case, case.stage("thermal"), base, wall_model(comparisons(), OBSERVATIONS), near)
    assert problem.first_jacobian is not None and problem.first_curvature is not None
    assert problem.first_curvature == pytest.approx(problem.first_jacobian.T @ problem.first_jacobian, rel=1e-12)
    assert not np.allclose(problem.first_curvature, near.curvature)
