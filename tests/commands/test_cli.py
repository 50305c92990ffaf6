"""Command lines of the form key=value."""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import pytest

from ogmp_sb3.commands import cli
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.machine import mount_point


@dataclass(frozen=True, kw_only=True)
class Options:
    run: str = cli.option("which run")
    episodes: int = cli.option("how many", 100)
    out: str | None = cli.option("where", None)


def test_values_get_the_types_of_the_fields() -> None:
    options, rest = cli.parse(Options, ["run=a/b", "episodes=7", "out=x=y"], "prog")
    assert (options, rest) == (Options(run="a/b", episodes=7, out="x=y"), [])


@pytest.mark.parametrize("text", ["2026-01-31", "123", "1e5", "true", "[1]", "a: b", "!!bool x", "${x}", "["])
def test_what_must_be_text_is_text_whatever_it_looks_like(text: str) -> None:
    assert cli.parse(Options, [f"run={text}", f"out={text}"], "prog")[0] == Options(run=text, out=text)
    assert cli.parse(Options, ["run=null", "out=null"], "prog")[0] == Options(run="null", out=None)


@pytest.mark.parametrize("text", ["[", "[" * 3000, "9" * 5000, "!!bool x", "a: b: c", "2026-01-31"])
def test_what_must_be_a_number_and_is_not_even_yaml_is_shown_as_text(text: str) -> None:
    with pytest.raises(TypeError, match=r"^prog: 'episodes' must be a whole number, found the (text|value) "):
        cli.parse(Options, ["run=a", f"episodes={text}"], "prog")


def test_keys_of_the_task_are_handed_on_with_or_without_their_prefix() -> None:
    _, rest = cli.parse(Options, ["run=a", "task.rho=0.3", "modes.jump.h=[0.1,0.2]"], "prog", ("rho", "modes"))
    assert rest == ["rho=0.3", "modes.jump.h=[0.1,0.2]"]


@pytest.mark.parametrize(
    ("arguments", "error", "sentence"),
    [
        (["run=a", "episode=3"], KeyError, "unknown key 'episode'.*Did you mean 'episodes'"),
        (["episodes=3"], KeyError, "'run' is missing: give run=<which run>"),
        (["run=a", "episodes=many"], TypeError, "prog: 'episodes' must be a whole number, found the text 'many'"),
        (["a"], ValueError, "'a' must have the form key=value"),
        (["run=a", "episodes=5", "episodes=500"], ValueError, "'episodes' is given twice"),
    ],
)
def test_mistakes_are_one_sentence(arguments: list[str], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        cli.parse(Options, arguments, "prog")


def test_a_key_of_the_task_given_twice_is_refused_however_it_is_written() -> None:
    with pytest.raises(ValueError, match=r"'rho' is given twice"):
        cli.parse(Options, ["run=a", "rho=0.3", "task.rho=0.5"], "prog", ("rho",))


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


def test_what_programs_print_is_text_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    path = f"runs/modes.flip.r=[left],[/red]/:smile:/{'x' * 300}/report.html"
    cli.console().print(path)
    assert capsys.readouterr().out == f"{path}\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (KeyError("prog: 'x'\nis wrong."), "prog: 'x' is wrong.\n"),
        (PermissionError(13, "Permission denied", "/a/b"), "prog: /a/b: Permission denied.\n"),
        (OSError(28, "No space left on device"), "prog: No space left on device.\n"),
        (MemoryError("Unable to allocate 9 TiB."), "prog: not enough memory. Unable to allocate 9 TiB.\n"),
    ],
)
def test_every_mistake_ends_in_one_line(error: Exception, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert isinstance(error, cli.MISTAKES)
    with pytest.raises(SystemExit, match="2"):
        cli.fail("prog", error)
    assert capsys.readouterr().err == line


def test_task_keys_are_those_of_the_file() -> None:
    keys = cli.task_keys(TaskConfig)
    assert "rho" in keys and "robot_config" not in keys


def test_a_missing_optional_package_names_the_extra_to_install() -> None:
    cli.require("viewer", "json")
    with pytest.raises(ValueError, match=r"'no_such_package' is missing: pip install \"ogmp_sb3\[viewer\]\""):
        cli.require("viewer", "json", "no_such_package")


def test_our_own_warnings_are_sentences_and_those_of_others_say_where_they_are_from(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def body(arguments: list[str]) -> None:
        for file in (cli.__file__, __file__):
            warnings.warn_explicit("it has changed", UserWarning, file, 7)

    monkeypatch.setattr("sys.argv", ["prog", "a=b"])
    before = warnings.formatwarning
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda *arguments: print(warnings.formatwarning(*arguments[:4]), end="", file=sys.stderr)
        cli.run("prog", "", body)
    assert warnings.formatwarning is before
    first, second, *_ = capsys.readouterr().err.splitlines()
    assert first == "prog: it has changed"
    assert second == f"{__file__}:7: UserWarning: it has changed"


# ---- signals and places ----


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2])
def test_what_would_end_a_program_does_so_as_ctrl_c_does(number: signal.Signals, monkeypatch) -> None:
    undone = []

    def body(arguments: list[str]) -> None:
        try:
            os.kill(os.getpid(), number)
            time.sleep(10)
        finally:
            undone.append(arguments)  # such as a file that is half written

    before = signal.signal(number, signal.SIG_DFL)
    try:
        monkeypatch.setattr("sys.argv", ["prog", "a=1"])
        with pytest.raises(SystemExit) as stop:
            cli.run("prog", "help", body)
        assert stop.value.code == 130 and undone == [["a=1"]]
        assert signal.getsignal(number) is signal.SIG_DFL

        signal.signal(number, signal.SIG_IGN)  # by nohup, for one
        cli.run("prog", "help", lambda arguments: os.kill(os.getpid(), number))
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_a_place_where_nothing_can_be_saved_is_said_with_the_reason(tmp_path: Path) -> None:
    cli.check_out(tmp_path / "new" / "place")
    (tmp_path / "file").touch()
    with pytest.raises(ValueError) as error:
        cli.check_out(tmp_path / "file" / "new")
    why = f"({tmp_path / 'file'}: Not a directory)"
    text = f"'{tmp_path / 'file' / 'new'}': nothing can be saved there {why}. Give another directory: out=<directory>."
    assert str(error.value) == text


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "a" / "b"))
    ending = f"b: No space left on device: the disk mounted at {mount_point(tmp_path)} is full."
    assert cli.one_line("prog", full).endswith(ending)
    monkeypatch.setattr("ogmp_sb3.runs.atomic.full_disks", lambda: [Path("/home"), Path("/tmp")])
    text = cli.one_line("prog", OSError(errno.EDQUOT, "Disk quota exceeded"))  # of which the system does not say where
    assert text == "Disk quota exceeded: the disk mounted at /home and the disk mounted at /tmp are full."
