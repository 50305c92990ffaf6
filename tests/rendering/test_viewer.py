"""The browser viewer: what its controls do, and what a real browser shows."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.browser import Browser, needs_browser
from helpers.players import flat, still_player
from helpers.programs import program
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.rendering.player import Player
from ogmp_sb3.rendering.viewer import PLOT_EVERY, Performer, Viewer

pytest.importorskip("viser", reason="the browser viewer needs the extra 'viewer'")

STEP = 0.03  # s


@pytest.fixture
def serve() -> Iterator[Callable[[Player], Viewer]]:
    """Make viewers, and stop them afterwards."""
    viewers: list[Viewer] = []

    def make(player: Player) -> Viewer:
        with contextlib.redirect_stdout(io.StringIO()):
            viewers.append(Viewer(lambda *_: [Performer(player)], "127.0.0.1", 0))
        return viewers[-1]

    yield make
    for viewer in viewers:
        viewer.server.stop()


def controls(viewer: Viewer) -> dict[str, Any]:
    """The visible controls by label; button groups by their options."""
    handles = viewer.server.gui._gui_input_handle_from_uuid.values()
    shown = [h for h in handles if h.visible]
    return {getattr(h, "label", "") or ", ".join(h.options): h for h in shown}


def test_time_passes_at_the_speed_that_was_chosen(serve) -> None:
    viewer = serve(Player(load_task("parkour"), None))
    for speed, steps in ((1.0, 20), (0.5, 10), (2.0, 40)):
        viewer.settings.speed = speed
        start = viewer.player.frame.time
        for _ in range(20):
            viewer.advance(STEP)
        assert viewer.player.frame.time - start == pytest.approx(steps * STEP, abs=STEP)


def test_nothing_moves_while_paused_but_single_steps(serve) -> None:
    viewer = serve(Player(load_task("parkour"), None))
    viewer.settings.paused = True
    for _ in range(5):
        viewer.advance(STEP)
    assert viewer.player.frame.time == 0.0
    viewer.single_step()
    viewer.advance(STEP)
    assert viewer.player.frame.time == pytest.approx(STEP)


def test_between_two_steps_the_robot_is_on_the_way(serve) -> None:
    viewer = serve(Player(load_task("parkour"), None))
    viewer.settings.speed = 0.25
    places = []
    for _ in range(40):
        viewer.advance(STEP)
        places.append(-viewer.stage.world.position[0])
    distances = np.diff(places)
    assert (distances > 0).all()
    assert distances.max() < 2.5 * np.median(distances)


def test_the_world_moves_under_the_robot_until_the_camera_is_let_go(serve) -> None:
    viewer = serve(Player(load_task("parkour"), None))
    for _ in range(20):
        viewer.advance(STEP)
    assert -viewer.stage.world.position[0] == pytest.approx(viewer.player.frame.base[0], abs=0.05)
    viewer.settings.follow = False
    before = viewer.stage.world.position.copy()
    for _ in range(20):
        viewer.advance(STEP)
    np.testing.assert_array_equal(viewer.stage.world.position, before)


def test_without_a_policy_there_is_no_robot_to_push(serve) -> None:
    alone, policy = serve(Player(load_task("parkour"), None)), serve(still_player(flat()))
    assert not alone.stage.lanes[0].robot.node.visible and policy.stage.lanes[0].robot.node.visible
    assert "Velocity" not in controls(alone) and "Velocity" in controls(policy)


@pytest.mark.parametrize("name", ["parkour", "dive", "stairs"])
def test_every_mode_of_a_shipped_task_can_be_commanded(name: str, serve) -> None:
    viewer = serve(Player(load_task(name), None))
    for mode, ranges in viewer.player.commands.items():
        controls(viewer)["Mode"].value = mode
        for _ in range(50):
            if set(ranges) <= set(controls(viewer)):
                break
            time.sleep(0.02)
        shown = controls(viewer)
        assert set(ranges) <= set(shown)
        others = {key for other, keys in viewer.player.commands.items() if other != mode for key in keys}
        assert not (others - set(ranges)) & set(shown)


def test_commands_that_leave_no_room_for_terrain_end_the_episode_and_say_so(serve) -> None:
    viewer = serve(Player(load_task("parkour"), None))
    for _ in range(200):
        viewer.player.command("pace", v=0.8, length=0.02)
    for _ in range(200):
        viewer.advance(STEP)
    assert "too short" in viewer._message
    assert viewer.player.frame.time > 0


def test_the_controls_set_what_they_are_called(serve) -> None:
    viewer = serve(still_player(flat()))
    shown = controls(viewer)
    for label, value, found in (
        ("Pause", True, lambda: viewer.settings.paused),
        ("Speed", 0.5, lambda: viewer.settings.speed),
        ("Follow", False, lambda: viewer.settings.follow),
        ("Ghost", False, lambda: viewer.stage.lanes[0].ghost.node.visible),
        ("Plan", False, lambda: viewer.stage.lanes[0].trail.visible),
        ("Bound", False, lambda: viewer.stage.lanes[0].bound.visible),
        ("Contacts", True, lambda: viewer.stage.lanes[0].contacts.visible),
        ("Collision", True, lambda: viewer.stage.lanes[0].collision is not None),
        ("View", 80.0, lambda: round(float(np.degrees(viewer.server.initial_camera.fov)), 6)),
    ):
        assert found() != value
        shown[label].value = value
        until = time.monotonic() + 5.0
        while found() != value and time.monotonic() < until:  # handles call back from a thread of their own
            viewer.advance(0.0)
            time.sleep(0.01)
        assert found() == value, label


def test_the_plots_show_deviation_and_reward_of_the_last_steps_beside_the_bound(serve) -> None:
    viewer = serve(still_player(flat()))
    frames = [viewer.player.frame]
    for _ in range(5):
        viewer.step()
        frames.append(viewer.player.frame)
    for _ in range(PLOT_EVERY):
        viewer.show()
    seconds, deviation, bound = viewer._plots.deviation.data
    np.testing.assert_allclose(np.diff(seconds), STEP, rtol=0.01)
    np.testing.assert_allclose(deviation[1:], [frame.deviation for frame in frames[1:]])
    assert set(bound) == {viewer.player.task.rho}
    np.testing.assert_allclose(viewer._plots.reward.data[1][1:], [frame.reward for frame in frames[1:]])


def test_the_terms_of_the_reward_are_plotted_beside_it(serve) -> None:
    viewer = serve(still_player(flat()))
    for _ in range(3):
        viewer.step()
    viewer.controls.plots.show()
    names = [series["label"] for series in viewer.controls.plots.reward.series]
    assert names == ["s", "reward", *viewer.player.frame.reward_terms]
    _, reward, *terms = viewer.controls.plots.reward.data
    np.testing.assert_allclose([term[-1] for term in terms], list(viewer.player.frame.reward_terms.values()))
    np.testing.assert_allclose(np.sum(terms, axis=0), reward)


def test_the_pace_is_of_real_time(serve) -> None:
    viewer = serve(Player(load_task("parkour"), None))
    viewer.settings.speed = 0.5
    for _ in range(60):
        viewer.advance(STEP)
    assert viewer.pace == pytest.approx(0.5, abs=0.05)
    viewer.settings.paused = True
    for _ in range(60):
        viewer.advance(STEP)
    assert viewer.pace == pytest.approx(0.0, abs=0.02)


def test_what_is_asked_for_is_done_by_every_robot(serve) -> None:
    players = [still_player(flat()), still_player(flat())]
    with contextlib.redirect_stdout(io.StringIO()):
        viewer = Viewer(lambda *_: [Performer(p, str(i), i) for i, p in enumerate(players)], "127.0.0.1", 0, seed=4)
    try:
        viewer.step()
        speeds = [float(p.env.sim.qvel[0, p.env.sim.base_qvel]) for p in players]
        viewer.push("forward")
        after = [float(p.env.sim.qvel[0, p.env.sim.base_qvel]) for p in players]
        np.testing.assert_allclose(np.subtract(after, speeds), 0.5)
        viewer.command("pace", v=0.7, length=1.0)
        assert all(p.env.guide.course.commands[0] for p in players)
        viewer.reset()
        expected = [Player(p.task, p.policy, 4 + i).env.modes[0] for i, p in enumerate(players)]
        assert [p.env.modes[0] for p in players] == expected
    finally:
        viewer.server.stop()


def test_policies_of_a_run_can_be_chosen_and_new_checkpoints_take_over(monkeypatch: pytest.MonkeyPatch) -> None:
    names, loaded = ["latest", "checkpoints/1", "best"], []

    def load(overrides: list[str], policy: str) -> list[Performer]:
        loaded.append((overrides, policy))
        return [Performer(Player(load_task("parkour"), None))]

    monkeypatch.setattr("ogmp_sb3.rendering.viewer.LOOK_EVERY", -1.0)
    with contextlib.redirect_stdout(io.StringIO()):
        viewer = Viewer(load, "127.0.0.1", 0, ["rho=0.3"], policies=lambda: names)
    try:
        assert controls(viewer)["Samples"].options == tuple(names)
        viewer.settings.speed, viewer.settings.ghost = 0.5, False
        viewer.choose("best")
        assert loaded == [(["rho=0.3"], "latest"), (["rho=0.3"], "best")]
        assert controls(viewer)["Samples"].value == "best"
        assert controls(viewer)["Speed"].value == 0.5 and not viewer.stage.lanes[0].ghost.node.visible
        viewer.settings.newest = True
        viewer.advance(STEP)
        assert len(loaded) == 2  # nothing is new
        names.insert(1, "checkpoints/2")
        viewer.advance(STEP)
        viewer.advance(STEP)
        assert loaded[2:] == [(["rho=0.3"], "checkpoints/2")]
    finally:
        viewer.server.stop()


def test_a_command_that_cannot_be_carried_out_is_named_on_the_page_and_the_play_goes_on(serve) -> None:
    viewer = serve(Player(load_task("dive"), None))
    viewer.ask(lambda: viewer.player.command("flip", h=50.0))
    viewer.advance(STEP)
    assert "there is room for" in viewer._message
    viewer.advance(STEP)
    assert viewer.player.frame.time > 0


def apply(viewer: Viewer, overrides: str) -> None:
    """Give overrides of the task, as a visitor does."""
    shown = controls(viewer)
    shown["Overrides"].value = overrides
    button = shown["Apply"]
    for callback in button._impl.update_cb:
        callback(None)
    viewer.advance(0.0)


def test_overrides_of_the_task_begin_anew_with_its_bound_and_its_modes(tmp_path: Path) -> None:
    def load_player(overrides: list[str], policy: str) -> list[Performer]:
        return [Performer(Player(load_task("parkour", overrides), None))]

    with contextlib.redirect_stdout(io.StringIO()):
        viewer = Viewer(load_player, "127.0.0.1", 0, ["rho=0.3"])
    try:
        assert controls(viewer)["Overrides"].value == "rho=0.3"
        viewer.advance(10 * STEP)
        apply(viewer, "rho=0.2 modes.jump=null 'modes.pace.v=[1.0, 1.2]'")
        player = viewer.player
        assert (player.task.rho, player.task.modes["pace"]["v"].high) == (0.2, 1.2)
        assert viewer.stage.lanes[0].rho == 0.2 and player.frame.time == 0.0
        assert controls(viewer)["Mode"].options == ("pace", "leap")
        for mistake, sentence in (("roh=1", "Did you mean 'rho'?"), ("rho='", "quotation"), ("rho=a", "a number")):
            apply(viewer, mistake)
            assert viewer.player is player
            assert viewer.controls._mistake.visible and sentence in viewer.controls._mistake.content
    finally:
        viewer.server.stop()


def test_the_disturbances_of_the_training_have_sliders_and_begin_anew_as_they_were_set() -> None:
    trained = ["randomisation.friction.coefficient=[0.4,1.2]", "randomisation.push={speed: [0, 0.6], every: 2}"]

    def load_player(overrides: list[str], policy: str) -> list[Performer]:
        return [Performer(still_player(load_task("parkour", [*trained, *overrides])))]

    with contextlib.redirect_stdout(io.StringIO()):
        viewer = Viewer(load_player, "127.0.0.1", 0, ["rho=0.3"])
    try:
        shown = controls(viewer)
        assert shown["Disturbance"].options == ("friction", "push")
        assert "coefficient" in shown and "speed" not in shown
        shown["Disturbance"].value = "push"
        for callback in shown["Disturbance"]._impl.update_cb:
            callback(None)
        speed = controls(viewer)["speed"]
        assert (speed.min, speed.value) == (0.0, 0.0) and speed.max == pytest.approx(0.9)
        speed.value = 0.45
        for callback in speed._impl.update_cb:
            callback(SimpleNamespace(target=speed))
        for callback in controls(viewer)["Disturb"]._impl.update_cb:
            callback(None)
        viewer.advance(0.0)
        assert viewer.player.task.evaluation.randomised == {"push": {"speed": Range(0.45, 0.45)}}
        assert viewer.player.task.rho == 0.3
        assert controls(viewer)["Overrides"].value == "rho=0.3 evaluation.randomisation.push.speed=0.45"
    finally:
        viewer.server.stop()


@needs_browser
def test_a_browser_shows_robot_ghost_and_controls_and_its_buttons_work(serve, tmp_path: Path) -> None:
    viewer = serve(still_player(flat()))
    viewer.settings.paused = True
    for _ in range(4):
        viewer.step()
    browser = Browser(f"http://127.0.0.1:{viewer.server.get_port()}", tmp_path)
    try:

        def until(condition: Callable[[], Any], seconds: float = 90.0) -> None:
            end = time.monotonic() + seconds
            while not condition():
                assert time.monotonic() < end, browser.javascript("document.body.innerText")
                viewer.advance(0.1)
                time.sleep(0.1)

        until(lambda: "Command" in (browser.javascript("document.body.innerText") or ""))
        scene = slice(160, None), slice(None, 570)  # below the notice of software rendering, beside the panel

        def orange() -> int:
            red, green, blue = np.moveaxis(browser.picture()[scene], -1, 0)
            return int(((red > 1.4 * green) & (green > 1.5 * blue) & (red > 120)).sum())

        def blue() -> int:
            picture = browser.picture()[scene]
            return int((picture[..., 2] - picture[..., 0] > 100).sum())

        until(lambda: orange() > 30 and blue() > 100)
        viewer.stage.lanes[0].ghost.node.visible = viewer.stage.lanes[0].trail.visible = False
        until(lambda: blue() < 20)

        steps = viewer.player.env.step_count[0]
        browser.click("Step")
        until(lambda: viewer.player.env.step_count[0] == steps + 1)
        browser.click("forward")
        speed = viewer.player.env.sim.qvel[0, 0]
        until(lambda: viewer.player.env.sim.qvel[0, 0] > speed + 0.4)
        browser.click("Next")
        until(lambda: viewer.player.env.guide.course.commands[0])
        browser.click("Reset")
        until(lambda: viewer.player.frame.time == 0.0)
    finally:
        browser.close()


def test_by_default_only_this_machine_can_open_the_page(tmp_path: Path, monkeypatch) -> None:
    """By the addresses that the kernel says this process listens on."""
    begun: list[Viewer] = []
    monkeypatch.setattr(Viewer, "run", lambda viewer: begun.append(viewer))
    done = program("play", "task=dive", "port=0", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (viewer,) = begun
    port = f"{viewer.server.get_port():04X}"
    listening = []
    for table in ("/proc/self/net/tcp", "/proc/self/net/tcp6"):
        rows = [line.split() for line in Path(table).read_text().splitlines()[1:]] if Path(table).is_file() else []
        listening += [row[1].split(":")[0] for row in rows if row[1].endswith(f":{port}") and row[3] == "0A"]
    viewer.server.stop()
    assert listening == ["0100007F"]  # 127.0.0.1
