"""The record button of the viewer: what is played becomes a video that the browser downloads."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.opengl import gl_library
from ogmp_sb3.rendering.video import write_video

LONGEST = 60.0  # s of what is kept: the last ones
NAME = "ogmp-play.mp4"


class Recorder:
    """Keeps frames from its start to its stop, and draws them then, in a thread of its own.

    :param send: called with the name and the bytes of a video
    :param say: called with a sentence on how it goes
    """

    def __init__(self, send: Callable[[str, bytes], object], say: Callable[[str], object]) -> None:
        self._send, self._say = send, say
        self._frames: list[Frame] | None = None
        self.drawing: threading.Thread | None = None

    @property
    def records(self) -> bool:
        """Whether it keeps frames now."""
        return self._frames is not None

    def start(self) -> None:
        """Keep frames from now on.

        :raises ValueError: if they could not be drawn here
        """
        gl_library()
        self._frames = []
        self._say("recording")

    def keep(self, frame: Frame, task: TaskConfig) -> None:
        """Take in a control step, if it records."""
        if self._frames is not None:
            self._frames.append(frame)
            del self._frames[: -round(LONGEST / task.control_dt)]

    def stop(self, task: TaskConfig) -> None:
        """Draw what was kept, and send it; the play goes on meanwhile."""
        frames, self._frames = self._frames, None
        if frames:
            self.drawing = threading.Thread(target=self._draw, args=(frames, task), daemon=True)
            self.drawing.start()

    def _draw(self, frames: list[Frame], task: TaskConfig) -> None:
        drawn = 0

        def progress(pictures: int) -> None:
            nonlocal drawn
            drawn += pictures
            self._say(f"drawing picture {drawn} of {len(frames)}")

        try:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / NAME
                write_video(frames, task, path, progress)
                self._send(NAME, path.read_bytes())
            self._say("the video is sent to the browser")
        except (OSError, ValueError) as error:
            self._say(f"no video: {error}")
