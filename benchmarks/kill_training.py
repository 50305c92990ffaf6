"""Kill a training again and again, start it again each time, and compare the end with a run that was left alone.

    python benchmarks/kill_training.py kills=20 out=/tmp/kills

A kill comes at a random moment of the start, of the training, or, so that it is sure to be hit, while a checkpoint or
the best policy is being written. After each it is said how far the log had come and where the next process goes on; in
the end, what was lost at most, and whether weights, optimiser, simulations and logs are those of the run that was left
alone. The exit code is 1 if anything is not as it must be.
"""

from __future__ import annotations

import csv
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from safetensors.torch import load_file
from torch import equal

from ogmp_sb3.runs.atomic import LOCK
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import checkpoint_dirs
from ogmp_sb3.runs.storage import verify

INTERVAL = 512
SETTINGS = ["task=dive", "num_envs=8", "ppo.n_steps=16", "ppo.batch_size=64", "ppo.n_epochs=1", "seed=3"]
SETTINGS += ["ppo.lstm_hidden_size=32", "torch_threads=1", "physics_threads=1"]
SETTINGS += [f"checkpoint_interval={INTERVAL}", "keep_checkpoints=2"]
MOMENTS = {"starting": 1, "training": 4, "writing": 3}  # when to kill, by how often
DELAY = 0.1  # s, at most, behind the row of the log or the file that was waited for


def command(run_dir: Path, samples: int, resume: bool = False) -> list[str]:
    arguments = [f"resume={run_dir}"] if resume else [*SETTINGS, f"hydra.run.dir={run_dir}"]
    arguments.append(f"total_timesteps={samples}")
    return [sys.executable, "-m", "ogmp_sb3.commands.train.program", *arguments]


def start(run_dir: Path, samples: int, resume: bool = False) -> subprocess.Popen[bytes]:
    with (run_dir.parent / "output.txt").open("ab") as output:
        return subprocess.Popen(command(run_dir, samples, resume), stdout=output, stderr=output)


def logged(run_dir: Path) -> list[int]:
    """The samples of all whole rows of the log."""
    if not (run_dir / "progress.csv").is_file():
        return []
    with (run_dir / "progress.csv").open(newline="") as file:
        return [int(row["time/total_timesteps"]) for row in csv.DictReader(file) if row.get("time/total_timesteps")]


def saved(run_dir: Path) -> int:
    """The samples of the newest checkpoint, which must be whole; 0 if there is none yet."""
    folders = checkpoint_dirs(run_dir)
    for folder in folders:
        verify(folder)
    return int(folders[-1].name) if folders else 0


def writing(run_dir: Path) -> bool:
    """Whether a checkpoint or the best policy is half written."""
    return any(run_dir.glob(".best.*")) or any((run_dir / "checkpoints").glob(".*"))


def wait(
    process: subprocess.Popen[bytes], run_dir: Path, samples: int, moment: str, rng: random.Random, life: float
) -> None:
    """Until it is time to kill, or the process has ended."""
    before, end = saved(run_dir), time.monotonic() + rng.uniform(0.0, life)
    reach = rng.uniform(before, min(before + 2 * INTERVAL, samples - 1))
    wanted = min(before + rng.choice((1, 2)) * INTERVAL, samples)
    due: dict[str, Callable[[], bool]] = {
        "starting": lambda: time.monotonic() > end,
        "training": lambda: max([0, *logged(run_dir)]) >= reach,
        "writing": lambda: max([0, *logged(run_dir)]) >= wanted and writing(run_dir),
    }
    while process.poll() is None and not due[moment]():
        time.sleep(0.002)
    if moment != "starting":
        time.sleep(rng.uniform(0.0, DELAY))


def first_row_after(run_dir: Path, samples: int) -> float:
    """Seconds from the start of a process to the first row of its log; the process comes to its end."""
    began, process = time.monotonic(), start(run_dir, samples)
    while process.poll() is None and not logged(run_dir):
        time.sleep(0.01)
    life = time.monotonic() - began
    assert process.wait() == 0, "the run that is left alone failed: see output.txt"
    return life


def main() -> None:
    given = dict(argument.split("=") for argument in sys.argv[1:])
    kills, samples, out = int(given.get("kills", 20)), int(given.get("samples", 3072)), Path(given.get("out", "kills"))
    rng = random.Random(int(given.get("seed", 0)))
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    alone, run_dir = out / "alone", out / "killed"
    life = first_row_after(alone, samples)
    print(f"left alone: {samples} samples, the first row after {life:.1f} s")

    lost: list[int] = []
    wrong: list[str] = []
    while len(lost) < kills:
        resume = len(lost) % 2 == 1 and (run_dir / "config.yaml").is_file()
        (moment,) = rng.choices([*MOMENTS], [*MOMENTS.values()])
        process = start(run_dir, samples, resume)
        wait(process, run_dir, samples, moment, rng, life)
        process.kill()
        code = process.wait()
        if code == 0:
            shutil.rmtree(run_dir)  # it came to its end before the kill: once more
            continue
        reached, goes_on = max([0, *logged(run_dir)]), saved(run_dir)
        lost.append(max(0, reached - goes_on))
        left = [path.name for path in [*run_dir.glob(".best.*"), *(run_dir / "checkpoints").glob(".*")]]
        print(f"kill {len(lost):2}: {moment}, logged to {reached}, goes on at {goes_on}, left {left}", flush=True)
        if code != -9:
            wrong.append(f"kill {len(lost)} found a process that had ended with {code}: it could not go on")
    if subprocess.run(command(run_dir, samples), stdout=subprocess.DEVNULL, check=False).returncode != 0:
        wrong.append("the last run could not go on")
    wrong += compare(alone, run_dir)
    if max(lost) > INTERVAL:
        wrong.append("more than a checkpoint interval was lost")
    print(f"{kills} kills: at most {max(lost)} samples lost, {sum(lost) / kills:.0f} on average; interval {INTERVAL}")
    print("\n".join(wrong) or "all went on; weights, optimiser, simulations and logs are those of the run left alone")
    sys.exit(bool(wrong))


def compare(alone: Path, killed: Path) -> list[str]:
    """What differs between two finished runs."""
    wrong = []
    for name in ("policy.safetensors", "trainer.safetensors"):
        one, two = (load_file(checkpoint_dirs(run)[-1] / name) for run in (alone, killed))
        if one.keys() != two.keys() or not all(equal(one[key], two[key]) for key in one):
            wrong.append(f"{name} differs from that of the run left alone")
    best = [load_policy(run / "best").info["num_timesteps"] for run in (alone, killed)]
    if best[0] != best[1]:
        wrong.append(f"the best policy is that of step {best[1]} instead of {best[0]}")
    if logged(alone) != logged(killed):
        wrong.append("the log has other rows")
    left = [str(path) for path in killed.rglob(".*") if path.name not in (".hydra", LOCK)]
    return wrong + [f"left over: {path}" for path in left]


if __name__ == "__main__":
    main()
