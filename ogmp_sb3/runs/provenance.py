"""When, where and from which code a training began: for whoever reads of it, as none of its numbers depend on it."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from ogmp_sb3.machine import PACKAGE

CPUS = Path("/proc/cpuinfo")
BEGAN = "began"  # in the config.yaml of a run


def provenance() -> dict[str, str]:
    """Date, machine, and the commit of the code where that is a clone, as text."""
    count = len(os.sched_getaffinity(0))
    machine = f"{_cpu()}, {count} CPU{'s' if count > 1 else ''}, {platform.system()}"
    began = {"date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), "machine": machine}
    commit = code_commit(PACKAGE)
    return {**began, "commit": commit} if commit else began


def _cpu() -> str:
    """The name of the processor."""
    try:
        lines = CPUS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.machine()


def code_commit(package: Path) -> str:
    """The commit that the code of a package is of, and whether it was changed since; empty for what is no clone.

    :param package: its directory, which lies in that of the clone
    """
    if not (package.parent / ".git").exists():
        return ""
    try:
        commit = _git(package, "rev-parse", "HEAD").strip()
        changed = _git(package, "status", "--porcelain", "--untracked-files=no", "--", str(package))
    except (OSError, subprocess.SubprocessError):  # git is missing, or refuses
        return ""
    return f"{commit[:12]}, with changes" if changed.strip() else commit[:12]


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
