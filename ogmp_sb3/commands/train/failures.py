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
        for file in Path(config.hydra.sweep.dir).rglob(FAILURE):
            file.unlink()

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """:raises SystemExit: with exit code 2, if a job failed"""
        folder = Path(config.hydra.sweep.dir)
        files = sorted(folder.rglob(FAILURE))
        for file in files:
            print(f"ogmp-train: {file.parent.relative_to(folder)}: {file.read_text(encoding='utf-8')}", file=sys.stderr)
        if files:
            raise SystemExit(2)
