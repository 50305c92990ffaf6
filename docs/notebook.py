"""Write a page of the documentation as a Jupyter notebook beside it.

    python docs/notebook.py docs/tutorials/first-policy.md docs/tutorials/first_policy.ipynb

Prose becomes markdown, commands begin with an exclamation mark, pictures that they write are shown, and nothing has
outputs before it is run. The first cell installs the package from the clone around the notebook, where it is missing.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

INSTALL = """import importlib.util

if importlib.util.find_spec("ogmp_sb3") is None:  # installed from the clone that this notebook lies in
    %pip install --quiet -c ../../constraints.txt "../..[viewer]"
"""
FENCE = re.compile(r"^```(console|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def notebook(page: str) -> dict[str, Any]:
    """The notebook of a page, in nbformat 4.5.

    :param page: markdown; its fenced blocks of ``console`` and ``python`` become code, all others stay text
    """
    parts = FENCE.split(page)  # text, then language, block and text again and again
    cells = [_cell("code", INSTALL), _cell("markdown", parts[0])]
    for language, block, text in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        code = _commands(block) if language == "console" else block
        cells += [_cell("code", code), _cell("markdown", text)]
    cells = [cell for cell in cells if cell["source"]]
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def _cell(kind: str, text: str) -> dict[str, Any]:
    cell = {"cell_type": kind, "metadata": {}, "source": text.strip().splitlines(keepends=True)}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def _commands(block: str) -> str:
    """The lines of a console; what a program printed becomes a comment, and a picture that it wrote is shown."""
    lines = [f"!{line[2:]}" if line.startswith("$ ") else f"# {line}" for line in block.splitlines()]
    pictures = re.findall(r"video=(\S+\.(?:png|gif))", block)
    if pictures:
        lines = ["from IPython.display import Image, display", "", *lines]
    return "\n".join([*lines, *(f'display(Image("{picture}"))' for picture in pictures)])


def text_of(page: Path) -> str:
    """A notebook as the text of its file."""
    return json.dumps(notebook(page.read_text(encoding="utf-8")), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(text_of(Path(sys.argv[1])), encoding="utf-8")
