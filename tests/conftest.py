"""Fixtures of several test modules."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from ogmp_sb3.config import plugins, registry
from ogmp_sb3.rendering.opengl import gl_library

# The same few examples in every run; HYPOTHESIS_PROFILE=thorough tries many, and others each time.
SLOW_IS_FINE = {"deadline": None, "suppress_health_check": list(HealthCheck)}
settings.register_profile("quick", max_examples=40, derandomize=True, **SLOW_IS_FINE)
settings.register_profile("thorough", max_examples=1000, print_blob=True, **SLOW_IS_FINE)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


# Files whose tests start processes or train for long, the slowest first.
SLOW = (
    "whole/test_launchers.py", "runs/test_training.py", "whole/test_tutorials.py", "commands/train/test_program.py",
    "commands/train/test_optuna_search.py", "commands/train/test_search.py",
    "runs/test_autosave.py", "whole/test_public_face.py", "whole/test_sb3.py",
    "config/test_plugins.py", "commands/test_report.py", "commands/bench/test_program.py", "whole/test_extremes.py",
    "rendering/test_opengl.py", "commands/test_play.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the slow files."""
    places = {name: place for place, name in enumerate(SLOW)}
    root = Path(__file__).parent
    items.sort(key=lambda item: places.get(item.path.relative_to(root).as_posix(), len(SLOW)))


@pytest.fixture
def forget(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """As if no plug-in had been looked for yet; afterwards all is as it was."""
    modules, functions = set(sys.modules), [dict(kind._functions) for kind in registry.KINDS]
    monkeypatch.setattr(plugins, "_plugins", None)
    yield
    for kind, before in zip(registry.KINDS, functions, strict=True):
        kind._functions = before
    installed = str(tmp_path_factory.getbasetemp())
    for name in set(sys.modules) - modules:
        module = sys.modules[name]
        places = [getattr(module, "__file__", None), *vars(module).get("__path__", [])]
        if any(str(place).startswith(installed) for place in places):
            del sys.modules[name]


@pytest.fixture(scope="session")
def opengl() -> None:
    """Skips a test that draws, with the reason, where there is no OpenGL."""
    try:
        gl_library()
    except ValueError as error:
        pytest.skip(str(error))
