"""The controls beside the scene of the viewer, and the keys that do the same."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.viewer_inputs import add_parameter, add_size
from ogmp_sb3.rendering.viewer_plots import Plots
from ogmp_sb3.rendering.viewer_scene import Stage
from ogmp_sb3.rendering.viewer_settings import Settings

if TYPE_CHECKING:
    import viser

IN_TEST = "evaluation.randomisation."
PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
ARROWS: dict[str, Any] = {"forward": "arrowup", "back": "arrowdown", "left": "arrowleft", "right": "arrowright"}
KEYS = "space: pause, S: step, R: reset, arrows: push, 1 to 9: go on with this mode"


class Play(Protocol):
    """What controls are of, and ask for: the viewer."""

    server: viser.ViserServer
    """whose page it is"""
    settings: Settings
    """what they set"""
    stage: Stage
    """the scene"""
    policies: tuple[str, ...]
    """to choose from"""
    overrides: str
    """of the task that plays, as on a command line"""

    @property
    def player(self) -> Player:
        """The first player."""

    def ask(self, action: Callable[[], object]) -> None:
        """Have something done between two steps."""

    def single_step(self) -> None:
        """One control step, shown at once."""

    def reset(self) -> None:
        """Begin anew with the seed that is set."""

    def push(self, direction: str) -> None:
        """Change the velocity of every robot at once."""

    def command(self, mode: str, **parameters: float | str) -> None:
        """Have every robot go on with a mode."""

    def begin_with(self, overrides: str) -> None:
        """Begin anew with overrides of the task."""

    def choose(self, policy: str) -> None:
        """Begin anew with another policy of the run."""

    def record(self) -> None:
        """Begin a video, or end it."""


class Controls:
    """The controls, set anew whenever another task or policy begins.

    :param viewer: does what they ask for
    """

    def __init__(self, viewer: Play) -> None:
        self._viewer, self._gui, self._settings = viewer, viewer.server.gui, viewer.settings
        self._player = viewer.player
        gui, settings, policy = self._gui, self._settings, self._player.policy is not None
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self.status = gui.add_markdown("")
        self.plots = Plots(gui, self._player.task) if policy else None
        with gui.add_folder("Play"):
            self._pause = self._set_by(gui.add_checkbox("Pause", settings.paused, hint=KEYS), "paused")
            buttons = gui.add_button_group("", ("Step", "Reset"))
            self._set_by(gui.add_slider("Speed", 0.1, 2.0, 0.1, settings.speed), "speed")
            self._set_by(gui.add_number("Seed", settings.seed, min=0, step=1, hint="taken by a reset"), "seed")
            record = gui.add_button("Record", hint="begin and end a video, which the browser downloads")
            self._recording = gui.add_markdown("", visible=False)
        actions = {"Step": viewer.single_step, "Reset": viewer.reset}
        buttons.on_click(lambda event: viewer.ask(actions[event.target.value]))
        record.on_click(lambda _: viewer.ask(viewer.record))
        self._add_policies()
        self._add_commands()
        self._add_overrides()
        if policy and self._player.task.randomised:
            self._add_disturbances()
        if policy:
            with gui.add_folder("Push"):
                self._set_by(gui.add_slider("Velocity", 0.1, 2.0, 0.1, settings.push, hint="m/s"), "push")
                pushes = gui.add_button_group("", tuple(PUSHES))
            pushes.on_click(lambda event: viewer.ask(partial(viewer.push, event.target.value)))
        self._add_views()
        self._add_keys()

    def say(self, text: str) -> None:
        """Show a sentence on how a recording goes."""
        self._recording.content, self._recording.visible = text, bool(text)

    def complain(self, text: str) -> None:
        """Show what is wrong with overrides."""
        self._mistake.content, self._mistake.visible = text, True

    def _add_views(self) -> None:
        """What is shown, and from where."""
        gui, settings, lane = self._gui, self._settings, self._viewer.stage.lanes[0]
        with gui.add_folder("Show", expand_by_default=False):
            boxes = ["follow", "ghost", "plan"] + (["bound"] if lane.bound is not None else [])
            boxes += ["contacts", "collision"] if self._player.policy is not None else []
            for name in boxes:
                self._set_by(
                    gui.add_checkbox(name.capitalize(), getattr(settings, name)), name, self._viewer.stage.apply
                )
            view = gui.add_slider("View", 20.0, 100.0, 5.0, settings.field_of_view, hint="field of view, degrees")
            self._set_by(view, "field_of_view", self._viewer.stage.apply)

    def _add_keys(self) -> None:
        """Keys of the keyboard, which viser also lists in its palette of commands."""
        gui = self._gui

        def add(label: str, key: Any, action: Callable[[], object]) -> None:
            gui.add_command(label, hotkey=key).on_trigger(lambda _: self._viewer.ask(action))

        add("Pause or go on", "space", lambda: setattr(self._pause, "value", not self._settings.paused))
        add("One control step", "S", self._viewer.single_step)
        add("Begin anew", "R", self._viewer.reset)
        for direction, key in ARROWS.items() if self._player.policy is not None else ():
            add(f"Push {direction}", key, partial(self._viewer.push, direction))
        for number, mode in enumerate(list(self._inputs)[:9], start=1):
            add(f"Go on with {mode}", str(number), partial(self._command, mode))

    def _add_policies(self) -> None:
        """A choice of the policies of a run, and whether each new checkpoint takes the place of the last."""
        names, gui = self._viewer.policies, self._gui
        if not names:
            return
        with gui.add_folder("Policy", expand_by_default=False):
            now = self._settings.policy if self._settings.policy in names else names[0]
            choice = gui.add_dropdown("Samples", names, initial_value=now)
            follow = gui.add_checkbox(
                "Newest", self._settings.newest, hint="go on with each new checkpoint of a training"
            )
        self._set_by(follow, "newest")

        choice.on_update(lambda event: self._viewer.ask(partial(self._viewer.choose, event.target.value)))

    def _add_commands(self) -> None:
        """A mode to choose, its parameters, and a button that has the robot go on with it."""
        gui, modes = self._gui, self._player.commands
        self._inputs: dict[str, dict[str, Any]] = {}
        with gui.add_folder("Command"):
            choice = gui.add_dropdown("Mode", tuple(modes))
            for mode, ranges in modes.items():
                self._inputs[mode] = {key: add_parameter(gui, key, range_) for key, range_ in ranges.items()}
            hint = "begin anew with this mode" if self._player.env.guide.timed else "after what lies ahead already"
            button = gui.add_button("Next", hint=hint)

        def show_inputs(_: Any = None) -> None:
            for mode, fields in self._inputs.items():
                for field in fields.values():
                    field.visible = mode == choice.value

        show_inputs()
        choice.on_update(show_inputs)
        button.on_click(lambda _: self._viewer.ask(partial(self._command, choice.value)))

    def _command(self, mode: str) -> None:
        self._viewer.command(mode, **{key: field.value for key, field in self._inputs[mode].items()})

    def _add_overrides(self) -> None:
        """A field of overrides of the task, and a button to begin anew with them."""
        gui = self._gui
        with gui.add_folder("Task", expand_by_default=False):
            hint = "e.g. rho=0.3 modes.jump.h=[0.35,0.4]"
            field = gui.add_text("Overrides", self._viewer.overrides, hint=hint)
            button = gui.add_button("Apply", hint="begin anew with them")
            self._mistake = gui.add_markdown("", visible=False)

        button.on_click(lambda _: self._viewer.ask(lambda: self._viewer.begin_with(field.value)))

    def _add_disturbances(self) -> None:
        """A slider for each parameter of the disturbances of the training, and a button to begin anew with them."""
        gui, now = self._gui, self._player.task.evaluation.randomised
        sliders: dict[str, Any] = {}
        wanted = {f"{term}.{key}": r.low for term, ranges in now.items() for key, r in ranges.items() if not r.words}
        with gui.add_folder("Disturbances", expand_by_default=False):
            choice = gui.add_dropdown("Disturbance", tuple(self._player.task.randomised))
            for term, ranges in self._player.task.randomised.items():
                for key, range_ in ranges.items():
                    name = f"{term}.{key}"
                    sliders[name] = add_size(gui, term, key, range_, wanted.get(name))
                    sliders[name].on_update(lambda event, name=name: wanted.update({name: event.target.value}))
            button = gui.add_button("Disturb", hint="begin anew with all of them")

        def show_sliders(_: Any = None) -> None:
            for name, slider in sliders.items():
                slider.visible = name.partition(".")[0] == choice.value

        def apply() -> None:
            others = [key for key in shlex.split(self._viewer.overrides) if not key.startswith(IN_TEST)]
            self._viewer.begin_with(
                shlex.join([*others, *(f"{IN_TEST}{name}={size:g}" for name, size in wanted.items())])
            )

        show_sliders()
        choice.on_update(show_sliders)
        button.on_click(lambda _: self._viewer.ask(apply))

    def _set_by(self, control: Any, name: str, then: Callable[[], object] = lambda: None) -> Any:
        """Have a control set a setting, and do something then."""

        def put(event: Any) -> None:
            self._viewer.ask(partial(setattr, self._settings, name, event.target.value))
            self._viewer.ask(then)

        control.on_update(put)
        return control
