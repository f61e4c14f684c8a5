"""The sinks of a run, in the order in which they see a frame and write at its end: the history first, the summary
last."""

from __future__ import annotations

from taichi_eye.recording.apex import Apex
from taichi_eye.recording.error_bar import Bars
from taichi_eye.recording.fields import Fields
from taichi_eye.recording.film import Film
from taichi_eye.recording.frames import Frames
from taichi_eye.recording.gif import Gif
from taichi_eye.recording.observer import Observer
from taichi_eye.recording.report import Report
from taichi_eye.recording.sheet import Sheet
from taichi_eye.recording.summary import Summary
from taichi_eye.recording.traces import Traces
from taichi_eye.recording.wall import Wall

SINKS: tuple[type[Observer], ...] = (Traces, Bars, Film, Wall, Frames, Fields, Apex, Sheet, Gif, Report, Summary)
