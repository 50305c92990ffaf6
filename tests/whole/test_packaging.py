"""Tests of the package as a whole: its metadata, its data files and the direction of its imports."""

import ast
import configparser
import graphlib
import importlib.metadata
import importlib.util
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import ogmp_sb3
from helpers.paths import ROOT

PACKAGE = Path(ogmp_sb3.__file__).parent

ORDER = ("config", "guidance", "env", "rendering", "sb3", "runs", "evaluation", "report", "commands")
"""The packages from left to right. Each imports from its left and, without cycles, from itself."""

NEED_EXTRAS = {"commands.export.onnx_graphs", "commands.export.controller"}  # of no use without

UNDOCUMENTED = {"policy"}  # an alias

SOLE_IMPORTERS = {
    "control": {"guidance.riccati"},
    "matplotlib": {"report.plots", "machine"},
    "numba": {"machine"},
    "mujoco.batch": {"env.simulation"},
    "hydra": {"commands.train", "runs.multirun"},
    "onnx": {"commands.export.onnx_graphs"},
    "onnxruntime": {"commands.export"},
    "wandb": {"runs.tracker_runs"},
    "mlflow": {"runs.tracker_runs"},
    "trackio": {"runs.tracker_runs"},
    "huggingface_hub": {"runs.hub"},
}

DISTRIBUTIONS = {
    "mujoco_menagerie": "mujoco-menagerie",
    "stable_baselines3": "stable-baselines3",
    "sb3_contrib": "sb3-contrib",
    "hydra": "hydra-core",
    "yaml": "pyyaml",
    "PIL": "pillow",
    "mlflow": "mlflow-skinny",
    "huggingface_hub": "huggingface-hub",
    "imageio_ffmpeg": "imageio-ffmpeg",
}
"""Distributions that are called otherwise than the module they install."""

PEERS = {"rsl_rl", "tensordict"}  # compared with where a user has installed them, never required


def setup_cfg() -> configparser.ConfigParser:
    parser = configparser.ConfigParser()
    parser.read(ROOT / "setup.cfg", encoding="utf-8")
    return parser


def listed(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines() if line.strip()]


def console_scripts() -> dict[str, str]:
    pairs = (line.split("=", 1) for line in listed(setup_cfg()["options.entry_points"]["console_scripts"]))
    return {name.strip(): target.strip() for name, target in pairs}


def requirement_name(requirement: str) -> str:
    return re.match(r"[A-Za-z0-9._-]+", requirement).group().lower().replace("_", "-")


def module_name(path: Path) -> str:
    """`config` for `ogmp_sb3/config/load.py`, `__init__` for the package itself."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


def imported_names(source: str) -> set[str]:
    """Dotted names that a module of `ogmp_sb3` imports anywhere, functions included.

    `from a import b` counts as `a` and `a.b`, because `b` may be a module. Relative imports get their full
    name. `mujoco.batch.X` counts as an import of `mujoco.batch`, for it works only after one.
    """
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = f"ogmp_sb3.{base}".rstrip(".")
            names.add(base)
            names.update(f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Attribute) and ast.unparse(node) == "mujoco.batch":
            names.add("mujoco.batch")
    return names


def imported_modules(names: set[str]) -> set[str]:
    """Modules of `ogmp_sb3` among dotted names: `config.load` for `ogmp_sb3.config.load.load_task`."""
    inner = {name.removeprefix("ogmp_sb3.") for name in names if name.startswith("ogmp_sb3.")}
    return {name for name in inner if name in SOURCES}


def package(module: str) -> str:
    """`config` for `config.load`; a module of the top level is its own."""
    return module.partition(".")[0]


def imports(names: set[str], target: str) -> bool:
    return any(name == target or name.startswith(f"{target}.") for name in names)


# `conf` holds Hydra's YAML files; what lies behind the links to tasks, robots and policies is data.
SOURCES = {
    module_name(path): path
    for path in sorted([*PACKAGE.glob("*.py"), *PACKAGE.glob("[!_]*/**/*.py")])
    if path.relative_to(PACKAGE).parts[0] not in {"conf", "tasks", "robots", "policies", "encoders"}
}
IMPORTED = {module: imported_names(path.read_text(encoding="utf-8")) for module, path in SOURCES.items()}
MODULES = sorted(set(SOURCES) - {"__init__"})


def test_imported_names_finds_imports_in_functions_and_relative_ones() -> None:
    source = (
        "import numpy as np\n"
        "from . import zoo\n"
        "from .config.load import load_task\n"
        "from ogmp_sb3.config import registry\n"
        "def late():\n"
        "    import ogmp_sb3.config.task\n"
        "    import mujoco\n"
        "    return mujoco.batch.Batch\n"
    )
    names = imported_names(source)
    assert {"numpy", "mujoco", "mujoco.batch"} <= names
    assert imported_modules(names) >= {"zoo", "config.load", "config.registry", "config.task"}


@pytest.mark.parametrize("module", [module for module in MODULES if package(module) in ORDER])
def test_module_imports_only_from_its_left(module: str) -> None:
    to_the_left = ORDER[: ORDER.index(package(module)) + 1]
    right = {name for name in imported_modules(IMPORTED[module]) if package(name) in ORDER}
    right = {name for name in right if package(name) not in to_the_left}
    assert not right, f"{module} imports {', '.join(sorted(right))}, to the right of '{package(module)}'"


def test_a_package_is_a_docstring_and_what_it_imports_costs_nothing() -> None:
    for name in ORDER:
        file = PACKAGE / name / "__init__.py"
        if file.is_file():
            assert [type(node) for node in ast.parse(file.read_text(encoding="utf-8")).body] == [ast.Expr], name


def test_imports_have_no_cycle() -> None:
    graph = {module: imported_modules(IMPORTED[module]) for module in MODULES}
    graphlib.TopologicalSorter(graph).prepare()


def test_the_picture_of_the_packages_is_up_to_date() -> None:
    picture = (ROOT / "docs" / "images" / "map.svg").read_text(encoding="utf-8")
    places = [picture.index(f">{name}/<") for name in ORDER]
    assert places == sorted(places)
    for module in (module for module in MODULES if package(module) in ORDER):
        assert re.search(rf"\b{re.escape(module.partition('.')[2])}\b", picture), f"{module}: run make map"


def test_every_module_has_a_section_in_the_documentation() -> None:
    pages = (ROOT / "docs" / "api.rst").read_text(encoding="utf-8")
    modules = {module for module in MODULES if SOURCES[module].name != "__init__.py"} - UNDOCUMENTED
    missing = [module for module in sorted(modules) if f".. automodule:: ogmp_sb3.{module}\n" not in pages]
    assert not missing, f"{', '.join(missing)}: add a section to docs/api.rst"


def test_package_itself_imports_no_program() -> None:
    programs = {name for name in imported_modules(IMPORTED["__init__"]) if package(name) == "commands"}
    assert not programs, f"ogmp_sb3/__init__.py imports {', '.join(sorted(programs))}"


@pytest.mark.parametrize("target", SOLE_IMPORTERS)
def test_heavy_import_stays_in_its_place(target: str) -> None:
    importers = {module for module, names in IMPORTED.items() if imports(names, target)}
    allowed = SOLE_IMPORTERS[target]
    strangers = {name for name in importers if not any(name == a or name.startswith(f"{a}.") for a in allowed)}
    assert not strangers, f"{', '.join(sorted(strangers))} import {target}; only {', '.join(sorted(allowed))} may"


def requirements(optional: bool) -> set[str]:
    """Names of what the package requires, or of what its extras do."""
    config = setup_cfg()
    texts = config["options.extras_require"].values() if optional else [config["options"]["install_requires"]]
    return {requirement_name(line) for text in texts for line in listed(text) if not line.startswith("#")}


def distributions(names: set[str]) -> set[str]:
    """The distributions that some imports need."""
    tops = {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) - {"ogmp_sb3"}
    return {DISTRIBUTIONS.get(name, name).lower() for name in tops}


@pytest.mark.parametrize("module", ["__init__", *MODULES])
def test_every_import_is_a_declared_requirement(module: str) -> None:
    missing = distributions(IMPORTED[module]) - requirements(optional=False) - requirements(optional=True) - PEERS
    assert not missing, f"{module} imports {', '.join(sorted(missing))}: add to setup.cfg"


def test_every_requirement_is_imported() -> None:
    imported = set().union(*(distributions(names) for names in IMPORTED.values()))
    assert requirements(optional=False) <= imported


def test_the_audit_never_passes_off_what_it_did_not_look_at() -> None:
    spec = importlib.util.spec_from_file_location("audit", ROOT / ".ci" / "audit.py")
    audit = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(audit)
    unknown = {"name": "a", "skip_reason": "not found"}
    fine = {"name": "b", "version": "1", "vulns": []}
    bad = {"name": "c", "version": "2", "vulns": [{"id": "CVE-1"}]}
    assert audit.verdict({"dependencies": [unknown, unknown]}) == (
        "no vulnerability service here knows any of the 2 packages: NOT audited",
        True,
    )
    assert audit.verdict({"dependencies": [unknown, fine]}) == (
        "1 of 2 packages audited, no known vulnerability",
        True,
    )
    assert audit.verdict({"dependencies": [unknown, fine, bad]}) == ("vulnerable: c 2: CVE-1", False)


def imported_at_load(module: str) -> set[str]:
    """What a module imports outside of functions and not only for type checkers."""
    tree = ast.parse(SOURCES[module].read_text(encoding="utf-8"))
    at_load = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    return imported_names(ast.unparse(ast.Module(at_load, [])))


@pytest.mark.parametrize("module", ["__init__", *MODULES])
def test_a_module_loads_without_any_extra(module: str) -> None:
    """What extras install may be imported in functions, and for type checkers; so may modules that need an extra."""
    found = imported_at_load(module)
    if module not in NEED_EXTRAS:
        optional = distributions(found) - requirements(optional=False)
        assert not optional, f"{module} imports {', '.join(sorted(optional))} when it is loaded; do so where it is used"
    needing = {f"ogmp_sb3.{name}" for name in NEED_EXTRAS}
    assert not {name for name in found if name in needing}, f"{module} imports what needs an extra when it is loaded"


def test_version_is_the_same_everywhere() -> None:
    version = setup_cfg()["metadata"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## [{version}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert getattr(ogmp_sb3, "__version__", version) == version


def test_constraints_pin_every_requirement() -> None:
    pins = listed((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    pinned = {requirement_name(line) for line in pins if not line.startswith("#")}
    required = {requirement_name(line) for line in listed(setup_cfg()["options"]["install_requires"])}
    assert required <= pinned


@pytest.mark.parametrize(("name", "target"), console_scripts().items())
def test_console_script_loads(name: str, target: str) -> None:
    try:
        distribution = importlib.metadata.distribution("ogmp_sb3")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("ogmp_sb3 is importable here but not installed")
    installed = {entry.name: entry for entry in distribution.entry_points if entry.group == "console_scripts"}
    assert name in installed, "setup.cfg has changed since the package was installed: install it again"
    assert installed[name].value == target
    assert callable(installed[name].load())


def test_package_is_marked_as_typed() -> None:
    assert (PACKAGE / "py.typed").is_file()


@pytest.mark.parametrize(
    "path", ["tasks/parkour.yaml", "tasks/dive.yaml", "robots/hector/hector.xml", "robots/hector/robot.yaml"]
)
def test_data_file_lies_in_the_package(path: str) -> None:
    assert (PACKAGE / path).is_file()


def test_wheel_holds_code_and_data(tmp_path: Path) -> None:
    if importlib.util.find_spec("setuptools") is None or importlib.util.find_spec("pip") is None:
        pytest.skip("building a wheel needs pip and setuptools: install the extra 'dev'")
    # A build leaves files beside the sources, and takes old ones from there: work on a copy.
    source = tmp_path / "source"
    source.mkdir()
    for name in ("setup.cfg", "pyproject.toml", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, source)
    for name in ("ogmp_sb3", "tasks", "robots", "policies", "encoders"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index"]
    built = subprocess.run(
        [*command, "--wheel-dir", str(tmp_path), str(source)], capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr

    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    expected = {f"ogmp_sb3/{path.relative_to(PACKAGE).as_posix()}" for path in SOURCES.values()}
    expected |= {"ogmp_sb3/py.typed", "ogmp_sb3/conf/train.yaml", "ogmp_sb3/report/templates/report.html"}
    expected |= {f"ogmp_sb3/report/templates/replay{name}" for name in (".html", ".css", "_page.js", "_scene.js")}
    for folder, patterns in {
        "tasks": ("*.yaml",),
        "robots": ("*.xml", "*.yaml"),
        "policies": ("*.json", "*.safetensors", "*.md"),
        "encoders": ("*.json", "*.safetensors"),
    }.items():
        files = (path for pattern in patterns for path in (ROOT / folder).rglob(pattern) if path.is_file())
        expected |= {f"ogmp_sb3/{path.relative_to(ROOT).as_posix()}" for path in files}
    assert {"ogmp_sb3/tasks/parkour.yaml", "ogmp_sb3/robots/hector/hector.xml"} <= expected
    assert expected <= held, f"missing in the wheel: {sorted(expected - held)}"
    assert not [name for name in held if name.startswith(("tests/", "tasks/", "robots/", "docs/"))]
