"""Grids over two parameters of a mode."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.ranges import Range
from ogmp_sb3.env.batch_env import BatchEnv
from ogmp_sb3.evaluation.grid import cell_task, default_grids, read_grid
from ogmp_sb3.report.heat_maps import grid_rows
from ogmp_sb3.report.plots.evaluations import plot_grids

PARKOUR = load_task("parkour")


def test_an_axis_spans_half_a_range_beyond_both_ends_and_knows_what_was_trained() -> None:
    grid = read_grid("jump.w,jump.h", PARKOUR, PARKOUR, cells=4)
    assert (grid.mode, grid.axes) == ("jump", ("w", "h"))
    np.testing.assert_allclose(grid.edges[0], [0.2, 0.3, 0.4, 0.5, 0.6])
    np.testing.assert_allclose(grid.edges[1][[0, -1]], [0.125, 0.425])
    assert grid.trained == {"w": [0.3, 0.5], "h": [0.2, 0.35]}
    assert read_grid("pace.v,pace.length", PARKOUR, PARKOUR).edges[1][0] == 0.2  # half of 0.4, not 0


def test_what_was_trained_is_not_what_the_test_asks_for() -> None:
    asked = load_task("parkour", {"modes.jump.h": [0.35, 0.45]})
    (grid,) = (grid for grid in default_grids(asked, PARKOUR, 2) if grid.mode == "jump")
    assert grid.trained == {"w": [0.3, 0.5], "h": [0.2, 0.35]}
    np.testing.assert_allclose(grid.edges[1], [0.3, 0.4, 0.5])


def test_a_mode_that_was_never_trained_has_no_range_to_outline(tmp_path: Path) -> None:
    grid = read_grid("jump.w:0.1:0.3:2,jump.h:0.1:0.3:2", PARKOUR, load_task("dive"))
    data = grid.as_data([{"return": {"mean": 1.0, "std": 0.4, "ci95": [0.0, 2.0], "n": 3}}] * 4)
    assert data["trained"] == {}
    assert [row["trained"] for row in grid_rows([data])] == [False] * 4
    plot_grids([data], "return", tmp_path / "grid.png")
    assert (tmp_path / "grid.png").is_file()


def test_an_axis_can_be_given_with_its_limits_and_cells() -> None:
    grid = read_grid("leap.w:0.1:0.3:2,leap.d:0.4:0.5:1", PARKOUR, PARKOUR)
    assert grid.cells == [
        {"w": Range(0.1, 0.2), "d": Range(0.4, 0.5)},
        {"w": Range(0.2, 0.3), "d": Range(0.4, 0.5)},
    ]


def test_data_keep_metrics_with_their_cells() -> None:
    grid = read_grid("jump.w:0:1:2,jump.h:2:3:2", PARKOUR, PARKOUR)
    data = grid.as_data([{"sum": cell["w"].low + cell["h"].high} for cell in grid.cells])
    assert [cell["metrics"]["sum"] for cell in data["cells"]] == [2.5, 3.0, 3.0, 3.5]
    assert all(cell["metrics"]["sum"] == cell["w"][0] + cell["h"][1] for cell in data["cells"])
    assert data["axes"] == ["w", "h"]


def test_every_mode_with_two_ranges_has_a_grid_over_the_first_two() -> None:
    assert [(g.mode, g.axes) for g in default_grids(PARKOUR, PARKOUR)] == [
        ("pace", ("v", "length")), ("jump", ("w", "h")), ("leap", ("w", "run_up")),
    ]  # fmt: skip
    dive = load_task("dive")
    assert default_grids(dive, dive) == []


def test_a_cell_holds_its_mode_alone_with_its_values_and_the_other_ranges() -> None:
    cell = cell_task(PARKOUR, "leap", {"w": Range(0.6, 0.7)})
    assert cell.sampling.weights == {"pace": 0.0, "jump": 0.0, "leap": 1.0}
    assert cell.mode_ranges["leap"]["w"] == Range(0.6, 0.7)
    assert cell.mode_ranges["leap"]["run_up"] == Range(0.3, 0.6)
    assert PARKOUR.mode_ranges["leap"]["w"] == Range(0.2, 0.35)


@pytest.mark.parametrize(
    ("text", "error", "sentence"),
    [
        ("jump.w", ValueError, "'grid' needs two parameters of one mode"),
        ("jump.w,jump.w", ValueError, "'grid' needs two parameters of one mode"),
        ("jump.w,leap.w", ValueError, "'grid' needs two parameters of one mode"),
        ("jmp.w,jmp.h", KeyError, "unknown mode 'jmp'.*Did you mean 'jump'"),
        ("jump.q,jump.h", KeyError, "mode 'jump' has no number 'q'"),
        ("jump.w:1:2,jump.h", ValueError, "must be mode.parameter or mode.parameter:low:high:cells"),
        ("jump.w:a:b:c,jump.h", ValueError, "must be mode.parameter or mode.parameter:low:high:cells"),
    ],
)
def test_mistakes_are_one_sentence(text: str, error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        read_grid(text, PARKOUR, PARKOUR)


def test_what_a_sequence_says_itself_is_not_varied() -> None:
    sequence = {"order": "sequence", "sequence": ["pace", {"jump": {"h": 0.1}}]}
    task = load_task("parkour", {"curriculum": None, "sampling": sequence})
    for text in ("jump.w,jump.h", "leap.w,leap.d"):
        with pytest.raises(ValueError, match="the sequence of modes says what its parameters are"):
            read_grid(text, task, PARKOUR)
    assert [grid.mode for grid in default_grids(task, PARKOUR)] == ["pace"]


@pytest.mark.parametrize(("w", "run_up"), [(0.125, 0.15), (0.05, 0.05)])
def test_a_cell_has_room_for_modes_far_shorter_than_those_of_training(w: float, run_up: float) -> None:
    task = replace(PARKOUR.for_evaluation(), terminations={})
    cell = {"w": Range(w, w), "run_up": Range(run_up, run_up)}
    env = BatchEnv(cell_task(task, "leap", cell), 2, seed=0, threads=1)
    env.reset()
    x = env.sim.base_qpos
    for _ in range(60):  # wherever a robot is along the track, the track goes on
        env.sim.qpos[:, x] += 0.1
        env.step(np.zeros((2, env.action_size)))
    assert (env.sim.qpos[:, x] > 5.0).all()
