"""A page that opens from disk and needs nothing else: text, tables, pictures and videos in one HTML file."""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jinja2

from ogmp_sb3.runs.atomic import replacing

TEMPLATES = Path(__file__).parent / "templates"
ABREAST = 4  # columns of means with their intervals
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Table:
    """Text in rows and columns; the first column names the row."""

    rows: list[list[str]]
    """cells"""
    columns: list[str] = field(default_factory=list)
    """headings, or none"""
    caption: str = ""
    """what it shows"""
    files: list[str] = field(default_factory=list)
    """its data, beside the page"""
    kind: str = "table"


@dataclass(frozen=True)
class Picture:
    """A picture within the page, and the files that it and its data also lie in."""

    name: str
    """name of the files without ending"""
    caption: str
    """what it shows"""
    source: str
    """data URI"""
    files: list[str]
    """beside the page"""
    kind: str = "picture"


@dataclass(frozen=True)
class Video:
    """A video within the page."""

    caption: str
    """what it shows"""
    source: str
    """data URI"""
    kind: str = "video"


@dataclass(frozen=True)
class KeyNumber:
    """A number that is read first."""

    value: str
    """with its unit"""
    label: str
    """what it is"""
    about: str
    """its interval, and what it means"""


@dataclass(frozen=True)
class KeyNumbers:
    """Numbers side by side, in large letters."""

    numbers: list[KeyNumber]
    """in order"""
    kind: str = "numbers"


@dataclass(frozen=True)
class Inset:
    """A page within the page."""

    name: str
    """of its file beside the page, without ending"""
    caption: str
    """what it shows"""
    html: str
    """all of it"""
    kind: str = "inset"


@dataclass(frozen=True)
class Note:
    """A paragraph among the other parts."""

    text: str
    """sentences"""
    kind: str = "note"


Part = Table | Picture | Video | KeyNumbers | Inset | Note


@dataclass(frozen=True)
class Section:
    """A section of the page."""

    title: str
    """its heading, also in the table of contents; empty for what stands above the first"""
    text: str
    """a paragraph, or nothing"""
    parts: list[Part]
    """what follows, in order"""


def make_picture(out: Path, name: str, caption: str, rows: Rows, draw: Callable[[Path], None], **more: Rows) -> Picture:
    """Draw a picture into ``<name>.png`` and ``<name>.svg`` and write its data to ``<name>.csv``.

    :param out: directory of the page
    :param rows: the data; all rows have the keys of the first
    :param draw: draws to a path without ending
    :param more: further data, written to ``<name>_<key>.csv``
    """
    draw(out / name)
    tables = {name: rows, **{f"{name}_{key}": table for key, table in more.items()}}
    for stem, table in tables.items():
        write_csv(out / f"{stem}.csv", table)
    source = data_uri(out / f"{name}.svg", "image/svg+xml")
    return Picture(name, caption, source, [f"{name}.png", f"{name}.svg", *(f"{stem}.csv" for stem in tables)])


def fitting(table: Table, leading: int = 1) -> list[Table]:
    """A table as one or more that fit a window of 1,200 pixels, below each other: each has the leading columns.

    :param table: with headings; its caption stands above the first, its files are below the last
    :param leading: columns that name the rows
    """
    columns = range(leading, len(table.columns))
    groups = [columns[i : i + ABREAST] for i in range(0, len(columns), ABREAST)] or [columns]
    tables = [
        Table(
            [[*row[:leading], *(row[i] for i in group)] for row in table.rows],
            [*table.columns[:leading], *(table.columns[i] for i in group)],
        )
        for group in groups
    ]
    tables[0] = replace(tables[0], caption=table.caption)
    tables[-1] = replace(tables[-1], files=table.files)
    return tables


def write_csv(path: Path, rows: Rows) -> None:
    """Write rows with a line of headings, all or nothing; nan is an empty cell."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows({key: "" if value != value else value for key, value in row.items()} for row in rows)


def first_paragraph(function: Any) -> str:
    """What the docstring of a function begins with, as plain text."""
    text = (function.__doc__ or "").strip().split("\n\n")[0]
    return re.sub(r":\w+:|`+", "", " ".join(text.split()))


def data_uri(path: Path, kind: str) -> str:
    """A file as a URI that holds all of it.

    :param kind: media type
    """
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def template(name: str) -> jinja2.Template:
    """A template of a page, in which values are text and none may be missing."""
    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined)
    return environment.get_template(name)


def write_page(path: Path, title: str, subtitle: str, sections: list[Section]) -> None:
    """Write the page, all or nothing."""
    html = template("report.html").render(title=title, subtitle=subtitle, sections=sections)
    with replacing(path) as file:
        file.write_text(html, encoding="utf-8")
