"""Signals that end a run: Ctrl-C, SIGTERM, SIGHUP.

While a run is set up they end it at once, with nothing written. While it steps the first is noted, and the run ends in
order at its next sample, where everything belongs together; a second ends it at once, and its last checkpoint stands.
While the report is written they wait: it takes a second, and half of it would help nobody.
"""

from __future__ import annotations

import signal
import threading

from taichi_eye.errors import Interrupted

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Signals:
    """Holds the signals for a block. asked: the first one noted, or None.

    Takes only those whose default is in force: a program's own handlers, and signals that are ignored (`nohup`), stay
    as they are. Outside the main thread, which alone gets signals, it does nothing.
    """

    def __init__(self):
        self.asked: int | None = None
        self._noting = self._shielded = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            for number in ENDING:
                before = signal.getsignal(number)
                if before in (signal.SIG_DFL, signal.default_int_handler):
                    self._before[number] = before
                    signal.signal(number, self._heard)
        return self

    def __exit__(self, kind, error, trace) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def ask(self, number: int) -> None:
        """Note a signal that nobody sent: the run ends in order at its next sample. From any thread."""
        if not self._shielded and self.asked is None:
            self.asked = number

    def note(self) -> None:
        """From here on the first signal is noted."""
        self._noting = True

    def shield(self) -> None:
        """From here on signals change nothing."""
        self._shielded = True

    def _heard(self, number, _) -> None:
        if self._shielded:
            return
        if not self._noting or self.asked is not None:
            raise Interrupted(number)
        self.asked = number
