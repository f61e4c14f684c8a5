"""The errors that a user of taichi_eye meets: a scene that cannot be, a run that left its validity, a film that cannot
be read."""

from __future__ import annotations

import signal


class SceneError(Exception):
    """Bad input, refused before anything is written.

    The message names the file (or `--set`), the key, its value and what is allowed; several problems stand one
    to a line.
    """


class NoEstimate(SceneError):
    """Data that no eye of a scene's model can have made, so that an estimate from them would be none."""


class RunStopped(Exception):
    """A run that left its validity and was stopped.

    Attributes
    ----------
    what : str
        What failed, e.g. "the membrane went slack".
    where : str
        Where, e.g. "membrane node 12, r = 0.61 mm".
    time_ms : float
        Simulated time of the failure [ms].
    advice : str
        What to change in the scene.
    folder : Path or None
        The run folder that holds what was computed up to there, where there is one.
    """

    folder = None

    def __init__(self, what: str, where: str, time_ms: float, advice: str):
        super().__init__(what, where, time_ms, advice)
        self.what, self.where, self.time_ms, self.advice = what, where, float(time_ms), advice

    def __str__(self) -> str:
        return f"stopped at {self.time_ms:.4f} ms: {self.what} ({self.where}). {self.advice}"


class Interrupted(KeyboardInterrupt):
    """A run ended from outside: number, of the signal; folder, what it left and can be resumed from, or None."""

    folder = None

    def __init__(self, number: int):
        super().__init__(number)
        self.number = int(number)

    def __str__(self) -> str:
        return "interrupted" if self.number == signal.SIGINT else f"ended by {signal.Signals(self.number).name}"


class OutputError(Exception):
    """What was computed could not be written: the message names the file, the reason and what is kept."""


class FilmError(Exception):
    """A film, folder or run that cannot be read or measured; the message says what is missing."""
