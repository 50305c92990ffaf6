"""The ``.zip`` that Stable-Baselines3 saves: for import only, and only if it is trusted, because it holds pickles."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path

from ogmp_sb3.sb3.policy import LstmPolicy
from ogmp_sb3.sb3.recurrent_ppo import RecurrentPPO

PICKLES = (".zip", ".pt", ".pth", ".pkl", ".pickle", ".ckpt", ".joblib", ".npy", ".npz")
# What reading a file that is no such model can end in.
UNREADABLE: tuple[type[Exception], ...] = (ValueError, KeyError, TypeError, AttributeError, ImportError, EOFError)
UNREADABLE += (RuntimeError, OSError, AssertionError, IndexError, pickle.UnpicklingError, zipfile.BadZipFile)


def load_zip(file: Path, trust: bool, task: str | None) -> tuple[LstmPolicy, int]:
    """The policy in the ``.zip`` of a :class:`~ogmp_sb3.sb3.recurrent_ppo.RecurrentPPO`, and its training samples.

    :param file: what was given as a policy
    :param trust: whoever gave it trusts it; without, nothing of the file is read
    :param task: what it was trained on, which the file does not say
    :raises ValueError: if the file is not trusted, or is no such ``.zip``
    """
    if file.suffix.lower() not in PICKLES:
        raise ValueError(f"'{file}' is no policy: expected a run directory, a checkpoint or a shipped policy's name.")
    if not trust:
        raise ValueError(
            f"'{file}' can hold pickled objects, which run any code they like when they are loaded: "
            "give trust=true only if you trust where it is from."
        )
    if file.suffix.lower() != ".zip":
        raise ValueError(f"'{file}': only the .zip that RecurrentPPO.save writes can be loaded.")
    if task is None:
        raise ValueError(f"'{file}' does not say what it was trained on: give task=<name or YAML file>.")
    try:
        model = RecurrentPPO.load(file, device="cpu")
    except UNREADABLE as error:
        raise ValueError(f"'{file}': not readable as a RecurrentPPO ({' '.join(str(error).split())[:200]}).") from None
    if not isinstance(model.policy, LstmPolicy):
        raise ValueError(f"'{file}': its policy is a {type(model.policy).__name__}, expected an LstmPolicy.")
    model.policy.set_training_mode(False)
    return model.policy, model.num_timesteps
