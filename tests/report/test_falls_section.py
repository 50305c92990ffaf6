"""What a report says of falls, and of tracks without end."""

from __future__ import annotations

import csv
from pathlib import Path
from types import SimpleNamespace

import pytest

from ogmp_sb3.evaluation.evaluate import Evaluation
from ogmp_sb3.evaluation.falls import BEFORE, BEHIND, FallRow
from ogmp_sb3.evaluation.statistics import estimate
from ogmp_sb3.evaluation.survival import DISTANCE, TIME, survival_curve
from ogmp_sb3.report.falls_section import endless, falls
from ogmp_sb3.report.page import Picture, Table


def row(mode: str, by: str, value: tuple[float, float] | str | None, fell: int, n: int) -> FallRow:
    return FallRow(mode, by, value, fell, 1, estimate(i < fell for i in range(n)))


ROWS = [
    row("jump", "", None, 2, 10),
    row("jump", "h", (0.2, 0.3), 0, 6),
    row("jump", "h", (0.3, 0.4), 2, 4),
    row("jump", BEFORE, "leap", 1, 5),
    row("jump", BEFORE, "pace", 1, 5),
    row(BEHIND, "", None, 0, 3),
]


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_falls_have_a_picture_with_all_rows_and_a_table_of_modes(tmp_path: Path) -> None:
    section = falls(ROWS, tmp_path)
    assert section is not None
    picture, table = section.parts
    assert isinstance(picture, Picture) and isinstance(table, Table)
    assert [cells[:4] for cells in table.rows] == [["jump", "10", "2", "0.200"], [BEHIND, "3", "0", "0.000"]]
    assert table.columns[-2:] == ["95 % interval over instances", "passed, but fell right behind"]
    assert [cells[-1] for cells in table.rows] == ["1", "1"]
    found = read_csv(tmp_path / "falls.csv")
    assert len(found) == len(ROWS)
    assert [found[2][key] for key in ("mode", "by", "from", "to", "instances", "falls")] == [
        "jump", "h", "0.3", "0.4", "4", "2",
    ]  # fmt: skip
    assert (found[3]["by"], found[3]["word"]) == ("mode before", "leap")


def test_without_an_instance_there_is_no_section(tmp_path: Path) -> None:
    assert falls([], tmp_path) is None
    assert not list(tmp_path.iterdir())


def test_an_endless_test_has_its_median_and_its_curves(tmp_path: Path) -> None:
    ends, fell = [10.0, 20.0, 30.0, 40.0], [True, False, True, False]
    survival = {DISTANCE: survival_curve(ends, fell), TIME: survival_curve([x / 2 for x in ends], fell)}
    found = Evaluation({}, {}, 0.0, {"fall": 2, "max_distance": 2}, falls=tuple(ROWS), survival=survival)
    subject = SimpleNamespace(endless=lambda *_: found, endless_steps=lambda *_: 4)
    section = endless(subject, 4, 0, 40.0, tmp_path)  # type: ignore[arg-type]
    assert "Median to a fall: 30.0 m (95 % interval over episodes: 10.0 .. open); 15.0 s (" in section.text
    shares = section.parts[1]
    assert isinstance(shares, Table) and "4 episodes, of which 2 ended by a fall" in shares.caption
    assert [cells[0] for cells in shares.rows] == ["0.5", "1", "2", "5", "10", "20"]
    assert [cells[1] for cells in shares.rows[-2:]] == ["0.750", "0.750"]
    rows = read_csv(tmp_path / "survival.csv")
    assert [(each["curve"], float(each["at"]), float(each["share"])) for each in rows[:2]] == [
        ("distance_m", 10.0, pytest.approx(0.75)), ("distance_m", 20.0, pytest.approx(0.75)),
    ]  # fmt: skip
    assert (tmp_path / "falls_endless.csv").is_file()
