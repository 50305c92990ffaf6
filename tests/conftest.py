"""What tests of several modules need."""

from __future__ import annotations

import pytest

from ogmp_sb3.opengl import gl_library


@pytest.fixture(scope="session")
def opengl() -> None:
    """Skips a test that draws, with the reason, where there is no OpenGL."""
    try:
        gl_library()
    except ValueError as error:
        pytest.skip(str(error))
