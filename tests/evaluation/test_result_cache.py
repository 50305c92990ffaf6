"""ResultCache that survive an interruption."""

from __future__ import annotations

from pathlib import Path

import pytest

from ogmp_sb3.evaluation.result_cache import ResultCache


def count_calls(value: object) -> tuple[list[int], object]:
    calls: list[int] = []
    return calls, lambda: calls.append(1) or value


def test_a_result_is_computed_once_and_found_again_by_its_settings(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "results.jsonl"
    calls, compute = count_calls({"mean": 0.1, "ci95": [0.0, 1 / 3]})
    first = ResultCache(path).remember({"seed": 0, "episodes": 5}, compute)
    again = ResultCache(path)
    assert {"episodes": 5, "seed": 0} in again  # in whatever order
    assert again.remember({"episodes": 5, "seed": 0}, compute) == first
    assert len(calls) == 1
    again.remember({"episodes": 5, "seed": 1}, compute)
    assert len(calls) == 2


def test_results_of_other_files_are_known_and_left_where_they_are(tmp_path: Path) -> None:
    calls, compute = count_calls(1.0)
    ResultCache(tmp_path / "shared.jsonl").remember({"seed": 0}, compute)
    before = (tmp_path / "shared.jsonl").read_bytes()
    own = ResultCache(tmp_path / "own.jsonl", tmp_path / "shared.jsonl", tmp_path / "nowhere.jsonl")
    assert [own.remember({"seed": seed}, compute) for seed in (0, 1)] == [1.0, 1.0]
    assert len(calls) == 2
    assert (tmp_path / "shared.jsonl").read_bytes() == before
    assert {"seed": 0} not in ResultCache(tmp_path / "own.jsonl")


def test_results_before_an_interruption_are_kept(tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    results = ResultCache(tmp_path / "results.jsonl")
    results.remember({"cell": 1}, lambda: 1.0)
    with pytest.raises(KeyboardInterrupt):
        results.remember({"cell": 2}, interrupt)
    kept = ResultCache(tmp_path / "results.jsonl")
    assert {"cell": 1} in kept and {"cell": 2} not in kept


def test_a_line_that_was_cut_off_is_passed_over_and_does_not_spoil_the_next(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    ResultCache(path).remember({"cell": 1}, lambda: 1.0)
    with path.open("ab") as file:
        file.write(b'\n{"settings": {"cell": 2}, "resu\xff')
    ResultCache(path).remember({"cell": 3}, lambda: 3.0)
    kept = ResultCache(path)
    assert [{"cell": i} in kept for i in (1, 2, 3)] == [True, False, True]
