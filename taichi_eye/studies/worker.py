"""The process of a worker (`taichi_eye.studies.crew`): `python -m taichi_eye.studies.worker THREADS`.

It reads messages from standard input and writes answers to what was standard output when it started; whatever the
libraries print goes to standard error. It ends with its input.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

from taichi_eye import backend
from taichi_eye.studies import crew


def main(threads: int) -> None:
    """Answer until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    backend.init("cpu", "f64", threads)
    compute, common = None, None
    while True:
        try:
            message = crew.read(sys.stdin.buffer)
        except EOFError:
            return
        if "compute" in message:
            module, _, name = message["compute"].partition(":")
            compute, common = getattr(import_module(module), name), message["common"]
        else:
            crew.write(answers, {"rows": compute(common, message["items"])})


if __name__ == "__main__":
    main(int(sys.argv[1]))
