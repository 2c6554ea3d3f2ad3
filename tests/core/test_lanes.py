"""Lanes: each of the eight is what a number would be; memory, masks, exp and log."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scalar_update import exponential, exponential_derivative

from thermofit.core.jit import kernel
from thermofit.core.lanes import OF_NUMPY, Lanes, all_lanes, any_lane, larger, multiply_add, spread, where
from thermofit.point.lanes_memory import at, column, lane_sum, lane_workspace, number, row, set_at, set_column, set_row, set_vectors
from thermofit.point.lanes_tensor import exponential_of_traceless, exponential_slopes, set_symmetric_rows, symmetric_rows


@kernel
def formula(x: Lanes, y: Lanes) -> Lanes:
    """All operations; to be called with numbers and with lanes."""
    z = (x + 2 * y) / (1 + y**2) - 3.0 * x * y
    return math.sqrt(abs(-z)) + np.exp(x) - math.exp(0.1 * y) + np.log(2.0 + x) * math.log(3.0 + y)


@kernel
def formula_of_numbers(a: np.ndarray, out: np.ndarray) -> None:
    for q in range(8):
        out[q] = formula(a[q], a[8 + q])


@kernel
def formula_of_lanes(a: np.ndarray, out: np.ndarray) -> None:
    set_row(out, 0, formula(row(a, 0), row(a, 1)))


def test_a_formula_of_lanes_is_that_of_numbers() -> None:
    a = np.random.default_rng(0).uniform(-1.0, 1.0, 16)
    numbers, lanes = np.empty(8), np.empty(8)
    formula_of_numbers(a, numbers)
    formula_of_lanes(a, lanes)
    assert lanes == pytest.approx(numbers, rel=1e-14, abs=1e-15)


@kernel
def chosen(a: np.ndarray, model: int, out: np.ndarray) -> tuple[float, bool, bool, bool]:
    x, y = row(a, 0), row(a, 1)
    factor = 1.0 if model == 1 else y  # a number on one way, lanes on the other
    set_row(out, 0, where((x > y) & ~(x >= 0.5) | (y < -0.5), x, 7.0))
    set_row(out, 1, larger(x, y) * factor)
    return lane_sum(x), any_lane(x > y), all_lanes(x > y), all_lanes(x <= x)


@pytest.mark.parametrize("model", [1, 2])
def test_masks_choose_lane_by_lane(model: int) -> None:
    a, out = np.random.default_rng(1).uniform(-1.0, 1.0, 16), np.empty(16)
    x, y = a[:8], a[8:]
    total, some, every, always = chosen(a, model, out)
    assert total == pytest.approx(x.sum(), rel=1e-15) and some and not every and always
    assert np.array_equal(out[:8], np.where((x > y) & ~(x >= 0.5) | (y < -0.5), x, 7.0))
    assert np.array_equal(out[8:], np.maximum(x, y) * (1.0 if model == 1 else y))
    a[8:] = a[:8] - 1.0
    assert chosen(a, model, out)[1:3] == (True, True)
    a[8:] = np.nan
    assert chosen(a, model, out)[1:3] == (False, False)


@kernel
def moved(table: np.ndarray, out: np.ndarray, vectors: np.ndarray) -> tuple[float, int]:
    w = lane_workspace(3)
    for n in range(3):
        set_row(w, n, column(table, n))
    set_column(out, 1, row(w, 2))
    set_vectors(vectors, 3, row(w, 0), row(w, 1), row(w, 2))
    set_row(vectors, 0, spread(5.0))
    set_row(vectors, 1, 6.0)
    return number(w, 1, 5), w.ctypes.data % 64


def test_rows_columns_and_vectors() -> None:
    """Columns of any array (8, m), also of a transposed one; vectors at the nodes; a workspace on a line of the memory."""
    for table in (np.arange(24.0).reshape(8, 3), np.arange(24.0).reshape(3, 8).T):
        out, vectors = np.zeros((8, 2)), np.zeros((2, 8, 3))
        one, place = moved(table, out, vectors)
        assert one == table[5, 1] and place == 0
        assert np.array_equal(out, np.stack([np.zeros(8), table[:, 2]], axis=1))
        assert np.array_equal(vectors[1], table)
        assert np.array_equal(vectors[0].ravel(), np.repeat([5.0, 6.0, 0.0], 8))


@kernel
def shifted(a: np.ndarray, out: np.ndarray) -> None:
    set_at(out, 5, multiply_add(at(a, 3), a[0], at(a, 11)))


def test_numbers_from_any_place_on_and_one_rounding() -> None:
    """a b + c with a b = 1 - 2^-60 and c = -1: rounded once it is -2^-60, rounded twice nothing is left."""
    a, out = np.arange(20.0), np.full(16, 7.0)
    a[0], a[4], a[12] = 1.0 + 2.0**-30, 1.0 - 2.0**-30, -1.0
    shifted(a, out)
    assert np.array_equal(np.delete(out, 6), [7.0] * 5 + [a[3 + k] * a[0] + a[11 + k] for k in range(8) if k != 1] + [7.0] * 3)
    assert out[6] == -(2.0**-60)


@kernel
def exp_and_log(x: np.ndarray, exps: np.ndarray, logs: np.ndarray) -> None:
    for n in range(len(x) // 8):
        set_row(exps, n, math.exp(row(x, n)))
        set_row(logs, n, math.log(row(x, n)))


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.3, 5.0, 700.0])
def test_exp_and_log_to_the_last_digits(size: float) -> None:
    x = np.random.default_rng(2).uniform(-size, size, 8000)
    exps, logs = np.empty(8000), np.empty(8000)
    exp_and_log(x, exps, logs)
    assert np.abs(exps / np.exp(x) - 1.0).max() < 5e-16
    positive = np.concatenate([np.abs(x[:4000]), 1.0 + np.abs(x[4000:])])
    exp_and_log(positive, exps, logs)
    assert np.abs(logs / np.log(positive) - 1.0).max() < 5e-16


def test_exp_and_log_out_of_range() -> None:
    x = np.array([-1e9, -709.0, 0.0, np.nan, np.inf, -1.0, 1e300, 5e-324])
    exps, logs = np.empty(8), np.empty(8)
    exp_and_log(x, exps, logs)
    assert np.all(exps[:2] < 1e-307) and exps[2] == 1.0 and np.isnan(exps[3]) and np.all(exps[[4, 6]] > 1e307)
    assert np.all(np.isnan(logs[[0, 1, 2, 3, 4, 5, 7]])) and logs[6] == pytest.approx(np.log(1e300), rel=1e-15)


def applied(function: Any, x: np.ndarray) -> np.ndarray:
    """Values (n,) of a function that is called with eight numbers at once."""

    @kernel(cache=False)
    def in_rows(x: np.ndarray, out: np.ndarray) -> None:
        for n in range(len(x) // 8):
            set_row(out, n, function(row(x, n)))

    out = np.empty(len(x))
    in_rows(x, out)
    return out


@pytest.mark.parametrize("name", OF_NUMPY)
def test_functions_of_numpy_to_the_last_digits(name: str) -> None:
    """Also next to zero, where exp x - 1 and the like lose their digits."""
    function = getattr(np, name)
    for size in (1e-12, 1e-5, 0.3, 5.0, 300.0):
        x = np.random.default_rng(5).uniform(-size, size, 800)
        x = np.abs(x) if name in ("log", "sqrt") else np.maximum(x, -0.99) if name == "log1p" else x
        assert applied(function, x) == pytest.approx(function(x), rel=8e-16, abs=0.0)


@kernel
def powers(a: np.ndarray, n: int, out: np.ndarray) -> None:
    x = row(a, 0)
    set_row(out, 0, x**2)
    set_row(out, 1, x**3)
    set_row(out, 2, x**-2)
    set_row(out, 3, x**n)
    set_row(out, 4, x**0)
    set_row(out, 5, x**0.37)
    set_row(out, 6, x**-0.5)
    set_row(out, 7, 2.0**x)
    set_row(out, 8, x**x)
    set_row(out, 9, x**0.0)


@pytest.mark.parametrize("n", [-3, 0, 5, 12])
def test_powers_are_those_of_numbers(n: int) -> None:
    """Whole exponents of either sign, real ones, and lanes as exponents; of a negative number a real power is none."""
    a, out = np.array([0.0, 1.0, 2.0, 0.3, -1.0, -1.7, 1e-6, 7.3]), np.empty(80)
    powers(a, n, out)
    with np.errstate(all="ignore"):
        told = np.array([a**2, a**3, a**-2.0, a ** float(n), a**0, a**0.37, a**-0.5, 2.0**a, a**a, a**0.0])
    told[8, 4:6] = np.nan  # numpy has -1 there, for -1.0 is whole: a power of lanes does not ask
    assert out.reshape(10, 8) == pytest.approx(told, rel=4e-15, abs=0.0, nan_ok=True)


@kernel
def exponential_and_slopes(x: np.ndarray, out: np.ndarray) -> int:
    s = symmetric_rows(x, 0)
    y, terms = exponential_of_traceless(s)
    slopes = exponential_slopes(s, terms)
    set_symmetric_rows(out, 0, y)
    set_symmetric_rows(out, 6, slopes[0])
    set_symmetric_rows(out, 12, slopes[1])
    set_symmetric_rows(out, 18, slopes[2])
    set_symmetric_rows(out, 24, slopes[3])
    set_symmetric_rows(out, 30, slopes[4])
    return terms


@pytest.mark.parametrize("size", [0.0, 1e-8, 1e-3, 0.05, 0.4])
def test_exponential_of_traceless_tensors_and_its_derivative(size: float) -> None:
    """By the characteristic equation, against the power series of `tensor`."""
    x = np.random.default_rng(3).uniform(-size, size, (6, 8))
    x[2] = -x[0] - x[1]
    out = np.empty((6, 6, 8))
    terms = exponential_and_slopes(x, out)
    assert 2 <= terms <= 20
    basis = np.eye(6)[[0, 1, 3, 4, 5]]
    basis[:2, 2] = -1.0
    for q in range(8):
        one = tuple(x[:, q])
        y, n = exponential(one)
        assert n > 0 and out[0, :, q] == pytest.approx(y, abs=5e-16)
        for m, e in enumerate(basis):
            assert out[1 + m, :, q] == pytest.approx(exponential_derivative(one, tuple(e), 20), abs=2e-15)


def test_exponential_of_too_large_a_tensor_is_refused() -> None:
    x = np.zeros((6, 8))
    x[:3, 4] = (8.0, -4.0, -4.0)
    assert exponential_and_slopes(x, np.empty((6, 6, 8))) == 0
    x[:] = np.nan
    assert exponential_and_slopes(x, np.empty((6, 6, 8))) == 0


IN_LANES = """
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters
from thermofit.core.lanes import any_lane, spread
from thermofit.law.page import law_of, yield_stress_at_rate

@kernel(cache=False)
def flows(x, law):
    lanes = spread(x)
    return any_lane(yield_stress_at_rate(lanes, lanes, lanes, 300.0 + lanes, law) > 0.0)

assert flows(0.01, law_of(Parameters.of({"theta_ref": 297.0})))
"""
IN_NUMBERS = """
import numpy as np
from thermofit.core.jit import kernel
from thermofit.core.parameters import Parameters
from thermofit.law.page import law_of, yield_stress_at_rate

@kernel(cache=False)
def strength(x, law):
    return np.exp(x) * yield_stress_at_rate(x, x, x, 300.0 + x, law)

@kernel(cache=False)
def answer(x, law):
    return np.exp(x) * strength(x, law) * np.exp(-x)

assert answer(0.01, law_of(Parameters.of({"theta_ref": 297.0}))) > 0.0
"""


def test_kernels_of_numbers_compile_beside_cached_kernels_of_lanes(tmp_path: Path) -> None:
    """A process without the body reads from the cache what a body has compiled: np.exp must mean the same before and after."""
    environment = {**os.environ, "THERMOFIT_CACHE_DIR": str(tmp_path)}
    for program in (IN_LANES, IN_NUMBERS):
        ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr[-2000:]


def test_pointers_have_types() -> None:
    """The lanes load and address by typed pointers, which llvmlite is going to drop: then `load` and `gep` need the type as an argument in
    point/lanes_memory.py and body/sensitivity/lanes.py, and this test says so before a kernel does."""
    import llvmlite
    from llvmlite import ir

    enabled = getattr(llvmlite, "ir_layer_typed_pointers_enabled", True)
    assert enabled and ir.PointerType(ir.DoubleType()).pointee == ir.DoubleType(), f"llvmlite {llvmlite.__version__} has opaque ones only"
