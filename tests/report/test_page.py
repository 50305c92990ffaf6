"""Pages that need nothing but themselves."""

from __future__ import annotations

import base64
import csv
import re
from html import unescape
from pathlib import Path

from ogmp_sb3.report.page import (
    ABREAST,
    Inset,
    KeyNumber,
    KeyNumbers,
    Note,
    Section,
    Table,
    Video,
    data_uri,
    fitting,
    make_picture,
    write_csv,
    write_page,
)


def draw(path: Path) -> None:
    path.with_name(f"{path.name}.png").write_bytes(b"png")
    path.with_name(f"{path.name}.svg").write_bytes(b"<svg/>")


def test_a_page_holds_its_sections_in_order_with_links_to_them(tmp_path: Path) -> None:
    picture = make_picture(tmp_path, "curve", "A curve.", [{"x": 1.0}], draw, ground=[{"y": 2.0}])
    sections = [
        Section("First", "Some words.", [Table([["rho", "0.5"]], ["key", "value_of_it"], "All keys.", ["all.csv"])]),
        Section("Second", "", [picture, Video("run.mp4", "data:video/mp4;base64,AAAA")]),
    ]
    write_page(tmp_path / "page.html", "Title", "more", sections)
    html = (tmp_path / "page.html").read_text()
    assert re.findall(r'<a href="#(section-\d)">(\w+)</a>', html) == [("section-1", "First"), ("section-2", "Second")]
    assert html.index('id="section-1"') < html.index("Some words.") < html.index('id="section-2"')
    assert "value_<wbr>of_<wbr>it" in html
    for file in ("all.csv", "curve.png", "curve.svg", "curve.csv", "curve_ground.csv"):
        assert f'href="{file}"' in html
    (source,) = re.findall(r'<img src="data:image/svg\+xml;base64,([^"]*)"', html)
    assert base64.b64decode(source) == b"<svg/>"
    assert '<video controls preload="metadata" src="data:video/mp4;base64,AAAA">' in html
    assert not list(tmp_path.glob("*.tmp"))


def test_text_is_never_markup(tmp_path: Path) -> None:
    nasty = '<script>alert("&")</script>'
    write_page(tmp_path / "page.html", nasty, nasty, [Section(nasty, nasty, [Table([[nasty]], [nasty], nasty)])])
    html = (tmp_path / "page.html").read_text()
    assert "<script>" not in html
    assert html.count("&lt;script&gt;") >= 6


def test_what_stands_above_the_first_section_is_not_among_the_contents(tmp_path: Path) -> None:
    numbers = KeyNumbers([KeyNumber("10.0 m", "way", "n = <3>.")])
    write_page(tmp_path / "page.html", "Title", "more", [Section("", "", [Note("<words>"), numbers])])
    html = (tmp_path / "page.html").read_text()
    assert "<h2>" not in html and "<li>" not in html
    assert "<p>&lt;words&gt;</p>" in html
    assert "<b>10.0 m</b> <strong>way</strong><p>n = &lt;3&gt;.</p>" in html


def test_a_page_within_the_page_is_whole_and_no_part_of_it(tmp_path: Path) -> None:
    inner = '<!DOCTYPE html><script>run("a & b")</script>'
    write_page(tmp_path / "page.html", "Title", "", [Section("", "", [Inset("replay", "It moves.", inner)])])
    html = (tmp_path / "page.html").read_text()
    (found,) = re.findall(r'<iframe srcdoc="([^"]*)" title="It moves."', html)
    assert unescape(found) == inner and "<script" not in html
    assert '<a href="replay.html">' in html


def test_a_wide_table_becomes_several_that_fit_with_the_leading_columns_in_each() -> None:
    names = [str(i) for i in range(ABREAST + 1)]
    wide = Table([["a", "b", *names]], ["job", "n", *names], "All.", ["all.csv"])
    first, second = fitting(wide, 2)
    assert (first.columns, first.rows) == (["job", "n", *names[:-1]], [["a", "b", *names[:-1]]])
    assert (second.columns, second.rows) == (["job", "n", names[-1]], [["a", "b", names[-1]]])
    assert [(each.caption, each.files) for each in (first, second)] == [("All.", []), ("", ["all.csv"])]
    assert fitting(first, 2) == [first]
    assert fitting(Table([["a"]], ["job"])) == [Table([["a"]], ["job"])]


def test_a_table_for_a_file_keeps_every_digit_and_leaves_out_nan(tmp_path: Path) -> None:
    rows = [{"a": 1 / 3, "b": float("nan")}, {"a": 1e-17, "b": "x,y"}]
    write_csv(tmp_path / "rows.csv", rows)
    with (tmp_path / "rows.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [float(row["a"]) for row in found] == [1 / 3, 1e-17]
    assert [row["b"] for row in found] == ["", "x,y"]


def test_a_data_uri_is_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(bytes(range(256)))
    head, _, body = data_uri(tmp_path / "file", "video/mp4").partition(",")
    assert head == "data:video/mp4;base64"
    assert base64.b64decode(body) == bytes(range(256))
