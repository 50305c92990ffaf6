"""What run= names is said aloud."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.run_directories import make_run
from ogmp_sb3.commands.named_run import named_run


@pytest.mark.parametrize(
    ("run", "found", "note"),
    [
        ("latest", "runs/a", "ogmp-eval: 'latest' is runs/a\n"),
        ("runs/a", "runs/a", ""),
        ("dive", "dive", ""),
        ("parkour", "parkour", "ogmp-eval: 'parkour' is the directory here, not the policy of that name that ships ("),
    ],
)
def test_a_note_says_what_a_name_stands_for(
    run: str, found: str, note: str, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("parkour", "runs/a"):
        make_run(tmp_path / folder, ["task=dive"], checkpoint=256)
    assert named_run("ogmp-eval", run) == found
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith(note) and bool(said.err) == bool(note)
