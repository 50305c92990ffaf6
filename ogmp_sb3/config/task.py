"""What a task file says, as frozen, validated dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ogmp_sb3.config.messages import Where, describe
from ogmp_sb3.config.ranges import ModeRanges, Range
from ogmp_sb3.config.robot import STATE_NAMES, RobotConfig
from ogmp_sb3.config.strict import all_different, not_negative, positive, read
from ogmp_sb3.config.variation import CurriculumConfig, InitialConfig, RestartConfig

MAX_SUBSTEPS = 10_000  # physics steps per control step; more is a slip of the pen, as are more of the next two
MAX_HORIZON = 10_000  # control steps between queries
MAX_BOXES = 1_000  # terrain boxes of each simulation


@dataclass(frozen=True)
class SequenceEntry:
    """One place in a sequence of modes."""

    mode: str
    """name of the mode"""
    ranges: dict[str, Range] = field(default_factory=dict)
    """its parameters here, where they differ from the task's"""

    @classmethod
    def from_data(cls, data: Any, where: Where) -> SequenceEntry:
        """Read ``jump`` or ``{jump: {h: 0.1}}``."""
        if isinstance(data, str):
            return cls(data)
        if not isinstance(data, Mapping) or len(data) != 1:
            raise TypeError(f"{where} must be a mode, or one mode with parameters, found {describe(data)}.")
        ((mode, ranges),) = data.items()
        return cls(str(mode), read(dict[str, Range], {} if ranges is None else ranges, where / mode))


@dataclass(frozen=True, kw_only=True)
class SamplingConfig:
    """How a task variant is drawn from the modes, Psi_T = Psi_M^N."""

    order: Literal["random", "sequence"] = "random"
    """``random``: modes follow each other at random, without end; ``sequence``: in the given order"""
    weights: dict[str, float] = field(default_factory=dict)
    """random: relative frequency of each mode (1 if not given)"""
    sequence: tuple[SequenceEntry, ...] = ()
    """sequence: the modes in order, with parameters of their own if need be (``{jump: {h: 0.1}}``)"""
    repeat: Literal["all", "last"] = "last"
    """sequence: what comes after its end"""

    def __post_init__(self) -> None:
        if self.order == "sequence" and not self.sequence:
            raise ValueError("order: sequence needs a sequence of modes.")
        if self.order == "random" and self.sequence:
            raise ValueError("a sequence of modes needs order: sequence; found order: random.")
        not_negative("weights", self.weights)


@dataclass(frozen=True, kw_only=True)
class TrackConfig:
    """The ground that the modes' terrain is built on."""

    width: float = 2.0
    """m; nothing lies beside the track"""
    length: float | None = None
    """m; flat ground follows. null: endless"""
    boxes: int = 16
    """terrain boxes of each simulation, recycled ahead of the robot"""

    def __post_init__(self) -> None:
        positive("width", self.width)
        if self.length is not None:
            positive("length", self.length)
        if self.boxes < 2:
            raise ValueError(f"boxes must be at least 2, found {self.boxes}.")
        if self.boxes > MAX_BOXES:
            raise ValueError(f"boxes must be at most {MAX_BOXES}, found {self.boxes}.")


@dataclass(frozen=True, kw_only=True)
class GaitConfig:
    """How set-points cross ground: hops of half stance and half flight."""

    height: float = 0.55
    """base above the ground in the set-points, m"""
    cycle: float = 0.25
    """duration of a hop, s; rounded so that a whole number fits the stretch"""

    def __post_init__(self) -> None:
        positive("height", self.height)
        positive("cycle", self.cycle)


@dataclass(frozen=True, kw_only=True)
class ActionConfig:
    """Joint-position targets: nominal pose + scale * action, action in [-1, 1]."""

    scale: float = 2.0
    """rad"""
    noise: float = 0.13
    """standard deviation of the exploration noise, at the start if it is learned, rad"""

    def __post_init__(self) -> None:
        positive("scale", self.scale)
        positive("noise", self.noise)


Terms = dict[str, dict[str, Any] | None]
RandomisationTerms = dict[str, dict[str, Range] | None]


def _in_use(terms: RandomisationTerms | None) -> ModeRanges:
    return {name: ranges for name, ranges in (terms or {}).items() if ranges is not None}


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """The test protocol. The bound and the reward floor are off."""

    episode_steps: int = 400
    """time limit, control steps"""
    physics_dt: float | None = None
    """physics step of the test, s; null: that of the training"""
    track_length: float | None = None
    """m; flat ground follows"""
    terminations: Terms = field(default_factory=dict)
    """what ends an episode before the time limit"""
    metrics: tuple[str, ...] = ()
    """names of metrics to report"""
    initial: InitialConfig | None = None
    """how robots begin in the test; null: all alike, whatever the policy was trained with"""
    randomisation: RandomisationTerms | None = None
    """disturbances in the test; null: none, whatever the policy was trained with"""

    def __post_init__(self) -> None:
        if self.episode_steps < 1:
            raise ValueError(f"'episode_steps' must be at least 1, found {self.episode_steps}.")
        if self.track_length is not None:
            positive("track_length", self.track_length)
        all_different("metrics", self.metrics)

    @property
    def randomised(self) -> ModeRanges:
        """The disturbances in use in the test and their parameters."""
        return _in_use(self.randomisation)


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """``tasks/<name>.yaml``: everything that defines a task. Only data."""

    description: str
    """one sentence"""
    robot: str
    """name of a shipped robot, or path of a robot.yaml (relative to the task file)"""
    control_dt: float
    """s"""
    physics_dt: float
    """s"""
    episode_steps: int
    """time limit in training, control steps"""
    modes: dict[str, dict[str, Range] | None]
    """mode -> parameter -> value, [low, high] or words; null removes a mode"""
    sampling: SamplingConfig = SamplingConfig()
    """how modes follow each other"""
    curriculum: CurriculumConfig | None = None
    """schedule on the modes and their ranges, null = off"""
    restarts: RestartConfig | None = None
    """training episodes that begin shortly before earlier falls, null = none"""
    track: TrackConfig = TrackConfig()
    """the ground"""
    gait: GaitConfig = GaitConfig()
    """set-points while crossing ground"""
    oracle: str
    """name of an oracle"""
    oracle_params: dict[str, dict[str, Any]] = field(default_factory=dict)
    """oracle -> its parameters"""
    encoder: str | None = None
    """encoder of the observation ``mode_latent``: a name or a directory; null: none"""
    feedback: tuple[str, ...]
    """states the oracle takes from the robot at a query; the others start at 0"""
    horizon: int | None
    """control steps between oracle queries; null: one query per (timed) mode"""
    rho: float | None
    """permissible-state bound; null: off (unguided PPO)"""
    bound: dict[str, float]
    """diagonal of W by state name; states not named have weight 0; roll, pitch and yaw are the error's rotation vector
    about the axes of the reference's body; in an override, a mapping replaces the whole"""
    min_step_reward: float | None = None
    """an episode also ends when a step's reward falls below this; null: off"""
    action: ActionConfig = ActionConfig()
    """what the policy commands"""
    initial: InitialConfig | None = None
    """how robots begin a training episode; null: all alike"""
    randomisation: RandomisationTerms | None = None
    """disturbances in training: term -> parameter -> value or [low, high]; null: none"""
    observations: Terms
    """observation terms in order, with parameters; null removes one"""
    critic_observations: Terms = field(default_factory=dict)
    """observation terms that only the critic sees, in training"""
    rewards: Terms
    """reward terms with parameters; null removes one"""
    terminations: Terms = field(default_factory=dict)
    """termination terms in training, besides the bound, the reward floor and the time limit"""
    evaluation: EvaluationConfig = EvaluationConfig()
    """the test protocol"""
    objective: str
    """the task's true objective J"""
    name: str = field(default="task", metadata={"internal": True})
    """file name without ending"""
    file: str = field(default="task", metadata={"internal": True})
    """the file, for messages"""
    robot_config: RobotConfig = field(default=None, metadata={"internal": True})  # type: ignore[assignment]
    """the robot"""

    def __post_init__(self) -> None:
        positive("control_dt", self.control_dt)
        self._check_physics_step("physics_dt", self.physics_dt)
        self._check_physics_step("evaluation.physics_dt", self.test_physics_dt)
        if self.episode_steps < 1:
            raise ValueError(f"'episode_steps' must be at least 1, found {self.episode_steps}.")
        if self.horizon is not None and self.horizon < 1:
            raise ValueError(f"'horizon' must be at least 1 control step or null, found {self.horizon}.")
        if self.horizon is not None and self.horizon > MAX_HORIZON:
            raise ValueError(f"'horizon' must be at most {MAX_HORIZON} control steps, found {self.horizon}.")
        if self.rho is not None and self.rho <= 0:
            raise ValueError(f"'rho' must be above 0, or null for no bound, found {self.rho:g}.")
        for name, initial in (("initial", self.initial), ("evaluation.initial", self.evaluation.initial)):
            beside = initial.y if initial is not None else None
            if beside is not None and 2.0 * max(-beside.low, beside.high) >= self.track.width:
                raise ValueError(
                    f"'{name}.y' must lie on the track, which is {self.track.width:g} m wide, found "
                    f"{beside.low:g} to {beside.high:g}."
                )
        latents = [terms.get("mode_latent") for terms in (self.observations, self.critic_observations)]
        if None not in latents and latents[0] != latents[1]:
            raise ValueError("'mode_latent' must be the same in 'observations' and 'critic_observations'.")
        not_negative("bound", self.bound)
        if not any(self.bound.values()):
            raise ValueError("'bound' gives every state the weight 0: it must name one with a weight above 0.")
        all_different("feedback", self.feedback)

    def _check_physics_step(self, key: str, physics_dt: float) -> None:
        positive(key, physics_dt)
        ratio = self.control_dt / physics_dt
        if not (0.5 < ratio < MAX_SUBSTEPS and abs(ratio - round(ratio)) <= 1e-6):
            division = f"{self.control_dt:g} / {physics_dt:g} = {ratio:g}"
            raise ValueError(f"control_dt / {key} must be a whole number below {MAX_SUBSTEPS}, found {division}.")

    @property
    def test_physics_dt(self) -> float:
        """Physics step of the test, s."""
        own = self.evaluation.physics_dt
        return self.physics_dt if own is None else own

    @property
    def substeps(self) -> int:
        """Physics steps per control step."""
        return round(self.control_dt / self.physics_dt)

    @property
    def mode_ranges(self) -> ModeRanges:
        """The modes in use and their parameters."""
        return {name: ranges for name, ranges in self.modes.items() if ranges is not None}

    @property
    def randomised(self) -> ModeRanges:
        """The disturbances in use in training and their parameters."""
        return _in_use(self.randomisation)

    @property
    def observed(self) -> dict[str, dict[str, Any]]:
        """The terms that policy or critic observe, with their parameters."""
        given = (*self.critic_observations.items(), *self.observations.items())
        return {name: parameters for name, parameters in given if parameters is not None}

    @property
    def uses_latent(self) -> bool:
        """Whether policy or critic observe the mode latent."""
        return "mode_latent" in self.observed

    @property
    def latent_of_both_sides(self) -> bool:
        """Whether they observe that of the reference's mirror image too."""
        return bool(self.observed.get("mode_latent", {}).get("both_sides", False))

    @property
    def bound_weights(self) -> tuple[float, ...]:
        """Diagonal of W, length 12."""
        return tuple(self.bound.get(name, 0.0) for name in STATE_NAMES)

    def for_evaluation(self) -> TaskConfig:
        """This task under its test protocol.

        No bound, reward floor, curriculum or restarts, and no critic; physics step, initial states and randomisation of
        its own.
        """
        return replace(
            self,
            physics_dt=self.test_physics_dt,
            rho=None,
            min_step_reward=None,
            curriculum=None,
            restarts=None,
            critic_observations={},
            initial=self.evaluation.initial,
            randomisation=self.evaluation.randomisation,
            terminations=self.evaluation.terminations,
            episode_steps=self.evaluation.episode_steps,
            track=replace(self.track, length=self.evaluation.track_length),
        )
