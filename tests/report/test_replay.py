"""The page of a replay, without a browser."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.players import flat, still_player
from ogmp_sb3.rendering.replay import RecordedEpisode, replay_data
from ogmp_sb3.report import replay
from ogmp_sb3.report.replay import check_folder, replay_page, write_replay

TASK = flat()


@pytest.fixture(scope="module")
def episode() -> RecordedEpisode:
    player = still_player(TASK)
    return RecordedEpisode(name="best", detail="seed 0", frames=[player.frame, *(player.step() for _ in range(5))])


def inside(page: str, name: str) -> str:
    return re.search(rf'<script type="[a-z/]+" id="{name}">(.*?)</script>', page, re.DOTALL).group(1)


def test_the_page_holds_the_recording_and_names_no_other_place(episode: RecordedEpisode) -> None:
    page = replay_page(TASK, [episode], "parkour", "a <b>")
    data, arrays = replay_data(TASK, [episode])
    assert json.loads(inside(page, "data")) == data
    assert zlib.decompress(base64.b64decode(inside(page, "recording"))) == arrays
    assert "a &lt;b&gt;" in page
    assert "://" not in page
    assert not re.search(r"\b(src|href)=|@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|\bimport\b", page)
    assert "default-src 'none'" in page


def test_what_modes_are_called_cannot_end_a_script(episode: RecordedEpisode) -> None:
    frames = [replace(frame, mode="</script><b>") for frame in episode.frames]
    page = replay_page(TASK, [replace(episode, frames=frames)], "</title>")
    assert json.loads(inside(page, "data"))["episodes"][0]["modes"][0]["text"] == "</script><b>"
    assert page.count("</script>") == 3 and page.count("</title>") == 1


def test_episodes_are_chosen_by_name_if_there_are_several(episode: RecordedEpisode) -> None:
    page = replay_page(TASK, [episode, replace(episode, name="worst, a fall")], "parkour")
    assert re.findall(r'<button role="tab">(.*?)</button>', page) == ["Best", "Worst, a fall"]
    assert 'aria-label="Episodes">' in page
    assert 'aria-label="Episodes" hidden>' in replay_page(TASK, [episode], "parkour")


def test_a_page_that_would_be_too_large_is_one_sentence_and_no_file(
    episode: RecordedEpisode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_replay(tmp_path / "a" / "page.html", TASK, [episode], "parkour")
    size = (tmp_path / "a" / "page.html").stat().st_size
    assert 30_000 < size < 200_000
    monkeypatch.setattr(replay, "MOST_BYTES", size - 1)
    with pytest.raises(ValueError, match=r"large\.html' would be .* MB .*fewer or shorter .*1, of up to 5 control"):
        write_replay(tmp_path / "large.html", TASK, [episode], "parkour")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_new_an_empty_and_a_replay_s_own_directory_can_be_written(episode: RecordedEpisode, tmp_path: Path) -> None:
    check_folder(tmp_path / "new")
    check_folder(tmp_path)
    write_replay(tmp_path / "index.html", TASK, [episode], "parkour")
    (tmp_path / "CNAME").write_text("a page of one's own beside it")
    check_folder(tmp_path)


def test_a_file_and_a_directory_of_other_things_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file' is a file, and a replay needs a directory"):
        check_folder(tmp_path / "file")
    with pytest.raises(ValueError, match="holds 'file', which is no replay"):
        check_folder(tmp_path)
    (tmp_path / "index.html").write_text("<html>another page</html>")
    with pytest.raises(ValueError, match=r"holds 'index\.html', which is no replay"):
        check_folder(tmp_path)
