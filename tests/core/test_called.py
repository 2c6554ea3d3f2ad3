"""Kernels that kernels call: one version for all numbers in a call, no entry from Python, errors with what they say, from the cache too."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from numba.core import codegen

from thermofit.core.called import Kernel
from thermofit.core.jit import kernel


@kernel(cache=False)
def power(x: float, n: int) -> float:
    value = 1.0
    for _ in range(n):
        value *= x
    return value


@kernel(cache=False)
def polynomial(x: float) -> float:
    return power(x, 1) + power(x, 2) + power(x, n=3)


def test_a_called_kernel_is_compiled_once_and_without_machine_code() -> None:
    assert polynomial(2.0) == 14.0
    assert len(power.overloads) == 0
    (made,) = power._called.overloads.values()
    assert not made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
    (entered,) = polynomial.overloads.values()
    assert entered.library.get_pointer_to_function(entered.fndesc.llvm_func_name)


def test_python_calls_it_as_well() -> None:
    assert polynomial(3.0) == 39.0
    assert power(2.0, 5) == 32.0
    assert polynomial(2.0) == 14.0


def test_a_kernel_is_made_machine_code_once_with_all_that_it_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with the bodies of its parallel loops and with numba's own functions."""

    @kernel(cache=False, parallel=True)
    def sums(a: np.ndarray) -> np.ndarray:
        found = np.zeros(len(a)).reshape(-1)
        for i in numba.prange(len(a)):
            for x in a[i]:
                found[i] += polynomial(x)
        return found

    made, address = set(), codegen.JITCodeLibrary.get_pointer_to_function

    def told(library: codegen.JITCodeLibrary, name: str) -> int:
        made.add(library)
        return int(address(library, name))

    monkeypatch.setattr(codegen.JITCodeLibrary, "get_pointer_to_function", told)
    a = np.arange(6.0).reshape(2, 3)
    assert sums(a).tolist() == [(a[i] + a[i] ** 2 + a[i] ** 3).sum() for i in range(2)]
    assert len(made) == 1, made


def test_what_a_kernel_does_not_say_of_inlining_it_does_not_take_from_its_caller() -> None:
    """Else all that a kernel with `forceinline` calls is copied into every caller as well."""
    apart = kernel(cache=False)(lambda x: x + 1.0)

    @kernel(cache=False, forceinline=True)
    def inlined(x: float) -> float:
        return float(apart(x))

    @kernel(cache=False)
    def entered(x: float) -> float:
        return float(inlined(x))

    assert entered(1.0) == 2.0
    for called, expected in ((inlined, True), (apart, False)):
        (made,) = called._called.overloads.values()
        attributes = made.library.get_function(made.fndesc.llvm_func_name).attributes
        assert (b"alwaysinline" in attributes) == expected


def test_functions_that_numba_compiles_call_kernels_with_all_that_these_call() -> None:
    @numba.njit
    def shifted(x: float) -> float:
        return float(np.zeros(1)[0] + polynomial(x + 1.0))

    assert shifted(1.0) == 14.0


def test_garbage_is_collected_after_a_compilation() -> None:
    @kernel(cache=False)
    def third(x: float) -> float:
        return x / 3.0

    assert gc.isenabled()
    assert third(6.0) == 2.0
    assert gc.isenabled()


RAISES = """
import numba
import numpy as np
from thermofit.core.called import Kernel
from thermofit.core.jit import kernel

@kernel
def fill(into, values):
    if values.size > into.size:
        raise ValueError("too many", values.size)
    for i in range(values.size):
        into[i] = values[i]

@kernel
def filled(values, n):
    into = np.empty(n)
    fill(into, values)
    return into
"""
MAIN = """
import numba
import numpy as np
from raises import filled
print(filled(np.ones(3), 3).sum())
try:
    filled(np.ones(3), 2)
except ValueError as error:
    print(error)
print(sum(filled.stats.cache_hits.values()))
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> list[list[str]]:
    """What two processes say, of which the second reads the kernel of the first."""
    folder = tmp_path_factory.mktemp("raises")
    (folder / "raises.py").write_text(RAISES)
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), root]), "THERMOFIT_CACHE_DIR": str(folder / "cache")}
    found = []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", MAIN], env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        found.append(done.stdout.splitlines())
    return found


def test_an_error_in_a_called_kernel_says_what_it_says(said: list[list[str]]) -> None:
    """The message is made when it is raised, from the environment of the function that raises it."""
    for number, text, _ in said:
        assert number == "3.0"
        assert text == "('too many', 3)"
    assert [hits for *_, hits in said] == ["0", "1"]


def test_the_same_bits_as_numba() -> None:
    """Called or compiled alone: the formula rounds alike."""
    x = np.random.default_rng(3).standard_normal(1000)
    plain = numba.njit(power.py_func)
    assert [polynomial(float(v)) for v in x] == [plain(v, 1) + plain(v, 2) + plain(v, 3) for v in x]


@pytest.mark.parametrize(("version", "own"), [((0, 60), True), ((0, 68), True), ((0, 69), False), ((1, 0), False)])
def test_an_unknown_numba_compiles_as_it_does(monkeypatch: pytest.MonkeyPatch, version: tuple[int, int], own: bool) -> None:
    """Its classes may have changed: kernels are compiled without ours, and answer the same."""
    monkeypatch.setattr(numba, "version_info", SimpleNamespace(short=version))
    made = kernel(cache=False)(power.py_func)
    assert made(3.0, 4) == 81.0 and isinstance(made, Kernel) is own
