"""The scripts of ``examples/elsewhere``: one task under several libraries, with a budget of seconds."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from helpers.paths import ROOT

FOLDER = ROOT / "examples" / "elsewhere"
SMALLER = {
    "SAMPLES = 1_000_000": "SAMPLES = 256",
    "ITERATIONS = 244": "ITERATIONS = 2",
    "UPDATES, STEPS, ENVS = 244, 64, 64": "UPDATES, STEPS, ENVS = 2, 16, 4",
    "num_envs=64": "num_envs=4",
    "n_steps=64, batch_size=1024": "n_steps=16, batch_size=64",
    '"num_steps_per_env": 64': '"num_steps_per_env": 16',
}
PRINTED = {"with_sb3": r"total_timesteps +\| 256", "with_rsl_rl": r"Total steps: +128", "with_torch": r"128 samples, "}
"""What each says of its last update."""


@pytest.mark.parametrize("script", sorted(FOLDER.glob("*.py")), ids=lambda script: script.stem)
def test_the_script_trains(script: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    if script.stem == "with_rsl_rl" and importlib.util.find_spec("rsl_rl") is None:
        pytest.skip("needs the extra 'rsl-rl'")
    monkeypatch.chdir(tmp_path)
    torch.set_num_threads(1)
    code = script.read_text(encoding="utf-8")
    for whole, part in SMALLER.items():
        code = code.replace(whole, part)
    assert code.count("64") <= 2  # of comments and minibatches
    exec(compile(code, script.name, "exec"), {})
    assert re.search(PRINTED[script.stem], capsys.readouterr().out)


def test_every_script_is_on_the_page() -> None:
    page = (ROOT / "docs" / "sb3.md").read_text(encoding="utf-8")
    shown = re.findall(r"^```\{literalinclude\} \.\./examples/elsewhere/(\w+)\.py", page, re.MULTILINE)
    assert shown == list(PRINTED)
    assert sorted(shown) == sorted(script.stem for script in FOLDER.glob("*.py"))
