"""Standard output and error that end no work: whatever they are, a command that has done its work says so as it can.

A character that the encoding of a stream lacks is written as an escape. A stream that is closed is the null device, so
that no file of the run takes its number. A stream that fails, as on a full disk, takes nothing more and is
reported at the end on the other one; a reader that has gone (`| head`) is no failure.
"""

import functools
import os
import sys
from collections.abc import Callable


class Lasting:
    """A text stream; what it cannot take is dropped, and `failure` keeps the first reason."""

    def __init__(self, stream):
        self.stream = stream
        self.failure: OSError | None = None

    def write(self, text: str) -> int:
        if self.failure is None:
            try:
                return self.stream.write(text)
            except OSError as failure:
                self._fail(failure)
        return len(text)

    def flush(self) -> None:
        if self.failure is None:
            try:
                self.stream.flush()
            except OSError as failure:
                self._fail(failure)

    def _fail(self, failure: OSError) -> None:
        self.failure = failure
        # what is left in the stream's buffer would fail once more at the end of the process
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self.stream.fileno())
        os.close(null)

    def __getattr__(self, name):
        return getattr(self.stream, name)


def steady(command: Callable[..., int]) -> Callable[..., int]:
    """A command whose standard streams last as long as its work.

    Exit status 1 where standard output could not be written and the command itself found nothing wrong.
    """

    @functools.wraps(command)
    def run(*arguments):
        _hold_numbers()
        kept = sys.stdout, sys.stderr
        out, err = sys.stdout, sys.stderr = [Lasting(_escaping(stream)) for stream in kept]
        exited = False
        try:
            status = command(*arguments)
        except SystemExit as asked:
            status, exited = asked.code or 0, True
        finally:
            out.flush()
            lost = out.failure is not None and not isinstance(out.failure, BrokenPipeError)
            if lost:
                err.write(f"taichi-eye: standard output cannot be written ({out.failure.strerror})\n")
            err.flush()
            sys.stdout, sys.stderr = kept
        status = status or int(lost)
        if exited:
            raise SystemExit(status)
        return status

    return run


def _hold_numbers() -> None:
    """Keep the numbers of the standard streams from the files that a run opens."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the smallest number that is free


def _escaping(stream):
    """The stream, with escapes for what its encoding lacks; the null device for one that was closed at the start."""
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")
    if hasattr(stream, "reconfigure") and (stream.errors == "strict" or stream.encoding.lower() != "utf-8"):
        stream.reconfigure(errors="backslashreplace")
    return stream
