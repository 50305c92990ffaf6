"""A page that replays recorded episodes in 3-D. It opens from disk, and loads nothing."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from pathlib import Path

from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.rendering.replay import RecordedEpisode, replay_data
from ogmp_sb3.report.page import template
from ogmp_sb3.runs.atomic import replacing

MOST_BYTES = 25_000_000  # of a page: more would open slowly, and is refused by mail servers and forges
INDEX = "index.html"  # the page in a directory of its own
MARK = '<meta name="generator" content="ogmp_sb3 replay">'


def write_replay(
    path: Path, task: TaskConfig, episodes: Sequence[RecordedEpisode], title: str, subtitle: str = ""
) -> None:
    """Write the page, all or nothing.

    :param path: of the page, ``.html``; its directory is made
    :param task: the task as in training; its bound is shown
    :param episodes: what can be chosen, in order (:func:`~ogmp_sb3.evaluation.recording.record_chosen`)
    :param title: above the page
    :param subtitle: below the title
    :raises ValueError: if the page would be larger than :data:`MOST_BYTES`, or a geom of the robot cannot be drawn
    """
    page = replay_page(task, episodes, title, subtitle)
    size = len(page.encode("utf-8"))
    if size > MOST_BYTES:
        longest = max(len(episode.frames) for episode in episodes) - 1
        raise ValueError(
            f"'{path}' would be of {size / 1e6:.1f} MB, and a replay may be of {MOST_BYTES / 1e6:.1f} MB at most: "
            f"show fewer or shorter episodes (found {len(episodes)}, of up to {longest} control steps)."
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write_text(page, encoding="utf-8")


def replay_page(task: TaskConfig, episodes: Sequence[RecordedEpisode], title: str, subtitle: str = "") -> str:
    """The page as text; another page can show it in a frame, by ``<iframe srcdoc>`` or from a file beside it.

    The parameters are those of :func:`write_replay`.
    """
    data, arrays = replay_data(task, episodes)
    recording = base64.b64encode(zlib.compress(arrays, 9)).decode("ascii")
    return template("replay.html").render(title=title, subtitle=subtitle, data=data, recording=recording, mark=MARK)


def check_folder(folder: Path) -> None:
    """Check that a replay may be written into a directory.

    :raises ValueError: if it is a file, or holds other things but no replay
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ValueError(f"'{folder}' is a file, and a replay needs a directory.")
    page = folder / INDEX
    others = sorted(entry.name for entry in folder.iterdir())
    if page.is_file():
        others = [] if MARK in page.read_text(encoding="utf-8", errors="replace")[:2000] else [INDEX]
    if others:
        raise ValueError(f"'{folder}' holds '{others[0]}', which is no replay: give a new or an empty directory.")
