"""What a user meets first: the names of ``ogmp_sb3``, their types, the first examples, and a first plug-in."""

from __future__ import annotations

import ast
import pydoc
import re
import rlcompleter
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ogmp_sb3
import ogmp_sb3.extend
from helpers.paths import ROOT
from helpers.plugins import lay
from helpers.programs import SMALL, program
from helpers.views import make_view
from ogmp_sb3.config import registry
from ogmp_sb3.config.load import load_task
from ogmp_sb3.config.registry import NameTaken
from ogmp_sb3.env.observations import Signal
from ogmp_sb3.runs.run_directory import checkpoint_dirs

PACKAGE = ROOT / "ogmp_sb3"


def example(text: str | None) -> list[str]:
    """The indented code of a docstring, one text for each ``::``."""
    blocks = re.findall(r"::\n\n((?:    .*\n|\n)+)", str(text))
    return [textwrap.dedent(block) for block in blocks]


def smaller(code: str) -> str:
    """An example with a budget of seconds."""
    for whole, part in {"100_000": "128", "num_envs=64": "num_envs=2", "episodes=4": "episodes=1"}.items():
        code = code.replace(whole, part)
    return code


# ---- the names ----


def test_dir_and_completion_show_the_public_names_and_nothing_else() -> None:
    public = {*ogmp_sb3.__all__, "__version__"}
    assert set(dir(ogmp_sb3)) == public
    completer, found = rlcompleter.Completer({"ogmp_sb3": ogmp_sb3}), set()
    while (name := completer.complete("ogmp_sb3.", len(found))) is not None:
        found.add(name)
    assert {name.removeprefix("ogmp_sb3.").rstrip("()") for name in found} == {n for n in public if n[0] != "_"}
    for name in public:
        assert getattr(ogmp_sb3, name) is not None


def test_help_begins_with_a_quick_start() -> None:
    text = pydoc.plain(pydoc.render_doc(ogmp_sb3))
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if "from ogmp_sb3 import" in line)
    assert start < 12
    assert "model.learn" in "".join(lines[start : start + 10])


def test_the_quick_start_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = example(ogmp_sb3.__doc__)
    assert 5 <= len([line for line in code.splitlines() if line]) <= 10
    exec(compile(smaller(code), "quick start", "exec"), {})
    assert (tmp_path / "my_policy.zip").is_file()
    assert re.fullmatch(r"\d+ \w+\n", capsys.readouterr().out)


def test_importing_stays_cheap() -> None:
    code = (
        "import sys, ogmp_sb3.extend; print({'torch', 'stable_baselines3', 'matplotlib', 'hydra'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "set()", done.stderr


SCRIPT = """
import numpy as np
import sb3_contrib
from ogmp_sb3 import Player, RecurrentPPO, TaskConfig, load_policy, make_env, make_model, play_episodes, write_video
from ogmp_sb3.extend import EnvView, Plateau, Segment, Span, mode, reward

env = make_env("parkour", num_envs=2, seed=1, rho=0.4)
model: RecurrentPPO = make_model(env, learning_rate=1e-4, n_steps=16, batch_size=32)
learned: RecurrentPPO = model.learn(64)
stock: sb3_contrib.RecurrentPPO = make_model(env, kind=sb3_contrib.RecurrentPPO)
model.no_such_thing  # type: ignore[attr-defined]

loaded = load_policy("parkour")
task: TaskConfig = loaded.task.for_evaluation()
lengths: list[int] = [episode.steps for episode in play_episodes(loaded.policy, task, 1, seed=0)]

player = Player(task, loaded.policy)
player.command("jump", w=0.8, h=0.3)
write_video([player.frame, player.step()], task, "two.png")


@mode
def stroll(v: float, length: float = 0.6) -> Segment:
    ground = Plateau(start=0.0, end=length, top=0.0)
    return Segment(length=length, plateaus=(ground,), spans=(Span(end=length, velocity=(v, 0.0)),))


@reward("at_rest")
def rest(view: EnvView, weight: float) -> np.ndarray:
    still: np.ndarray = weight * np.exp(-np.linalg.norm(view.joint_vel, axis=1))
    return still


distance: float = stroll(1.0).length
stroll("fast")  # type: ignore[arg-type]
rest(weight=1.0)  # type: ignore[call-arg]
"""


def test_a_user_s_script_is_typed(tmp_path: Path, pytestconfig: pytest.Config, monkeypatch) -> None:
    """By the strict rules, under which an ``ignore`` that is not needed is an error too."""
    pytest.importorskip("mypy", reason="checking types needs the extra 'dev'")
    (tmp_path / "script.py").write_text(SCRIPT)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # as an editable install has it
    cache = pytestconfig.cache.mkdir("mypy_of_a_script")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(cache), "script.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == "Success: no issues found in 1 source file\n", done.stdout + done.stderr


def test_a_video_as_the_page_about_playing_makes_it(opengl, tmp_path: Path, monkeypatch) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="videos need the extra 'viewer'")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "play.md").read_text(encoding="utf-8")
    _, code = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    exec(compile(code.replace("range(200)", "range(20)").replace("step == 60", "step == 6"), "play.md", "exec"), names)
    assert len(names["frames"]) == 21
    assert (tmp_path / "jump.mp4").stat().st_size > 1000


def test_a_replay_as_the_page_about_playing_makes_it(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "play.md").read_text(encoding="utf-8")
    code, _ = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    exec(compile(code.replace("episodes=4", "episodes=1"), "play.md", "exec"), names)
    assert len(names["episodes"]) == 1
    assert 50_000 < (tmp_path / "replay" / "index.html").stat().st_size < 1_000_000


# ---- extend ----


def imported(source: str) -> set[str]:
    """The modules of ours that a source imports."""
    nodes = list(ast.walk(ast.parse(source)))
    names = {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    names |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return {name for name in names if name.partition(".")[0] == "ogmp_sb3"}


def test_no_module_of_ours_imports_extend() -> None:
    sources = [*PACKAGE.glob("*.py"), *PACKAGE.glob("[!_]*/**/*.py")]
    assert len(sources) > 90
    assert [path for path in sources if "ogmp_sb3.extend" in imported(path.read_text(encoding="utf-8"))] == []


def test_plugins_in_the_examples_and_the_docs_import_from_extend_alone() -> None:
    files = (ROOT / "examples" / "ogmp_pup").rglob("*.py")
    found = {path.name: imported(path.read_text(encoding="utf-8")) for path in files if "build" not in path.parts}
    assert set().union(*found.values()) == {"ogmp_sb3.extend"}
    page = (ROOT / "docs" / "tutorials" / "own-oracle.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert set().union(*map(imported, blocks)) == {"ogmp_sb3", "ogmp_sb3.extend"}


@pytest.mark.parametrize("kind", [kind.kind for kind in registry.KINDS])
def test_every_kind_has_a_decorator_that_registers_and_gives_the_function_back(kind: str, forget: None) -> None:
    def mine(view: Any) -> float:
        return 1.0

    functions = next(functions for functions in registry.KINDS if functions.kind == kind)
    decorate = getattr(ogmp_sb3.extend, kind)
    assert decorate(mine) is mine
    assert decorate("another")(mine) is mine
    assert functions.get("mine") is functions.get("another") is mine
    with pytest.raises(NameTaken, match=f"{kind} 'mine' of .* is registered already"):
        decorate()(mine)


def test_all_that_extend_offers_is_there() -> None:
    assert set(ogmp_sb3.extend.__all__) <= set(vars(ogmp_sb3.extend))
    assert ogmp_sb3.extend.Signal is Signal


# ---- a first plug-in: a mode, an oracle and a reward, as ``extend`` shows them ----

TASK = """
description: Stroll over flat ground.
robot: hector
control_dt: 0.03
physics_dt: 0.002
episode_steps: 100
modes:
  stroll: {v: [0.5, 0.8]}
oracle: shift
oracle_params: {shift: {share: 0.7}}
feedback: [x, y, z]
horizon: 30
rho: 0.4
bound: {x: 1.0}
observations: {proprioception: {}, clock: {}}
rewards: {REWARD: {weight: 0.5}, position_tracking: {weight: 0.5, sharpness: 5.0}}
terminations: {fall: {min_height: 0.3}}
evaluation: {metrics: [no_fall_fraction]}
objective: track_displacement
"""
BROKEN = """
import numpy as np
from ogmp_sb3.extend import EnvView, reward

@reward
def spoilt(view: EnvView, weight: float) -> np.ndarray:
    return ANSWER
"""


def lay_first(folder: Path, reward: str = "upright", answer: str = "None") -> None:
    """The plug-in of the docstring, with one more reward."""
    (code,) = example(ogmp_sb3.extend.__doc__)
    broken = BROKEN.replace("ANSWER", answer)
    lay(folder, "plug_first", {"__init__.py": code + broken, "tasks/strolling.yaml": TASK.replace("REWARD", reward)})


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forget: None) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_a_plugin_written_from_the_docs_trains(folder: Path) -> None:
    lay_first(folder)
    done = program("check", "task=strolling", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "plug_first 1.2" in done.stdout
    done = program("train", "task=strolling", *SMALL, "total_timesteps=4096", "hydra.run.dir=run", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert int(checkpoint_dirs(folder / "run")[-1].name) == 4096
    ours = registry.rewards.get("upright")(make_view(2, base_pos_w=np.array([[0, 0, 0.5], [0, 0, 0.2]])), weight=0.5)
    np.testing.assert_array_equal(ours, [0.5, 0.0])
    assert load_task("strolling").oracle_params["shift"] == {"share": 0.7}


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("view.joint_vel[:, :1]", r"what reward 'spoilt' returns must be .* \(8,\); it is an array of shape \(8, 1\)"),
        ("np.full(len(view.state), np.nan)", "what reward 'spoilt' returns must be finite; it holds nan"),
        ("weight", "what reward 'spoilt' returns must be .*; it is the number 0.5"),
        (
            "np.where(view.phase > 1, np.nan, 0.1)",
            "stopped at step 1280: 10 updates in a row were undone, .* a reward of the rollout is not finite",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:Update at step")
def test_a_reward_that_is_wrong_ends_the_training_with_a_sentence(folder: Path, answer: str, message: str) -> None:
    lay_first(folder, "spoilt", answer)
    done = program("train", "task=strolling", *SMALL, "total_timesteps=4096", "hydra.run.dir=run", cwd=folder)
    assert done.returncode == 2
    assert re.search(f"ogmp-train: {message}", done.stderr.splitlines()[-1]), done.stderr
    assert "Traceback" not in done.stderr
