"""Draw the ten packages, the modules in each and what imports what: ``make map``, the picture of CONTRIBUTING.md.

Everything in it is read from the sources: packages in the order of their imports, their purpose from their docstrings,
and for each pair how many modules of one import from the other.
"""

from __future__ import annotations

import ast
import textwrap
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "ogmp_sb3"
PICTURE = ROOT / "docs" / "images" / "map.svg"
LINE = 0.19  # inches, height of a line of text
WIDTH = 6.6  # inches, of a package
CELL = 0.42  # inches, of the table beside them
SHADES = ("#f4efe6", "#e9e2d3")


def modules() -> dict[str, list[Path]]:
    """The modules of each package, by its name."""
    folders = sorted(path.parent for path in SOURCES.glob("*/__init__.py") if path.parent.name != "conf")
    return {
        folder.name: sorted(path for path in folder.rglob("*.py") if path.name != "__init__.py") for folder in folders
    }


def imports(packages: dict[str, list[Path]]) -> Counter[tuple[str, str]]:
    """How many modules of a package import from another one: by both names."""
    found: Counter[tuple[str, str]] = Counter()
    for name, paths in packages.items():
        for path in paths:
            nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            names = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
            others = {parts[1] for parts in (text.split(".") for text in names) if parts[0] == "ogmp_sb3" and parts[1:]}
            found.update((name, other) for other in others - {name} if other in packages)
    return found


def order(packages: dict[str, list[Path]], found: Counter[tuple[str, str]]) -> list[str]:
    """The packages, each behind all that it imports from."""
    graph = {name: {other for one, other in found if one == name} for name in packages}
    return list(TopologicalSorter(graph).static_order())


def purpose(package: str) -> str:
    """The docstring of a package."""
    return ast.get_docstring(ast.parse((SOURCES / package / "__init__.py").read_text(encoding="utf-8"))) or ""


def labels(package: str, paths: list[Path]) -> list[str]:
    """The names of modules within their package, in lines."""
    names = [".".join(path.relative_to(SOURCES / package).with_suffix("").parts) for path in paths]
    return textwrap.wrap("   ".join(name.replace(" ", "") for name in names), 96, break_long_words=False)


def draw() -> None:
    """Write the picture."""
    packages = modules()
    found = imports(packages)
    names = order(packages, found)
    texts = {name: labels(name, packages[name]) for name in names}
    heights = {name: (2.2 + len(texts[name])) * LINE for name in names}
    total = sum(heights.values())
    plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "ogmp_sb3", "font.family": "sans-serif"})
    figure = plt.figure(figsize=(WIDTH + CELL * (len(names) + 1), total + 0.9))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH + CELL * (len(names) + 1)), ylim=(total, -0.9))
    axes.axis("off")
    top = 0.0
    for row, name in enumerate(names):
        height = heights[name]
        axes.add_patch(Rectangle((0.05, top + 0.03), WIDTH - 0.1, height - 0.06, color=SHADES[row % 2]))
        axes.text(0.2, top + 0.25, f"{name}/", fontsize=11, fontweight="bold", va="center")
        axes.text(1.25, top + 0.25, purpose(name), fontsize=8.5, va="center", color="0.25")
        for line, text in enumerate(texts[name]):
            axes.text(0.2, top + 0.5 + LINE * line, text, fontsize=7.5, va="center", family="monospace", color="0.2")
        for column, other in enumerate(names):
            x, count = WIDTH + CELL * (column + 0.5), found[name, other]
            if column < row:
                axes.add_patch(Rectangle((x - 0.48 * CELL, top + 0.03), 0.96 * CELL, height - 0.06, color=SHADES[0]))
                axes.text(x, top + height / 2, str(count or ""), fontsize=9, ha="center", va="center")
            elif column == row:
                axes.text(x, top + height / 2, "·", fontsize=12, ha="center", va="center")
        top += height
    for column, other in enumerate(names):
        axes.text(WIDTH + CELL * (column + 0.4), -0.08, f"{other}/", fontsize=8.5, rotation=55, ha="left", va="bottom")
    axes.text(0.2, -0.45, "Each package imports only from those above it.", fontsize=9, va="center")
    axes.text(0.2, -0.22, "Numbers: how many of its modules import from which.", fontsize=9, va="center", color="0.25")
    figure.savefig(PICTURE, metadata={"Date": None})
    plt.close(figure)


if __name__ == "__main__":
    draw()
    print(PICTURE.relative_to(ROOT))
