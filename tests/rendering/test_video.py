"""Videos, pictures and strips, drawn for real where there is an OpenGL."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.players import flat, still_player
from ogmp_sb3.config.load import load_task
from ogmp_sb3.rendering import video
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.video import FORMATS

Image = pytest.importorskip("PIL.Image", reason="drawing needs the extra 'viewer'")


def play(player: Player, steps: int) -> list[Frame]:
    return [player.frame, *(player.step() for _ in range(steps))]


def orange(picture: np.ndarray) -> int:
    """Pixels with the accent colour of the robot."""
    red, green, blue = np.moveaxis(np.asarray(picture).astype(int), -1, 0)
    return int(((red > 1.4 * green) & (green > 1.5 * blue) & (red > 120)).sum())


def blue(picture: np.ndarray) -> int:
    """Pixels with the colour of the ghost; the sky is paler."""
    picture = np.asarray(picture).astype(int)
    return int((picture[..., 2] - picture[..., 0] > 90).sum())


def tiles(strip: Path) -> list[np.ndarray]:
    picture = np.asarray(Image.open(strip).convert("RGB"))
    height, width = FORMATS[".png"].height, FORMATS[".png"].width
    rows, columns = picture.shape[0] // height, picture.shape[1] // width
    return [
        picture[row * height : (row + 1) * height, column * width : (column + 1) * width]
        for row in range(rows)
        for column in range(columns)
    ]


def test_a_strip_shows_robot_ghost_and_ground_and_the_robot_moves(opengl, tmp_path: Path) -> None:
    task = flat()
    video.write_video(play(still_player(task), 11), task, tmp_path / "strip.png")
    pictures = tiles(tmp_path / "strip.png")
    assert len(pictures) == 12
    assert all(orange(picture) > 50 for picture in pictures[4:])  # at first the ghost stands where the robot does
    for picture in pictures:
        ground = picture[-20:].reshape(-1, 3).astype(int)
        assert np.median(ground[:, 0] - ground[:, 2]) > 0  # the ground is warm, the sky is not
        sky = picture[60:80].reshape(-1, 3).astype(int)
        assert np.median(sky[:, 2] - sky[:, 0]) > 20
    assert blue(pictures[8]) > 200
    changed = np.abs(pictures[1].astype(int) - pictures[8])[60:].max(axis=-1) > 40
    assert 0.005 < changed.mean() < 0.5


def test_the_oracle_alone_is_a_ghost_without_a_robot(opengl, tmp_path: Path) -> None:
    task = load_task("dive")
    video.write_video(play(Player(task, None), 11), task, tmp_path / "strip.png")
    for picture in tiles(tmp_path / "strip.png"):
        assert orange(picture) < 10
        assert blue(picture) > 200


def test_a_block_is_drawn_where_it_is(opengl, tmp_path: Path) -> None:
    task = load_task("parkour")
    player = Player(task, None)
    frame = player.frame
    level = np.array([(-5.0, 5.0, -1.0, 1.0, 0.0)])
    block = np.array([(-5.0, 0.4, -1.0, 1.0, 0.0), (0.4, 0.8, -1.0, 1.0, 0.3), (0.8, 5.0, -1.0, 1.0, 0.0)])
    frames = [replace(frame, terrain=level, time=0.0), replace(frame, terrain=block, time=0.0)]
    video.write_video(frames, task, tmp_path / "strip.png")
    without, with_block = (picture.astype(int) for picture in tiles(tmp_path / "strip.png"))
    changed = np.abs(without - with_block).max(axis=-1) > 25
    width = changed.shape[1]
    assert changed[:, width // 2 :].sum() > 2000
    assert changed[:, : width // 4].sum() < 100


def test_a_gif_has_every_other_step_at_true_speed(opengl, tmp_path: Path) -> None:
    task = flat()
    video.write_video(play(still_player(task), 6), task, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.size) == (4, (FORMATS[".gif"].width, FORMATS[".gif"].height))
        assert gif.info["duration"] == 60
        assert gif.info["loop"] == 0
        gif.seek(3)
        assert orange(gif.convert("RGB")) > 20


def test_an_mp4_has_every_step_at_true_speed(opengl, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="mp4 needs the extra 'viewer'")
    task = flat()
    video.write_video(play(still_player(task), 6), task, tmp_path / "new" / "a.mp4")
    reader = ffmpeg.read_frames(str(tmp_path / "new" / "a.mp4"))
    meta = next(reader)
    pictures = [np.frombuffer(data, np.uint8).reshape(*meta["size"][::-1], 3) for data in reader]
    assert meta["size"] == (FORMATS[".mp4"].width, FORMATS[".mp4"].height)
    assert meta["fps"] == pytest.approx(1 / 0.03, rel=0.01)
    assert len(pictures) == 7
    assert orange(pictures[-1]) > 100


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must end in \.mp4, \.gif, \.png; found 'a\.avi'"):
        video.check_suffix(Path("a.avi"))


def test_every_frame_shows_all_the_ground_of_its_episode_and_none_of_others() -> None:
    a, b, c = (0.0, 1.0, -1.0, 1.0, 0.0), (1.0, 2.0, -1.0, 1.0, 0.2), (1.0, 3.0, -1.0, 1.0, -0.5)
    frame = Player(load_task("parkour"), None).frame
    boxes_and_times = [([a], 0.0), ([a, b], 0.03), ([b], 0.06), ([c], 0.0)]
    frames = [replace(frame, terrain=np.array(boxes), time=time) for boxes, time in boxes_and_times]
    np.testing.assert_array_equal(video.begins(frames), [True, False, False, True])
    terrain = video.whole_terrain(frames)
    for ground in terrain[:3]:
        np.testing.assert_array_equal(ground, [a, b])
    np.testing.assert_array_equal(terrain[3], [c])
