"""Taichi's Python front end without its detours: half of a start with compiled kernels in the cache.

Taichi runs a kernel's source through its front end in every process, also where the compiled kernel lies in the offline
cache. For every node of the syntax tree 1.7.4 wraps the source line and a line of carets under it, for a compile error
that does not come; for every function that it decorates or inlines it asks `inspect`, which walks all loaded modules,
parses afresh. Here the place is file, line and function, and sources are looked up once.
"""

import functools
import inspect
import linecache
import re
import sys

from taichi.lang import kernel_impl
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


def shorten() -> None:
    """Put the short ways in place."""
    ASTTransformerContext.get_pos_info = _place
    kernel_impl._inside_class = _inside_class
    kernel_impl.getsourcelines = _source_lines
    kernel_impl.getsourcefile = lambda function: function.__code__.co_filename
