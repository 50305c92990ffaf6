"""Drive an exported policy's robot in PyBullet over the tracks of ogmp-eval, and say how often it does not fall.

    python examples/sim2sim/run.py exported tracks=100 video=film.mp4

``exported`` is what ogmp-export and prepare.py wrote. numpy, onnxruntime and pybullet are all that runs here.
"""

from __future__ import annotations

import importlib.util
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from bullet import World
from observe import NOTHING, Observer, State, ground_height

KEYS = {
    "tracks": "how many tracks, the first of tracks.json (default 100)",
    "engine_dt": "step of the engine and of the servos, s (default 0.00025)",
    "video": "an .mp4 to write, of the first track",
    "out": "a .json to write, with each track's result",
}
USAGE = "usage: python run.py FOLDER [KEY=VALUE ...]\n" + "\n".join(f"  {key:<10} {what}" for key, what in KEYS.items())
WIDTH, HEIGHT = 640, 360  # of a video
TILTED = math.radians(60.0)


@dataclass(frozen=True)
class Settings:
    """What the command line says."""

    folder: Path
    tracks: int = 100
    engine_dt: float = 0.00025
    video: Path | None = None
    out: Path | None = None


@dataclass(frozen=True)
class Result:
    """What became of a track."""

    seed: int
    fell: str
    """why, or empty"""
    mode: str
    """where"""
    distance: float
    """m"""
    seconds: float


def settings(arguments: list[str]) -> Settings:
    """Read the command line.

    :raises ValueError: for a mistake in it, in one sentence
    """
    if not arguments or "=" in arguments[0]:
        raise ValueError(USAGE)
    values: dict[str, Any] = {}
    kinds = {"tracks": int, "engine_dt": float, "video": Path, "out": Path}
    for argument in arguments[1:]:
        key, _, text = argument.partition("=")
        if key not in kinds:
            close = "".join(f" Did you mean '{each}'?" for each in get_close_matches(key, KEYS, 1))
            raise ValueError(f"unknown key '{key}' (known: {', '.join(KEYS)}).{close}")
        try:
            values[key] = kinds[key](text)
        except ValueError:
            number = "a whole number" if key == "tracks" else "a number"
            raise ValueError(f"'{key}' must be {number}, found '{text}'.") from None
    found = Settings(Path(arguments[0]), **values)
    if found.tracks < 1 or not 0.0 < found.engine_dt <= 0.001:
        raise ValueError("'tracks' must be at least 1, and 'engine_dt' above 0 and at most 0.001 s.")
    return found


def check_engine_dt(engine_dt: float, control_dt: float) -> None:
    """:raises ValueError: if a control step is no whole number of steps of the engine"""
    if abs(control_dt / engine_dt - round(control_dt / engine_dt)) > 1e-6:
        raise ValueError(f"'engine_dt' is {engine_dt:g} s, of which a control step, {control_dt:g} s, is no multiple.")


def load_controller(folder: Path) -> Any:
    """The Controller of the exported controller.py."""
    file = folder / "controller.py"
    if not file.is_file():
        raise ValueError(f"{folder}: no controller.py; ogmp-export writes one.")
    spec = importlib.util.spec_from_file_location("exported_controller", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Controller(folder)


def play(
    world: World, controller: Any, observer: Observer, data: dict[str, Any], track: dict[str, Any],
    watch: Callable[[], None] | None = None,
) -> Result:  # fmt: skip
    """One episode, from the start that the track names to a fall or the time limit.

    :param data: tracks.json
    :param watch: called after every control step
    """
    control_dt = float(controller.info["control_dt"])
    controller.reset()
    observer.begin(track)
    world.put_ground(observer.boxes)
    world.put_robot(**track["start"])
    state, fell, step = world.state(), "", 0
    begin = state.pos[0]
    while step < data["steps"] and not fell:
        world.step(controller.step(observer.observe(state, controller.last_action)), control_dt)
        state, step = world.state(), step + 1
        fell = cause(state, observer.boxes, data["fall"])
        if watch is not None:
            watch()
    mode = next((name for name, end in track["modes"] if end > state.pos[0]), track["modes"][-1][0])
    behind = data["track_length"] is not None and state.pos[0] >= data["track_length"]
    return Result(track["seed"], fell, "behind the track" if behind else mode, state.pos[0] - begin, step * control_dt)


def cause(state: State, boxes: np.ndarray, fall: dict[str, Any]) -> str:
    """Why an episode ends here, by the test protocol: the base is too low; empty if it is not."""
    if not np.isfinite(state.pos).all():
        return "the simulation failed"
    ground = ground_height(boxes, state.pos[0], state.pos[1])[0]
    surface = max(ground, 0.0) if fall["fill_gaps"] else ground
    if state.pos[2] - surface >= fall["min_height"]:
        return ""
    if ground <= NOTHING:
        return "beside the track"
    return "tilted" if state.rotation[2, 2] < math.cos(TILTED) else "low but upright"


def wilson(successes: int, n: int) -> tuple[float, float]:
    """95 % confidence interval of a share."""
    z, share = 1.959964, successes / n
    middle, scale = (share + z * z / (2 * n)), 1.0 + z * z / n
    half = z * math.sqrt(share * (1.0 - share) / n + z * z / (4 * n * n))
    return (middle - half) / scale, (middle + half) / scale


def table(results: list[Result]) -> str:
    """The results as text."""
    upright = sum(not result.fell for result in results)
    low, high = wilson(upright, len(results))
    rows = [
        ("tracks", f"{len(results)}"),
        ("no fall", f"{upright / len(results):.2f}   95 % interval {low:.2f} .. {high:.2f}"),
        ("distance", f"{np.mean([result.distance for result in results]):.1f} m (mean)"),
    ]
    falls = Counter(f"{result.mode}, {result.fell}" for result in results if result.fell)
    rows += [("fell in" if not i else "", f"{count} x {what}") for i, (what, count) in enumerate(falls.most_common())]
    return "\n".join(f"{name:<10} {value}" for name, value in rows)


def film(world: World, file: Path, fps: float) -> Iterator[Callable[[], None]]:
    """Yields what takes a picture; the video is closed afterwards."""
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(str(file), (WIDTH, HEIGHT), fps=fps, macro_block_size=8)
    writer.send(None)
    yield lambda: writer.send(world.picture(WIDTH, HEIGHT).tobytes())
    writer.close()


def main(arguments: list[str]) -> None:
    """Play the tracks and print the table.

    :raises ValueError: for a mistake of the user's
    """
    given = settings(arguments)
    controller = load_controller(given.folder)
    for name in ("robot.urdf", "robot.json", "tracks.json"):
        if not (given.folder / name).is_file():
            raise ValueError(f"{given.folder}: no {name}; prepare.py writes it where ogmp_sb3 is installed.")
    data = json.loads((given.folder / "tracks.json").read_text(encoding="utf-8"))
    if given.tracks > len(data["tracks"]):
        raise ValueError(f"tracks.json has {len(data['tracks'])} tracks, fewer than {given.tracks}: see prepare.py.")
    check_engine_dt(given.engine_dt, float(controller.info["control_dt"]))
    world = World(given.folder, controller.info, given.engine_dt)
    observer = Observer(given.folder, controller.info)
    results = []
    for i, track in enumerate(data["tracks"][: given.tracks]):
        if given.video is not None and i == 0:
            for picture in film(world, given.video, controller.info["control_rate_hz"]):
                results.append(play(world, controller, observer, data, track, picture))
        else:
            results.append(play(world, controller, observer, data, track))
        last = results[-1]
        print(f"{i + 1:4d}  seed {last.seed}: {last.fell or 'no fall'}, {last.distance:.1f} m", file=sys.stderr)
    print(table(results))
    if given.out is not None:
        plain = [{field.name: getattr(result, field.name) for field in fields(Result)} for result in results]
        given.out.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except ValueError as error:
        sys.exit(f"run.py: {error}")
