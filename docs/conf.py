"""Sphinx settings; `make docs` builds with warnings as errors."""

import configparser
from pathlib import Path
from typing import Any

_setup = configparser.ConfigParser()
_setup.read(Path(__file__).parents[1] / "setup.cfg", encoding="utf-8")

project = "ogmp_sb3"
author = _setup["metadata"]["author"]
copyright = f"2026, {author}"
version = release = _setup["metadata"]["version"]

# The last brings MathJax along, so that equations are drawn without the internet.
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx-mathjax-offline"]
exclude_patterns = ["_build"]

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_inherit_docstrings = False  # other projects' docstrings are not reStructuredText
autodoc_mock_imports = ["onnx", "onnxruntime"]  # of an extra
autodoc_default_options = {"members": True, "undoc-members": True, "show-inheritance": True}

html_theme = "furo"
html_title = f"ogmp_sb3 {release}"
html_static_path = ["_static"]
html_css_files = ["front.css"]

REPLAY = "replay.html"  # on the front page: test episodes of the policy that ships
EPISODES = 20  # that they are chosen from


def write_replay(app: Any) -> None:
    """Play the policy that ships, for the front page."""
    if app.builder.format != "html" or (Path(app.outdir) / REPLAY).is_file():
        return
    from ogmp_sb3 import load_policy
    from ogmp_sb3.evaluation.recording import record_chosen
    from ogmp_sb3.report import replay

    loaded = load_policy("parkour")
    episodes = record_chosen(loaded.policy, loaded.task.for_evaluation(), EPISODES, seed=0)
    subtitle = f"{len(episodes)} of {EPISODES} test episodes of the policy that ships"
    replay.write_replay(Path(app.outdir) / REPLAY, loaded.task, episodes, "Parkour", subtitle)


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", write_replay)
