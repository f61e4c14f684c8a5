"""Taichi's Python front end without its detours: half of a start with compiled kernels in the cache, and of a launch.

Taichi runs a kernel's source through its front end in every process, also where the compiled kernel lies in the offline
cache. For every node of the syntax tree 1.7.4 wraps the source line and a line of carets under it, for a compile error
that does not come; for every function that it decorates or inlines it asks `inspect`, which walks all loaded modules,
parses afresh. Here the place is file, line and function, and sources are looked up once.

At every launch it asks again what its arguments are and which compiled kernel belongs to them, some 40 us. A small eye
is launched twice a sample, 1400 samples a puff: `launcher` remembers the answer.
"""

import functools
import inspect
import linecache
import re
import sys
import weakref

import numpy as np
from taichi.lang import impl, kernel_impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext

_taichi_source_lines = kernel_impl.getsourcelines
IN_CLASS = re.compile(r"@(\w+\.)?data_oriented|class ")


def _place(context, node) -> str:
    """Where a node of the syntax tree stands."""
    return f'File "{context.file}", line {node.lineno + context.lineno_offset}, in {context.func.func.__name__}:\n'


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Whether the statement that runs in the frame so far up is a class."""
    try:
        frame = sys._getframe(level_of_class_stackframe)
    except ValueError:
        return False  # a function of the script that runs: nothing is above it
    return bool(IN_CLASS.match(linecache.getline(frame.f_code.co_filename, frame.f_lineno).strip()))


@functools.cache
def _source_lines(function) -> tuple[list[str], int]:
    """Source lines of a function, decorators included, and the number of the first."""
    code = function.__code__
    lines = linecache.getlines(code.co_filename)
    if not lines:
        return _taichi_source_lines(function)  # typed at a prompt
    return inspect.getblock(lines[code.co_firstlineno - 1 :]), code.co_firstlineno


def launcher(kernel):
    """A kernel that returns nothing, to be called as it is with integers and C-contiguous NumPy arrays.

    The first launch is Taichi's own. Later ones with arguments of the same types go straight to what it compiled; those
    with others, and those under another start of Taichi, are its own again.
    """
    known = program = made = compiled = None  # program: weakly held, or it would outlive its start

    def launch(*args):
        nonlocal known, program, made, compiled
        kinds = tuple((v.dtype, v.ndim, v.flags.c_contiguous) if type(v) is np.ndarray else type(v) for v in args)
        running = impl.get_runtime().prog
        if kinds != known or program() is not running:
            kernel(*args)
            known = compiled = None
            now, found = impl.get_runtime().prog, kernel._primal.compiled_kernels.values()
            plain = all(kind is int or type(kind) is tuple and kind[2] for kind in kinds)
            if plain and len(found) == 1 and not impl.current_cfg().debug:
                (made,), program, known = found, weakref.ref(now), kinds
                compiled = now.compile_kernel(now.config(), now.get_device_caps(), made)
            return
        context = made.make_launch_context()
        for n, value in enumerate(args):
            if type(value) is int:
                context.set_arg_int((n,), value)
            else:
                context.set_arg_external_array_with_shape((n,), value.ctypes.data, value.nbytes, value.shape, 0)
        running.launch_kernel(compiled, context)

    return launch


def shorten() -> None:
    """Put the short ways in place."""
    ASTTransformerContext.get_pos_info = _place
    kernel_impl._inside_class = _inside_class
    kernel_impl.getsourcelines = _source_lines
    kernel_impl.getsourcefile = lambda function: function.__code__.co_filename
