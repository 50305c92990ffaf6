"""Machines without a home, without room, with a read-only package or with the settings of a notebook."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from ogmp_sb3 import machine
from ogmp_sb3.machine import (
    PACKAGE,
    PRIVATE,
    can_write,
    check_writable,
    compiled,
    cpu_count,
    import_matplotlib,
    keep_compiled_code,
    private_folder,
)


def test_what_can_be_written_is_known_without_a_trace(tmp_path: Path) -> None:
    check_writable(tmp_path / "a" / "b")
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError) as error:
        check_writable(tmp_path / "file" / "b")
    assert error.value.filename == str(tmp_path / "file")
    assert not can_write(Path("/proc/nothing"))  # not even by root


# ---- private_folder ----


def test_a_private_folder_is_nobody_elses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    folder = private_folder()
    assert folder == tmp_path / PRIVATE == private_folder()
    assert folder.stat().st_mode & 0o777 == 0o700 and folder.stat().st_uid == os.getuid()


@pytest.mark.parametrize("trap", ["open", "link", "file", "unguarded"])
def test_a_folder_that_others_could_have_filled_is_not_trusted(
    trap: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    if trap == "open":
        (tmp_path / PRIVATE).mkdir()
        (tmp_path / PRIVATE).chmod(0o777)
    elif trap == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        (tmp_path / PRIVATE).symlink_to("elsewhere")
    elif trap == "file":
        (tmp_path / PRIVATE).touch()
    else:
        tmp_path.chmod(0o777)  # not sticky: anyone may rename what is in it
    found = private_folder()
    assert found is None or found.parent != tmp_path


def test_a_folder_of_another_user_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert private_folder() == tmp_path / PRIVATE
    monkeypatch.setattr(machine.os, "getuid", lambda: os.stat(tmp_path).st_uid + 1)
    found = private_folder()
    assert found is None or found.parent != tmp_path


# ---- keep_compiled_code ----


@pytest.fixture
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A home and temporary files, of which a test takes away what it wants."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


def full(monkeypatch: pytest.MonkeyPatch, *places: Path) -> None:
    monkeypatch.setattr(machine, "can_write", lambda folder: not any(folder.is_relative_to(p) for p in places))


def test_compiled_code_stays_beside_its_source_where_it_can(cache: Path) -> None:
    assert keep_compiled_code()
    assert numba.config.CACHE_DIR == ""


def test_beside_a_read_only_package_it_goes_into_the_home(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full(monkeypatch, PACKAGE)
    assert keep_compiled_code()
    assert numba.config.CACHE_DIR == str(cache / "home" / "numba")


@pytest.mark.parametrize("home", ["full", "none"])
def test_without_a_home_among_the_temporary_files(home: str, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full(monkeypatch, PACKAGE, cache / "home")
    if home == "none":  # what expanduser gives for a user without one
        monkeypatch.setenv("XDG_CACHE_HOME", "~/.cache")
    assert keep_compiled_code()
    assert numba.config.CACHE_DIR == str(cache / PRIVATE / "numba")


def test_a_directory_that_was_asked_for_counts_if_it_can_be_written(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(cache / "mine"))
    assert keep_compiled_code()
    assert numba.config.CACHE_DIR == str(cache / "mine")
    full(monkeypatch, PACKAGE, cache / "mine")
    assert keep_compiled_code()
    assert numba.config.CACHE_DIR == str(cache / "home" / "numba")


def test_where_nothing_can_be_written_one_sentence_says_what_it_costs(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full(monkeypatch, Path("/"))
    with pytest.warns(UserWarning, match=r"every start takes half a minute longer: set NUMBA_CACHE_DIR to"):
        assert not keep_compiled_code()


def test_compiled_functions_are_kept_with_any_options() -> None:
    @compiled
    def twice(x: float) -> float:
        return 2.0 * x

    @compiled(fastmath=True)
    def thrice(x: float) -> float:
        return 3.0 * x

    for function in (twice, thrice):
        assert type(function._cache).__name__ == "FunctionCache"
    assert thrice.targetoptions["fastmath"]


# ---- import_matplotlib ----


def test_a_backend_that_is_not_installed_is_no_hindrance_and_stays_in_the_environment() -> None:
    code = (
        "import os, ogmp_sb3; from ogmp_sb3.guidance.plans import make_oracle\n"
        "make_oracle(ogmp_sb3.load_task('parkour', {'oracle': 'lqr'}))\n"  # by python-control, which imports pyplot
        "print(os.environ['MPLBACKEND'])"
    )
    for backend in ("no_such_backend", "module://matplotlib_inline.backend_inline"):
        environment = {**os.environ, "MPLBACKEND": backend}
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout.strip(), done.stderr) == (0, backend, "")


def test_a_backend_that_a_user_has_chosen_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib

    monkeypatch.setitem(matplotlib.rcParams, "backend", "svg")
    monkeypatch.setenv("MPLBACKEND", "pdf")
    import_matplotlib()
    assert (matplotlib.rcParams["backend"], os.environ["MPLBACKEND"]) == ("svg", "pdf")


def test_matplotlib_keeps_its_fonts_where_there_is_no_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nothing")
    for left_by_another_process in (False, True):
        if left_by_another_process:
            monkeypatch.setenv("MPLCONFIGDIR", f"/elsewhere/{PRIVATE}/matplotlib")
        import_matplotlib()
        assert os.environ["MPLCONFIGDIR"] == str(tmp_path / PRIVATE / "matplotlib")
    monkeypatch.setenv("MPLCONFIGDIR", "mine")
    import_matplotlib()
    assert os.environ["MPLCONFIGDIR"] == "mine"


def test_windows_is_one_sentence() -> None:
    code = (
        "import gymnasium, numba, torch, stable_baselines3, sys\n"
        "sys.modules['fcntl'], sys.platform = None, 'win32'\n"
        "import ogmp_sb3"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.strip() == "ImportError: ogmp_sb3 needs Linux: on Windows, install it within WSL 2."


def test_where_the_system_does_not_tell_all_cpus_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cpu_count() == len(os.sched_getaffinity(0))
    monkeypatch.delattr("os.sched_getaffinity")
    monkeypatch.setattr("os.cpu_count", lambda: 7)
    assert cpu_count() == 7
    monkeypatch.setattr("os.cpu_count", lambda: None)
    assert cpu_count() == 1
