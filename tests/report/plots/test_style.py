"""What all pictures share: files, colours, panels."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import pytest
from PIL import Image

from ogmp_sb3.report.plots.style import (
    CAUSE_COLOURS,
    MODE_COLOURS,
    colours_of,
    in_style,
    legend_entries,
    panel_grid,
    save,
)


def test_a_picture_is_written_as_png_and_as_svg(tmp_path: Path) -> None:
    figure, (axes,) = panel_grid(1, 1, 5.2, 3.8)
    axes.plot([0.0, 1.0])
    save(figure, tmp_path / "a")
    with Image.open(tmp_path / "a.png") as image:
        assert image.width > image.height > 300
    assert (tmp_path / "a.svg").read_text().rstrip().endswith("</svg>")


def test_a_path_with_an_ending_gets_that_file_alone(tmp_path: Path) -> None:
    save(panel_grid(1, 1, 2.0, 2.0)[0], tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_modes_and_causes_of_one_s_own_have_colours_that_differ() -> None:
    colours = colours_of(["hop", "", "pace", "skip", "hop", "bound"], MODE_COLOURS)
    assert colours["pace"] == MODE_COLOURS["pace"]
    own = [colours[name] for name in ("hop", "skip", "bound")]
    assert len({*own, *MODE_COLOURS.values()}) == 3 + len(set(MODE_COLOURS.values()))
    many = colours_of(map(str, range(50)), CAUSE_COLOURS)
    assert len(many) == 50 + len(CAUSE_COLOURS)


def test_panels_stand_in_rows_and_the_last_row_may_be_short() -> None:
    figure, panels = panel_grid(5, 3, 2.0, 1.5)
    assert [axes.axison for axes in figure.axes] == [True] * 5 + [False]
    assert panels == figure.axes[:5]
    assert figure.get_size_inches().tolist() == [6.0, 3.0]


def test_a_label_that_several_panels_have_is_in_the_legend_once() -> None:
    _, panels = panel_grid(2, 2, 2.0, 1.5)
    for axes in panels:
        axes.plot([0.0, 1.0], label="base")
    panels[1].plot([1.0, 0.0], label="reference")
    assert list(legend_entries(panels)) == ["base", "reference"]


def test_the_settings_and_the_backend_of_matplotlib_are_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {**matplotlib.rcParams, "backend": "module://of_a_notebook"}  # pyplot could not draw with this one
    seen = []

    @in_style
    def draw() -> None:
        seen.append(matplotlib.rcParams["font.size"])
        save(panel_grid(1, 1, 2.0, 2.0)[0], tmp_path / "a")

    monkeypatch.setitem(matplotlib.rcParams, "backend", "module://of_a_notebook")
    draw()
    draw()
    assert seen == [9.0, 9.0] and before["font.size"] != 9.0
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "a.svg"}
    assert dict(matplotlib.rcParams) == before
