"""The key ``run`` of several programs: what it names, said aloud where it is not the path itself."""

from __future__ import annotations

from pathlib import Path

from ogmp_sb3.commands import cli
from ogmp_sb3.config.catalogue import find
from ogmp_sb3.runs.run_names import find_run, is_path_of_run, is_policy_name

RUN = (
    "run or checkpoint directory, name of a shipped policy, 'latest', part of the name of a run below runs/, or "
    "hf:<owner>/<name>"
)
"""Help of the key."""


def named_run(program: str, run: str, to_resume: bool = False) -> str:
    """What ``run=`` means (:func:`~ogmp_sb3.runs.run_names.find_run`); a note says what a part of a name stands for.

    :param program: for the note
    """
    found = find_run(run, to_resume)
    if found != run:
        cli.note(program, f"'{run}' is {found}")
    elif is_path_of_run(run) and is_policy_name(run):
        shipped = find("policy", run, relative_to=Path("/nowhere"))
        cli.note(program, f"'{run}' is the directory here, not the policy of that name that ships ({shipped.parent})")
    return found
