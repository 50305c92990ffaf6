"""The tutorials, done as a reader does them: every page from top to bottom, in an empty directory.

What a page has in its fenced blocks is executed in order:

- ``console``: lines that begin with ``$`` are commands; the lines below one must be among what it prints.
- ``python``, ``yaml``, ``toml``: with a first line that is a comment with a file name, it becomes that file; other
  Python is run.
- ``diff``: is applied to the files it names.

All others are only read.
"""

from __future__ import annotations

import importlib
import io
import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from helpers.paths import ROOT
from helpers.programs import SMALL, Result, program
from ogmp_sb3.config import plugins
from ogmp_sb3.rendering.opengl import gl_library

TUTORIALS = ROOT / "docs" / "tutorials"
PAGES = sorted(TUTORIALS.glob("*.md"))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"# (\S+\.(?:py|yaml|toml))\n")

# The budgets of seconds that the tests put in place of the pages' own.
LESS = {
    "encode": ["references=100", "updates=20"],
    "train": [*SMALL, "hydra/launcher=basic", "++task.evaluation.episode_steps=20"],
    "eval": ["episodes=2", "evaluation.episode_steps=20"],
    "play": ["seconds=0.06"],
    "report": ["episodes=2", "evaluation.episode_steps=20", "variants=null"],
}


def smaller(name: str, given: list[str]) -> list[str]:
    """The arguments of a command with a budget of seconds."""
    given = [re.sub(r"^(total_timesteps=)(\d+)$", lambda m: f"{m[1]}{max(256, int(m[2]) // 2000)}", g) for g in given]
    if any(word.startswith("resume=") for word in given):  # its other settings cannot change
        return given
    less = LESS.get(name, [])
    replaced = {word.partition("=")[0] for word in less}
    return [*(word for word in given if word.partition("=")[0] not in replaced), *less]


def blocks(page: Path) -> list[tuple[str, str]]:
    """The fenced blocks of a page: language and text."""
    return FENCE.findall(page.read_text(encoding="utf-8"))


def commands(text: str) -> list[tuple[list[str], list[str]]]:
    """The commands of a console block, each with the lines of output below it."""
    found: list[tuple[list[str], list[str]]] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append((shlex.split(line[2:], comments=True), []))
        elif line.strip():
            found[-1][1].append(line.strip())
    return found


Install = Callable[[str], Result]


@pytest.fixture
def install(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, forget: None) -> Install:
    """``pip install <folder>``, into a place that is forgotten after the test."""
    site = tmp_path_factory.mktemp("site")
    monkeypatch.syspath_prepend(site)

    def install(folder: str) -> Result:
        options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--target", str(site)]
        command = [sys.executable, "-m", "pip", "install", *options, folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        importlib.invalidate_caches()
        monkeypatch.setattr(plugins, "_plugins", None)  # the next command is a new process
        return Result(done.returncode, done.stdout, done.stderr)

    return install


def draws() -> bool:
    """Whether there is an OpenGL library."""
    try:
        gl_library()
    except ValueError:
        return False
    return True


def run(words: list[str], folder: Path, install: Install) -> Result:
    """Run one command of a page."""
    name, *given = words
    if name == "pip":
        return install(given[-1])
    if name == "python":
        with redirect_stdout(io.StringIO()) as out:
            runpy.run_path(given[0])
        return Result(0, out.getvalue(), "")
    if not name.startswith("ogmp-"):
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        return Result(done.returncode, done.stdout, done.stderr)
    name = name.removeprefix("ogmp-")
    return program(name, *smaller(name, given), cwd=folder)


def check_console(text: str, folder: Path, install: Install) -> None:
    """Run the commands of a block; each prints what is shown, and fails only if a mistake is shown."""
    for words, shown in commands(text):
        if any(word.startswith("video=") for word in words) and not draws():
            continue
        done = run(words, folder, install)
        said = f"{shlex.join(words)}\n{done.stdout}{done.stderr}"
        mistake = any(line.startswith(f"{words[0]}: ") for line in shown)
        assert done.returncode == (2 if mistake else 0), said
        printed = [plain(line) for line in said.splitlines()]
        assert [line for line in shown if plain(line) not in printed] == [], said


def plain(line: str) -> str:
    """A line without the spaces that align it."""
    return " ".join(line.split())


@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_a_page_can_be_followed(page: Path, tmp_path: Path, install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    ignored = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(ROOT / "examples", tmp_path / "examples", ignore=ignored)  # pages begin in a clone
    for language, text in blocks(page):
        file = FILE.match(text)
        if language == "console":
            check_console(text, tmp_path, install)
        elif file:
            path = tmp_path / file[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, page.name, "exec"), {"__name__": "__main__"})
        elif language == "diff":
            subprocess.run(["git", "apply"], input=text, text=True, check=True)


def test_the_notebook_is_the_page() -> None:
    write = runpy.run_path(str(ROOT / "docs" / "notebook.py"))["text_of"]
    page, notebook = TUTORIALS / "first-policy.md", TUTORIALS / "first_policy.ipynb"
    assert notebook.read_text(encoding="utf-8") == write(page), (
        f"write it again: python docs/notebook.py {page.relative_to(ROOT)} {notebook.relative_to(ROOT)}"
    )


def test_the_notebook_has_the_commands_of_the_page_and_no_outputs() -> None:
    notebook = json.loads((TUTORIALS / "first_policy.ipynb").read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    lines = "".join(line if line.endswith("\n") else line + "\n" for cell in code for line in cell["source"])
    typed = [shlex.split(line[1:]) for line in lines.splitlines() if line.startswith("!")]
    blocks_of_page = blocks(TUTORIALS / "first-policy.md")
    assert typed == [words for lang, text in blocks_of_page if lang == "console" for words, _ in commands(text)]


def test_every_tutorial_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert [page.stem for page in PAGES if f"\ntutorials/{page.stem}\n" not in index] == []
