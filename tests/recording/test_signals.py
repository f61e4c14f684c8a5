"""Signals: at once before a run steps, noted while it does, of no effect while it writes."""

import os
import signal
import threading

import pytest

from taichi_eye.errors import Interrupted
from taichi_eye.recording.signals import ENDING, Signals


def send(number):
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", ENDING)
def test_each_phase_takes_a_signal_its_way(number):
    before = signal.getsignal(number)
    with Signals() as signals:
        with pytest.raises(Interrupted) as caught:
            send(number)
        assert caught.value.number == number and signals.asked is None
        signals.note()
        send(number)
        assert signals.asked == number
        with pytest.raises(Interrupted):
            send(number)
        signals.shield()
        send(number)
    assert signal.getsignal(number) == before


def test_handlers_of_the_program_and_ignored_signals_stay():
    heard = []
    before = (
        signal.signal(signal.SIGTERM, lambda *_: heard.append("mine")),
        signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    try:
        with Signals() as signals:
            signals.note()
            send(signal.SIGTERM)
            send(signal.SIGHUP)
            assert heard == ["mine"] and signals.asked is None
    finally:
        signal.signal(signal.SIGTERM, before[0])
        signal.signal(signal.SIGHUP, before[1])


def test_another_thread_leaves_signals_alone():
    before, seen = signal.getsignal(signal.SIGINT), []

    def inside():
        with Signals():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert seen == [before]
