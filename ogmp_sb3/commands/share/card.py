"""The card of a shared policy: what it does, how it was made, how it was measured, how to run it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

import yaml

from ogmp_sb3.evaluation.statistics import Estimate, as_text
from ogmp_sb3.runs.hub import PREFIX
from ogmp_sb3.runs.policies import LoadedPolicy

TAGS = ["reinforcement-learning", "robotics", "legged-locomotion", "mujoco", "stable-baselines3", "ogmp"]
PICTURES, VIDEOS = (".gif", ".png", ".jpg", ".jpeg", ".webp"), (".mp4", ".webm")


@dataclass(frozen=True, kw_only=True)
class Card:
    """What a card is written from."""

    loaded: LoadedPolicy
    """the policy"""
    robot: str
    """by which its task names its robot"""
    repo: str
    """``<owner>/<name>``"""
    license: str | None
    """as the Hub names it; None: none was chosen"""
    training: dict[str, Any]
    """the ``config.yaml`` of its run; empty if it is not known"""
    evaluation: dict[str, Any]
    """what ``ogmp-eval`` measured; empty if nothing"""
    replay: list[str] = field(default_factory=list)
    """names of pictures, videos and pages of it, beside the card"""

    def __str__(self) -> str:
        parts = [self._head(), self._purpose(), self._use(), self._training(), self._evaluation(), self._replay()]
        parts.append("## Files\n\nThe policy is safetensors, JSON, YAML and MJCF; none of it is a pickle.")
        return "\n\n".join(part for part in parts if part) + "\n"

    def _head(self) -> str:
        """The metadata, which the Hub searches by."""
        name = self.loaded.task.name
        data: dict[str, Any] = {"library_name": "ogmp_sb3", "pipeline_tag": "reinforcement-learning"}
        data["tags"] = list(dict.fromkeys([*TAGS, name, self._robot()]))
        if self.license is not None:
            data["license"] = self.license
        measured = self.evaluation.get("metrics", {}).get("return")
        if measured:
            value = " +/- ".join(as_text([number], 2) for number in (measured["mean"], measured["std"]))
            data["model-index"] = [
                {
                    "name": self.repo.rpartition("/")[2],
                    "results": [
                        {
                            "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
                            "dataset": {"name": name, "type": name},
                            "metrics": [{"type": "mean_reward", "name": "mean_reward", "value": value}],
                        }
                    ],
                }
            ]
        return f"---\n{yaml.safe_dump(data, sort_keys=False, allow_unicode=True)}---"

    def _robot(self) -> str:
        path = PurePosixPath(self.robot)
        return path.parent.name or path.stem if path.suffix in (".yaml", ".yml") else path.name

    def _purpose(self) -> str:
        description = " ".join(str(self.loaded.task_data.get("description") or "").split())
        by = "trained with *Oracle Guided Multi-mode Policies* by `ogmp_sb3`"
        rights = "" if self.license else " No licence was chosen for it."
        text = f"A policy for the task `{self.loaded.task.name}` on the robot `{self._robot()}`, {by}.{rights}"
        return "\n\n".join([f"# {self.repo.rpartition('/')[2]}", *([description] if description else []), text])

    def _use(self) -> str:
        name = f"{PREFIX}{self.repo}"
        lines = ['pip install "ogmp_sb3[hub,viewer]"', f"ogmp-play run={name}", f"ogmp-eval run={name}"]
        return "\n".join(["```console", *(f"$ {line}" for line in lines), "```"])

    def _training(self) -> str:
        task, info = self.loaded.task, self.loaded.info
        overrides = self.training.get("overrides")
        versions = {key: text for key, text in (info.get("versions") or {}).items() if key != "machine"}
        samples = info.get("num_timesteps")
        rows = {
            "command": f"`{shlex.join(['ogmp-train', *overrides])}`" if overrides else None,
            "samples": f"{samples:,}" if samples else None,
            "seed": info.get("seed"),
            "oracle, horizon": f"`{task.oracle}`, {task.horizon} control steps",
            "bound": "none" if task.rho is None else f"rho = {task.rho:g}",
            "observations": ", ".join(f"`{name}`" for name in task.observations),
            "versions": ", ".join(f"{key} {text}" for key, text in versions.items()),
        }
        lines = [f"| {key} | {_cell(value)} |" for key, value in rows.items() if value not in (None, "")]
        return "\n".join(["## Training", "", "| | |", "|---|---|", *lines])

    def _evaluation(self) -> str:
        report = self.evaluation
        if not report:
            return "## Evaluation\n\nNot evaluated yet."
        keys = [f"episodes={report['episodes']}", f"seed={report['seed']}", f"protocol={report['protocol']}"]
        command = shlex.join(["ogmp-eval", f"run={PREFIX}{self.repo}", *keys, *report["overrides"]])
        lines = ["| metric | mean | 95 % interval | std | n |", "|---|---|---|---|---|"]
        for name, data in report["metrics"].items():
            each = Estimate.from_data(data)
            interval = as_text([each.low, each.high], 3, " .. ")
            lines.append(f"| {name} | {as_text([each.mean])} | {interval} | {as_text([each.std])} | {each.n} |")
        return "\n".join(["## Evaluation", "", f"`{command}`", "", *lines])

    def _replay(self) -> str:
        lines = []
        for name in self.replay:
            if name.endswith(PICTURES):
                lines.append(f"![{name}]({name})")
            elif name.endswith(VIDEOS):
                lines.append(f'<video controls src="{name}"></video>')
            elif name.endswith(".html"):
                lines.append(f"[{name}]({name}): download it, and open it in a browser")
        return "\n\n".join(["## Replay", *lines]) if lines else ""


def _cell(value: Any) -> str:
    """Text in a cell of a table."""
    return " ".join(str(value).split()).replace("|", r"\|")
