"""How a kernel and the kernels that it calls become one piece of machine code.

Numba optimises each function by itself, makes it callable from Python, turns it into machine code,
and then does the first and the last again in every function that calls it. Here a kernel called by
a kernel is a *part*: as it was written until all parts of a *whole*, which is what Python calls,
lie in one module, and that is optimised once.
"""

from __future__ import annotations

import gc
import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import update_wrapper
from typing import Any

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import register_pass
from numba.core.registry import cpu_target
from numba.core.typed_passes import NativeLowering
from numba.core.untyped_passes import InlineInlinables

from swarm_envs.borrowed import borrow, mark_borrowed, types


class _Flags(Flags):  # type: ignore[misc]  # numba is untyped
    """Numba's options, compared by what is set: it compares them ten thousands of times."""

    def __eq__(self, other: object) -> bool:
        if isinstance(other, _Flags) and self._values == other._values:
            return True
        return bool(super().__eq__(other))

    def __hash__(self) -> int:
        return _HASH


_HASH = hash(Flags())
"""Numba's hash does not depend on the values, and takes long."""


class _WholeLibrary(JITCodeLibrary):  # type: ignore[misc]  # numba is untyped
    """The code of a kernel and all its parts, optimised when it is complete."""

    _linking_libraries: list[Any]

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout

    def finalize(self) -> None:
        """Take in all that parts need, each once."""
        needed = dict.fromkeys(self._linking_libraries)
        for library in self._linking_libraries:
            needed |= library.needed if isinstance(library, _PartLibrary) else {}
        self._linking_libraries = list(needed)
        super().finalize()

    def _optimize_final_module(self) -> None:
        builder = self._codegen._pass_builder()
        builder.getModulePassManager().run(self._final_module, builder)


class _PartLibrary(_WholeLibrary):
    """The code of a part, for others to take in."""

    needed: dict[Any, None]
    """The code that this one calls, and that calls, and so on."""

    def add_ir_module(self, ir_module: Any) -> None:
        mark_borrowed(ir_module)
        super().add_ir_module(ir_module)

    def finalize(self) -> None:
        """Take in nothing, and leave that to the whole, but know what it will need."""
        self.needed = dict.fromkeys(self._linking_libraries)
        for library in self._linking_libraries:
            self.needed |= library.needed if isinstance(library, _PartLibrary) else {}
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerWhole(NativeLowering):  # type: ignore[misc]  # numba is untyped
    _name = "lower_whole"

    def run_pass(self, state: Any) -> bool:
        state.library = _WholeLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerPart(NativeLowering):  # type: ignore[misc]  # numba is untyped
    _name = "lower_part"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = state.flags.no_cpython_wrapper = True
        super().run_pass(state)
        key = object()  # by which callers find it; elsewhere, what Python calls
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


class _WholeCompiler(CompilerBase):  # type: ignore[misc]  # numba is untyped
    """Numba's pipeline, with another last step; nothing is inlined before LLVM does."""

    lowering = _LowerWhole

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags = _Flags(self.state.flags)

    def define_pipelines(self) -> list[Any]:
        steps = DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps.passes = [
            (self.lowering, text) if step is NativeLowering else (step, text)
            for step, text in steps.passes
            if step is not InlineInlinables
        ]
        steps._finalized = False
        steps.finalize()
        return [steps]


class _PartCompiler(_WholeCompiler):
    lowering = _LowerPart


@contextmanager
def _in_haste() -> Iterator[None]:
    """Let garbage lie, and find out once what an operator does with operands of certain types.

    Compilation makes little garbage, and looking for it takes a tenth of the time. To ask anew for
    each of thousands of additions takes another.
    """
    enabled, context = gc.isenabled(), cpu_target.typing_context
    resolve, found = context.resolve_function_type, {}

    def look_up(function: Any, arguments: Any, keywords: Any) -> Any:
        if keywords or not isinstance(function, types.Function):
            return resolve(function, arguments, keywords)
        key = function, tuple(arguments)
        if key not in found:
            found[key] = resolve(function, arguments, keywords)
        return found[key]

    gc.disable()
    context.resolve_function_type = look_up
    try:
        yield
    finally:
        context.resolve_function_type = resolve
        if enabled:
            gc.enable()


def whole_and_part(function: Callable[..., Any], **options: Any) -> Any:
    """A dispatcher whose function is compiled as a part.

    Called from Python, it compiles a whole that does nothing but call that part. Its part takes
    integers that are constant as integers, lest it be compiled twice, and borrows named tuples.
    """
    part = numba.njit(pipeline_class=_PartCompiler, **options)(function)
    resolve = part.get_call_template

    def get_call_template(arguments: Any, keywords: Any) -> Any:
        borrowed = {name: borrow(kind) for name, kind in keywords.items()}
        return resolve(tuple(map(borrow, arguments)), borrowed)

    def add_overload(result: Any) -> None:
        part.overloads[tuple(result.signature.args)] = result

    part.get_call_template, part.add_overload = get_call_template, add_overload
    names = ", ".join(inspect.signature(function).parameters)
    forward = update_wrapper(eval(f"lambda {names}: part({names})", {"part": part}), function)
    whole = numba.njit(pipeline_class=_WholeCompiler, **options)(forward)
    whole.py_func, whole.compile = function, _in_haste()(whole.compile)
    whole.get_call_template, whole.get_overload = get_call_template, part.get_overload
    return whole
