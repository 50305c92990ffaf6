"""Policies by name or directory."""

from __future__ import annotations

from pathlib import Path

import pytest

from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.runs.policies import policy_dir


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("nowhere", "'nowhere' is neither a run directory nor a shipped policy"),
        ("../policies/parkour", "is neither a run directory nor a shipped policy"),
        ("", "'' is a directory here, but neither a run nor a policy"),
        ("parkour", "'parkour' is a directory here, but neither a run nor a policy"),  # not the shipped one
    ],
)
def test_a_name_that_is_no_policy_is_a_sentence(name: str, sentence: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parkour" / "2026-01-31_12-00-00").mkdir(parents=True)
    with pytest.raises(KeyError, match=sentence):
        policy_dir(name)


def test_no_file_that_ships_is_a_pickle() -> None:
    files = (path for path in (PACKAGE / "policies").glob("*/**/*") if path.is_file() and "wip" not in path.parts)
    assert {path.suffix for path in files} <= {".json", ".safetensors", ".md"}
