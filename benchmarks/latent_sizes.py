"""How much latents keep of the references of parkour and dive, over their size, before and after.

    python benchmarks/latent_sizes.py [out=runs/latent_sizes]

Trains an encoder of every size by ``ogmp-encode`` (what was trained already is not trained again), and measures these
and the encoder that the shipped policy was trained with: on references of courses that were held out, and on what the
shipped policy asks for in episodes of its test. Leaves ``benchmarks/latent_sizes.csv``.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ogmp_sb3 import load_policy
from ogmp_sb3.commands.encode import HELD_OUT, EncodeConfig
from ogmp_sb3.config.load import load_task
from ogmp_sb3.evaluation.episodes import play_episodes
from ogmp_sb3.guidance.encoder_training import latent_quality, load_auto_encoder
from ogmp_sb3.guidance.latent import reference_features
from ogmp_sb3.guidance.reference_data import ReferenceData, collect, reference_data
from ogmp_sb3.report.page import write_csv

HERE = Path(__file__).parent
SIZES = {"parkour": (2, 3, 4, 8), "dive": (2,)}
SETTINGS = {"parkour": [], "dive": ["updates=2000", "references=5000"]}
EPISODES, SEED = 48, 1000  # of the shipped policy


def trained(task: str, size: int, folder: Path) -> Path:
    """The directory of an encoder, trained if it is not there."""
    out = folder / f"{task}_{size}"
    if not (out / "encoder.json").is_file():
        arguments = [f"task={task}", f"latent_size={size}", f"out={out}", *SETTINGS[task]]
        subprocess.run([sys.executable, "-m", "ogmp_sb3.commands.encode", *arguments], check=True)
    return out


def measured(name: str, folder: Path) -> Iterator[dict[str, Any]]:
    """A row for each encoder of a task."""
    policy, task = load_policy(name), load_task(name)
    records = play_episodes(policy, policy.task.for_evaluation(), EPISODES, SEED)
    own = collect([query for record in records for query in record.queries])
    first, second = np.random.SeedSequence(0).spawn(2)  # as ogmp-encode draws them
    references = int(dict(each.split("=") for each in SETTINGS[name]).get("references", EncodeConfig.references))
    training = reference_data(task, references, first)
    held_out = reference_data(replace(task, curriculum=None), HELD_OUT, second)
    encoders = {"of the policy": str(policy.task.encoder)}
    encoders |= {f"size {size}": str(trained(name, size, folder)) for size in SIZES[name]}
    for title, encoder in encoders.items():
        model = load_auto_encoder(encoder)
        assert model is not None
        row: dict[str, Any] = {"task": name, "encoder": title, "size": model.encoder_out.hidden_size}
        for what, data in (("held_out", held_out), ("own", own)):
            quality = latent_quality(model, training, data)
            row |= {f"{what}_{key}": round(value, 4) for key, value in vars(quality).items()}
        yield row
    row = {"task": name, "encoder": "none: the nearest whole reference", "size": None}
    for what, data in (("held_out", held_out), ("own", own)):
        row |= {f"{what}_unexplained": 0.0, f"{what}_same_mode": round(whole(training, data), 4)}
        row[f"{what}_references"] = len(data.steps)
    yield row


def whole(known: ReferenceData, test: ReferenceData) -> float:
    """Share of references whose nearest one, as a whole, belongs to the same mode: what no latent can be asked for."""
    knots = min(known.state.shape[1], test.state.shape[1])
    a, b = (reference_features(data.state[:, :knots]).reshape(len(data.steps), -1) for data in (known, test))
    squared = (a**2).sum(axis=1) - 2.0 * b @ a.T  # but for a term that is the same for all known
    return float(np.mean(known.modes[squared.argmin(axis=1)] == test.modes))


def main() -> None:
    """Train what is missing, and measure."""
    given = dict(argument.partition("=")[::2] for argument in sys.argv[1:])
    folder = Path(given.pop("out", "runs/latent_sizes"))
    if given:
        raise SystemExit(f"latent_sizes.py: unknown argument '{next(iter(given))}'; the only one is out=<directory>.")
    rows = [row for name in SIZES for row in measured(name, folder)]
    write_csv(HERE / "latent_sizes.csv", rows)
    for row in rows:
        print(", ".join(f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()
