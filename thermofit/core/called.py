"""Kernels that other kernels call: kept as LLVM code, without machine code and without an entry from Python.

numba makes machine code and two wrappers for Python of every function that it compiles. Of the functions that kernels call nobody uses
them, for their code is linked into the caller and optimised there. They took a third of the compilation. A `Kernel` is therefore compiled
as numba does it where Python calls it, and as a `_Called` where a kernel does. The code that runs is the same.

This rests on numba's own classes, which a later version may change: `KNOWN` are the versions that it was tried with, all others compile as
numba does (`core.jit`).
"""

from __future__ import annotations

import gc
from typing import Any

from numba import types
from numba.core import codegen, compiler, compiler_machinery, environment, registry, typed_passes

# numba's own classes, without types of theirs.
_types: Any = types
_Library: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.CompilerBase
_Passes: Any = compiler.DefaultPassBuilder
_Pass: Any = compiler_machinery.LoweringPass
_register_pass: Any = compiler_machinery.register_pass
_environment_of: Any = environment.lookup_environment
_Dispatcher: Any = registry.CPUDispatcher
_LAST_BEFORE_LOWERING: Any = typed_passes.AnnotateTypes

KNOWN = ((0, 60), (0, 68))
"""First and last version of numba that these classes were tried with."""
_ENVIRONMENT = "_ZN08NumbaEnv"
"""Beginning of the name under which the code of a function looks for its environment."""


class _NoEnvironment:
    """The code generator, which sets no environment: there is no machine code yet that could look for it."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing: `_EnteredLibrary` does it."""


class _CalledLibrary(_Library):
    """LLVM code to be linked into that of a caller."""

    @property
    def codegen(self) -> Any:
        return _NoEnvironment(self._codegen)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _EnteredLibrary(_Library):
    """Machine code that Python calls, with the environments of all functions that are linked into it."""

    def _finalize_final_module(self) -> None:
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                found = _environment_of(variable.name)
                if found is not None:
                    self._codegen.set_env(variable.name, found)


class _IntoLibrary(_Pass):
    """Choose the library that a function is lowered into."""

    library: Any

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """As numba's lowering does where no library is given."""
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return True


@_register_pass(mutates_CFG=False, analysis_only=False)
class _IntoCalled(_IntoLibrary):
    _name = "into_called"
    library = _CalledLibrary


@_register_pass(mutates_CFG=False, analysis_only=False)
class _IntoEntered(_IntoLibrary):
    _name = "into_entered"
    library = _EnteredLibrary


class _CalledCompiler(_Compiler):
    """numba's pipeline into a `_CalledLibrary`."""

    def define_pipelines(self) -> list[Any]:
        return [_with(self.state, _IntoCalled)]


class _EnteredCompiler(_Compiler):
    """numba's pipeline into an `_EnteredLibrary`."""

    def define_pipelines(self) -> list[Any]:
        return [_with(self.state, _IntoEntered)]


def _with(state: Any, choice: Any) -> Any:
    passes = _Passes.define_nopython_pipeline(state)
    passes.add_pass_after(choice, _LAST_BEFORE_LOWERING)
    passes.finalize()
    return passes


class _Called(_Dispatcher):
    """A function as kernels see it. A number that is written in a call is an argument as any other: no version for each of them."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        options = {**(targetoptions or {}), "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(py_func, locals or {}, options, _CalledCompiler)  # numba 0.60 takes no None

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(tuple(_types.unliteral(a) for a in args), {name: _types.unliteral(a) for name, a in kws.items()})

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres  # without an entry for Python


class Kernel(_Dispatcher):
    """A compiled function: called from Python, and from other kernels as a `_Called`."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(py_func, locals or {}, targetoptions, _EnteredCompiler)
        self._called = _Called(py_func, locals, targetoptions)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """What a kernel that calls this one asks for."""
        return self._called.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        """What such a kernel is linked with."""
        return self._called.get_overload(sig)

    def compile(self, sig: Any) -> Any:
        """As numba does, without the collection of garbage meanwhile, which took a sixth of the time."""
        collects = gc.isenabled()
        gc.disable()
        try:
            return super().compile(sig)
        finally:
            if collects:
                gc.enable()
