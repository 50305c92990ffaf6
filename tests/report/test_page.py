"""Pages that need nothing but themselves."""

from __future__ import annotations

import base64
import csv
import re
from pathlib import Path

from ogmp_sb3.report.page import Section, Table, Video, data_uri, make_picture, write_csv, write_page


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
