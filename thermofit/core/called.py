"""Kernels that other kernels call: kept as LLVM code, without machine code and without an entry from Python.

numba links every function that it compiles with all that it calls, optimises the whole, and makes machine code of it with two wrappers for
Python. Of the functions that kernels call, the bodies of parallel loops among them, nobody uses all that: their code is linked into the
caller and optimised there. It took more than half of the compilation. A `Kernel` is therefore compiled as numba does it where Python calls
it, and all else that is compiled for it is kept as it comes, to be linked and optimised once. Answers are the same to the last bit.

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
_codegen: Any = codegen
_EXTERNAL: Any = _codegen.ll.Linkage.external
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
    """LLVM code of one function, to be linked into that of an entered one together with the code of what it calls itself."""

    _shared_module: Any

    @property
    def codegen(self) -> Any:
        return _NoEnvironment(self._codegen)

    def finalize(self) -> None:
        """Neither linked, nor optimised, nor made machine code here: `_EnteredLibrary` does each once, over all that it is made of."""
        self._raise_if_finalized()
        self._finalize_dynamic_globals()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == _EXTERNAL:
                function.linkage = "linkonce_odr"  # numba's own choice for what is linked
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Its code with that of all it calls, for libraries that numba makes."""
        self._ensure_finalized()
        if self._shared_module is None:
            module = self._final_module.clone()
            _link(module, self)
            self._shared_module = module
        return self._shared_module

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _EnteredLibrary(_Library):
    """Machine code that Python calls, with the environments of all functions that are linked into it."""

    def finalize(self) -> None:
        """As numba does, with every function linked in once."""
        self._codegen._check_llvm_bugs()
        self._raise_if_finalized()
        _link(self._final_module, self)
        self._optimize_final_module()
        self._final_module.verify()
        self._finalize_final_module()

    def _finalize_final_module(self) -> None:
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                found = _environment_of(variable.name)
                if found is not None:
                    self._codegen.set_env(variable.name, found)


def _link(module: Any, library: Any) -> None:
    """Link into a module the code of all that the library calls, directly or not, each function once and after all that call it: of code
    that nothing in the module asks for yet, LLVM takes nothing."""
    for other in reversed(_callees(library, [], {library})):
        if hasattr(library, "_reload_init"):  # numba 0.60 has none
            library._reload_init.update(other._reload_init)
        module.link_in(other._final_module if isinstance(other, _CalledLibrary) else other._get_module_for_linking(), preserve=True)


def _callees(library: Any, found: list[Any], seen: set[Any]) -> list[Any]:
    """Libraries that one calls, directly or not, each after those that it calls itself."""
    for other in library._linking_libraries:
        if other not in seen:
            seen.add(other)
            other._ensure_finalized()
            if isinstance(other, _CalledLibrary):
                _callees(other, found, seen)
            found.append(other)
    return found


@_register_pass(mutates_CFG=False, analysis_only=False)
class _IntoEntered(_Pass):
    """Lower a function into an `_EnteredLibrary`."""

    _name = "into_entered"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        """As numba's lowering does where no library is given."""
        state.library = _EnteredLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return True


class _EnteredCompiler(_Compiler):
    """numba's pipeline into an `_EnteredLibrary`. All that it compiles besides is code to be linked into that, the bodies of parallel loops
    and numba's own functions too."""

    def compile_extra(self, func: Any) -> Any:
        """As numba does; what is read from the cache is none of this."""
        codegen = self.state.targetctx.codegen()
        usual = codegen._library_class
        codegen._library_class = _CalledLibrary
        try:
            return super().compile_extra(func)
        finally:
            codegen._library_class = usual

    def define_pipelines(self) -> list[Any]:
        passes = _Passes.define_nopython_pipeline(self.state)
        passes.add_pass_after(_IntoEntered, _LAST_BEFORE_LOWERING)
        passes.finalize()
        return [passes]


class _Called(_Dispatcher):
    """A function as kernels see it. A number that is written in a call is an argument as any other: no version for each of them."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        options = {**(targetoptions or {}), "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(py_func, locals or {}, options)  # numba 0.60 takes no None

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
