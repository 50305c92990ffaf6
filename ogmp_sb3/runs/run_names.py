"""What ``run=`` names: a path, a policy that ships, the latest run, or a run below ``runs/`` by a part of its name.

A path that is there comes first, then a policy that ships or that a plug-in brings, by its whole name. What is neither
is looked for among the names of the runs below :data:`~ogmp_sb3.runs.run_folders.RUNS`, and must fit one of them
only. ``/best`` and ``/checkpoints/<samples>`` may follow.
"""

from __future__ import annotations

import difflib
import re
import shlex
from pathlib import Path

from ogmp_sb3.config.catalogue import find, is_file, names
from ogmp_sb3.runs.hub import PREFIX
from ogmp_sb3.runs.run_directory import BEST, CHECKPOINTS, INFO, checkpoint_dirs
from ogmp_sb3.runs.run_folders import (
    RUNS,
    RunFolder,
    is_run,
    name_elements,
    newest_first,
    relative,
    run_folders,
    short_names,
)

LATEST = "latest"
PART = re.compile(rf"(.+?)(/(?:{BEST}|{CHECKPOINTS}/\d+))?/?", re.DOTALL)  # a run, and a policy of it
SHOWN = 4  # names in a sentence


def find_run(text: str, to_resume: bool = False) -> str:
    """What ``run=`` means, as a path, or as the name of a policy that ships or that is on the Hub.

    :param to_resume: a run to go on with, which need have no checkpoint; no policy alone will do
    :raises KeyError: if nothing has this name, or has what is asked of it; with the closest names
    :raises ValueError: if several have
    """
    if not text:
        raise KeyError("'' is a directory here, but neither a run nor a policy.")
    if is_path_of_run(text):
        return text
    if text.startswith(PREFIX):
        if to_resume:
            raise ValueError(f"'{text}' is a policy on the Hub: there is no training to go on with.")
        return text
    if _is_folder(text):
        return str(_newest(text, Path(text), to_resume))
    missing = _no_policy(text)
    if not missing:
        if to_resume:
            raise ValueError(f"'{text}' is a policy that ships: there is no training to go on with.")
        return text
    if to_resume:
        missing = f"'{text}' is no run directory."
    named, part = _split(text)
    if named == LATEST:
        return f"{_newest(named, RUNS, to_resume)}{part}"
    return f"{_by_name(named, missing)}{part}"


def is_path_of_run(text: str) -> bool:
    """Whether a path leads to a run, a policy, or a file such as SB3's ``.zip``."""
    path = Path(text)
    if is_file(path):
        return True
    return _is_folder(text) and (is_run(path) or is_file(path / INFO) or (path / CHECKPOINTS).is_dir())


def is_policy_name(text: str) -> bool:
    """Whether a text, which may also be a path, is the name of a policy that ships or that a plug-in brings."""
    return "/" not in text and text in names("policy")


def _is_folder(text: str) -> bool:
    try:
        return bool(text) and Path(text).is_dir()
    except (OSError, ValueError):  # no name of a directory
        return False


def _split(text: str) -> tuple[str, str]:
    """The name of a run, as seen from the directory of runs, and the part of the run that is meant."""
    match = PART.fullmatch(text)
    named, part = (match[1], match[2] or "") if match else (text, "")
    return named.removeprefix(f"{RUNS}/"), part


def _no_policy(text: str) -> str:
    """Why a text is not the name of a policy; empty if it is."""
    try:
        find("policy", text)
    except KeyError as error:
        return str(error.args[0])
    return ""


def _newest(text: str, folder: Path, to_resume: bool) -> Path:
    """The newest run of a folder, if it has a checkpoint.

    :param text: how the folder was named
    """
    if is_policy_name(text):
        raise ValueError(
            f"'{text}' is a directory here, but neither a run nor a policy, and also the name of a policy that ships: "
            f"write ./{text} for the newest run in it, or {find('policy', text).parent} for that policy."
        )
    runs = newest_first(run_folders(folder))
    if not runs:
        if text == LATEST:
            raise KeyError(f"'{text}': no run is below '{folder}' here yet.")
        raise KeyError(f"'{text}' is a directory here, but neither a run nor a policy, and no run is below it.")
    newest, jobs = runs[0].path, [run for run in runs if run.sweep is not None and run.sweep == runs[0].sweep]
    if len(jobs) > 1:
        sweep = jobs[0].sweep
        which = "" if sweep == folder else f"the newest run below '{folder}' is a job of a sweep, and "
        raise ValueError(
            f"{which}'{sweep}' has {len(jobs)} jobs: give one of them, e.g. '{newest}', "
            f"or compare them with ogmp-report {shlex.quote(f'sweep={sweep}')}."
        )
    if to_resume or checkpoint_dirs(newest):
        return newest
    other = next((run.path for run in runs if checkpoint_dirs(run.path)), None)
    end = f"; the newest that has one is '{other}'." if other else ", and no other has one."
    raise KeyError(f"the newest run below '{folder}', '{newest}', has no checkpoint yet{end}")


def _by_name(text: str, missing: str) -> Path:
    """The run below the directory of runs that a text names.

    :param missing: what to say first if there is none
    """
    runs = newest_first(run_folders(RUNS))
    names_of = {run.path: relative(run.path, RUNS) for run in runs}
    found = next((some for some in _matches(text, names_of) if some), [])
    if not found:
        raise KeyError(missing + _closest(text, runs))
    shipped = [name for name in names("policy") if name.startswith(text)]
    if len(found) > 1 or shipped:
        short = short_names(runs, RUNS)
        shown = [f"the policy '{name}' that ships" for name in shipped] + [f"'{short[path]}'" for path in found[:SHOWN]]
        more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
        raise ValueError(f"'{text}' may be {', '.join(shown)}{more}: give more of the name.")
    return found[0]


def _matches(text: str, names_of: dict[Path, str]) -> list[list[Path]]:
    """The runs whose names a text fits: as the whole, as a beginning, by all their elements, as a part."""
    elements = set(name_elements(text))
    return [
        [path for path, name in names_of.items() if text in (name, path.name)],
        [path for path, name in names_of.items() if name.startswith(text) or path.name.startswith(text)],
        [path for path, name in names_of.items() if elements <= set(name_elements(name))],
        [path for path, name in names_of.items() if text in name],
    ]


def _closest(text: str, runs: list[RunFolder]) -> str:
    """The end of a sentence: the runs whose names are closest, else the newest."""
    if not runs:
        return ""
    short = short_names(runs, RUNS)
    by_ending = {name.rpartition("/")[2]: name for name in short.values()} | {name: name for name in short.values()}
    close = difflib.get_close_matches(text, [*by_ending, LATEST], n=SHOWN, cutoff=0.5)
    shown = dict.fromkeys(by_ending.get(name, name) for name in close)
    kind = "closest" if shown else "newest"
    listed = ", ".join(f"'{name}'" for name in (list(shown) or [short[run.path] for run in runs])[:SHOWN])
    return f" Of the runs below '{RUNS}', the {kind}: {listed}."
