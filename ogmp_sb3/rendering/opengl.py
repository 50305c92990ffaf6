"""The OpenGL library that pictures are drawn with. Nothing else needs one."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

LIBRARIES = ("egl", "osmesa", "glfw")  # in the order they are tried; glfw needs a screen
PROBE = """
import mujoco
context = mujoco.GLContext(16, 16)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100.value)
"""
REMEDY = (
    "install a software one (Debian: apt install libosmesa6, then MUJOCO_GL=osmesa) or a GPU driver (MUJOCO_GL=egl)."
)


def gl_library() -> str:
    """The OpenGL library that works here: that of ``MUJOCO_GL`` if set, else the first of EGL, OSMesa and GLFW.

    :raises ValueError: if none does
    """
    wanted = os.environ.get("MUJOCO_GL")
    for name in (wanted,) if wanted else LIBRARIES:
        environment = {**os.environ, "MUJOCO_GL": name}
        probe = [sys.executable, "-c", PROBE]
        if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode == 0:
            return name
    tried = f"with MUJOCO_GL={wanted}" if wanted else f"by {', '.join(LIBRARIES)}"
    raise ValueError(f"no OpenGL found {tried}: {REMEDY}")


def import_mujoco() -> None:
    """Import MuJoCo also where ``MUJOCO_GL`` names a library that is missing, with a warning: only drawing needs it.

    MuJoCo loads that library when it is imported. PyOpenGL says with an AttributeError that there is none, and MuJoCo
    with a RuntimeError that it knows none of that name.
    """
    wanted = os.environ.get("MUJOCO_GL")
    if not wanted:
        return  # then MuJoCo loads none that can be missing
    try:
        import mujoco
    except (AttributeError, RuntimeError):
        warnings.warn(f"nothing can be drawn: no OpenGL found with MUJOCO_GL={wanted}: {REMEDY}", stacklevel=2)
        os.environ["MUJOCO_GL"] = "disable"
        import mujoco  # noqa: F401

        os.environ["MUJOCO_GL"] = wanted
