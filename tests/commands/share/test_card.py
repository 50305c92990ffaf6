"""The card of a shared policy, as the Hub and a reader see it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import yaml

from ogmp_sb3.commands.share.card import Card
from ogmp_sb3.runs.policies import load_policy

ESTIMATE = {"mean": 332.7448, "std": 40.4752, "n": 500, "ci95": [329.188, 336.301]}
EVALUATION = {
    "episodes": 500, "seed": 3, "protocol": "endless", "overrides": ["modes.jump.h=[0.1, 0.2]"],
    "metrics": {"return": ESTIMATE, "no_fall_fraction": {**ESTIMATE, "std": None, "ci95": [None, None]}},
}  # fmt: skip


@pytest.fixture(scope="module")
def card() -> Card:
    loaded = load_policy("dive")
    training = {"overrides": ["task=dive", "rho=0.5", "modes.flip.h=[1.0, 2.0]"]}
    return Card(
        loaded=loaded,
        robot="hector",
        repo="me/my-dive",
        license="mit",
        training=training,
        evaluation=EVALUATION,
        replay=["replay/index.html", "replay/a.mp4", "replay/a.gif", "replay/data.bin"],
    )


def head(card: Card) -> dict[str, Any]:
    _, text, _ = str(card).split("---\n", 2)
    return yaml.safe_load(text)


def test_the_metadata_are_those_that_the_hub_searches_by(card: Card) -> None:
    data = head(card)
    assert (data["library_name"], data["license"], data["pipeline_tag"]) == (
        "ogmp_sb3",
        "mit",
        "reinforcement-learning",
    )
    assert {"dive", "hector", "reinforcement-learning", "robotics"} <= set(data["tags"])
    (model,) = data["model-index"]
    assert model["name"] == "my-dive"
    assert model["results"][0]["metrics"][0] == {
        "type": "mean_reward", "name": "mean_reward", "value": "332.74 +/- 40.48",
    }  # fmt: skip
    assert model["results"][0]["dataset"]["name"] == "dive"


def test_the_tables_say_how_it_was_made_and_measured(card: Card) -> None:
    lines = str(card).splitlines()
    assert "| command | `ogmp-train task=dive rho=0.5 'modes.flip.h=[1.0, 2.0]'` |" in lines
    info = card.loaded.info
    assert f"| samples | {info['num_timesteps']:,} |" in lines
    assert f"mujoco {info['versions']['mujoco']}" in str(card)
    measured = "`ogmp-eval run=hf:me/my-dive episodes=500 seed=3 protocol=endless 'modes.jump.h=[0.1, 0.2]'`"
    assert measured in lines
    assert "| return | 332.745 | 329.188 .. 336.301 | 40.475 | 500 |" in lines
    assert "| no_fall_fraction | 332.745 | - | - | 500 |" in lines
    assert "$ ogmp-play run=hf:me/my-dive" in lines


def test_a_replay_is_shown_by_what_it_is(card: Card) -> None:
    lines = str(card).splitlines()
    assert "![replay/a.gif](replay/a.gif)" in lines
    assert '<video controls src="replay/a.mp4"></video>' in lines
    assert "[replay/index.html](replay/index.html): download it, and open it in a browser" in lines
    assert "data.bin" not in str(card)


def test_what_is_not_known_is_left_out_or_said(card: Card) -> None:
    bare = replace(card, license=None, training={}, evaluation={}, replay=[])
    assert not {"license", "model-index"} & set(head(bare))
    assert "No licence was chosen" in str(bare) and "Not evaluated yet." in str(bare)
    assert "| command |" not in str(bare) and "Replay" not in str(bare)
    assert "No licence" not in str(card)


@pytest.mark.parametrize(
    ("robot", "name"), [("hector", "hector"), ("mine/spot/robot.yaml", "spot"), ("robot.yaml", "robot")]
)
def test_a_robot_is_called_by_its_directory(robot: str, name: str, card: Card) -> None:
    assert name in head(replace(card, robot=robot))["tags"]
