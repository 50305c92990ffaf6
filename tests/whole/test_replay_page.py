"""The page of a replay in a browser, opened from disk: it plays, it draws, and it asks for nothing."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ogmp_sb3 import load_policy
from ogmp_sb3.evaluation.recording import record_frames
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.replay import RecordedEpisode
from ogmp_sb3.report.replay import write_replay

Image = pytest.importorskip("PIL.Image", reason="looking at pictures needs the extra 'viewer'")

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason=f"no browser: none of {', '.join(NAMES)} is installed")

DRAWN_IN_SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_NETWORK = "--host-resolver-rules=MAP * ~NOTFOUND"  # also where there is one
STEPS, AT = 60, 1.2  # control steps, s
LOOK, LONGEST, ATTEMPTS = 0.5, 60, 3  # s of the page's own clock, s of ours, for each of so many
BROWSER = "not an origin"  # in a log of the network
SCENE = slice(110, 640), slice(30, 760)  # rows and columns of a picture that the scene fills


def patient(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a browser; one that hangs, as headless ones do now and then by a page that never stops drawing, again."""
    for attempt in range(ATTEMPTS):
        try:
            return subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=True)
        except subprocess.TimeoutExpired:
            if attempt == ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


class Page:
    """A page, and a browser that opens it anew for each look."""

    def __init__(self, path: Path, frames: list[Frame]) -> None:
        self.path, self.frames, self.folder = path, frames, path.parent

    def browse(self, fragment: str, *flags: str, seconds: float = LOOK, dark: bool = False) -> str:
        """What the browser prints about the page, so many seconds after it was opened."""
        command = [
            str(CHROMIUM), "--headless=new", "--no-sandbox", "--disable-gpu", *DRAWN_IN_SOFTWARE, NO_NETWORK,
            "--hide-scrollbars", "--window-size=1200,800", f"--user-data-dir={self.folder / 'profile'}",
            f"--virtual-time-budget={round(1000 * seconds)}", "--enable-logging=stderr",
            f"--blink-settings=preferredColorScheme={0 if dark else 1}", *flags, f"{self.path.as_uri()}{fragment}",
        ]  # fmt: skip
        done = patient(command)
        errors = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "GL Driver Message" not in line]
        assert not errors
        return done.stdout

    def picture(self, fragment: str = "", seconds: float = LOOK, dark: bool = False) -> np.ndarray:
        """The page as it is seen, shape (height, width, 3)."""
        file = self.folder / "seen.png"
        self.browse(fragment, f"--screenshot={file}", seconds=seconds, dark=dark)
        return np.asarray(Image.open(file).convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    loaded = load_policy("parkour")
    task = loaded.task.for_evaluation()
    (frames,) = record_frames(loaded, task, [0])
    episode = RecordedEpisode(name="best", detail="seed 0", frames=frames[: STEPS + 1])
    path = tmp_path_factory.mktemp("page") / "replay.html"
    write_replay(path, loaded.task, [episode, episode], "parkour")
    return Page(path, episode.frames)


def text_of(html: str, name: str) -> str:
    return re.search(rf'id="{name}"[^>]*>([^<]*)<', html).group(1)


def accent(picture: np.ndarray) -> np.ndarray:
    """Where the scene has the accent colour of the robot, rows and columns."""
    red, green, blue = np.moveaxis(picture[SCENE], -1, 0)
    return np.argwhere((red > 1.5 * green) & (green > 1.4 * blue) & (red > 120))


def test_it_plays(page: Page) -> None:
    early, late = page.picture(seconds=LOOK), page.picture(seconds=3 * LOOK)
    assert len(accent(early)) > 300 and len(accent(late)) > 300
    moved = np.abs(early - late)[SCENE].max(axis=-1) > 40
    assert moved.mean() > 0.02


def test_a_moment_that_is_held_is_drawn_the_same_again(page: Page) -> None:
    first, later = page.picture(f"#1@{AT}"), page.picture(f"#1@{AT}", seconds=2 * LOOK)
    assert np.abs(first - later).max() <= 2  # soft edges of a button may round otherwise


def test_the_robot_is_the_right_way_up_on_the_ground(page: Page) -> None:
    """The trunk's accents are above the shanks, which are of the accent's colour; and the sky is above all."""
    picture = page.picture(f"#1@{AT}")
    rows = accent(picture)[:, 0]
    assert 150 < rows.mean() < 450 and np.ptp(rows) > 60
    columns = np.arange(picture.shape[1])[SCENE[1]]
    sky, ground = picture[110, columns], picture[600, columns]
    assert sky[:, 2].mean() > sky[:, 0].mean() + 10  # blue
    assert ground[:, 0].mean() > ground[:, 2].mean() + 10  # sand


def test_figures_and_charts_are_in_step_with_the_time(page: Page) -> None:
    html, frame = page.browse(f"#2@{AT}", "--dump-dom"), page.frames[round(AT / 0.03)]
    assert text_of(html, "time") == f"{AT:.2f} s"
    assert text_of(html, "mode") == frame.mode
    assert text_of(html, "figures") == f"x {frame.base[0]:.1f} m  ·  {frame.speed:.2f} m/s"
    shown = re.findall(r"<output>([^<]*)</output>", html)
    rho = 0.5
    wanted = [
        frame.base[2], frame.reference[2], frame.ground,
        frame.velocity[0], frame.commanded_speed,
        frame.deviation / rho, 1.0,
    ]  # fmt: skip
    assert [float(value.replace("−", "-")) for value in shown] == pytest.approx(wanted, abs=0.0051)


def test_it_is_dark_where_the_reader_wants_it_dark(page: Page) -> None:
    bright, dark = page.picture(f"#1@{AT}"), page.picture(f"#1@{AT}", dark=True)
    assert bright[5, 5].min() > 240 and dark[5, 5].max() < 40
    assert len(accent(dark)) > 300


def requests(page: Page, name: str) -> set[str]:
    """The addresses that a page asked for; the browser's own services have no origin."""
    log = page.folder / f"{name}.json"
    Page(page.folder / f"{name}.html", page.frames).browse("", f"--log-net-log={log}", "--dump-dom")
    begun = [event.get("params", {}) for event in json.loads(log.read_text())["events"]]
    return {it["url"] for it in begun if it.get("initiator", BROWSER) != BROWSER and not it["url"].startswith("file:")}


def test_no_request_leaves(page: Page) -> None:
    html = page.path.read_text()
    policy = re.search(r"<meta http-equiv=[^>]*>", html).group()
    asking = "<script>new Image().src = 'http://example.org/a.png'</script></body>"
    (page.folder / "asks.html").write_text(html.replace(policy, "").replace("</body>", asking))
    assert requests(page, "asks") == {"http://example.org/a.png"}  # else nothing would be seen here
    assert requests(page, "replay") == set()
