"""When the frames were taken: from the names of their files, from stamps in the pictures, or by counting.

Order of trust: times written into the names ("..._09.26ms.png", "12us", "0.0002s"), stamps in the frames, numbers in
the names, counting. Numbers count from the smallest; they are frame numbers where they rise by one, times where they
rise by the frame interval in some unit; what is neither is refused. A frame that repeats the one before is no frame:
it is left out and said. A test lasts 30 ms; one of more than 200 ms is refused.
"""

from __future__ import annotations

import re

import numpy as np

from taichi_eye.analysis.stamps import read_stamps
from taichi_eye.errors import FilmError

LONGEST_MS = 200.0
COUNTED = "counting; a missing frame would go unnoticed"
NOISY_MIN = 0.5  # share of the pixels that change between two frames of a film with noise
REPEAT_MAX = 0.3  # of the usual change from frame to frame: less, and it is the same frame
_UNIT = re.compile(
    r"([0-9]+(?:\.[0-9]+)?)\s*(ms|us|\N{MICRO SIGN}s|\N{GREEK SMALL LETTER MU}s|s)(?![a-z])", re.IGNORECASE
)
_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]+)?)(?!.*[0-9])")
_COPY = re.compile(r"(?: ?\([0-9]+\)|[ _-]*copy(?: ?[0-9]+)?|~)$", re.IGNORECASE)
_MICRO = re.compile("[\N{MICRO SIGN}\N{GREEK SMALL LETTER MU}]")
_IN_MS = {"ms": 1.0, "us": 1e-3, "s": 1e3}
UNIT_MATCH = 0.03  # of the frame interval, for numbers to be times


def repeats(frames: np.ndarray) -> np.ndarray:
    """Which frames [frames] show the one before once more, bool.

    Told by the noise: where most pixels change from frame to frame, one that changes hardly at all is a copy. A film
    without noise has none: a cornea at rest looks the same for long.
    """
    change, share = np.empty(len(frames) - 1), np.empty(len(frames) - 1)
    for k in range(len(change)):
        off = np.abs(frames[k + 1].astype(np.int16) - frames[k])
        change[k], share[k] = off.mean(), (off > 0).mean()
    found = np.zeros(len(frames), bool)
    busy = share >= NOISY_MIN
    if busy.mean() > 0.25:
        found[1:] = change < REPEAT_MAX * np.median(change[busy])
    return found


def without_copy_marks(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names without the " (1)" or " copy" that a copy of a file of that name is given."""
    taken = set(names)
    return tuple(bare if (bare := _COPY.sub("", name)) in taken else name for name in names)


def times_of(names: tuple[str, ...], frames: np.ndarray, interval_ms: float) -> tuple[np.ndarray, str, list[str]]:
    """Times [frames] in ms, NaN where unknown; where from; and notes. names: of the files, or empty."""
    found = _written(names)
    if found is not None:
        return *_from_zero(found, "file names"), []
    stamped = read_stamps(frames, interval_ms)
    if stamped is not None:
        return stamped, "stamps in the frames", []
    found = _numbers(names, interval_ms)
    if found is not None:
        return *_from_zero(found, "numbers in the file names"), []
    notes = []
    if names and not all(_NUMBER.search(name) for name in names):
        notes.append("the file names are not numbered: frames are taken in the order of their names")
    return np.arange(len(frames)) * interval_ms, COUNTED, notes


def refuse_long(path, times_ms: np.ndarray, how: str) -> None:
    """FilmError for a test that lasts too long to be one."""
    known = times_ms[np.isfinite(times_ms)]
    if len(known) and not known.max() - known.min() <= LONGEST_MS:
        raise FilmError(
            f"{path}: by {how} the test lasts {known.max() - known.min():.4g} ms; at most {LONGEST_MS:g} ms are read "
            '(the instrument takes 32 ms). Number the files by frame, name them by time, as in "09.26ms.png", or say '
            "--frame-interval-ms"
        )


def _from_zero(times: np.ndarray, how: str) -> tuple[np.ndarray, str]:
    """Times counted from the smallest, where they do not start near zero."""
    if times.min() <= LONGEST_MS:
        return times, how
    return times - times.min(), f"{how}, counted from the first"


def _written(names: tuple[str, ...]) -> np.ndarray | None:
    found = [_UNIT.search(name) for name in names]
    if not names or not all(found):
        return None
    times = np.array([float(match[1]) * _IN_MS[_MICRO.sub("u", match[2].lower())] for match in found])
    return times if len(np.unique(times)) > 0.5 * len(times) else None


def _numbers(names: tuple[str, ...], interval_ms: float) -> np.ndarray | None:
    """Times from numbers in the names; FilmError where the numbers are neither frames nor times."""
    found = [_NUMBER.search(name) for name in names]
    if not names or not all(found) or any(len(match[1]) > 30 for match in found):
        return None
    whole = all("." not in match[1] for match in found)
    # whole numbers may exceed what a float holds exactly: less the smallest first
    smallest = min(int(match[1]) for match in found) if whole else min(float(match[1]) for match in found)
    number = np.array([float((int(match[1]) if whole else float(match[1])) - smallest) for match in found])
    steps = np.diff(np.unique(number))
    if len(steps) + 1 < 0.9 * len(number):
        return None
    step = float(np.median(steps))
    if whole and (step <= 4 and steps.max() <= 1e6):
        return number * interval_ms
    for unit_ms in (1e-6, 1e-3, 1.0, 1e3):
        if abs(step * unit_ms / interval_ms - 1.0) < UNIT_MATCH:
            return number * unit_ms
    raise FilmError(
        f'the numbers in the file names, such as "{names[0][:60]}", rise by {step:g}: neither frame numbers nor times '
        f"{interval_ms:g} ms apart. Number the files by frame, or name them by time, as in "
        '"09.26ms.png"'
    )
