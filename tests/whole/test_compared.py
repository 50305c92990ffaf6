"""Behind what docs/compared.md says of this package is a test or a result, behind what it says of others a source."""

from __future__ import annotations

import ast
import re
from functools import cache

import pytest

from helpers.paths import ROOT

TEXT = (ROOT / "docs" / "compared.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8")
BODY, _, SOURCES = TEXT.partition("\n## Sources\n")
OURS = "**ogmp_sb3**"
OTHERS = ["mjlab", "UniLab", "MuJoCo Playground", "rsl_rl", "Isaac Lab"]
TESTS = sorted(set(re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", BODY)))
SECTIONS = sorted(set(re.findall(r"`benchmarks/RESULTS.md`, section \*([^*]+)\*", BODY)))
DEFINITIONS = dict(re.findall(r"^\[\^([\w-]+)\]: (.+)$", SOURCES, re.MULTILINE))
TABLES = {
    title: ([[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines.splitlines()[2:]], behind)
    for title, lines, behind in re.findall(
        r"^## ([^\n]+)\n\n((?:\|[^\n]*\n)+)\nBehind our row: ((?:[^\n]+\n)+)", BODY, re.MULTILINE
    )
}
"""By title: rows, and what is behind the first of them."""
VERSION = r"\bcommits? [0-9a-f]{7}|\d+ commits|\b\d+\.\d+|`(main|develop|latest)`|without a version"
TESTED = r"`tests/|`benchmarks/RESULTS.md`, section \*"


def notes(text: str) -> list[str]:
    return re.findall(r"\[\^([\w-]+)\]", text)


@cache
def functions(file: str) -> set[str]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_the_page_is_read() -> None:
    assert len(TABLES) > 14 and len(TESTS) > 35 and len(DEFINITIONS) > 40 and SECTIONS
    assert len(TABLES) == len(re.findall(r"^\|---", BODY, re.MULTILINE))
    assert len(re.findall(r"tests/", BODY)) == len(re.findall(r"`tests/[\w/]+\.py::\w+`", BODY))


@pytest.mark.parametrize(("file", "name"), TESTS)
def test_a_test_exists(file: str, name: str) -> None:
    assert name.startswith("test_") and name in functions(file)


@pytest.mark.parametrize("title", SECTIONS)
def test_a_section_exists(title: str) -> None:
    assert re.search(rf"^## {re.escape(title)}(:|$)", RESULTS, re.MULTILINE)


@pytest.mark.parametrize("title", TABLES)
def test_a_table_has_a_row_for_everyone_with_what_is_behind_it(title: str) -> None:
    ((ours, said, _), *others), behind = TABLES[title]
    assert ours == OURS and said and re.search(TESTED, behind)
    assert [name for name, _, _ in others][: len(OTHERS)] == OTHERS
    for name, said, source in others:
        assert name and said and notes(source), f"{title}: {name}"


def test_numbers_of_results_are_those_of_results() -> None:
    cells = [rows[0][1] for rows, behind in TABLES.values() if "RESULTS.md" in behind]
    numbers = re.findall(r"\b\d[\d,.]*\d\b", " ".join(cells))
    assert {"1,880", "4.29"} <= set(numbers)
    assert [number for number in numbers if number not in RESULTS] == []


def test_what_others_do_better_comes_with_sources() -> None:
    _, _, better = BODY.partition("\n## What they do better\n\n")
    points = better.partition("\n## ")[0].strip().split("\n- ")
    assert len(points) >= 6
    for point in points:
        assert notes(point), point


def test_every_note_is_defined_and_used() -> None:
    assert len(DEFINITIONS) == len(re.findall(r"^\[\^", SOURCES, re.MULTILINE))
    assert set(notes(BODY)) == set(DEFINITIONS)


@pytest.mark.parametrize("note", DEFINITIONS)
def test_a_source_has_an_address_a_version_and_the_month_it_was_read(note: str) -> None:
    text = DEFINITIONS[note]
    assert re.search(r"<https://[^ >]+>", text)
    assert re.search(VERSION, re.sub(r"<[^>]+>", "", text)), "no version, commit or branch"
    assert re.search(r"Read 20\d\d-(0[1-9]|1[0-2])\.$", text)
