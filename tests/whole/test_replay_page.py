"""The page of a replay in a browser, opened from disk: it plays, it draws, and it asks for nothing."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.browser import Browser, needs_browser
from ogmp_sb3 import load_policy
from ogmp_sb3.evaluation.recording import record_frames
from ogmp_sb3.rendering.frame import Frame
from ogmp_sb3.rendering.replay import RecordedEpisode
from ogmp_sb3.report.replay import write_replay

pytest.importorskip("PIL.Image", reason="looking at pictures needs the extra 'viewer'")
pytest.importorskip("websockets", reason="a browser is driven through websockets, of the extra 'viewer'")
pytestmark = needs_browser

NO_NETWORK = "--host-resolver-rules=MAP * ~NOTFOUND"  # also where there is one
STEPS, AT = 60, 1.2  # control steps, s
SIZE = (1200, 800)
SCENE = slice(110, 640), slice(30, 760)  # rows and columns of a picture that the scene fills
ERRORS = ("Runtime.exceptionThrown", "Log.entryAdded")


class Page:
    """A page that is looked at in a browser."""

    def __init__(self, folder: Path, frames: list[Frame]) -> None:
        self.path, self.frames = folder / "replay.html", frames
        self.browser = Browser("about:blank", folder / "profile", SIZE, (NO_NETWORK,))
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.browser.call(f"{domain}.enable")

    def open(self, fragment: str = "", path: Path | None = None) -> None:
        """Open it anew, and wait until it shows a time."""
        self.browser.call("Page.navigate", url="about:blank")
        self.browser.events.clear()
        self.browser.call("Page.navigate", url=f"{(path or self.path).as_uri()}{fragment}")
        self.until(lambda: " s" in self.text("time"))

    def until(self, condition: Callable[[], Any], seconds: float = 90.0) -> None:
        """Wait for something; what is drawn in software takes its time."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, self.browser.events
            time.sleep(0.1)

    def text(self, name: str) -> str:
        """What an element of the page says."""
        return self.browser.javascript(f"document.getElementById('{name}')?.textContent") or ""

    def clock(self) -> float:
        """The time that it shows, s."""
        return float(self.text("time").removesuffix(" s"))

    def picture(self) -> np.ndarray:
        """What is seen, once the scene has been drawn, shape (height, width, 3)."""
        self.until(lambda: len(accent(self.browser.picture())) > 300)
        return self.browser.picture()

    def told(self, *methods: str) -> list[dict[str, Any]]:
        """What the browser told since the page was opened."""
        self.browser.javascript("0")  # takes in what has come
        return [event["params"] for event in self.browser.events if event.get("method") in methods]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    loaded = load_policy("parkour")
    (frames,) = record_frames(loaded, loaded.task.for_evaluation(), [0])
    episode = RecordedEpisode(name="best", detail="seed 0", frames=frames[: STEPS + 1])
    page = Page(tmp_path_factory.mktemp("page"), episode.frames)
    write_replay(page.path, loaded.task, [episode, episode], "parkour")
    yield page
    page.browser.close()


def accent(picture: np.ndarray) -> np.ndarray:
    """Where the scene has the accent colour of the robot, rows and columns."""
    red, green, blue = np.moveaxis(picture[SCENE], -1, 0)
    return np.argwhere((red > 1.5 * green) & (green > 1.4 * blue) & (red > 120))


def test_it_plays(page: Page) -> None:
    page.open()
    early, began = page.picture(), page.clock()
    page.until(lambda: abs(page.clock() - began) > 0.3)
    late = page.picture()
    moved = np.abs(early - late)[SCENE].max(axis=-1) > 40
    assert moved.mean() > 0.02
    assert not [told for told in page.told(*ERRORS) if "GL Driver Message" not in str(told)]


def test_a_moment_that_is_held_is_drawn_the_same_again(page: Page) -> None:
    page.open(f"#1@{AT}")
    first = page.picture()
    time.sleep(0.5)
    assert page.clock() == AT
    assert np.abs(first - page.picture()).max() <= 2  # soft edges of a button may round otherwise


def test_the_robot_is_the_right_way_up_on_the_ground(page: Page) -> None:
    """The shanks, which are of the accent's colour, are below the trunk's few accents; and the sky is above all."""
    page.open(f"#1@{AT}")
    picture = page.picture()
    rows = accent(picture)[:, 0]
    assert np.ptp(rows) > 60 and rows.mean() > 0.5 * (rows.min() + rows.max())
    columns = np.arange(picture.shape[1])[SCENE[1]]
    sky, ground = picture[110, columns], picture[600, columns]
    assert sky[:, 2].mean() > sky[:, 0].mean() + 10  # blue
    assert ground[:, 0].mean() > ground[:, 2].mean() + 10  # sand


def test_figures_and_charts_are_in_step_with_the_time(page: Page) -> None:
    page.open(f"#2@{AT}")
    frame = page.frames[round(AT / 0.03)]
    page.until(lambda: page.text("time") == f"{AT:.2f} s")
    assert page.text("mode") == frame.mode
    assert page.text("figures") == f"x {frame.base[0]:.1f} m  ·  {frame.speed:.2f} m/s"
    outputs = "[...document.querySelectorAll('#charts output')].map(output => output.textContent)"
    shown = page.browser.javascript(outputs)
    rho = 0.5
    wanted = [
        frame.base[2], frame.reference[2], frame.ground,
        frame.velocity[0], frame.commanded_speed,
        frame.deviation / rho, 1.0,
    ]  # fmt: skip
    assert [float(value.replace("−", "-")) for value in shown] == pytest.approx(wanted, abs=0.0051)


def test_it_is_dark_where_the_reader_wants_it_dark(page: Page) -> None:
    corner = []
    for scheme in ("light", "dark"):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        page.browser.call("Emulation.setEmulatedMedia", features=features)
        page.open(f"#1@{AT}")
        corner.append(page.picture()[5, 5])
    page.browser.call("Emulation.setEmulatedMedia", features=[])
    assert corner[0].min() > 240 and corner[1].max() < 40


def requests(page: Page, path: Path) -> set[str]:
    """The addresses that a page asked for, itself left out."""
    page.open(path=path)
    time.sleep(1.0)
    urls = {told["request"]["url"] for told in page.told("Network.requestWillBeSent")}
    return {url for url in urls if not url.startswith("data:")} - {path.as_uri(), "about:blank"}


def test_no_request_leaves(page: Page) -> None:
    html = page.path.read_text(encoding="utf-8")
    policy = re.search(r"<meta http-equiv=[^>]*>", html)
    assert policy is not None
    asks = page.path.with_name("asks.html")
    asking = "<script>new Image().src = 'http://example.org/a.png'</script></body>"
    asks.write_text(html.replace(policy.group(), "").replace("</body>", asking), encoding="utf-8")
    assert requests(page, asks) == {"http://example.org/a.png"}  # else nothing would be seen here
    assert requests(page, page.path) == set()
