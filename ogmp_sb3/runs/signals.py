"""Signals that stop a training: it saves first."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType
from typing import Protocol

Handler = Callable[[int, FrameType | None], object]
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
"""Ctrl-C; what Slurm sends before the end, by itself or by ``--signal``; a connection that is lost."""


class Saver(Protocol):
    """What saves a training."""

    def request_stop(self, signum: int, frame: FrameType | None) -> None:
        """Save and stop after the present update."""

    def request_save(self, then: Callable[[], object]) -> None:
        """Save after the present update, then call a function."""


@contextmanager
def saved_first(saver: Saver) -> Iterator[None]:
    """Have signals stop a training after its present update.

    A signal that is ignored, as by ``nohup``, stays ignored. One that somebody handles, such as submitit, which puts
    the job into the queue again, is handed on to him when the training is saved.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread gets signals
        return
    terminals = [stream.fileno() for stream in (sys.__stdout__, sys.__stderr__) if stream and stream.isatty()]

    def stop(signum: int, frame: FrameType | None) -> None:
        _let_go_of_lost(terminals)
        saver.request_stop(signum, frame)

    def hand_on(handler: Handler, signum: int, frame: FrameType | None) -> None:
        saver.request_save(partial(handler, signum, None))

    before = {number: signal.getsignal(number) for number in STOPPING}
    for number, handler in before.items():
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, stop)
        elif callable(handler):
            signal.signal(number, partial(hand_on, handler))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _let_go_of_lost(terminals: list[int]) -> None:
    """Write nowhere instead of to a terminal that is gone, where writing is an error."""
    for descriptor in terminals:
        try:
            os.write(descriptor, b"\n")
        except OSError:
            with contextlib.suppress(OSError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, descriptor)
                os.close(nowhere)
