"""ogmp-export: the exported policy is the policy, its description is the environment's, and it runs alone."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from helpers.programs import program
from ogmp_sb3.commands.export import bundle


def test_the_program_exports_checks_and_times(policies, tmp_path: Path) -> None:
    done = program("export", f"run={policies['dive']}", "out=there", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Actions over 1000 steps differ from PyTorch's by at most" in done.stdout
    assert "99th percentile" in done.stdout
    names = ["controller.json", "controller.py", "encoder.onnx", "policy.onnx"]
    assert sorted(file.name for file in (tmp_path / "there").iterdir()) == names


def test_a_model_of_another_policy_does_not_stay(policies, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "encoder.onnx").write_bytes(b"of another policy")
    done = program("export", f"run={policies['blind']}", "out=there", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(file.name for file in (tmp_path / "there").iterdir()) == [
        "controller.json",
        "controller.py",
        "policy.onnx",
    ]


def test_a_model_that_strays_from_pytorch_is_reported(policies, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(bundle, "TOLERANCE", 1e-12)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "policy.onnx").write_bytes(b"an earlier one")
    done = program("export", f"run={policies['blind']}", "out=there", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("ogmp-export: the actor strays from PyTorch by")
    assert [(file.name, file.read_bytes()) for file in (tmp_path / "there").iterdir()] == [
        ("policy.onnx", b"an earlier one")
    ]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run=nowhere", "out=x"], "'nowhere' is neither a run directory nor a shipped policy"),
        (["run={policy}"], "'out' is missing"),
        (["run={damaged}", "out=x"], "policy.safetensors: damaged or missing"),
    ],
)
def test_mistakes_are_a_sentence(arguments, sentence, policies, tmp_path: Path) -> None:
    damaged = shutil.copytree(policies["dive"], tmp_path / "damaged") / "policy.safetensors"
    content = bytearray(damaged.read_bytes())
    content[-1] ^= 1
    damaged.write_bytes(content)
    given = [a.format(policy=policies["dive"], damaged=damaged.parent) for a in arguments]
    done = program("export", *given, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert sentence in done.stderr


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_without_what_it_needs_the_program_names_the_extra(package: str, policies, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    done = program("export", f"run={policies['dive']}", "out=x", cwd=tmp_path)
    assert done.returncode == 2
    assert f"the package '{package}' is missing: pip install \"ogmp_sb3[export]\"" in done.stderr
