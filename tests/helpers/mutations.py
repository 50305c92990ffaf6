"""Bad input: shipped tasks with mistakes in them, and what has to become of them."""

from __future__ import annotations

import copy
import dataclasses
import math
import string
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hypothesis import assume
from hypothesis import strategies as st

from ogmp_sb3 import load_task
from ogmp_sb3.config import registry
from ogmp_sb3.config.catalogue import TASKS_DIR
from ogmp_sb3.config.robot import INPUT_NAMES, STATE_NAMES
from ogmp_sb3.config.task import TaskConfig
from ogmp_sb3.config.yaml_files import read_yaml

TEXTS = {
    name: (TASKS_DIR / f"{name}.yaml").read_text(encoding="utf-8")
    for name in ("dive", "dive_robot", "parkour", "parkour_robot", "stairs")
}
SHIPPED = {name: read_yaml(TASKS_DIR / f"{name}.yaml") for name in TEXTS}


def nodes(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where every value of nested plain data is."""
    if path:
        yield path
    for key in data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ():
        yield from nodes(data[key], (*path, key))


def parent(data: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        data = data[key]
    return data


def known_words() -> set[str]:
    """Every name that is right somewhere: an edited key that is one of them proves nothing."""
    words = {key for data in SHIPPED.values() for path in nodes(data) for key in path if isinstance(key, str)}
    kinds = [vars(registry)[kind] for kind in ("modes", "oracles", "observations", "rewards", "terminations")]
    for kind in kinds:
        words |= {*kind.names(), *(p for name in kind.names() for p in kind.parameters(name))}
    return words | {*STATE_NAMES, *INPUT_NAMES, "sequence", "repeat"}


KNOWN = known_words()
PATHS = {name: list(nodes(data)) for name, data in SHIPPED.items()}
KEYS = {name: [path for path in paths if isinstance(path[-1], str)] for name, paths in PATHS.items()}
EXTREMES = [0, -1, 0.0, -0.0, 1e-300, 1e-9, 1e9, 1e12, 1e308, math.nan, math.inf, -math.inf, 2**31, 2**63, 10**400]
SMALL = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([*EXTREMES, "", "front", "random", "x", "${rho}", "null"]),
    st.floats(),
    st.text(max_size=8),
)
JUNK = st.one_of(
    SMALL, st.lists(SMALL, max_size=3), st.dictionaries(st.text(max_size=4) | st.just("x"), SMALL, max_size=2)
)
NUMBERS = st.one_of(
    st.sampled_from(EXTREMES),
    st.floats(),
    st.integers(-3, 3000),
    st.lists(st.floats(0.0, 10.0), min_size=2, max_size=2),
)


@st.composite
def edited(draw: st.DrawFn, word: str) -> str:
    """A word with one letter dropped, doubled, changed or added."""
    at = draw(st.integers(0, len(word) - 1))
    letter = draw(st.sampled_from(string.ascii_letters + "_ "))
    head, tail = word[:at], word[at + 1 :]
    return draw(
        st.sampled_from([head + tail, head + word[at] * 2 + tail, head + letter + tail, head + letter + word[at:]])
    )


@st.composite
def misspelt(draw: st.DrawFn, keep: bool = False) -> tuple[dict[str, Any], str]:
    """A shipped task with one key misspelt (``keep``: beside the right one), and the wrong key."""
    name = draw(st.sampled_from(sorted(SHIPPED)))
    path = draw(st.sampled_from(KEYS[name]))
    wrong = draw(edited(path[-1]))
    assume(wrong not in KNOWN)
    task = copy.deepcopy(SHIPPED[name])
    node = parent(task, path)
    node[wrong] = copy.deepcopy(node[path[-1]]) if keep else node.pop(path[-1])
    return task, wrong


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    """A shipped task with one to three values dropped or replaced by junk, or keys edited."""
    data = copy.deepcopy(SHIPPED[draw(st.sampled_from(sorted(SHIPPED)))])
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(list(nodes(data)) or [("rho",)]))
        node = parent(data, path)
        match draw(st.sampled_from(["drop", "junk", "rename"])):
            case "drop":
                node.pop(path[-1], None) if isinstance(node, dict) else node.pop(path[-1])
            case "junk":
                node[path[-1]] = draw(JUNK)
            case "rename" if isinstance(node, dict) and path[-1]:
                node[draw(edited(path[-1]))] = node.pop(path[-1], None)
    return data


@st.composite
def renumbered(draw: st.DrawFn) -> dict[str, Any]:
    """A shipped task with one or two numbers or ranges replaced by others, most of which are allowed."""
    data = copy.deepcopy(SHIPPED[draw(st.sampled_from(sorted(SHIPPED)))])
    for _ in range(draw(st.integers(1, 2))):
        paths = [p for p in nodes(data) if is_number(parent(data, p)[p[-1]]) and not isinstance(p[-1], int)]
        path = draw(st.sampled_from(paths))
        parent(data, path)[path[-1]] = draw(NUMBERS)
    return data


def is_number(value: Any) -> bool:
    """Whether a value is a number or a range of numbers."""
    values = value if isinstance(value, list) else [value]
    return bool(values) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


JUNK_BYTES = [b"\x00", b"\xff\xfe", b"\t", b"\r", b"'", b'"', b"{", b"]", b":", b"- ", b"&a ", b"*a", b"*tracker"]
JUNK_BYTES += [b"<<: ", b"!!python/object/apply:os.system [x]", b"!!bool ", b"---\n", b"%", b"@", b"|\n", b"? ", b"${"]
JUNK_BYTES += [b"\xef\xbb\xbf", b"\n", b"#", b"[" * 2000, b"9" * 5000, "é".encode("latin-1"), "\u2028".encode(), b"..."]


@st.composite
def mangled(draw: st.DrawFn) -> bytes:
    """The text of a shipped task with one to three mistakes of an editor, a merge or a broken disk."""
    text = TEXTS[draw(st.sampled_from(sorted(TEXTS)))].encode()
    for _ in range(draw(st.integers(1, 3))):
        lines = text.splitlines(keepends=True) or [b""]
        i, at = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(text)))
        match draw(st.sampled_from(["twice", "drop", "swap", "indent", "insert", "cut", "binary"])):
            case "twice":
                text = b"".join([*lines[: i + 1], *lines[i:]])
            case "drop":
                text = b"".join([*lines[:i], *lines[i + 1 :]])
            case "swap":
                lines.insert(draw(st.integers(0, len(lines) - 1)), lines.pop(i))
                text = b"".join(lines)
            case "indent":
                lines[i] = b" " * draw(st.integers(1, 3)) + lines[i]
                text = b"".join(lines)
            case "insert":
                text = text[:at] + draw(st.sampled_from(JUNK_BYTES)) + text[at:]
            case "cut":
                text = text[:at]
            case "binary":
                text = text[:at] + draw(st.binary(max_size=20)) + text[at:]
    return text


def numbers(value: Any) -> Iterator[float]:
    """Every number in nested plain data."""
    if isinstance(value, float | int):
        yield value
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        yield from numbers(inner)


def check_sentence(message: Any) -> None:
    """Whether a message is one sentence, as far as a machine can tell."""
    assert isinstance(message, str)
    assert len(message.splitlines()) == 1, message
    assert message[-1] in ".?", message


def works_or_says_why(path: Path | str, overrides: Any = ()) -> TaskConfig | None:
    """A task that loads has only finite numbers; one that does not ends in one sentence that names the file."""
    try:
        task = load_task(path, overrides)
    except (ValueError, KeyError, TypeError) as error:
        assert type(error) in (ValueError, KeyError, TypeError)
        (message,) = error.args
        name = f"tasks/{path}.yaml" if path in SHIPPED else str(path)
        assert message.startswith(name)
        check_sentence(message)
        return None
    assert all(math.isfinite(number) for number in numbers(dataclasses.asdict(task)))
    task.for_evaluation()
    return task
