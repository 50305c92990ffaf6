"""The files that a robot is made of, as they lie side by side in one directory: :func:`robot_files`.

MuJoCo finds included files, meshes, textures and height fields by rules of its own: from the directory of the model,
from that of the file that includes, below ``meshdir`` and ``texturedir``, by absolute paths. Side by side all of this
falls away, so every reference becomes the bare name of a file. Nothing else of an MJCF is touched, and one whose
references are bare names already stays as it is, byte for byte: numbers keep their digits, and the model its bits.
"""

from __future__ import annotations

import html
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from xml.sax.saxutils import quoteattr

from omegaconf import OmegaConf

from ogmp_sb3.config.catalogue import is_file
from ogmp_sb3.config.robot import RobotConfig
from ogmp_sb3.config.yaml_files import read_yaml

ROBOT_FILE = "robot.yaml"
_TAG = re.compile(
    r"<!--.*?-->|<!\[CDATA\[.*?]]>|<\?.*?\?>|<([A-Za-z_][\w.:-]*)((?:[^<>\"']|\"[^\"]*\"|'[^']*')*)>", re.S
)
_ATTRIBUTE = re.compile(r"\s+([\w.:-]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_FACES = tuple(f"file{side}" for side in ("right", "left", "up", "down", "front", "back"))
_MESHES = ("mesh", "hfield", "skin", "flexcomp")  # elements whose files lie in meshdir
_DIRECTORIES = ("assetdir", "meshdir", "texturedir", "strippath")  # attributes of <compiler>


def robot_files(robot: RobotConfig) -> dict[str, bytes]:
    """The files that a robot is made of: ``robot.yaml``, the MJCF, and all that it includes or reads.

    Written into one directory, they are the same robot.

    :param robot: the robot
    :return: what is in them, by name; a name that two files have is put into a directory with a number for one of them
    :raises OSError: if one cannot be read
    """
    files: dict[str, bytes] = {ROBOT_FILE: b""}
    name = _Model(robot.mjcf_path.absolute()).collect(files)
    if robot.mjcf == name:
        files[ROBOT_FILE] = robot.path.read_bytes()
    else:
        data = {**read_yaml(robot.path), "mjcf": name}
        files[ROBOT_FILE] = OmegaConf.to_yaml(OmegaConf.create(data)).encode()
    return files


@dataclass
class _Model:
    """An MJCF with the files that it includes."""

    path: Path
    """the MJCF"""
    folder: str = ""
    """what its files are put into, with a slash"""
    mesh_dir: str = ""
    texture_dir: str = ""
    strip: bool = False
    """whether only the names of files count, not the directories before them"""
    xml: dict[Path, str] = field(default_factory=dict)
    """the MJCF and what it includes, as text"""
    names: dict[Path, str] = field(default_factory=dict)
    """what files are called from the directory of the MJCF"""

    def collect(self, files: dict[str, bytes]) -> str:
        """Put all files of the model into a mapping.

        :return: the name of the MJCF
        """
        self._read(self.path)
        for path in self.xml:
            self._name(path, files)
        for path, text in self.xml.items():
            changed = _TAG.sub(lambda tag, path=path: self._rewritten(tag, path, files), text)  # type: ignore[misc]
            files[self.folder + self.names[path]] = _encoded(changed)
        return self.folder + self.names[self.path]

    def _read(self, path: Path) -> None:
        """Read an MJCF and what it includes, and follow the settings of where files are, in the order of the text."""
        self.xml[path] = path.read_bytes().decode("utf-8", "surrogateescape")
        for tag in _TAG.finditer(self.xml[path]):
            values = {name: _plain(value) for name, value in _ATTRIBUTE.findall(tag[2] or "")}
            if tag[1] == "compiler":
                self.mesh_dir = values.get("meshdir", values.get("assetdir", self.mesh_dir))
                self.texture_dir = values.get("texturedir", values.get("assetdir", self.texture_dir))
                self.strip = values.get("strippath", str(self.strip).lower()) == "true"
            elif tag[1] == "include":
                included = self._included(values.get("file", ""), path)
                if included is not None and included not in self.xml:
                    self._read(included)

    def _rewritten(self, tag: re.Match[str], path: Path, files: dict[str, bytes]) -> str:
        """A tag with its files by their new names, which are put into ``files`` on the way."""
        element = tag[1]

        def attribute(match: re.Match[str]) -> str:
            key, value = match[1], _plain(match[2])
            if element == "compiler":
                return "" if key in _DIRECTORIES else match[0]
            if not (key == "file" or (element == "texture" and key in _FACES)):
                return match[0]
            source = self._source(element, value, path)
            name = None if source is None else self._put(source, element, files)
            return match[0] if name in (None, value) else f" {key}={quoteattr(str(name))}"

        return tag[0] if element is None else f"<{element}{_ATTRIBUTE.sub(attribute, tag[2])}>"

    def _source(self, element: str, value: str, path: Path) -> Path | None:
        """The file that an element reads; None if there is none."""
        if element == "include":
            return self._included(value, path)
        if element == "model":
            return _existing(self.path.parent, value)
        if element not in (*_MESHES, "texture"):
            return None
        directory = self.texture_dir if element == "texture" else self.mesh_dir
        return _existing(self.path.parent, directory, re.split(r"[/\\]", value)[-1] if self.strip else value)

    def _included(self, value: str, path: Path) -> Path | None:
        return _existing(self.path.parent, value) or _existing(path.parent, value)

    def _put(self, source: Path, element: str, files: dict[str, bytes]) -> str:
        """Put a file where it has not been put yet.

        :return: its name
        """
        if source in self.names:
            return self.names[source]
        if element == "model":  # which has directories of its own
            empty = (place for place in _numbered(self.folder, 1) if not any(name.startswith(place) for name in files))
            model = _Model(source, next(empty))
            self.names[source] = model.collect(files).removeprefix(self.folder)
        else:
            files[self.folder + self._name(source, files)] = source.read_bytes()
        return self.names[source]

    def _name(self, path: Path, files: dict[str, bytes]) -> str:
        """Give a file a name; meshes without one are called by it, so it stays as it is."""
        folder = _place(self.folder, path.name, files)
        files[folder + path.name] = b""
        self.names[path] = (folder + path.name).removeprefix(self.folder)
        return self.names[path]


def _place(folder: str, name: str, files: dict[str, bytes]) -> str:
    """A directory in which no file has a name yet, also where capitals do not tell names apart."""
    taken = {known.lower() for known in files}
    return next(place for place in _numbered(folder, 0) if (place + name).lower() not in taken)


def _numbered(folder: str, first: int) -> Iterator[str]:
    return (f"{folder}{number}/" if number else folder for number in count(first))


def _existing(folder: Path, *parts: str) -> Path | None:
    """A file by its path, read as MuJoCo reads it: either slash, and ``..`` by name."""
    path = Path(os.path.normpath(os.path.join(folder.absolute(), *(part.replace("\\", "/") for part in parts))))
    return path if parts[-1] and is_file(path) else None


def _plain(value: str) -> str:
    """The text of an attribute that stands in quotes."""
    return html.unescape(value[1:-1])


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")
