"""Log, memory, store, failures and the limit of evaluations."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fit_models import DictStore, problem

from thermofit.core.errors import NumericsError
from thermofit.fit.evaluate import EvaluationLimit, Evaluations, attempt
from thermofit.fit.settings import Hooks


def _square(x):
    if x[0] < 0.0:
        raise NumericsError("Newton did not converge at t = 3 s")
    return np.array([x[0], 2.0 * x[0]])


def _evaluations(**kwargs):
    return Evaluations(problem(_square, [1.0]), **kwargs)


def test_log_counts_and_memory():
    evaluations = _evaluations()
    for value in (1.0, 2.0, 2.0, -1.0):
        evaluations.outcome(np.array([value]))
    counts = evaluations.counts()
    assert (counts.forward, counts.failed, counts.repeated, counts.replayed) == (3, 1, 1, 0)
    assert [entry.f for entry in evaluations.log] == [5.0, 20.0, np.inf]
    assert evaluations.log[2].failed and evaluations.log[2].reason == "Newton did not converge at t = 3 s"
    assert evaluations.best[0] == 1.0
    assert counts.wall_s > 0.0


def test_residual_raises_with_reason_and_objective_is_finite():
    evaluations = _evaluations()
    evaluations.outcome(np.array([2.0]))
    with pytest.raises(NumericsError, match="p0 = -1: Newton did not converge at t = 3 s"):
        evaluations.residual(np.array([-1.0]))
    assert evaluations.objective(np.array([-1.0])) == 200.0


def test_not_finite_residual_is_a_failure_with_a_count():
    outcome = attempt(lambda x: np.array([1.0, np.nan, np.inf]), np.zeros(1))
    assert outcome.residual is None and "2 of 3 values" in outcome.reason
    assert attempt(lambda x: np.array([1e200, 1.0]), np.zeros(1)).reason  # r.r overflows although r does not


def test_best_is_a_step_never_a_difference_point():
    evaluations = _evaluations()
    evaluations.outcome(np.array([2.0]))
    evaluations.outcome(np.array([1.0]), "jacobian")
    assert evaluations.best[0] == 2.0


def test_a_caller_cannot_change_the_log_through_its_own_array():
    evaluations = _evaluations()
    x = np.array([2.0])
    evaluations.outcome(x)
    x[0] = 5.0
    assert evaluations.log[0].x == 2.0 and evaluations.best[0] == 2.0


def test_memory_of_residuals_is_bounded_but_f_is_kept():
    evaluations = _evaluations()
    for value in np.linspace(1.0, 2.0, 40):
        evaluations.outcome(np.array([value]))
    assert len(evaluations._recent) == 6
    evaluations.objective(np.array([2.0]))
    evaluations.residual(np.array([1.0]))  # the best one stays
    assert evaluations.counts().forward == 40


def test_limit_counts_replayed_too():
    evaluations = _evaluations(limit=2)
    evaluations.batch([np.array([1.0]), np.array([2.0])], "step")
    evaluations.outcome(np.array([2.0]))
    with pytest.raises(EvaluationLimit):
        evaluations.outcome(np.array([3.0]))


def test_store_replays_success_and_failure():
    store = DictStore()
    first = _evaluations(hooks=Hooks(store))
    second = Evaluations(problem(lambda x: pytest.fail("computed again"), [1.0]), Hooks(store))
    for evaluations in (first, second):
        good, bad = evaluations.batch([np.array([3.0]), np.array([-3.0])], "step")
        assert good.f == 45.0 and np.array_equal(good.residual, [3.0, 6.0])
        assert bad.residual is None and "t = 3 s" in bad.reason
    assert (second.counts().forward, second.counts().replayed) == (0, 2)


def test_store_keeps_residuals_only_where_they_may_be_asked_for():
    store = DictStore()
    evaluations = _evaluations(hooks=Hooks(store))
    for value in (2.0, 3.0, 1.0):
        evaluations.objective(np.array([value]))
    kept = ["residual" in store.get(np.array([value])) for value in (2.0, 3.0, 1.0)]
    assert kept == [True, False, True]


def test_hook_sees_every_evaluation():
    seen = []
    evaluations = _evaluations(hooks=Hooks(on_evaluation=lambda entry, residual: seen.append((entry.number, residual is None))))
    evaluations.batch([np.array([1.0]), np.array([-1.0])], "step")
    assert seen == [(0, False), (1, True)]


def test_batch_in_threads_keeps_the_order():
    xs = [np.array([value]) for value in np.linspace(1.0, 2.0, 8)]
    with ThreadPoolExecutor(3) as pool:
        outcomes = _evaluations(hooks=Hooks(map_function=pool.map)).batch(xs, "jacobian")
    assert [o.f for o in outcomes] == [5.0 * x[0] ** 2 for x in xs]


def test_changed_length_is_refused():
    evaluations = Evaluations(problem(lambda x: np.ones(int(x[0])), [2.0]))
    evaluations.outcome(np.array([2.0]))
    with pytest.raises(ValueError, match="masks must not change"):
        evaluations.outcome(np.array([3.0]))


def test_other_errors_are_not_swallowed():
    def broken(_x):
        raise KeyError("bug")

    with pytest.raises(KeyError):
        Evaluations(problem(broken, [2.0])).outcome(np.array([2.0]))
