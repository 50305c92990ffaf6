"""``key=value`` command lines of the programs that do not need Hydra."""

from __future__ import annotations

import dataclasses
import importlib.util
import signal
import sys
import threading
import typing
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from keyword import iskeyword
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from rich.console import Console

from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.config.messages import Where, did_you_mean
from ogmp_sb3.config.strict import read
from ogmp_sb3.config.yaml_files import read_value
from ogmp_sb3.machine import check_writable
from ogmp_sb3.runs.atomic import reason

C = TypeVar("C")

TRUST = "true: also load an SB3 .zip, which can run any code; needs 'task'"  # help of a key of several programs
ROBOT = "another robot in place of the policy's own: a name, or the path of a robot.yaml"
ZIP_TASK = "of an SB3 .zip: what it was trained on, a name or a YAML file"
MISTAKES = (ValueError, KeyError, TypeError, OSError, MemoryError)
"""What a user's mistake is raised as, a file that cannot be written and a size that does not fit included."""


def parse(kind: type[C], arguments: list[str], program: str, extra: tuple[str, ...] = ()) -> tuple[C, list[str]]:
    """Read ``key=value`` arguments into a dataclass.

    :param kind: a dataclass; its fields are the keys (``from_`` for ``from``, which is a word of Python)
    :param arguments: the command line
    :param program: for messages
    :param extra: further keys that are allowed, and everything below them (``modes.jump.h=0.2``)
    :return: the dataclass, and the arguments whose key is one of ``extra``
    :raises KeyError: for an unknown or missing key
    :raises TypeError: for a value of the wrong type
    :raises ValueError: for an argument that is not ``key=value``, and a key that is given twice
    """
    fields = typing.get_type_hints(kind)
    values: dict[str, Any] = {}
    rest: list[str] = []
    for argument in arguments:
        key, sign, text = argument.partition("=")
        if not sign:
            raise ValueError(f"'{argument}' must have the form key=value.")
        key = _field(key.removeprefix("task."))
        if key in values or any(other.partition("=")[0] == key for other in rest):
            raise ValueError(f"'{_key(key)}' is given twice.")
        if key in fields:
            values[key] = _value(text, fields[key])
        elif key.split(".")[0] in extra:
            rest.append(f"{key}={text}")
        else:
            raise KeyError(f"unknown key '{key}'{did_you_mean(key, [*map(_key, fields), *extra])}")
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if field.default is dataclasses.MISSING and field.name not in values:
            name = _key(field.name)
            raise KeyError(f"'{name}' is missing: give {name}=<{field.metadata['help']}>.")
    return read(kind, values, Where(program)), rest


def _field(key: str) -> str:
    """The field of a key."""
    return f"{key}_" if iskeyword(key) else key


def _key(field: str) -> str:
    """The key of a field."""
    return field.removesuffix("_")


def _value(text: str, kind: Any) -> Any:
    """A value as a YAML file would have it; what must be text is text, whatever it looks like."""
    inner = {str if typing.get_origin(k) is typing.Literal else k for k in typing.get_args(kind) or (kind,)}
    if typing.get_origin(kind) is typing.Literal or inner <= {str, type(None)}:
        return None if text == "null" and type(None) in inner else text
    try:
        return read_value(text)
    except ValueError:
        return text


def usage(program: str, purpose: str, examples: list[str], kind: type[Any], extra: str = "") -> str:
    """The text of ``--help``: purpose, examples, and every key with its default and meaning.

    :param kind: a dataclass; the metadata ``help`` of its fields says what they are
    :param extra: a line about further keys
    """
    lines = [f"{program}: {purpose}", "", "Examples:", *(f"  {example}" for example in examples), "", "Keys:"]
    for field in dataclasses.fields(kind):
        default = "required" if field.default is dataclasses.MISSING else f"default {shown(field.default)}"
        lines.append(f"  {_key(field.name):<15} {field.metadata['help']} ({default})")
    return "\n".join([*lines, *([f"  {extra}"] if extra else [])])


def shown(value: Any) -> str:
    """A value as one types it."""
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def option(help_text: str, default: Any = dataclasses.MISSING) -> Any:
    """A dataclass field that is a key of a command line."""
    return dataclasses.field(default=default, metadata={"help": help_text})


def run(
    program: str, help_text: str | Callable[[], str], body: Callable[[list[str]], None], alone: bool = False
) -> None:
    """Run a program: help on demand, and a user's mistake is one sentence and exit code 2.

    :param help_text: what ``--help`` prints, or what makes it
    :param alone: whether the program does something without arguments, too
    """
    arguments = sys.argv[1:]
    if (not arguments and not alone) or any(a in ("-h", "--help", "help") for a in arguments):
        text = help_text() if callable(help_text) else help_text
        print(f"{text}\n", end="")  # in one write, so that `| head` breaks no pipe
        return
    try:
        with _plain_warnings(program), _ended_like_ctrl_c():
            body(arguments)
    except MISTAKES as error:
        fail(program, error)
    except KeyboardInterrupt:
        raise SystemExit(130) from None


@contextmanager
def _plain_warnings(program: str) -> Iterator[None]:
    """Print our own warnings as one sentence each, without the line of code that it is from."""
    others = warnings.formatwarning

    def text(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
    ) -> str:
        own = category is UserWarning and Path(filename).is_relative_to(PACKAGE)
        return f"{program}: {message}\n" if own else others(message, category, filename, lineno, line)

    warnings.formatwarning = text
    try:
        yield
    finally:
        warnings.formatwarning = others


@contextmanager
def _ended_like_ctrl_c() -> Iterator[None]:
    """Have the signals that end a program do so as Ctrl-C does, so that it leaves nothing half-written.

    Those that are ignored, as by ``nohup``, stay ignored, and those that somebody handles are his.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread gets signals
        return
    ending = (signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
    taken = [number for number in ending if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def console() -> Console:
    """Where programs print: brackets and colons are text, and no line is broken, so that a path can be copied."""
    return Console(markup=False, emoji=False, soft_wrap=True)


def note(program: str, text: str) -> None:
    """Say something on the way, beside what the program prints."""
    print(f"{program}: {text}", file=sys.stderr)


def fail(program: str, error: BaseException) -> NoReturn:
    """End a program with one line about a mistake, and exit code 2."""
    print(f"{program}: {one_line(program, error)}", file=sys.stderr)
    raise SystemExit(2) from None


def one_line(program: str, error: BaseException) -> str:
    """What a mistake is, without the name of the program."""
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {reason(error)}." if error.filename else f"{reason(error)}."
    elif isinstance(error, MemoryError):
        text = f"not enough memory. {error}"
    else:
        text = str(error.args[0] if error.args else error)
    return " ".join(text.removeprefix(f"{program}: ").split())


def check_name(key: str, name: str) -> None:
    """Check a name by which something that is written will be found.

    :raises ValueError: if it is a path, or would be read as one
    """
    if not name or name != Path(name).name or name.startswith(".") or name.endswith((".yaml", ".yml")):
        raise ValueError(f"'{key}' must be a name, not a path; found '{name}'.")


def check_out(out: Path, key: str = "out") -> None:
    """Check that results can be saved in a directory, before any work is done for them.

    :param key: by which it was given
    :raises ValueError: if not
    """
    try:
        check_writable(out)
    except OSError as error:
        why = f"{error.filename}: {reason(error)}"
        raise ValueError(
            f"'{out}': nothing can be saved there ({why}). Give another directory: {key}=<directory>."
        ) from None


def task_keys(task: type[Any]) -> tuple[str, ...]:
    """The top-level keys of a task file."""
    return tuple(field.name for field in dataclasses.fields(task) if not field.metadata.get("internal"))


def require(extra: str, *modules: str) -> None:
    """Check that the packages of an optional part are installed.

    :param extra: of setup.cfg
    :param modules: what it installs
    :raises ValueError: naming the extra, if one is missing
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise ValueError(f"the package '{module}' is missing: pip install \"ogmp_sb3[{extra}]\".")
