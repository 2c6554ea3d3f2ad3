"""All optimisers on problems with known answers, without exact derivatives; failures, bounds, resume, honesty about convergence."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fit_models import (
    BAR_LOWER,
    BAR_TRUE,
    DictStore,
    bar,
    bar_problem,
    decay,
    decay_problem,
    problem,
    rosenbrock,
)

from thermofit.core.errors import NumericsError, StudyError
from thermofit.fit.evaluate import Evaluations
from thermofit.fit.least_squares import Ending
from thermofit.fit.minimise import METHODS, minimise
from thermofit.fit.result import conclude
from thermofit.fit.settings import Hooks, Settings

GRADIENT = ("least-squares", "trust-region")
FREE = ("nelder-mead", "sbplx", "bobyqa", "cobyla")
NEAR = [69000.0, 125.0, 310.0, 12.0, 0.30, 0.5]
FAR = [50000.0, 200.0, 400.0, 5.0, 0.25, 1.0]


def test_methods_are_those_of_the_study_file():
    assert {"least-squares", *FREE} <= set(METHODS)
    with pytest.raises(StudyError, match="'newton' is not known"):
        minimise(decay_problem(), "newton")


@pytest.mark.parametrize("method", ["least-squares", "trust-region", "nelder-mead", "sbplx", "bobyqa"])
def test_rosenbrock(method):
    fit = minimise(problem(rosenbrock, [-1.2, 1.0], [-5, -5], [5, 5]), method, Settings(x_tolerance=1e-6))
    assert fit.converged
    assert np.allclose(fit.x, 1.0, atol=2e-3)


@pytest.mark.parametrize("method", GRADIENT)
@pytest.mark.parametrize(("worth", "most"), [(0.0, 400), (3e-3, 40)])
def test_a_search_that_crawls_ends_where_the_rest_is_not_worth_it(worth: float, most: int, method: str) -> None:
    """A bent valley along which a step lowers the objective by a millionth; a fit that ends quickly is not touched."""

    def valley(x: np.ndarray) -> np.ndarray:
        return np.array([30.0, 200.0 * (x[1] - np.sin(6.0 * x[0])), 0.1 * (x[0] - 8.0)])

    fit = minimise(
        problem(valley, [0.0, 0.0], [-10, -5], [10, 5]),
        method,
        Settings(x_tolerance=1e-9, f_tolerance=1e-9, max_evaluations=400, worth=worth),
    )
    assert not fit.converged and ("at the pace of the last 5 steps" in fit.message) == (worth == 3e-3)
    assert most - 39 <= fit.counts.forward <= most + 20
    quick = minimise(decay_problem(), method, Settings(worth=worth))
    assert quick.converged


@pytest.mark.parametrize(("to_beat", "early"), [(np.inf, False), (9.0, True)])
def test_a_search_ends_that_would_not_get_below_an_end_that_is_known(to_beat: float, early: bool) -> None:
    """The same valley, whose steps are worth their time by themselves."""

    def valley(x: np.ndarray) -> np.ndarray:
        return np.array([3.0, 200.0 * (x[1] - np.sin(6.0 * x[0])), 0.1 * (x[0] - 8.0)])

    settings = Settings(x_tolerance=1e-9, f_tolerance=1e-9, max_evaluations=60, worth=1e-5, to_beat=to_beat)
    fit = minimise(problem(valley, [0.0, 0.0], [-10, -5], [10, 5]), "trust-region", settings)
    assert ("of another start" in fit.message) is early and (fit.counts.forward < 30) is early


@pytest.mark.parametrize("method", ["least-squares", "trust-region", "nelder-mead"])
def test_methods_agree_on_noisy_exponentials(method):
    reference = minimise(decay_problem(), "trust-region", Settings(x_tolerance=1e-7, f_tolerance=1e-9, differences="central"))
    fit = minimise(decay_problem(), method)
    assert fit.converged, fit.message
    assert np.abs((fit.x - reference.x) / reference.sigma).max() < 0.1
    assert fit.f == pytest.approx(reference.f, rel=1e-4)
    assert np.allclose(fit.sigma, reference.sigma, rtol=0.02)
    assert fit.counts.forward == len(fit.log)


@pytest.mark.parametrize("method", GRADIENT)
@pytest.mark.parametrize("start", [NEAR, FAR])
def test_bar_is_identified_within_its_errors(method, start):
    """Six parameters from 0.3 to 7e4, with a region in which the model fails next to the path."""
    fit = minimise(bar_problem(start), method)
    assert fit.converged, fit.message
    assert (np.abs(fit.x - BAR_TRUE) < 3.5 * fit.sigma).all()
    assert fit.f / (280 - 6) == pytest.approx(1.0, abs=0.3)
    assert not fit.at_bound.any() and fit.optimality.drop < 0.05


def test_default_method_saves_forward_runs():
    """The reason why it is the default; broken if its updates stop working."""
    starts = np.random.default_rng(5).uniform(0.7, 1.3, (12, 6)) * np.array(NEAR)
    starts[:, 2] = np.maximum(starts[:, 2], 290.0)
    starts[:, 4] = np.minimum(starts[:, 4], 0.45)
    fits = {m: [minimise(bar_problem(s), m) for s in starts] for m in GRADIENT}
    runs = {m: np.mean([fit.counts.forward for fit in fits[m]]) for m in GRADIENT}
    assert runs["least-squares"] < 0.85 * runs["trust-region"]
    # It stops only where a Jacobian computed at the very point, not an updated one, says so.
    for fit in fits["least-squares"]:
        assert fit.optimality.step <= 1.01e-4 or fit.optimality.drop <= 1.01e-3


def test_badly_scaled_parameters():
    t = np.linspace(0.0, 1.0, 30)
    truth = np.array([2e-6, 3e5, 4.0])

    def residual(p):
        return np.concatenate([p[0] / 1e-6 * np.exp(-t), p[1] / 1e5 * t**2 * np.cos(p[2] * t)]) - known

    known = 0.0
    known = residual(truth)
    for method in GRADIENT:
        fit = minimise(problem(residual, [1e-6, 1e5, 3.0], [0, 0, 0], [1, 1e9, 10], [1e-6, 1e5, 1.0]), method)
        assert fit.converged and np.allclose(fit.x, truth, rtol=1e-4)


@pytest.mark.parametrize("method", ["least-squares", "trust-region", "nelder-mead", "bobyqa", "cobyla"])
def test_active_bound_is_found_and_flagged(method):
    """min (x0 - 3)^2 + 100 (x1 - x0)^2 with x0 <= 1: x = (1, 1), f = 4."""
    tall = problem(lambda x: np.array([x[0] - 3.0, 10.0 * (x[1] - x[0]), 1e-3]), [0.0, 0.0], [-1, -1], [1, 2])
    fit = minimise(tall, method, Settings(f_tolerance=1e-6))
    assert fit.converged, fit.message
    assert np.allclose(fit.x, 1.0, atol=2e-3)
    assert list(fit.at_bound) == [True, False]
    assert all(((-1 <= e.x) & (e.x <= [1, 2])).all() for e in fit.log)
    assert fit.sigma[1] == pytest.approx(np.sqrt(fit.f / 2.0) / 10.0, rel=1e-3)


def test_bound_on_the_bar():
    """M_yinf may not fall to its true value: it stays on the bound, exactly, and the rest is fitted around it."""
    lower = BAR_LOWER.copy()
    lower[2] = 305.0
    fit = minimise(bar_problem(NEAR, lower=lower))
    assert fit.x[2] == 305.0 and fit.at_bound[2] and fit.converged


@pytest.mark.parametrize(("minimum", "flagged"), [(-3.0, True), (2e-4, False)])
def test_interior_method_just_short_of_a_bound(minimum, flagged):
    """At 2e-4 from the bound 0: flagged if the model pulls towards the bound, not if the minimum is there."""
    evaluations = Evaluations(problem(lambda x: np.array([x[0] - minimum, 0.1]), [2e-4], [0.0], [1.0]))
    evaluations.outcome(evaluations.problem.start)
    fit = conclude(evaluations, Settings(), "trust-region", "", Ending(True, "done"))
    assert fit.at_bound[0] == flagged


def test_start_on_a_bound_leaves_it():
    fit = minimise(problem(lambda x: np.array([x[0] - 0.5, 0.1]), [0.0], [0.0], [1.0]))
    assert fit.x == pytest.approx(0.5, abs=1e-4) and not fit.at_bound[0]


@pytest.mark.parametrize("method", [*GRADIENT, *FREE])
def test_failing_start_is_a_sentence(method):
    beyond = [69000.0, 125.0, 280.0, 12.0, 0.30, 0.5]
    with pytest.raises(NumericsError, match=r"M_yinf = 280.*load above the hardening limit"):
        minimise(bar_problem(beyond), method)


@pytest.mark.parametrize("method", [*GRADIENT, *FREE])
def test_failures_on_the_way_are_survived_and_counted(method):
    """A forbidden disc lies on the straight line from the start to the minimum at (2, 2)."""

    def residual(x):
        if np.hypot(x[0] - 0.6, x[1] - 1.0) < 0.3:
            raise NumericsError("no convergence")
        return np.array([x[0] - 2.0, 4.0 * (x[1] - 2.0), 0.3 * (x[0] * x[1] - 4.0), 1e-2])

    fit = minimise(problem(residual, [0.25, 0.4], [-3, -3], [3, 3]), method, Settings(initial_step=0.5))
    assert fit.converged, fit.message
    assert np.allclose(fit.x, 2.0, atol=0.01)
    assert fit.counts.failed == sum(entry.failed for entry in fit.log)


@pytest.mark.parametrize("method", GRADIENT)
def test_minimum_behind_the_wall_is_not_called_converged(method):
    def residual(x):
        if x[0] > 1.0:
            raise NumericsError("no convergence")
        return np.array([x[0] - 3.0, 0.1])

    fit = minimise(problem(residual, [0.0]), method)
    assert not fit.converged and "fails" in fit.message
    assert fit.counts.failed > 0 and 0.8 < fit.x[0] <= 1.0


def test_limit_is_said_never_silent():
    for method in METHODS:
        fit = minimise(bar_problem(FAR), method, Settings(max_evaluations=20))
        assert not fit.converged and "limit of 20 evaluations" in fit.message
        assert sum(entry.purpose == "step" for entry in fit.log) <= 20
        assert fit.f == min(entry.f for entry in fit.log if entry.purpose == "step")


def test_false_convergence_of_a_simplex_is_exposed():
    """Nelder-Mead stops in the curved valley of the bar far from the minimum; the derivative at its end tells."""
    fit = minimise(bar_problem(FAR), "nelder-mead")
    assert fit.f > 1000.0 and not fit.converged
    assert "one more Gauss-Newton step" in fit.message


@pytest.mark.parametrize("method", [*GRADIENT, *FREE])
def test_resume_repeats_nothing(method):
    store = DictStore()
    first = minimise(decay_problem(), method, hooks=Hooks(store))
    second = minimise(decay_problem(), method, hooks=Hooks(store))
    assert second.counts.forward == 0 and second.counts.replayed == first.counts.forward
    assert np.array_equal(first.x, second.x) and np.array_equal(first.sigma, second.sigma)
    assert second.message == first.message


@pytest.mark.parametrize("method", ["least-squares", "nelder-mead"])
def test_killed_fit_resumes_where_it_was(method):
    class Killed(Exception):
        pass

    def dying(limit):
        residual, calls = decay(), []

        def wrapped(x):
            calls.append(1)
            if len(calls) > limit:
                raise Killed
            return residual(x)

        return wrapped

    store, whole = DictStore(), minimise(decay_problem(), method)
    base = decay_problem()
    with pytest.raises(Killed):
        minimise(problem(dying(15), base.start, base.lower, base.upper), method, hooks=Hooks(store))
    fit = minimise(base, method, hooks=Hooks(store))
    assert fit.counts.replayed == 15 and fit.counts.forward == whole.counts.forward - 15
    assert np.array_equal(fit.x, whole.x)


def test_keyboard_interrupt_leaves_every_method():
    def interrupted(x):
        if len(calls) == 3:
            raise KeyboardInterrupt
        calls.append(1)
        return rosenbrock(x)

    for method in METHODS:
        calls: list[int] = []
        with pytest.raises(KeyboardInterrupt):
            minimise(problem(interrupted, [-1.2, 1.0]), method)


@pytest.mark.parametrize("method", METHODS)
def test_deterministic(method):
    first, second = (minimise(decay_problem(), method) for _ in range(2))
    assert [e.f for e in first.log] == [e.f for e in second.log]


def test_parallel_columns_change_nothing():
    serial = minimise(bar_problem(NEAR))
    with ThreadPoolExecutor(2) as pool:
        parallel = minimise(bar_problem(NEAR), hooks=Hooks(map_function=pool.map))
    assert np.array_equal(serial.x, parallel.x) and serial.counts.forward == parallel.counts.forward


def test_dependent_parameters_are_flagged_not_nan():
    t = np.linspace(0.0, 1.0, 40)
    noise = np.random.default_rng(2).standard_normal(40)
    fit = minimise(problem(lambda p: 100.0 * (p[0] * p[1] * t + p[2] - 6.0 * t - 1.0) + noise, [1, 2, 3], names=("a", "b", "c")))
    assert not fit.covariance.identifiable
    assert set(fit.covariance.null[0].names) == {"a", "b"}
    assert np.isinf(fit.sigma[:2]).all() and np.isfinite(fit.sigma[2])


def test_without_covariance_a_simplex_takes_no_differences():
    fit = minimise(decay_problem(), "nelder-mead", Settings(covariance=False))
    assert fit.covariance is None and fit.sigma is None and all(e.purpose == "step" for e in fit.log)


def test_as_many_data_as_parameters_is_said():
    fit = minimise(problem(rosenbrock, [-1.2, 1.0]))
    assert fit.covariance is None and "no standard errors: 2 residuals" in fit.message


def test_exact_start_needs_one_jacobian():
    residual = bar(noise=1.0)
    exact = residual(BAR_TRUE)
    fit = minimise(problem(lambda p: residual(p) - exact, BAR_TRUE, scale=BAR_TRUE))
    assert fit.converged and fit.counts.forward == 7 and fit.f == 0.0
