"""``ogmp-share``: upload a policy with its card to the Hugging Face Hub, or write what would be uploaded."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ogmp_sb3.commands import cli
from ogmp_sb3.commands.share.bundle import copy_replay, own_paths, training_file, write_policy
from ogmp_sb3.commands.share.card import Card
from ogmp_sb3.config.yaml_files import read_yaml
from ogmp_sb3.runs.atomic import fresh, put_in_place, remove
from ogmp_sb3.runs.hub import PREFIX, check_repo, upload
from ogmp_sb3.runs.policies import LoadedPolicy, load_policy
from ogmp_sb3.runs.run_directory import INFO, default_out, owner
from ogmp_sb3.runs.storage import load_json

PROGRAM = "ogmp-share"
CARD = "README.md"
MEASURED = "metrics.json"  # of ogmp-eval
FORM = "repo=<owner>/<name>"


@dataclass(frozen=True, kw_only=True)
class ShareConfig:
    """Keys of the command line."""

    run: str = cli.option("run directory, checkpoint directory, or name of a policy")
    repo: str | None = cli.option("repository on the Hub, <owner>/<name>, made if it is not there", None)
    out: str | None = cli.option("write what would be uploaded into this directory, and upload nothing", None)
    license: str | None = cli.option("as the Hub names it, e.g. mit, apache-2.0; null: the card has none", None)
    private: bool = cli.option("whether a new repository is private", False)
    evaluation: str | None = cli.option("directory of ogmp-eval's numbers; null: where it put them by default", None)
    replay: str | None = cli.option("a video, a picture or a page of it, or a directory of them", None)

    def __post_init__(self) -> None:
        if self.repo is None and self.out is None:
            raise ValueError(f"give {FORM}, or out=<directory> to see what would be uploaded.")
        if self.repo is not None:
            check_repo(self.repo, FORM, self.repo)


HELP = cli.usage(
    PROGRAM,
    "upload a policy to the Hugging Face Hub: weights as safetensors, its task, robot and encoder, and a card.",
    [
        "ogmp-share run=runs/parkour/2026-01-31_12-00-00 repo=me/parkour license=mit",
        "ogmp-share run=runs/parkour/2026-01-31_12-00-00/best repo=me/parkour replay=parkour.mp4 private=true",
        "ogmp-share run=parkour repo=me/parkour out=shared    (uploads nothing)",
        "ogmp-play run=hf:me/parkour                           (what is there, by any program; @<revision> behind it)",
    ],
    ShareConfig,
)


def _run(arguments: list[str]) -> None:
    config, _ = cli.parse(ShareConfig, arguments, PROGRAM)
    if Path(config.run).is_file():
        raise ValueError(f"'{config.run}': an SB3 .zip holds pickles; only a policy as ogmp-train makes it is shared.")
    out = None if config.out is None else Path(config.out)
    if out is not None:
        cli.check_out(out)
        if out.is_dir() and any(out.iterdir()) and not all((out / name).is_file() for name in (CARD, INFO)):
            raise ValueError(f"'{out}': holds something else: give an empty directory, or a new one.")
    if config.replay is not None and not Path(config.replay).exists():
        raise ValueError(f"'replay': there is no '{config.replay}'.")
    loaded = load_policy(config.run)
    if out is not None:
        temporary = fresh(out)
        try:
            _write(config, loaded, temporary)
            put_in_place(temporary, out)
        finally:
            remove(temporary)
        files = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
        cli.console().print(f"{out}: {', '.join(files)}\nNothing was uploaded.")
        return
    assert config.repo is not None
    with tempfile.TemporaryDirectory() as folder:
        _write(config, loaded, Path(folder))
        address = upload(Path(folder), config.repo, config.private)
    cli.console().print(f"{address}\nTo see it:  ogmp-play run={PREFIX}{config.repo}")


def _write(config: ShareConfig, loaded: LoadedPolicy, folder: Path) -> None:
    """Write the policy and its card into an empty directory."""
    evaluation, training = _evaluation(config, loaded), training_file(loaded, owner(config.run))
    write_policy(loaded, training, folder)
    replay = [] if config.replay is None else copy_replay(Path(config.replay), folder)
    settings = {} if training is None else read_yaml(training)
    info = load_json(folder / INFO)
    if paths := own_paths([info, settings]):
        cli.note(PROGRAM, f"names paths of this machine, which everybody will see: {', '.join(paths)}")
    if config.license is None:
        cli.note(PROGRAM, "no licence: nobody knows what they may do with it; choose one with license=<name>")
    card = Card(
        loaded=loaded,
        robot=info["task"]["robot"],
        repo=config.repo or f"<owner>/{loaded.task.name}",
        license=None if config.license is None else config.license.lower(),
        training=settings,
        evaluation=evaluation,
        replay=replay,
    )
    (folder / CARD).write_text(str(card), encoding="utf-8")


def _evaluation(config: ShareConfig, loaded: LoadedPolicy) -> dict[str, Any]:
    """What was measured of the policy; nothing if it was not.

    :raises ValueError: if a directory was named that has nothing of this policy
    """
    named = config.evaluation is not None
    folder = Path(config.evaluation) if config.evaluation else default_out(config.run, loaded.name, "evaluation")
    file = folder / MEASURED
    if not (named or file.is_file()):
        return {}
    report = load_json(file)
    if report.get("policy") == loaded.digest:
        return report
    if named:
        raise ValueError(f"{file}: is of another policy than '{config.run}'.")
    cli.note(PROGRAM, f"{file}: is of another policy, and left out; measure this one with: ogmp-eval run={config.run}")
    return {}


def main() -> None:
    """Entry point."""
    cli.run(PROGRAM, HELP, _run)


if __name__ == "__main__":
    main()
