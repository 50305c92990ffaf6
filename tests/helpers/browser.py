"""A browser, for tests that look at pages."""

from __future__ import annotations

import base64
import io
import itertools
import json
import re
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason=f"no browser: none of {', '.join(NAMES)} is installed")


class Browser:
    """A Chromium without a window, driven through its DevTools protocol.

    What it tells unasked is kept in ``events``.

    :param url: opened at first
    :param folder: for its profile
    :param size: of the window, pixels
    :param more: further flags
    """

    def __init__(self, url: str, folder: Path, size: tuple[int, int] = (900, 700), more: tuple[str, ...] = ()) -> None:
        from websockets.sync.client import connect

        flags = ["--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
        window = f"--window-size={size[0]},{size[1]}"
        flags += ["--enable-unsafe-swiftshader", window, "--remote-debugging-port=0", *more]
        folder.mkdir(parents=True, exist_ok=True)
        said = folder / "said.txt"  # a pipe that nobody reads would fill up and stop the browser
        with said.open("wb") as file:
            self.process = subprocess.Popen(
                [cast(str, CHROMIUM), *flags, f"--user-data-dir={folder}", url], stderr=file
            )
        while (found := re.search(r"listening on ws://([^/]+)/", said.read_text("utf-8", "replace"))) is None:
            assert self.process.poll() is None, said.read_text("utf-8", "replace")
            time.sleep(0.1)
        address = found[1]
        while True:
            with urllib.request.urlopen(f"http://{address}/json") as answer:
                pages = [target for target in json.load(answer) if target["type"] == "page"]
            if pages:
                break
            time.sleep(0.1)
        self.socket = connect(pages[0]["webSocketDebuggerUrl"], max_size=None)
        self.numbers = itertools.count()
        self.events: list[dict[str, Any]] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self.numbers)
        self.socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (answer := json.loads(self.socket.recv(timeout=120))).get("id") != number:
            self.events.append(answer)
        return answer["result"]

    def javascript(self, expression: str) -> Any:
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def click(self, label: str) -> None:
        assert self.javascript(
            f"(() => {{ const b = [...document.querySelectorAll('button')].find(b => b.innerText == '{label}');"
            " if (b) b.click(); return Boolean(b) })()"
        )

    def picture(self) -> np.ndarray:
        from PIL import Image

        png = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

    def close(self) -> None:
        self.call("Browser.close")
        self.socket.close()
        self.process.wait(60)
