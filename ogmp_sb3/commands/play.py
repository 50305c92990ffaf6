"""``ogmp-play``: watch a policy, or the oracle alone, in a browser, as a video or as a page to keep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.named_run import RUN, named_run
from ogmp_sb3.config.catalogue import find
from ogmp_sb3.config.scenes import SHOWN, task_for_test
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.task_files import read_task
from ogmp_sb3.env.agent import Policy
from ogmp_sb3.evaluation.recording import RECORDED, oracle_episodes, record_chosen
from ogmp_sb3.machine import check_writable
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.opengl import gl_library
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.video import check_suffix, picture_count, write_video
from ogmp_sb3.rendering.viewer import Performer, Viewer
from ogmp_sb3.report.replay import INDEX, check_folder, write_replay
from ogmp_sb3.runs.callbacks import progress_bar, steps_bar
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import BEST, CONFIG, checkpoint_dirs

PROGRAM = "ogmp-play"
SECONDS, EPISODES = 12.0, 20  # defaults
LATEST = "latest"
MOST_ROBOTS = 16


@dataclass(frozen=True, kw_only=True)
class PlayConfig:
    """Keys of the command line."""

    run: str | None = cli.option(f"{RUN}; a,b: several, side by side in the browser", None)
    task: str | None = cli.option("instead of a run, a task: only its oracle plays; or that of an SB3 .zip", None)
    scene: str | None = cli.option("modes to command, a shipped scene or a YAML file; null: the task's own", None)
    seed: int = cli.option("of the modes that are drawn", 0)
    robots: int = cli.option("how many play side by side in the browser, with seeds from 'seed' on", 1)
    host: str = cli.option("address the viewer listens on; 0.0.0.0: the whole network can play", "127.0.0.1")
    port: int = cli.option("port of the viewer", 8080)
    video: str | None = cli.option("file to write instead: .mp4, .gif, or .png for a strip of pictures", None)
    seconds: float | None = cli.option(f"length of the video, or of the oracle's page, s; null: {SECONDS:g}", None)
    web: str | None = cli.option("directory to write a page into instead, which replays test episodes in 3-D", None)
    episodes: int | None = cli.option(f"test episodes that the page's are chosen from; null: {EPISODES}", None)
    robot: str | None = cli.option(cli.ROBOT, None)
    trust: bool = cli.option(cli.TRUST, False)

    def __post_init__(self) -> None:
        of_zip = self.run is not None and Path(self.run).is_file()
        if (self.run is None) == (self.task is None) and not of_zip:
            raise ValueError("give either 'run' (a policy) or 'task' (its oracle alone).")
        if not 1 <= self.robots <= MOST_ROBOTS:
            raise ValueError(f"'robots' must be from 1 to {MOST_ROBOTS}, found {self.robots}.")
        side_by_side = self.robots > 1 or len(self.runs) > 1
        if side_by_side and (self.video is not None or self.web is not None):
            raise ValueError("several robots are for the browser: give one of them for 'video' and 'web'.")
        if self.robots > 1 and len(self.runs) > 1:
            raise ValueError("give either 'robots' of one policy, or several policies.")
        if self.seed < 0:
            raise ValueError(f"'seed' must be at least 0, found {self.seed}.")
        if self.seconds is not None and self.seconds <= 0:
            raise ValueError(f"'seconds' must be above 0, found {self.seconds:g}.")
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"'episodes' must be at least 1, found {self.episodes}.")
        if self.video is not None and self.web is not None:
            raise ValueError("give either 'video' (a file) or 'web' (a directory for a page).")
        if self.episodes is not None and (self.web is None or self.run is None):
            raise ValueError("'episodes' is for a page of a policy: give 'run' and 'web' too.")
        if self.seconds is not None and self.web is not None and self.run is not None:
            raise ValueError(
                "a page of a policy shows whole test episodes: give evaluation.episode_steps=<control steps> in place "
                "of 'seconds'."
            )
        if not 0 <= self.port < 65536:
            raise ValueError(f"'port' must be from 0 to 65535, found {self.port}.")

    @property
    def runs(self) -> tuple[str, ...]:
        """The policies that play: one, but for a list with commas that is no name of a directory or file itself."""
        if self.run is None:
            return ()
        if Path(self.run).exists():
            return (self.run,)
        return tuple(name.strip() for name in self.run.split(",") if name.strip())


HELP = cli.usage(
    PROGRAM,
    "watch a policy, or a task's oracle, in a browser, as a video or as a page to keep.",
    [
        "ogmp-play run=runs/parkour/2026-01-31_12-00-00",
        "ogmp-play run=parkour scene=pace_to_jump oracle=lqr",
        "ogmp-play run=parkour modes.jump.h=[0.35,0.4]",
        "ogmp-play run=parkour robots=4",
        "ogmp-play run=parkour,runs/parkour/2026-01-31_12-00-00",
        "ogmp-play task=dive",
        "ogmp-play run=parkour video=parkour.mp4 seconds=20",
        "ogmp-play run=parkour video=strip.png seconds=3",
        "ogmp-play run=parkour web=replay",
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
    used = (
        ("rho",) if config.web is not None and policy is not None else SHOWN
    )  # test tracks have a length of their own
    return task_for_test(data, path, overrides, config.scene, PROGRAM, used), policy


def _run(arguments: list[str]) -> None:
    config, overrides = cli.parse(PlayConfig, arguments, PROGRAM, cli.task_keys(TaskConfig))
    runs = [named_run(PROGRAM, run) for run in config.runs]  # the same ones for as long as they play
    if len(runs) == 1:
        config = replace(config, run=runs[0])
    if config.web is not None:
        path = _write_page(config, overrides, Path(config.web))
    elif config.video is not None:
        path = _write_video(config, overrides, Path(config.video))
    else:
        cli.require("viewer", "viser")
        policies = partial(_policies, runs)
        Viewer(partial(_cast, config, runs), config.host, config.port, overrides, config.seed, policies).run()
        return
    cli.console().print(str(path))


def _player(config: PlayConfig, overrides: list[str]) -> Player:
    return Player(*load(config, overrides), config.seed)


def _cast(config: PlayConfig, runs: list[str], overrides: list[str], policy: str) -> list[Performer]:
    """Who plays in the viewer: the policies of several runs on the same track, or robots of one on tracks of their own.

    :param runs: none: the oracle alone
    :param policy: of the one run, one of :func:`_policies`; empty: the run says it itself
    """
    if len(runs) > 1:
        loaded = [(name, load(replace(config, run=name), overrides)) for name in runs]
        return [Performer(Player(*each, config.seed), name) for name, each in loaded]
    run = config.run if policy in ("", LATEST) else f"{config.run}/{policy}"
    each = load(replace(config, run=run), overrides)
    return [Performer(Player(*each, config.seed + i), f"robot {i + 1}", i) for i in range(config.robots)]


def _policies(runs: list[str]) -> list[str]:
    """The policies of a run to choose from: the latest, its checkpoints from the newest on, and the best.

    :param runs: what was given; there is no choice but of one run directory
    """
    if len(runs) != 1 or not (Path(runs[0]) / CONFIG).is_file():
        return []
    folder = Path(runs[0])
    checkpoints = [str(path.relative_to(folder)) for path in reversed(checkpoint_dirs(folder))]
    return [LATEST, *checkpoints, *([BEST] if (folder / BEST).is_dir() else [])]


def _played(player: Player, seconds: float | None) -> list[Frame]:
    """The frames of some time, the first one included."""
    steps = max(1, round((SECONDS if seconds is None else seconds) / player.task.control_dt))
    return [player.frame, *(player.step() for _ in range(steps))]


def _write_video(config: PlayConfig, overrides: list[str], path: Path) -> Path:
    check_suffix(path)
    cli.require("viewer", "PIL", "imageio_ffmpeg")
    player = _player(config, overrides)
    _check_file(path)
    gl_library()  # before a long play
    frames = _played(player, config.seconds)
    with progress_bar(picture_count(len(frames), path), "picture") as bar:
        write_video(frames, player.task, path, bar.update)
    return path


def _write_page(config: PlayConfig, overrides: list[str], folder: Path) -> Path:
    """The page of a policy's test episodes, or of the oracle's way."""
    check_folder(folder)
    task, policy = load(config, overrides)
    cli.check_out(folder, "web")
    page = folder / INDEX
    what = [f"{task.oracle} oracle", "no bound" if task.rho is None else f"rho {task.rho:g}"]
    what += [f"scene {config.scene}"] if config.scene else []
    if policy is None:
        episodes = oracle_episodes(_played(Player(task, None, config.seed), config.seconds), config.seed)
        write_replay(page, task, episodes, f"{task.name}: the oracle alone", ", ".join(what))
        return page
    tested, count = task.for_evaluation(), config.episodes or EPISODES
    with steps_bar((count + RECORDED) * tested.episode_steps) as bar:
        episodes = record_chosen(policy, tested, count, config.seed, bar.update)
        bar.update(bar.total - bar.n)  # fewer may have been chosen
    chosen = f"{len(episodes)} of {count} test episodes, chosen by return"
    write_replay(page, task, episodes, task.name, ", ".join([f"run {config.run}", *what, chosen]))
    return page


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
