"""The warning that an encoder was trained on other references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ogmp_sb3.commands import check
from ogmp_sb3.commands.encoder_warning import encoder_warning, warn_once
from ogmp_sb3.commands.train import program as train
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.load import task_from_data
from ogmp_sb3.config.yaml_files import apply_overrides, read_yaml
from ogmp_sb3.guidance.encoder_scope import TRAINED_ON, scope
from ogmp_sb3.guidance.encoder_training import AutoEncoder, save_encoder
from ogmp_sb3.runs.training import Job

KEY = "'modes.flip.h' was 1 to 1.75, and is 1 to 2.5 in this task"


@pytest.fixture
def encoder(tmp_path: Path) -> Path:
    """Trained on dive."""
    task = task_from_data(read_yaml(TASKS_DIR / "dive.yaml"), TASKS_DIR / "dive.yaml")
    save_encoder(AutoEncoder(np.zeros(13), np.ones(13)), tmp_path / "mine", {TRAINED_ON: scope(task)})
    return tmp_path / "mine"


def warning(encoder: Path, path: Path, *overrides: str) -> str | None:
    data = apply_overrides(read_yaml(path), [f"encoder={encoder}", *overrides], "")
    return encoder_warning(task_from_data(data, path), data, path)


def test_the_command_that_trains_another_encoder_has_what_differs_from_the_file(encoder: Path, tmp_path: Path) -> None:
    said = warning(encoder, TASKS_DIR / "dive.yaml", "modes.flip.h=[1.0,2.5]", "rho=0.1", "oracle=lqr")
    assert said is not None and KEY in said and "(oracle differs too)" in said
    command = "ogmp-encode task=dive 'modes.flip.h=[1.0,2.5]' oracle=lqr out=encoders/my_dive trains one"
    assert said.endswith(f"; {command} for encoder=my_dive.")
    mine = tmp_path / "my dive.yaml"
    mine.write_text((TASKS_DIR / "dive.yaml").read_text().replace("h: [1.0, 1.75]", "h: [1.0, 2.5]"))
    said = warning(encoder, mine)
    assert said is not None and KEY in said
    assert f"; ogmp-encode 'task={mine}' 'out=encoders/my_my dive' trains one" in said
    assert warning(encoder, TASKS_DIR / "dive.yaml", "rho=0.1") is None


def test_check_warns_before_it_says_that_a_task_is_right(encoder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check._run(["dive", f"encoder={encoder}", "modes.flip.h=[1.0,2.5]"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2].startswith("Warning: tasks/dive.yaml: the encoder") and KEY in lines[-2]
    assert lines[-1] == "tasks/dive.yaml is right."


def test_a_sweep_warns_once_and_trains_all_the_same(
    encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs: list[Job] = []
    monkeypatch.setattr(train, "begin_or_go_on", lambda job: jobs.append(job) or 0.0)
    warn_once.cache_clear()
    swept: list[Any] = ["-m", "task=dive", f"encoder={encoder}", "modes.flip.h=[1.0,2.5]", "seed=1,2"]
    train._train([*swept, f"hydra.sweep.dir={tmp_path / 'sweep'}"])
    printed = capsys.readouterr().out
    assert [job.config.seed for job in jobs] == [1, 2]
    assert printed.count("Warning: ") == printed.count(KEY) == 1
