"""Make the pictures of the policies that ship, those of the documentation and of the README, anew.

    python docs/figures.py [picture ...]

The heat maps take most of the time. This needs the extras ``viewer`` and ``dev``, an OpenGL library and Chromium. The
other pictures of a tutorial are what its own commands and code make.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

from ogmp_sb3 import Player, load_policy
from ogmp_sb3.rendering.viewer import Performer, Viewer

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from helpers.browser import CHROMIUM, Browser  # noqa: E402

IMAGES = ROOT / "docs" / "images"
VIDEOS = {
    "parkour.gif": ["run=parkour", "seconds=6", "seed=3"],
    "dive.gif": ["run=dive", "modes.flip.h=1.75", "modes.flip.r=back", "seconds=2.4"],
    "dive-strip.png": ["run=dive", "modes.flip.h=1.75", "seed=3", "seconds=2.4"],
    "tutorial-oracle.png": ["task=parkour", "seconds=4"],
}
REPORTED = {
    "traces.png": "traces.png",
    "traces-horizon.png": "traces_horizon.png",
    "grids.png": "grids.png",
    "latents.png": "latents.png",
}
PAGE, VIEWER, ROBUSTNESS = "report.png", "play.png", "robustness.png"
STRIP = (1200, 600)
CLOSE_NOTICES = "document.querySelectorAll('[class*=Notification-closeButton]').forEach(button => button.click())"
SETTLED = 4.0  # s of play before the viewer's picture is taken


def program(name: str, *arguments: str) -> None:
    """Run one of the package's programs."""
    subprocess.run([Path(sys.executable).with_name(f"ogmp-{name}"), *arguments], check=True)


def shrink(picture: Path) -> None:
    """Make a strip small enough for a page."""
    with Image.open(picture) as image:
        smaller = image.convert("RGB").resize(STRIP, Image.Resampling.LANCZOS)
    smaller.save(picture, optimize=True)


def draw_video(name: str) -> None:
    """A video, a GIF or a strip by ``ogmp-play``."""
    program("play", *VIDEOS[name], f"video={IMAGES / name}")
    if name.endswith(".png"):
        shrink(IMAGES / name)


def draw_reported(names: set[str]) -> None:
    """Pictures out of the report on parkour, and a picture of its page."""
    grids = "true" if "grids.png" in names else "false"
    with tempfile.TemporaryDirectory() as folder:
        program("report", "run=parkour", f"grids={grids}", f"out={folder}")
        for name in names & set(REPORTED):
            shutil.copy(Path(folder) / REPORTED[name], IMAGES / name)
        if PAGE in names:
            flags = ["--headless=new", "--no-sandbox", "--window-size=1000,1100", "--hide-scrollbars"]
            page = f"file://{folder}/report.html"
            subprocess.run([CHROMIUM, *flags, f"--screenshot={IMAGES / PAGE}", page], check=True)


def draw_robustness() -> None:
    """How much of each disturbance parkour withstands."""
    with tempfile.TemporaryDirectory() as folder:
        program("eval", "run=parkour", "robustness=true", "episodes=50", f"out={folder}")
        shutil.copy(Path(folder) / ROBUSTNESS, IMAGES / ROBUSTNESS)


def draw_viewer() -> None:
    """The browser viewer while it plays parkour."""
    loaded = load_policy("parkour")
    viewer = Viewer(lambda *_: [Performer(Player(loaded.task, loaded.policy, seed=3))], "127.0.0.1", 0)
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(f"http://127.0.0.1:{viewer.server.get_port()}", Path(folder), size=(1400, 900))
        while "Command" not in (browser.javascript("document.body.innerText") or ""):
            viewer.show()
            time.sleep(0.1)
        while viewer.player.frame.time < SETTLED:
            viewer.advance(0.03)
        viewer.settings.paused = True
        end = time.monotonic() + 20.0  # software rendering takes its time
        while time.monotonic() < end:
            viewer.advance(0.1)
            time.sleep(0.1)
        browser.javascript(CLOSE_NOTICES)
        time.sleep(1.0)
        Image.fromarray(browser.picture().astype("uint8")).save(IMAGES / VIEWER, optimize=True)
        browser.close()
    viewer.server.stop()


def main() -> None:
    """Draw what is named, or everything."""
    known = {*VIDEOS, *REPORTED, PAGE, VIEWER, ROBUSTNESS}
    names = set(sys.argv[1:]) or known
    if names - known:
        raise SystemExit(f"figures.py: unknown picture '{min(names - known)}' (allowed: {', '.join(sorted(known))}).")
    for name in sorted(names & set(VIDEOS)):
        draw_video(name)
    if names & {*REPORTED, PAGE}:
        draw_reported(names)
    if ROBUSTNESS in names:
        draw_robustness()
    if VIEWER in names:
        draw_viewer()


if __name__ == "__main__":
    main()
