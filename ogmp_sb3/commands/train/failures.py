"""The jobs of a multirun that failed: each leaves a sentence in its directory, and all are told at the end."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from ogmp_sb3.runs.run_directory import FAILURE


class Failures(Callback):
    """Tells which jobs failed when the others have ended. Hydra calls it (``hydra.callbacks``).

    It runs where the multirun was started; a job may run anywhere, but writes into a directory that both see.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Forget what failed before."""
        folder = Path(config.hydra.sweep.dir)
        for file in folder.rglob(FAILURE):
            file.unlink()
        _running[:] = [folder]

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """:raises SystemExit: with exit code 2, if a job failed"""
        if tell_failures():
            raise SystemExit(2)


_running: list[Path] = []  # the directory of the multirun that has not ended


def tell_failures() -> int:
    """Print a line for each job of the multirun that failed, once.

    :return: how many
    """
    files = [(folder, file) for folder in _running for file in sorted(folder.rglob(FAILURE))]
    _running.clear()
    for folder, file in files:
        print(f"ogmp-train: {file.parent.relative_to(folder)}: {file.read_text(encoding='utf-8')}", file=sys.stderr)
    return len(files)
