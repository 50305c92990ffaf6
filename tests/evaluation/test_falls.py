"""Where robots fall, on episodes made by hand and on one that is played."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from helpers.records import record
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.episodes import play_episodes
from ogmp_sb3.evaluation.falls import (
    BEFORE,
    BEHIND,
    FallRow,
    fall_rows,
    falls_csv,
    falls_tables,
    passages,
)
from ogmp_sb3.evaluation.record import EpisodeRecord
from ogmp_sb3.runs.policies import load_policy

PACE = {"mode": "pace", "v": 1.0, "length": 1.0}  # 0 to 1 m
JUMP = {"mode": "jump", "w": 0.5, "h": 0.3, "v": 1.0, "run_up": 0.5}  # 1 m
LEAP = {"mode": "leap", "w": 0.4, "d": 0.5, "v": 1.0, "run_up": 0.6}  # 1 m
PARKOUR = load_task("parkour")


def episode(x: float | list[float], termination: str, *modes: dict[str, Any], **fields: Any) -> EpisodeRecord:
    """An episode from 0 to some places along a track."""
    places = np.array([0.0, *np.atleast_1d(x)])
    position = np.outer(places, [1.0, 0.0, 0.0])
    given = {"base_pos_w": position, "reward": np.zeros(len(places)), "termination": termination, "modes": modes}
    return record(**{**given, **fields})


def found(each: EpisodeRecord) -> list[tuple[str, str, bool]]:
    return [(passage.call.name, passage.before, passage.fell) for passage in passages(each)]


@pytest.mark.parametrize(
    ("x", "termination", "expected"),
    [
        (0.5, "fall", [("pace", "(start)", True)]),
        (1.2, "fall", [("pace", "(start)", False), ("jump", "pace", True)]),
        (2.0, "fall", [("pace", "(start)", False), ("jump", "pace", False), ("leap", "jump", True)]),
        (1.2, "time_limit", [("pace", "(start)", False)]),  # how the jump would have ended is not known
        (2.5, "max_distance", [("pace", "(start)", False), ("jump", "pace", False)]),
        (0.5, "time_limit", []),
        (1.2, "unstable", [("pace", "(start)", False), ("jump", "pace", True)]),
        (-0.1, "fall", [("pace", "(start)", True)]),  # backwards
        ([2.1, 1.9], "fall", [("pace", "(start)", False), ("jump", "pace", True)]),  # back from the leap
    ],
)
def test_the_place_of_the_base_decides_where_it_fell(x: Any, termination: str, expected: list) -> None:
    assert found(episode(x, termination, PACE, JUMP, LEAP, PACE)) == expected


def test_who_falls_behind_a_mode_that_was_passed_is_counted_there_too() -> None:
    def behind(each: EpisodeRecord) -> list[bool]:
        return [passage.fell_behind for passage in passages(each)]

    assert behind(episode(2.1, "fall", PACE, JUMP, LEAP, PACE)) == [False, True, False]
    assert behind(episode(2.1, "time_limit", PACE, JUMP, LEAP, PACE)) == [False, False]
    flat = {"mode": "pace", "v": 1.0, "length": 1.0}
    assert behind(episode(2.2, "fall", PACE, JUMP, flat, flat, track_length=2.0)) == [False, True, False]
    assert behind(episode(3.2, "fall", PACE, JUMP, flat, flat, track_length=2.0)) == [False, False, False]  # far behind


def test_the_flat_ground_behind_a_track_is_no_instance_of_a_mode() -> None:
    behind = [{"mode": "pace", "v": 1.0, "length": 1.0}] * 3
    track = (PACE, JUMP, *behind)
    jumped = [("pace", "(start)", False), ("jump", "pace", False)]
    assert found(episode(1.9, "time_limit", *track, track_length=1.5)) == jumped[:1]
    assert found(episode(3.5, "time_limit", *track, track_length=1.5)) == [*jumped, (BEHIND, "jump", False)]
    assert found(episode(3.5, "fall", *track, track_length=2.0)) == [*jumped, (BEHIND, "jump", True)]
    assert found(episode(1.9, "fall", *track, track_length=1.5)) == [jumped[0], ("jump", "pace", True)]


def test_a_timed_mode_is_under_way_from_its_query_to_the_next() -> None:
    modes = ({"mode": "flip", "r": "left", "h": 1.0}, {"mode": "settle"}, {"mode": "settle"}, {"mode": "settle"})

    def timed(*phases: int, termination: str = "fall") -> EpisodeRecord:
        phase = np.array([0, *phases])
        return record(phase=phase, reward=np.zeros(len(phase)), termination=termination, modes=modes)

    assert found(timed(1, 2)) == [("flip", "(start)", True)]
    assert found(timed(1, 2, 3, 1, 2)) == [("flip", "(start)", False), ("settle", "flip", True)]
    assert found(timed(1, 2, 3, 1, 2, 1, termination="time_limit")) == [
        ("flip", "(start)", False), ("settle", "flip", False),
    ]  # fmt: skip
    assert found(timed()) == [("flip", "(start)", True)]  # the simulation failed in the first step


def jumps(*heights: float, fell: bool) -> EpisodeRecord:
    """An episode over jumps of some heights, that ends in the last of them or behind it."""
    modes = [{**JUMP, "h": h} for h in heights]
    return episode(len(heights) - 0.2 if fell else len(heights) + 0.1, "fall" if fell else "time_limit", *modes, PACE)


def test_falls_are_counted_by_size_and_by_the_mode_before() -> None:
    task = load_task("parkour", {"modes.jump.h": [0.2, 0.4]})
    records = [jumps(0.21, 0.39, fell=True), jumps(0.22, 0.24, fell=False), jumps(0.38, fell=True)]
    rows = {(row.mode, row.by, row.title): (row.falls, row.share.n) for row in fall_rows(task, records)}
    assert rows == {
        ("jump", "", ""): (2, 5),
        ("jump", "h", "0.20 to 0.25"): (0, 3),
        ("jump", "h", "0.35 to 0.40"): (2, 2),  # none between, no row
        ("jump", BEFORE, "(start)"): (1, 3),
        ("jump", BEFORE, "jump"): (1, 2),
    }
    (all_jumps,) = (row for row in fall_rows(task, records) if not row.by)
    z = 1.959964  # Wilson (1927): the roots of (p - 2/5)^2 = z^2 p (1 - p) / 5
    ends = np.roots([1 + z**2 / 5, -(2 * 0.4 + z**2 / 5), 0.4**2])
    assert (all_jumps.share.low, all_jumps.share.high) == (pytest.approx(min(ends)), pytest.approx(max(ends)))


def test_words_are_kinds_of_their_own() -> None:
    def dive(direction: str, termination: str) -> EpisodeRecord:
        modes = ({"mode": "flip", "r": direction, "h": 1.0}, {"mode": "settle"})
        return record(phase=np.array([0, 1, 2, 1]), reward=np.zeros(4), termination=termination, modes=modes)

    def in_flip(direction: str) -> EpisodeRecord:
        modes = ({"mode": "flip", "r": direction, "h": 1.0},)
        return record(phase=np.array([0, 1]), reward=np.zeros(2), termination="fall", modes=modes)

    rows = fall_rows(load_task("dive"), [dive("left", "time_limit"), dive("front", "fall"), in_flip("left")])
    assert [(row.mode, row.by, row.value, row.falls, row.falls_behind, row.share.n) for row in rows] == [
        ("flip", "", None, 1, 1, 3), ("flip", "r", "front", 0, 1, 1), ("flip", "r", "left", 1, 0, 2),
        ("settle", "", None, 1, 0, 1),
    ]  # fmt: skip


def test_who_runs_into_a_gap_of_3_m_falls_in_the_leap() -> None:
    sequence = [{"pace": {"v": 1.2, "length": 2.0}}, {"leap": {"w": 3.0, "run_up": 0.6}}, "pace"]
    changes = {"sampling": {"order": "sequence", "sequence": sequence}, "modes.leap.w": [0.2, 3.0]}
    task = load_task("parkour", {**changes, "evaluation.episode_steps": 200}).for_evaluation()
    records = play_episodes(load_policy("parkour"), task, 4, 0)
    assert all(each.termination == "fall" and 2.6 < each.base_pos_w[-1, 0] < 5.6 for each in records)
    rows = {(row.mode, row.by, row.title): (row.falls, row.share.n) for row in fall_rows(task, records)}
    assert rows == {("pace", "", ""): (0, 4), ("leap", "", ""): (4, 4)}  # gaps of one size, behind one mode


def test_rows_survive_json_and_a_file() -> None:
    rows = fall_rows(PARKOUR, [jumps(0.21, 0.3, fell=True), episode(1.2, "fall", PACE, JUMP)])
    assert [FallRow.from_data(json.loads(json.dumps(row.as_data()))) for row in rows] == rows
    first, *_ = falls_csv(rows)
    assert (first["mode"], first["instances"], first["falls"]) == ("jump", 3, 2)
    assert falls_csv([]) == []


def test_the_tables_say_how_many_episodes_ended_by_a_fall() -> None:
    rows = fall_rows(PARKOUR, [jumps(0.21, 0.3, fell=True), episode(1.2, "fall", PACE, JUMP)])
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(falls_tables({"falls": [row.as_data() for row in rows], "episodes": 3, "copies": 1}))
    text = console.export_text()
    assert "2 of 2 episodes ended by a fall. Intervals are Wilson's, over instances." in text
    assert "1 of 3 episodes is a copy of another and counts once." in " ".join(text.split())


def test_without_a_passage_there_are_no_rows() -> None:
    assert fall_rows(PARKOUR, [episode(0.5, "time_limit", PACE)]) == []
