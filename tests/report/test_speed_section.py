"""What a report says of commanded and measured speed."""

from __future__ import annotations

import csv
from pathlib import Path

from ogmp_sb3.evaluation.speed import SpeedRow
from ogmp_sb3.evaluation.statistics import Estimate
from ogmp_sb3.report.page import Picture, Table
from ogmp_sb3.report.speed_section import speed_parts

COMMAND = Estimate(0.7, 0.1, 4, 0.6, 0.8)
MEASURED = Estimate(0.95, 0.1, 4, 0.9, 1.0)
ERROR = Estimate(0.25, None, 1, None, None)


def test_there_is_a_picture_with_its_data_and_a_table(tmp_path: Path) -> None:
    rows = [SpeedRow("pace", None, COMMAND, MEASURED, MEASURED), SpeedRow("pace", (0.6, 0.8), COMMAND, MEASURED, ERROR)]
    picture, table = speed_parts(rows, tmp_path)
    assert isinstance(picture, Picture) and isinstance(table, Table)
    assert [row[0].strip() for row in table.rows] == ["pace", "0.6 to 0.8"]
    assert table.rows[1][1:] == ["0.70", "0.95 [0.90\u202f…\u202f1.00]", "0.25 [-]", "1"]
    with (tmp_path / "speeds.csv").open(newline="") as file:
        whole, band = csv.DictReader(file)
    assert (whole["from"], band["from"], band["to"], band["measured_low"]) == ("", "0.6", "0.8", "0.9")
    assert (band["error"], band["error_low"], band["n"]) == ("0.25", "", "1")


def test_timed_modes_have_no_such_part(tmp_path: Path) -> None:
    assert speed_parts([], tmp_path) == []
    assert not list(tmp_path.iterdir())
