"""What ogmp-check says about a task."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np
from rich.console import Console

from helpers.programs import program
from ogmp_sb3.commands.check import _describe, reference_panels
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import load_task
from ogmp_sb3.env.batch_env import BatchEnv


def test_every_oracle_has_a_reference_for_every_mode_also_at_rest() -> None:
    task = load_task("parkour", {"modes.pace.v": 0.0})
    panels = {title.partition(" ")[0]: panel for title, *panel in reference_panels(task)}
    assert set(panels) == {"pace", "jump", "leap"}
    for stance, points, references in panels.values():
        assert set(references) == {"linear", "lqr", "preview"}
        assert all(each.shape == (len(stance) + 1, 12) == points.shape for each in references.values())
        assert len(stance) < 500
    assert np.ptp(panels["jump"][1][:, 5]) > 0.2  # the block of 0.275 m


def test_a_flip_has_a_reference_in_each_direction_and_only_a_flip_to_the_side_rolls() -> None:
    panels = {title: panel for title, *panel in reference_panels(load_task("dive"))}
    flips = [f"flip ({word}, h 1.375)" for word in ("front", "back", "left", "right")]
    assert list(panels) == [*flips, "settle"]
    turned = {title: np.round(panels[title][1][-1, :3] / (2 * np.pi)).tolist() for title in flips}
    turns = [[0, 1, 0], [0, -1, 0], [-1, 0, 0], [1, 0, 0]]  # roll, pitch, yaw; front is nose down
    assert list(turned.values()) == turns


def test_a_robot_in_the_air_is_told_its_height(tmp_path: Path) -> None:
    folder = shutil.copytree(TASKS_DIR.parent / "robots" / "hector", tmp_path / "tall")
    text = (folder / "robot.yaml").read_text(encoding="utf-8")
    (folder / "robot.yaml").write_text(text.replace("nominal_height: 0.50", "nominal_height: 1.50"), encoding="utf-8")
    task = load_task("dive", {"robot": str(folder / "robot.yaml")})
    console = Console(width=200, record=True, file=io.StringIO())
    _describe(task, BatchEnv(task), console)
    cells = [[cell.strip() for cell in line.split("│")] for line in console.export_text().splitlines()]
    rows = {row[1]: row[2] for row in cells if len(row) == 4}
    assert rows["nominal height"] == "0.496 in robot.yaml puts the feet on the ground; they are 1.00 m above the ground"
    assert rows["nominal pose"].startswith("held for 1 s: base at ")


def test_a_file_with_an_equals_sign_in_its_name_is_checked(tmp_path: Path) -> None:
    shutil.copy(TASKS_DIR / "dive.yaml", tmp_path / "a=b.yaml")
    done = program("check", "a=b.yaml", "rho=0.4", cwd=tmp_path)
    assert done.returncode == 0 and "a=b.yaml is right." in done.stdout


def test_it_says_what_a_task_extends_and_shows_the_merged_values(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("extends: dive\nrho: 0.25\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\nmodes: {flip: {h: 1.2}}\n")
    done = program("check", "b.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "b.yaml extends a.yaml, which extends tasks/dive.yaml." in done.stdout
    assert "h 1.2" in done.stdout and "rho 0.25 on z, wx, wy" in done.stdout and "b.yaml is right." in done.stdout


def test_several_tasks_are_all_checked(tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text("rho: 0.5")
    done = program("check", "dive", "stairs", "wrong.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout.count("is right.") == 2 and "wrong.yaml" in done.stderr
    done = program("check", "dive", "stairs", "out=x", cwd=tmp_path)
    assert "'out' takes the picture of one task" in done.stderr
