"""A file of results, written as they come, so that a program that is interrupted goes on where it stopped."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ogmp_sb3.runs.atomic import naming


class ResultCache:
    """A file of results, one JSON line each, found by the settings they were computed with.

    :param path: the file; its directory is made when the first result comes
    :param others: files whose results are known too, and that are not written to
    """

    def __init__(self, path: Path, *others: Path) -> None:
        self.path = path
        self._known: dict[str, Any] = {}
        files = [file for file in (*others, path) if file.is_file()]
        for line in (line for file in files for line in file.read_text("utf-8", "replace").splitlines()):
            try:
                entry = json.loads(line)
                self._known[_key(entry["settings"])] = entry["result"]
            except (ValueError, KeyError, TypeError):
                continue  # a line that was being written when the machine stopped

    def remember(self, settings: dict[str, Any], compute: Callable[[], Any]) -> Any:
        """The result for these settings: from the file, or computed now and kept.

        :param settings: plain data; everything the result depends on
        :param compute: gives the result, plain data
        """
        if settings not in self:
            self.keep(settings, compute())
        return self[settings]

    def keep(self, settings: dict[str, Any], result: Any) -> None:
        """Write down what was computed for these settings.

        :param settings: as for :meth:`remember`
        :param result: plain data
        """
        line = json.dumps({"settings": settings, "result": result})
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with naming(self.path), self.path.open("a", encoding="utf-8") as file:
            file.write(f"\n{line}")  # begins a line of its own even behind one that was cut off
        self._known[_key(settings)] = json.loads(line)["result"]

    def __getitem__(self, settings: dict[str, Any]) -> Any:
        return self._known[_key(settings)]

    def __contains__(self, settings: dict[str, Any]) -> bool:
        return _key(settings) in self._known


def _key(settings: dict[str, Any]) -> str:
    return json.dumps(settings, sort_keys=True)
