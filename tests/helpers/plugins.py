"""Plug-ins in a test, laid into a folder that is on ``sys.path``."""

from __future__ import annotations

import importlib
from pathlib import Path


def lay(folder: Path, name: str, files: dict[str, str], entry: str = "") -> Path:
    """Write a package, with the metadata of an installed distribution of version 1.2.

    :param folder: on ``sys.path``
    :param name: of the package and its distribution; its plug-in is called ``of_<name>``
    :param files: texts by their path inside the package
    :param entry: what the entry point names; empty: the package
    :return: its folder
    """
    files = {
        f"{name}-1.2.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n",
        f"{name}-1.2.dist-info/entry_points.txt": f"[ogmp_sb3.plugins]\nof_{name} = {entry or name}\n",
        **{f"{name}/{path}": text for path, text in files.items()},
    }
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    importlib.invalidate_caches()
    return folder / name
