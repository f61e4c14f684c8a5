"""Checkpoints as the run goes, and the orderly end that a signal asks for."""

from __future__ import annotations

import time
from collections.abc import Sequence

from taichi_eye.errors import Interrupted
from taichi_eye.recording.observer import Observer
from taichi_eye.recording.signals import Signals
from taichi_eye.recording.workroom import WorkRoom, fingerprint, program

SHARE = 0.02  # of the run's time, that checkpoints may cost


class Checkpoint(Observer):
    """The last of the observers: a checkpoint holds what the others have seen, up to the sample that it is taken at.

    One is taken `output.checkpoint_s` seconds after the last one, later where they would cost more than SHARE of the
    time, at the next sample where the others can be held cheaply; and at once where a signal asks for the end.
    """

    def __init__(self, room: WorkRoom, others: Sequence[Observer], signals: Signals):
        self._room, self._others, self._signals = room, others, signals

    def opened(self, recording, held) -> None:
        super().opened(recording, held)
        self._scene, self._pause_s = fingerprint(recording.scene), recording.scene.output.checkpoint_s
        self._last = time.monotonic()

    def sample(self) -> None:
        simulation = self.recording.simulation
        if simulation.clock.frame_of(simulation.sample) is None:
            self._look()

    def frame(self, moment) -> None:
        self._look()

    def _look(self) -> None:
        if self._signals.asked is not None:
            self.take()
            raise Interrupted(self._signals.asked)
        if time.monotonic() - self._last >= self._pause_s and all(other.seam for other in self._others):
            self.take()

    def take(self) -> None:
        """Put a checkpoint on the disk."""
        recording, before = self.recording, time.monotonic()
        held = {type(other).__name__: other.held() for other in self._others}
        clock = recording.clock | {"total_s": recording.elapsed_s()}
        header = {"program": program(), "scene": self._scene, "held": held, "clock": clock}
        self._room.save(header, recording.simulation.state())
        self._last = time.monotonic()
        if recording.scene.output.checkpoint_s > 0:
            self._pause_s = max(recording.scene.output.checkpoint_s, (self._last - before) / SHARE)
