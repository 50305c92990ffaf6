"""``ogmp-play``: watch a policy, or the oracle alone, in a browser or as a video."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.named_run import RUN, named_run
from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.scenes import SHOWN, task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import read_task
from ogmp_sb3.env.agent import Policy
from ogmp_sb3.machine import check_writable
from ogmp_sb3.rendering.opengl import gl_library
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.video import check_suffix, picture_count, write_video
from ogmp_sb3.rendering.viewer import Viewer
from ogmp_sb3.runs.callbacks import progress_bar
from ogmp_sb3.runs.policies import load_policy

PROGRAM = "ogmp-play"


@dataclass(frozen=True, kw_only=True)
class PlayConfig:
    """Keys of the command line."""

    run: str | None = cli.option(RUN, None)
    task: str | None = cli.option("instead of a run, a task: only its oracle plays; or that of an SB3 .zip", None)
    scene: str | None = cli.option("modes to command, a shipped scene or a YAML file; null: the task's own", None)
    seed: int = cli.option("of the modes that are drawn", 0)
    host: str = cli.option("address the viewer listens on; 0.0.0.0: the whole network can play", "127.0.0.1")
    port: int = cli.option("port of the viewer", 8080)
    video: str | None = cli.option("file to write instead: .mp4, .gif, or .png for a strip of pictures", None)
    seconds: float = cli.option("length of the video, s", 12.0)
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)

    def __post_init__(self) -> None:
        of_zip = self.run is not None and Path(self.run).is_file()
        if (self.run is None) == (self.task is None) and not of_zip:
            raise ValueError("give either 'run' (a policy) or 'task' (its oracle alone).")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")
        if self.seconds <= 0:
            raise ValueError(f"'seconds' must be above 0, found {self.seconds:g}.")
        if not 0 <= self.port < 65536:
            raise ValueError(f"'port' must be from 0 to 65535, found {self.port}.")


HELP = cli.usage(
    PROGRAM,
    "watch a policy, or a task's oracle, in a browser or as a video.",
    [
        "ogmp-play run=runs/parkour/2026-01-31_12-00-00",
        "ogmp-play run=parkour scene=pace_to_jump oracle=lqr",
        "ogmp-play run=parkour modes.jump.h=[0.35,0.4]",
        "ogmp-play task=dive",
        "ogmp-play run=parkour video=parkour.mp4 seconds=20",
        "ogmp-play run=parkour video=strip.png seconds=3",
    ],
    PlayConfig,
    "any other key of the task file, e.g. modes.leap.w=0.5",
)


def load(config: PlayConfig, overrides: list[str]) -> tuple[TaskConfig, Policy | None]:
    """The task with the user's changes, and the policy if there is one.

    :raises KeyError: for an unknown policy, task, scene or key
    :raises ValueError: for a file that cannot be read, or a value that is out of range
    """
    policy = None
    if config.run is not None:
        loaded = load_policy(config.run, config.trust, config.task, config.robot)
        policy, data, path = loaded.policy, loaded.task_data, loaded.task_path
    else:
        assert config.task is not None
        path = find("task", config.task)
        data = read_task(path)
        overrides = [*overrides, *([f"robot={config.robot}"] if config.robot else [])]
    return task_for_test(data, path, overrides, config.scene, PROGRAM, SHOWN), policy


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(PlayConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    path = None if config.video is None else Path(config.video)
    if path is not None:
        check_suffix(path)
    cli.require("viewer", *(("viser",) if path is None else ("PIL", "imageio_ffmpeg")))
    if config.run is not None:  # the same one for as long as it plays
        config = replace(config, run=named_run(PROGRAM, config.run))

    def load_player(overrides: list[str]) -> Player:
        return Player(*load(config, overrides), config.seed)

    if path is None:
        Viewer(load_player, config.host, config.port, overrides, config.seed).run()
        return
    player = load_player(overrides)
    _check_file(path)
    gl_library()  # before a long play
    steps = max(1, round(config.seconds / player.task.control_dt))
    frames = [player.frame, *(player.step() for _ in range(steps))]
    with progress_bar(picture_count(len(frames), path), "picture") as bar:
        write_video(frames, player.task, path, bar.update)
    cli.console().print(str(path))


def _check_file(path: Path) -> None:
    """:raises OSError: if a file cannot be written, before any work is done for it"""
    check_writable(path.parent)
    if path.exists():
        with path.open("ab"):
            pass


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
