"""Exact derivatives from the forward run itself: one linearised run per step, nothing run twice, the same answers as without them."""

import dataclasses

import numpy as np
import pytest
from fit_models import (
    BAR_LOWER,
    BAR_TRUE,
    TIMES,
    DictStore,
    bar_problem,
    complex_step,
    decay_problem,
    exact,
    problem,
    rosenbrock,
    rosenbrock_jacobian,
)

from thermofit.core.errors import NumericsError
from thermofit.fit.evaluate import Evaluations, attempt_linearised
from thermofit.fit.minimise import METHODS, minimise
from thermofit.fit.settings import Hooks, Settings

LEAST_SQUARES = ("least-squares", "gauss-newton")
NEAR = [69000.0, 125.0, 310.0, 12.0, 0.30, 0.5]
FAR = [50000.0, 200.0, 400.0, 5.0, 0.25, 1.0]
FINE = Settings(x_tolerance=1e-6)
SHARP = Settings(x_tolerance=1e-7, f_tolerance=1e-9, differences="central", max_evaluations=20000)


def disc(x):
    """Residual with minimum at (2, 2) that fails in a disc on the straight way to it."""
    if np.hypot(np.real(x[0]) - 0.6, np.real(x[1]) - 1.0) < 0.3:
        raise NumericsError("no convergence at t = 3 s")
    return np.array([x[0] - 2.0, 4.0 * (x[1] - 2.0), 0.3 * (x[0] * x[1] - 4.0), 1e-2])


def without_plain_runs(base):
    """The same problem, which must never be run without its derivatives."""
    return dataclasses.replace(base, residual=lambda x: pytest.fail("run without derivatives"))


@pytest.mark.parametrize("method", LEAST_SQUARES)
@pytest.mark.parametrize("start", [NEAR, FAR])
def test_optimum_and_errors_are_those_of_differences(method, start):
    """One linearised run per trial, none at a point that was run before, none for the covariance."""
    fit = minimise(without_plain_runs(exact(bar_problem(start))), method, Settings(x_tolerance=1e-6))
    reference = minimise(bar_problem(NEAR), "trust-region", SHARP)
    assert fit.converged, fit.message
    assert (np.abs(fit.x - reference.x) < 0.05 * reference.sigma).all()
    assert fit.sigma == pytest.approx(reference.sigma, rel=1e-3)
    assert np.array_equal(fit.jacobian, complex_step(bar_problem(start).residual, fit.x))
    assert fit.counts.forward == fit.counts.linearised == len(fit.log) == len({e.x.tobytes() for e in fit.log}) < 25
    assert {e.purpose for e in fit.log} == {"linearise"}


def test_few_runs_from_many_starts():
    starts = np.random.default_rng(5).uniform(0.7, 1.3, (12, 6)) * np.array(NEAR)
    starts[:, 2] = np.maximum(starts[:, 2], 290.0)
    starts[:, 4] = np.minimum(starts[:, 4], 0.45)
    fits = [minimise(exact(bar_problem(start))) for start in starts]
    assert all(fit.converged for fit in fits)
    assert np.mean([fit.counts.forward for fit in fits]) < 9.0
    # The end is declared on the full Gauss-Newton step from the result, not on the last step made.
    assert all(fit.optimality.step <= 1.01e-4 or fit.optimality.drop <= 1.01e-3 for fit in fits)


def test_what_ran_is_named():
    assert minimise(exact(decay_problem())).algorithm == "gauss-newton, exact derivatives"
    assert minimise(decay_problem()).algorithm == "gauss-newton, forward differences"
    fit = minimise(exact(decay_problem()), "bobyqa")
    assert (fit.method, fit.algorithm) == ("bobyqa", "bobyqa, no derivatives")


@pytest.mark.parametrize("method", ["nelder-mead", "bobyqa"])
def test_nlopt_and_the_default_agree(method):
    """On the same objective; a derivative-free search takes one linearised run at its end, for the covariance."""
    default = minimise(exact(decay_problem()))
    fit = minimise(exact(decay_problem()), method, Settings(x_tolerance=1e-7, f_tolerance=1e-6, max_evaluations=5000))
    assert fit.converged, fit.message
    assert (np.abs(fit.x - default.x) < 0.05 * default.sigma).all()
    assert fit.f == pytest.approx(default.f, rel=1e-4)
    assert fit.sigma == pytest.approx(default.sigma, rel=0.01)
    assert fit.counts.linearised == 1 and fit.log[-1].purpose == "linearise"
    assert default.counts.forward < 0.1 * fit.counts.forward


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_exact_start_needs_one_run(method):
    base = bar_problem(BAR_TRUE)
    clean = base.residual(BAR_TRUE)
    fit = minimise(exact(dataclasses.replace(base, residual=lambda x: base.residual(x) - clean)), method)
    assert fit.converged and fit.counts.forward == 1 and fit.f == 0.0


def beside_the_optimum(factor):
    """An exact problem that begins beside its optimum, with `factor` times the derivative of a point near by; the fit without that."""
    plain = minimise(exact(bar_problem(NEAR)), settings=SHARP)
    start = plain.x * (1.0 + 0.004 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0]))
    base = exact(bar_problem(start))
    near_by = complex_step(base.residual, plain.x * 1.002)
    return dataclasses.replace(base, first_jacobian=factor * near_by), minimise(base, settings=FINE), plain


def test_a_jacobian_known_near_by_spares_the_first_one():
    known, without, optimum = beside_the_optimum(1.0)
    fit = minimise(known, settings=FINE)
    assert fit.converged and (np.abs(fit.x - optimum.x) < 0.05 * optimum.sigma).all()
    assert fit.log[0].purpose == "step" and {e.purpose for e in fit.log[1:]} == {"linearise"}
    assert fit.counts.linearised < without.counts.linearised
    assert np.array_equal(fit.jacobian, complex_step(known.residual, fit.x))


@pytest.mark.parametrize("factor", [1e6, -1.0])
def test_a_wrong_jacobian_is_left_for_the_own_one(factor):
    """One that promises that nothing is left ends no search, and one that leads uphill is left after one trial."""
    known, without, optimum = beside_the_optimum(factor)
    fit = minimise(known, settings=FINE)
    assert fit.converged and (np.abs(fit.x - optimum.x) < 0.05 * optimum.sigma).all()
    assert fit.counts.linearised <= without.counts.linearised + (1 if factor < 0.0 else 0)


@pytest.mark.parametrize("start", [[-1.2, 1.0], [-1.0, -1.0]])
@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_valley(method, start):
    fit = minimise(problem(rosenbrock, start, [-5, -5], [5, 5], jacobian=rosenbrock_jacobian), method, Settings(x_tolerance=1e-6))
    assert fit.converged and fit.x == pytest.approx([1.0, 1.0], abs=1e-5)
    assert fit.counts.forward <= 24


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_badly_scaled_parameters(method):
    """Eleven decades between the parameters; the scales say so."""
    t = np.linspace(0.0, 1.0, 30)
    truth = np.array([2e-6, 3e5, 4.0])

    def model(p):
        return np.concatenate([p[0] / 1e-6 * np.exp(-t), p[1] / 1e5 * t**2 * np.cos(p[2] * t)])

    base = problem(lambda p: model(p) - model(truth), [1e-6, 1e5, 3.0], [0, 0, 0], [1, 1e9, 10], [1e-6, 1e5, 1.0])
    fit = minimise(exact(base), method)
    assert fit.converged and fit.x == pytest.approx(truth, rel=1e-4)
    assert fit.counts.forward < 12


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_active_bound(method):
    """M_yinf may not fall to its true value: it is held on the bound, the rest is fitted around it as differences fit it."""
    lower = BAR_LOWER.copy()
    lower[2] = 305.0
    fit = minimise(without_plain_runs(exact(bar_problem(NEAR, lower=lower))), method)
    reference = minimise(bar_problem(NEAR, lower=lower), "gauss-newton", SHARP)
    assert fit.converged, fit.message
    assert fit.x[2] == pytest.approx(305.0, abs=1e-3) and fit.at_bound[2]
    assert np.array_equal(fit.at_bound, reference.at_bound)
    inside = ~fit.at_bound
    assert (np.abs(fit.x - reference.x) < 0.1 * reference.sigma)[inside].all()
    assert fit.sigma[inside] == pytest.approx(reference.sigma[inside], rel=0.03)
    assert all(((lower <= e.x) & (e.x <= bar_problem(NEAR).upper)).all() for e in fit.log)


@pytest.mark.parametrize(("start", "minimum"), [(0.0, 0.5), (1.0, 0.5), (0.0, -1.0)])
def test_start_on_a_bound_is_run_once(start, minimum):
    """scipy moves such a start by a hair: that must not cost a second run."""
    fit = minimise(exact(problem(lambda x: np.array([x[0] - minimum, 0.1]), [start], [0.0], [1.0])), settings=Settings(f_tolerance=1e-9))
    assert fit.converged and fit.x == pytest.approx(max(minimum, 0.0), abs=2e-4)
    assert fit.at_bound[0] == (minimum < 0.0)
    assert np.min(np.diff(np.sort([e.x[0] for e in fit.log])), initial=1.0) > 1e-6


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_dependent_parameters_are_flagged(method):
    t = np.linspace(0.0, 1.0, 40)
    noise = np.random.default_rng(2).standard_normal(40)
    base = problem(lambda p: 100.0 * (p[0] * p[1] * t + p[2] - 6.0 * t - 1.0) + noise, [1, 2, 3], names=("a", "b", "c"))
    fit = minimise(exact(base), method)
    assert fit.converged and set(fit.covariance.null[0].names) == {"a", "b"}
    assert np.isinf(fit.sigma[:2]).all() and np.isfinite(fit.sigma[2])


@pytest.mark.parametrize(
    ("method", "start"),
    [("trust-region", (0.0, -0.5)), ("least-squares", (-1.0, -0.5)), ("nelder-mead", (0.2, 0.4)), ("bobyqa", (0.0, 1.0))],
)
def test_failed_runs_on_the_way_are_survived_and_counted(method, start):
    fit = minimise(exact(problem(disc, start, [-3, -3], [3, 3])), method, Settings(initial_step=0.5))
    assert fit.converged, fit.message
    assert fit.x == pytest.approx([2.0, 2.0], abs=0.01)
    assert fit.counts.failed == sum(entry.failed for entry in fit.log) > 0
    assert all(entry.reason == "no convergence at t = 3 s" for entry in fit.log if entry.failed)


@pytest.mark.parametrize("start", [0.0, -0.6, -3.0])
@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_minimum_behind_a_wall_is_not_called_converged(method, start):
    """Whether the last trial is one that failed or a small one that was accepted."""

    def residual(x):
        if np.real(x[0]) > 1.0:
            raise NumericsError("no convergence")
        return np.array([x[0] - 3.0, 0.1])

    fit = minimise(exact(problem(residual, [start])), method)
    assert not fit.converged and "edge of a region" in fit.message
    assert fit.counts.failed > 0 and 0.8 < fit.x[0] <= 1.0


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_failing_start_is_a_sentence(method):
    with pytest.raises(NumericsError, match=r"M_yinf = 280.*load above the hardening limit"):
        minimise(exact(bar_problem([69000.0, 125.0, 280.0, 12.0, 0.30, 0.5])), method)


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_derivatives_that_are_not_finite_are_a_failed_trial(method):
    base = exact(problem(lambda x: np.array([x[0] - 2.0, 0.3 * (x[0] ** 2 - 4.0), 0.1]), [0.0]))

    def linearise(x):
        residual, jacobian = base.linearise(x)
        return residual, np.where(x[0] > 2.05, np.nan, jacobian)

    fit = minimise(dataclasses.replace(base, linearise=linearise), method)
    assert fit.converged and fit.x == pytest.approx([2.0], abs=1e-3)
    assert all("Jacobian has 3 of 3 values" in entry.reason for entry in fit.log if entry.failed)
    outcome = attempt_linearised(linearise, np.array([3.0]))
    assert outcome.residual is None and "not finite" in outcome.reason


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_wrong_derivatives_are_not_called_converged(method):
    base = exact(bar_problem(NEAR))

    def linearise(x):
        residual, jacobian = base.linearise(x)
        return residual, jacobian * np.array([1.0, -1.0, 1.0, 1.0, 1.0, 1.0])

    fit = minimise(dataclasses.replace(base, linearise=linearise), method)
    assert not fit.converged and "derivative" in fit.message


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_noise_of_the_run_ends_the_search(method):
    """A residual that is rough at a hundredth of its standard deviation: the end is reached, with hardly a run in vain."""
    base, settings = exact(decay_problem()), Settings(x_tolerance=1e-6, f_tolerance=0.01)
    smooth = minimise(base, method, settings)
    for phase in range(12):

        def rough(x, phase=phase):
            residual, jacobian = base.linearise(x)
            return residual + 0.01 * np.sin(1e9 * np.sum(x) + phase + np.arange(residual.size)), jacobian

        fit = minimise(dataclasses.replace(base, linearise=rough), method, settings)
        assert fit.converged, fit.message
        assert (np.abs(fit.x - smooth.x) < 0.5 * smooth.sigma).all()
        assert fit.counts.forward <= smooth.counts.forward + 1


def test_derivatives_that_fail_at_the_answer_leave_it_without_errors():
    base = exact(decay_problem())

    def singular(x):
        raise NumericsError("singular tangent")

    store = DictStore()
    fit = minimise(dataclasses.replace(base, linearise=singular), "bobyqa", hooks=Hooks(store))
    assert fit.converged and fit.sigma is None and "no standard errors" in fit.message and "singular tangent" in fit.message
    assert fit.f == pytest.approx(minimise(base).f, rel=0.01)
    # The store keeps the answer, and does not take it for a point that fails.
    again = minimise(base, "bobyqa", hooks=Hooks(store))
    assert np.array_equal(again.x, fit.x) and again.counts.forward == again.counts.linearised == 1 and again.sigma is not None


def test_wrong_shape_is_refused():
    base = dataclasses.replace(problem(rosenbrock, [1.0, 2.0]), linearise=lambda x: (rosenbrock(x), np.ones((3, 2))))
    with pytest.raises(ValueError, match=r"expected \(2, 2\)"):
        minimise(base)
    with pytest.raises(ValueError, match="no exact derivatives"):
        Evaluations(problem(rosenbrock, [1.0, 2.0])).linearised(np.ones(2))


@pytest.mark.parametrize("method", METHODS)
def test_resume_runs_nothing(method):
    """Residual and Jacobian come from the store."""
    store = DictStore()
    first = minimise(exact(decay_problem()), method, hooks=Hooks(store))
    empty = dataclasses.replace(
        decay_problem(), residual=lambda x: pytest.fail("run again"), linearise=lambda x: pytest.fail("linearised again")
    )
    second = minimise(empty, method, hooks=Hooks(store))
    assert second.counts.forward == second.counts.linearised == 0
    assert second.counts.replayed == first.counts.forward
    assert np.array_equal(first.x, second.x) and np.array_equal(first.sigma, second.sigma)
    assert np.array_equal(first.jacobian, second.jacobian) and second.message == first.message
    assert [e.purpose for e in second.log] == [e.purpose for e in first.log]


@pytest.mark.parametrize("method", LEAST_SQUARES)
def test_killed_fit_resumes_where_it_was(method):
    class Killed(Exception):
        pass

    base, store = exact(decay_problem()), DictStore()
    whole = minimise(base, method)

    def dying(x):
        if len(store.entries) == 4:
            raise Killed
        return base.linearise(x)

    with pytest.raises(Killed):
        minimise(dataclasses.replace(base, linearise=dying), method, hooks=Hooks(store))
    fit = minimise(base, method, hooks=Hooks(store))
    assert fit.counts.replayed == 4 and fit.counts.forward == fit.counts.linearised == whole.counts.forward - 4
    assert np.array_equal(fit.x, whole.x)


def test_a_plain_run_in_the_store_does_not_pass_for_a_linearised_one():
    store, base = DictStore(), exact(decay_problem())
    Evaluations(base, Hooks(store)).residual(base.start)
    evaluations = Evaluations(base, Hooks(store))
    residual, jacobian = evaluations.linearised(base.start)
    assert evaluations.counts().linearised == 1 and evaluations.counts().replayed == 0
    assert np.array_equal(residual, base.residual(base.start)) and jacobian.shape == (residual.size, 4)
    again = Evaluations(base, Hooks(store))
    again.residual(base.start)
    again.linearised(base.start)
    assert again.counts().forward == 0


def test_limit_counts_linearised_runs():
    fit = minimise(exact(bar_problem(FAR)), settings=Settings(max_evaluations=4))
    assert not fit.converged and "limit of 4 evaluations" in fit.message and fit.counts.forward == 4


def test_a_valley_is_not_followed_to_a_bound_where_the_model_is_wrong():
    """A factor common to all parameters changes nothing: from each start the search ends near it, at the same ratios, however large the
    misfit that no parameter explains. Derivatives are good to nine digits, as those of a forward model are."""
    data = 2.0 * np.exp(-1.5 * TIMES) + 0.7 + 0.5 * np.cos(5.0 * TIMES)
    rng = np.random.default_rng(3)

    def residual(p):
        return ((p[0] * np.exp(-1.5 * TIMES) + p[1]) / p[2] - data) / 0.01

    def jacobian(p):
        matrix = complex_step(residual, p)
        return matrix * (1.0 + 1e-9 * rng.standard_normal(matrix.shape))

    found = []
    for start in ([1.0, 1.0, 1.0], [1.0, 1.0, 2.5], [3.0, 0.4, 0.6]):
        fit = minimise(problem(residual, start, [1e-3] * 3, [1e3] * 3, jacobian=jacobian), "least-squares", SHARP)
        assert fit.converged and not fit.at_bound.any()
        assert np.all(np.abs(np.log(fit.x / start)) < 2.0), fit.x
        found.append(fit.x[:2] / fit.x[2])
    assert np.ptp(found, axis=0).max() < 1e-4
