"""ogmp-share as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from helpers.hub import running_hub, use
from helpers.programs import program
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.storage import verify

ESTIMATE = {"mean": 3.0, "std": 1.0, "n": 5, "ci95": [2.0, 4.0]}


def measured(folder: Path, policy: str) -> Path:
    folder.mkdir(parents=True)
    report = {"policy": policy, "episodes": 5, "seed": 0, "protocol": "paper", "overrides": []}
    (folder / "metrics.json").write_text(json.dumps({**report, "metrics": {"return": ESTIMATE}}))
    return folder


def test_a_dry_run_writes_what_would_be_uploaded_and_is_a_policy(tmp_path: Path) -> None:
    measured(tmp_path / "evaluation" / "dive", load_policy("dive").digest)
    (tmp_path / "dive.gif").touch()
    for _ in range(2):  # its own directory is written again
        done = program("share", "run=dive", "repo=me/dive", "out=out", "license=MIT", "replay=dive.gif", cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        assert "README.md" in done.stdout and done.stdout.endswith("Nothing was uploaded.\n")
    verify(tmp_path / "out", "policy.json", "policy.safetensors")
    assert load_policy(tmp_path / "out").digest == load_policy("dive").digest
    card = (tmp_path / "out" / "README.md").read_text()
    assert "license: mit" in card and "| return | 3.000 | 2.000 .. 4.000 | 1.000 | 5 |" in card
    assert "![replay/dive.gif]" in card
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_what_is_shared_is_played_and_measured_from_the_hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("huggingface_hub", reason="needs the extra 'hub'")
    with running_hub() as hub:
        use(hub, tmp_path / "cache", monkeypatch)
        done = program("share", "run=dive", "repo=me/dive", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout == f"{hub.endpoint}/me/dive\nTo see it:  ogmp-play run=hf:me/dive\n"
        assert "no licence" in done.stderr
        done = program("eval", "run=hf:me/dive", "episodes=1", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        report = json.loads((tmp_path / "evaluation" / "dive" / "metrics.json").read_text())
        assert report["policy"] == load_policy("dive").digest
        again = program("share", "run=hf:me/dive", "repo=me/copy", cwd=tmp_path)  # with what was just measured
        assert again.returncode == 0, again.stderr
        assert "## Evaluation\n\n`ogmp-eval run=hf:me/copy" in hub.repos["me/copy"].commits[-1]["README.md"].decode()


def test_numbers_of_another_policy_are_left_out_or_refused(tmp_path: Path) -> None:
    measured(tmp_path / "evaluation" / "dive", "another")
    done = program("share", "run=dive", "out=out", "license=mit", cwd=tmp_path)
    assert done.returncode == 0
    assert "metrics.json: is of another policy, and left out; measure this one with: ogmp-eval run=dive" in done.stderr
    assert "Not evaluated yet" in (tmp_path / "out" / "README.md").read_text()
    done = program("share", "run=dive", "out=out", "evaluation=evaluation/dive", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "is of another policy than 'dive'" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run=dive"], "give repo=<owner>/<name>, or out=<directory> to see what would be uploaded."),
        (["run=dive", "repo=dive"], "'dive' names no owner: give repo=<owner>/<name>."),
        (["run=dive", "repo=me/dive@main"], "'me/dive@main' is no repository of the Hub"),
        (["run=diwe", "out=out"], "Did you mean 'dive'?"),
        (["run=a.zip", "out=out"], "'a.zip': an SB3 .zip holds pickles"),
        (["run=dive", "out=full"], "'full': holds something else: give an empty directory, or a new one."),
        (["run=dive", "out=out", "replay=none.mp4"], "'replay': there is no 'none.mp4'."),
        (["run=dive", "out=out", "evaluation=nowhere"], "nowhere/metrics.json: not readable"),
        (["run=dive", "out=out", "licence=mit"], "unknown key 'licence'"),
    ],
)
def test_a_mistake_is_a_sentence_and_nothing_is_written(arguments: list[str], message: str, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    (tmp_path / "a.zip").touch()
    done = program("share", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out").exists() and not list(tmp_path.glob(".*"))
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.tex"]
