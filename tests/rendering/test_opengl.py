"""Choosing the OpenGL library, and doing without one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ogmp_sb3.rendering.opengl import gl_library

NO_OSMESA = """
import ctypes, ctypes.util
found, load = ctypes.util.find_library, ctypes.CDLL.__init__

def refuse(self, name, *rest, **more):
    if "OSMesa" in str(name):
        raise OSError(f"{name}: cannot open shared object file")
    load(self, name, *rest, **more)

ctypes.util.find_library = lambda name: None if "OSMesa" in name else found(name)
ctypes.CDLL.__init__ = refuse
"""


@pytest.mark.parametrize("wanted", ["glfw", "opengles"])
def test_without_opengl_one_sentence_says_what_to_install(wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", wanted)
    with pytest.raises(ValueError, match=rf"no OpenGL found with MUJOCO_GL={wanted}: .*apt install libosmesa6"):
        gl_library()


def without_osmesa(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python with MUJOCO_GL=osmesa as on a machine without that library."""
    (folder / "sitecustomize.py").write_text(NO_OSMESA)
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    environment = {**os.environ, "MUJOCO_GL": "osmesa", "PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_a_program_that_draws_says_what_to_install(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="videos need the extra 'viewer'")
    done = without_osmesa(tmp_path, "-m", "ogmp_sb3.commands.play", "task=dive", "video=a.png", "seconds=0.03")
    assert done.returncode == 2
    assert "ogmp-play: no OpenGL found with MUJOCO_GL=osmesa: install a software one" in done.stderr
    assert "apt install libosmesa6" in done.stderr
    assert "Traceback" not in done.stderr


def test_what_draws_nothing_warns_and_works(tmp_path: Path) -> None:
    code = "import os, ogmp_sb3; ogmp_sb3.make_env('dive').reset(); print(os.environ['MUJOCO_GL'])"
    done = without_osmesa(tmp_path, "-c", code)
    assert (done.returncode, done.stdout) == (0, "osmesa\n"), done.stderr
    assert "UserWarning: nothing can be drawn: no OpenGL found with MUJOCO_GL=osmesa" in done.stderr
