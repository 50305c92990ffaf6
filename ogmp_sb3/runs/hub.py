"""Policies on the Hugging Face Hub: ``run=hf:<owner>/<name>`` loads one from there, ``ogmp-share`` puts one there.

What is loaded is what a policy is made of: safetensors, JSON, YAML and MJCF, nothing that can run code. The cache is
that of ``huggingface_hub``; so are the settings, such as ``HF_ENDPOINT``, ``HF_HUB_OFFLINE`` and ``HF_TOKEN``.
"""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

from ogmp_sb3.config.messages import first_line
from ogmp_sb3.runs.robot_copy import ROBOT
from ogmp_sb3.runs.run_directory import ENCODER, INFO, WEIGHTS
from ogmp_sb3.runs.storage import MANIFEST

PREFIX = "hf:"  # of the name of a policy on the Hub
TRAINING = "training.yaml"  # in a shared policy: the config.yaml of its run
REPLAY = "replay"  # directory in a shared policy: pictures, a video or a page of it
LOADED = [INFO, WEIGHTS, MANIFEST, TRAINING, f"{ENCODER}/encoder.json", f"{ENCODER}/encoder.safetensors", f"{ROBOT}/*"]
OWNED = [*LOADED, f"{REPLAY}/*"]  # files of an earlier policy that go when another is put in its place
LOG_IN = "log in with 'hf auth login', or set HF_TOKEN"
NAME = re.compile(r"[\w.-]+/[\w.-]+")


def hub_folder(name: str) -> Path:
    """The directory of a policy from the Hub, in the cache of ``huggingface_hub``.

    :param name: ``hf:<owner>/<name>``, or with the revision, ``hf:<owner>/<name>@<revision>``
    :raises ValueError: if the name is none, there is no such policy, or it cannot be reached and is not in the cache
    """
    repo, _, revision = name.removeprefix(PREFIX).partition("@")
    check_repo(repo, f"{PREFIX}<owner>/<name>", name)
    _require()
    import huggingface_hub

    try:
        folder = huggingface_hub.snapshot_download(repo, revision=revision or None, allow_patterns=LOADED)
    except Exception as error:  # whatever the library raises
        raise ValueError(f"'{name}': {_why(error)}.") from None
    for file in (INFO, WEIGHTS):
        if not (Path(folder) / file).is_file():
            raise ValueError(f"'{name}' is not a policy of ogmp_sb3: it has no {file}.")
    return Path(folder)


def hub_name(folder: Path) -> str | None:
    """The name of the repository that a directory of the cache is of; None for any other directory."""
    *_, repo, snapshots, _ = ("", "", "", *folder.parts)
    return repo.rpartition("--")[2] if snapshots == "snapshots" and repo.startswith("models--") else None


def check_repo(repo: str, form: str, found: str) -> None:
    """:raises ValueError: if the name of a repository has no owner, or is none."""
    if "/" not in repo:
        raise ValueError(f"'{found}' names no owner: give {form}.")
    if not NAME.fullmatch(repo):
        raise ValueError(f"'{found}' is no repository of the Hub: give {form}.")


def upload(folder: Path, repo: str, private: bool) -> str:
    """Put a directory into a repository, which is made if it is not there. Of a policy that was there, nothing is left.

    :param private: of a new repository
    :return: its address
    :raises ValueError: if that is not allowed, or the Hub cannot be reached
    """
    _require()
    import huggingface_hub

    if huggingface_hub.get_token() is None:
        raise ValueError(f"'{repo}': uploading needs a token: {LOG_IN}.")
    api = huggingface_hub.HfApi(library_name="ogmp_sb3")
    try:
        address = api.create_repo(repo, private=private, exist_ok=True)
        api.upload_folder(
            repo_id=repo, folder_path=folder, commit_message="Upload a policy of ogmp_sb3", delete_patterns=OWNED
        )
    except Exception as error:  # whatever the library raises
        raise ValueError(f"'{repo}': {_why(error)}.") from None
    return str(address)


def _require() -> None:
    """:raises ValueError: naming the extra, if the library is not installed"""
    if importlib.util.find_spec("huggingface_hub") is None:
        raise ValueError("the package 'huggingface_hub' is missing: pip install \"ogmp_sb3[hub]\".")


def _why(error: Exception) -> str:
    """What went wrong with a repository."""
    from huggingface_hub import errors

    status = getattr(getattr(error, "response", None), "status_code", None)
    if isinstance(error, errors.GatedRepoError):
        return "access to it has to be asked for on its page"
    if isinstance(error, errors.RevisionNotFoundError):
        return "it has no such revision"
    if isinstance(error, errors.RepositoryNotFoundError):
        return f"there is no such repository on the Hub, or it is private: {LOG_IN}"
    if status == 401:
        return f"the Hub does not know the token: {LOG_IN}"
    if status == 403:
        return "the token does not allow this"
    if isinstance(error, errors.LocalEntryNotFoundError):
        return "the Hub cannot be reached, and it is not in the cache"
    if type(error).__module__.partition(".")[0].startswith("httpx") or isinstance(error, ConnectionError):
        return f"the Hub cannot be reached ({first_line(error)})"
    return first_line(error)
