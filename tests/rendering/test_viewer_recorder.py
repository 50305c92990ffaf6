"""The record button of the viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.rendering import viewer_recorder as module
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.viewer_recorder import NAME, Recorder

PLAYER = Player(load_task("parkour"), None)


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    """One whose videos are the number of their frames."""

    def write(frames: list[Any], task: Any, path: Path, progress: Any) -> None:
        progress(len(frames))
        path.write_bytes(bytes(str(len(frames)), "ascii"))

    monkeypatch.setattr(module, "gl_library", lambda: "none")
    monkeypatch.setattr(module, "write_video", write)
    recorder = Recorder(lambda name, content: sent.append((name, content)), said.append)
    sent.clear(), said.clear()
    return recorder


sent: list[tuple[str, bytes]] = []
said: list[str] = []


def finish(recorder: Recorder) -> None:
    recorder.stop(PLAYER.task)
    if recorder.drawing is not None:
        recorder.drawing.join(30)


def test_what_is_played_between_start_and_stop_is_sent(recorder: Recorder) -> None:
    recorder.keep(PLAYER.frame, PLAYER.task)
    recorder.start()
    assert recorder.records
    for _ in range(3):
        recorder.keep(PLAYER.frame, PLAYER.task)
    finish(recorder)
    recorder.keep(PLAYER.frame, PLAYER.task)
    assert not recorder.records and sent == [(NAME, b"3")]
    assert said == ["recording", "drawing picture 3 of 3", "the video is sent to the browser"]


def test_of_a_long_time_the_last_part_is_kept(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LONGEST", 0.3)  # ten control steps
    recorder.start()
    for _ in range(25):
        recorder.keep(PLAYER.frame, PLAYER.task)
    finish(recorder)
    assert sent == [(NAME, b"10")]


def test_nothing_is_sent_of_nothing(recorder: Recorder) -> None:
    finish(recorder)
    recorder.start()
    finish(recorder)
    assert sent == [] and recorder.drawing is None


def test_a_video_that_cannot_be_drawn_is_a_sentence(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise ValueError("no room")

    monkeypatch.setattr(module, "write_video", fail)
    recorder.start()
    recorder.keep(PLAYER.frame, PLAYER.task)
    finish(recorder)
    assert said[-1] == "no video: no room" and sent == []


def test_without_opengl_it_does_not_begin(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> str:
        raise ValueError("no OpenGL")

    monkeypatch.setattr(module, "gl_library", missing)
    with pytest.raises(ValueError, match="no OpenGL"):
        recorder.start()
    assert not recorder.records
