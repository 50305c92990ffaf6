"""The browser viewer: a loop that plays at a chosen speed, and the controls beside the scene."""

from __future__ import annotations

import logging
import shlex
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from queue import SimpleQueue

import mujoco
import numpy as np

from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.viewer_controls import PUSHES, Controls
from ogmp_sb3.rendering.viewer_recorder import Recorder
from ogmp_sb3.rendering.viewer_scene import Moment, Stage
from ogmp_sb3.rendering.viewer_settings import Settings

FRAME_TIME = 1 / 30  # s between two updates of the scene
PLOT_EVERY = 4  # updates of the scene between two of the plots
PACE_TIME = 1.0  # s that the pace is measured over
LOOK_EVERY = 2.0  # s between two looks for a new checkpoint
NO_POLICIES: tuple[str, ...] = ()


@dataclass(frozen=True)
class Performer:
    """A player on the stage."""

    player: Player
    """plays"""
    name: str = ""
    """stands over the robot where there are several"""
    later: int = 0
    """added to the seed of a reset"""


class Viewer:
    """Plays in a browser. What visitors ask for is queued, and done between two steps by the thread that plays.

    :param load: makes the players of a task with overrides (``["rho=0.3"]``) and of one of the policies; of several,
        the first is followed, and has the plots
    :param host: address to listen on
    :param port: the next free one is taken if it is in use
    :param overrides: the first ones
    :param seed: first value of the control that a reset reads
    :param policies: gives the names of the policies to choose from, the one that plays first, then the newest; none:
        there is no choice
    """

    def __init__(
        self,
        load: Callable[[list[str], str], list[Performer]],
        host: str,
        port: int,
        overrides: Iterable[str] = (),
        seed: int = 0,
        policies: Callable[[], Sequence[str]] = lambda: NO_POLICIES,
    ) -> None:
        import viser

        overrides = list(overrides)
        self.settings = Settings(seed=seed, policy=next(iter(policies()), ""))
        cast = load(overrides, self.settings.policy)
        # Browsers open connections that they do not use; each would be logged as an error.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        self._load, self._policies = load, policies
        self.server = viser.ViserServer(host=host, port=port, label="ogmp-play", verbose=False)
        self.server.on_client_connect(lambda client: self.stage.welcome(client))
        self._asked: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self.recorder = Recorder(self.server.send_file_download, lambda text: self.controls.say(text))
        self._open(cast, shlex.join(overrides))

    @property
    def player(self) -> Player:
        """The first player."""
        return self.cast[0].player

    @property
    def players(self) -> list[Player]:
        """All of them."""
        return [performer.player for performer in self.cast]

    def _open(self, cast: list[Performer], overrides: str) -> None:
        """Set the scene and the controls anew.

        :param cast: who plays from now on
        :param overrides: of their task, as on a command line
        """
        self.cast, self.overrides = cast, overrides
        self.server.scene.reset()
        self.server.gui.reset()
        named = [(performer.player.task, performer.name) for performer in cast]
        self.stage = Stage(self.server, named, self.player.frame, self.settings)
        # Those before the present ones, to move smoothly between the two.
        self._before = [player.frame for player in self.players]
        self._share = 1.0  # of the control step between them that has passed
        self._updates, self._message = 0, ""
        self._wall = self._played = self.pace = 0.0
        self.policies = tuple(self._policies())
        self._looked = time.monotonic()
        self.controls = Controls(self)
        self._plots = self.controls.plots
        self.show()

    def run(self) -> None:
        """Play until interrupted."""
        last = time.monotonic()
        while True:
            now = time.monotonic()
            self.advance(now - last)
            last = now
            time.sleep(max(0.0, FRAME_TIME - (time.monotonic() - now)))

    def advance(self, seconds: float) -> None:
        """Do what was asked, play on for some time, and bring the page up to date.

        :param seconds: by the clock on the wall
        """
        while not self._asked.empty():
            self._try(self._asked.get())
        if self.settings.newest and time.monotonic() - self._looked > LOOK_EVERY:
            self._take_newest()
        if not self.settings.paused:
            # A machine that is too slow plays slower, rather than ever further behind.
            period = self.player.task.control_dt
            self._share += min(seconds, 3 * FRAME_TIME) * self.settings.speed / period
            while self._share > 1.0:
                self.step()
                self._share -= 1.0
                self._played += period
        self._measure_pace(seconds)
        self.show()

    def step(self) -> None:
        """One control step of every player."""
        self._before = [player.frame for player in self.players]
        for player in self.players:
            self._try(player.step)
        frame = self.player.frame
        if self._plots is not None:
            self._plots.keep(frame)
        self.recorder.keep(frame, self.player.task)
        if frame.ended:
            self._message = f"{frame.ended} at {frame.time:.1f} s, {frame.base[0]:.1f} m"

    def _try(self, action: Callable[[], object]) -> None:
        """Do something; if a command makes it impossible, say so on the page and begin anew without commands."""
        try:
            action()
        except (ValueError, KeyError) as error:
            self._message = str(error.args[0])
            for player in self.players:
                player.env.guide.forget_commands(0)
                player.reset()

    def _measure_pace(self, seconds: float) -> None:
        self._wall += seconds
        if self._wall > PACE_TIME:
            self.pace = self._played / self._wall
            self._wall = self._played = 0.0

    def show(self) -> None:
        """Bring the page up to date."""
        lanes = zip(self.stage.lanes, self.players, self._before, strict=True)
        self.stage.show([self._moment(lane.robot.model, player, before) for lane, player, before in lanes])
        self._updates += 1
        if self._updates % PLOT_EVERY == 1:
            self.controls.status.content = self._described(self.player.frame)
            if self._plots is not None:
                self._plots.show()

    def _moment(self, model: mujoco.MjModel, player: Player, before: Frame) -> Moment:
        """Where a robot is now, on its way from one frame to the next."""

        def between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
            result = start.copy()
            if len(start):
                difference = np.zeros(model.nv)
                mujoco.mj_differentiatePos(model, difference, 1.0, start, end)
                mujoco.mj_integratePos(model, result, difference, self._share)
            return result

        frame = player.frame
        before = before if before.time < frame.time else frame
        contacts = player.contacts() if self.settings.contacts else None
        return Moment(frame, between(before.robot, frame.robot), between(before.ghost, frame.ghost), contacts)

    def _described(self, frame: Frame) -> str:
        mode, _, parameters = frame.mode.partition(" ")
        lines = [
            f"**{mode}** {parameters}",
            f"{frame.time:.1f} s, {frame.base[0]:.1f} m, {frame.speed:.2f} m/s",
            f"Last episode: {self._message or 'none'}",
            f"{self.pace:.2f} of real time",
        ]
        if self.player.policy is not None:
            lines.insert(2, f"reward {frame.reward:.2f}, deviation {frame.deviation:.2f}")
        return "  \n".join(lines)

    # ------------------------------------------------------------------ what visitors ask for

    def ask(self, action: Callable[[], object]) -> None:
        """Have something done between two steps."""
        self._asked.put(action)

    def single_step(self) -> None:
        """One control step, shown at once."""
        self.step()
        self._share = 1.0

    def reset(self) -> None:
        """Begin anew with the seed that is set."""
        for performer in self.cast:
            performer.player.reset(int(self.settings.seed) + performer.later)

    def push(self, direction: str) -> None:
        """Change the velocity of every robot at once."""
        x, y = PUSHES[direction]
        for player in self.players:
            player.push((self.settings.push * x, self.settings.push * y))

    def command(self, mode: str, **parameters: float | str) -> None:
        """Have every robot go on with a mode."""
        for player in self.players:
            player.command(mode, **parameters)

    def begin_with(self, overrides: str) -> None:
        """Begin anew with overrides of the task, or say what is wrong with them."""
        try:
            cast = self._load(shlex.split(overrides), self.settings.policy)
        except (ValueError, KeyError, TypeError) as error:
            self.controls.complain(str(error.args[0]))
            return
        if self.recorder.records:
            self.recorder.stop(self.player.task)
        self._open(cast, overrides)

    def choose(self, policy: str) -> None:
        """Begin anew with another policy of the run."""
        self.settings.policy = policy
        self.begin_with(self.overrides)

    def record(self) -> None:
        """Begin a video, or end it."""
        if self.recorder.records:
            self.recorder.stop(self.player.task)
            return
        try:
            self.recorder.start()
        except ValueError as error:
            self.controls.say(str(error))

    def _take_newest(self) -> None:
        """Go on with a checkpoint that was not there before."""
        self._looked = time.monotonic()
        names = tuple(self._policies())
        if names != self.policies and len(names) > 1:
            self.choose(names[1])
