"""Command lines of the form key=value."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from ogmp_sb3 import cli
from ogmp_sb3.definitions import TaskConfig


@dataclass(frozen=True, kw_only=True)
class Options:
    run: str = cli.option("which run")
    episodes: int = cli.option("how many", 100)
    out: str | None = cli.option("where", None)


def test_values_get_the_types_of_the_fields() -> None:
    options, rest = cli.parse(Options, ["run=a/b", "episodes=7", "out=x=y"], "prog")
    assert (options, rest) == (Options(run="a/b", episodes=7, out="x=y"), [])


def test_keys_of_the_task_are_handed_on_with_or_without_their_prefix() -> None:
    _, rest = cli.parse(Options, ["run=a", "task.rho=0.3", "modes.jump.h=[0.1,0.2]"], "prog", ("rho", "modes"))
    assert rest == ["rho=0.3", "modes.jump.h=[0.1,0.2]"]


@pytest.mark.parametrize(
    ("arguments", "error", "sentence"),
    [
        (["run=a", "episode=3"], KeyError, "unknown key 'episode'.*Did you mean 'episodes'"),
        (["episodes=3"], KeyError, "prog: 'run' is missing"),
        (["run=a", "episodes=many"], TypeError, "prog: 'episodes' must be a whole number, found the text 'many'"),
        (["a"], ValueError, "'a' must have the form key=value"),
    ],
)
def test_mistakes_are_one_sentence(arguments: list[str], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        cli.parse(Options, arguments, "prog")


def test_help_shows_examples_and_every_key_with_its_default() -> None:
    text = cli.usage("prog", "does it.", ["prog run=a"], Options)
    assert "prog run=a" in text
    assert "episodes        how many (default 100)" in text
    assert "which run (required)" in text


def test_run_turns_a_mistake_into_one_line_and_exit_code_2(monkeypatch, capsys) -> None:
    def body(arguments: list[str]) -> None:
        raise KeyError("unknown key 'x'.")

    monkeypatch.setattr("sys.argv", ["prog", "x=1"])
    with pytest.raises(SystemExit, match="2"):
        cli.run("prog", "help", body)
    assert capsys.readouterr().err == "prog: unknown key 'x'.\n"


def test_task_keys_are_those_of_the_file() -> None:
    keys = cli.task_keys(TaskConfig)
    assert "rho" in keys and "robot_config" not in keys


def test_a_missing_optional_package_names_the_extra_to_install() -> None:
    cli.require("viewer", "json")
    with pytest.raises(ValueError, match=r"'no_such_package' is missing: pip install \"ogmp_sb3\[viewer\]\""):
        cli.require("viewer", "json", "no_such_package")
