"""Policies on the Hugging Face Hub, against one on this machine that answers over HTTP."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.hub import TOKEN, USER, Hub, running_hub, use
from ogmp_sb3.config.catalogue import PACKAGE
from ogmp_sb3.runs.hub import check_repo, hub_folder, hub_name, upload
from ogmp_sb3.runs.policies import load_policy
from ogmp_sb3.runs.run_directory import INFO, WEIGHTS

POLICY = PACKAGE / "policies" / "dive"


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    pytest.importorskip("huggingface_hub", reason="needs the extra 'hub'")
    with running_hub() as running:
        use(running, tmp_path / "cache", monkeypatch)
        yield running


# ---- hub_folder ----


def test_a_policy_is_loaded_from_the_hub_then_from_the_cache_and_nothing_else_is_fetched(
    hub: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    more = {"README.md": b"# Dive", "model.pkl": b"cos\nsystem", "replay/a.mp4": b"0", "encoder/weights.bin": b"0"}
    hub.add("me/dive", files_of(POLICY) | more)
    loaded = load_policy("hf:me/dive")
    assert (loaded.digest, loaded.name) == (load_policy(POLICY).digest, "dive")
    assert set(hub.files_taken) == set(files_of(POLICY)) - {"README.md"}
    hub.files_taken.clear()
    load_policy("hf:me/dive")
    assert not hub.files_taken
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")  # no network
    assert load_policy("hf:me/dive").digest == loaded.digest


def test_a_revision_is_the_policy_of_that_time(hub: Hub) -> None:
    repo = hub.add("me/dive", {INFO: b"old", WEIGHTS: b"1"})
    repo.commits.append({INFO: b"new", WEIGHTS: b"2"})
    assert (hub_folder("hf:me/dive") / INFO).read_bytes() == b"new"
    assert (hub_folder(f"hf:me/dive@{repo.sha(0)}") / INFO).read_bytes() == b"old"
    assert (hub_folder("hf:me/dive@main") / INFO).read_bytes() == b"new"
    with pytest.raises(ValueError, match=r"^'hf:me/dive@v9': it has no such revision\.$"):
        hub_folder("hf:me/dive@v9")


@pytest.mark.parametrize("files", [{}, {"README.md": b"a"}, {"model.safetensors": b"a", "config.json": b"{}"}])
def test_a_repository_of_something_else_is_a_sentence(files: dict[str, bytes], hub: Hub) -> None:
    hub.add("other/model", files)
    with pytest.raises(ValueError, match=r"^'hf:other/model' is not a policy of ogmp_sb3: it has no policy\.json\.$"):
        load_policy("hf:other/model")
    assert not hub.files_taken


def test_a_policy_that_was_changed_on_the_way_is_a_sentence(hub: Hub) -> None:
    hub.add("me/dive", files_of(POLICY) | {"manifest.json": json.dumps({WEIGHTS: "0", INFO: "0"}).encode()})
    with pytest.raises(ValueError, match=r"policy\.(json|safetensors): damaged or missing"):
        load_policy("hf:me/dive")


@pytest.mark.parametrize("token", [None, TOKEN])
def test_a_repository_that_is_not_there_is_a_sentence(
    token: str | None, hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(hub, tmp_path, monkeypatch, token)
    with pytest.raises(ValueError, match=r"^'hf:me/none': there is no such repository on the Hub, or it is private: "):
        hub_folder("hf:me/none")


def test_a_private_repository_needs_a_token(hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hub.add("me/secret", files_of(POLICY), private=True)
    for token, message in [(None, "or it is private: log in with"), ("wrong", "does not know the token: log in with")]:
        use(hub, tmp_path, monkeypatch, token)
        with pytest.raises(ValueError, match=message):
            hub_folder("hf:me/secret")
    use(hub, tmp_path, monkeypatch)
    assert (hub_folder("hf:me/secret") / WEIGHTS).is_file()


def test_without_a_network_what_is_not_in_the_cache_is_a_sentence(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(ValueError, match=r"^'hf:me/dive': the Hub cannot be reached, and it is not in the cache\.$"):
        hub_folder("hf:me/dive")
    with pytest.raises(ValueError, match=r"^'me/dive': the Hub cannot be reached \(.*\)\.$"):
        upload(POLICY, "me/dive", private=False)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hf:dive", "'hf:dive' names no owner: give hf:<owner>/<name>."),
        ("hf:", "'hf:' names no owner"),
        ("hf:@main", "names no owner"),
        ("hf:me/", "'hf:me/' is no repository of the Hub: give hf:<owner>/<name>."),
        ("hf:/dive", "is no repository"),
        ("hf:me/di ve", "is no repository"),
        ("hf:me/dive/best", "is no repository"),
        ("hf:../../etc", "is no repository"),
    ],
)
def test_a_name_that_is_none_is_a_sentence(name: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        load_policy(name)
    assert message in str(caught.value)


def test_without_the_library_a_sentence_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for call in (lambda: hub_folder("hf:me/dive"), lambda: upload(POLICY, "me/dive", private=False)):
        with pytest.raises(ValueError, match=r"'huggingface_hub' is missing: pip install \"ogmp_sb3\[hub\]\"\.$"):
            call()


def test_a_directory_of_the_cache_has_the_name_of_its_repository() -> None:
    assert hub_name(Path("/cache/models--me--dive-2/snapshots/abc")) == "dive-2"
    assert hub_name(Path("/runs/snapshots/abc")) is None
    assert hub_name(Path("dive")) is None
    assert hub_name(Path()) is None


def test_a_good_name_is_good() -> None:
    check_repo("me/a.b-c_d", "", "")


# ---- upload ----


def test_what_is_uploaded_takes_the_place_of_what_was_there(hub: Hub, tmp_path: Path) -> None:
    before = {"robot/a.xml": b"1", "encoder/encoder.json": b"1", "replay/old.mp4": b"1", "LICENSE": b"mine"}
    hub.add("me/dive", before)
    (tmp_path / "new").mkdir()
    for name in (INFO, WEIGHTS, "README.md"):
        (tmp_path / "new" / name).write_bytes(name.encode())
    assert upload(tmp_path / "new", "me/dive", private=False) == f"{hub.endpoint}/me/dive"
    assert hub.repos["me/dive"].commits[-1] == files_of(tmp_path / "new") | {"LICENSE": b"mine"}


def test_a_new_repository_is_private_if_asked(hub: Hub) -> None:
    upload(POLICY, "me/secret", private=True)
    upload(POLICY, "me/open", private=False)
    assert [hub.repos[name].private for name in ("me/secret", "me/open")] == [True, False]


@pytest.mark.parametrize(
    ("token", "repo", "message"),
    [
        (None, "me/dive", "^'me/dive': uploading needs a token: log in with 'hf auth login', or set HF_TOKEN.$"),
        ("wrong", "me/dive", "^'me/dive': the Hub does not know the token: log in"),
        (TOKEN, "others/dive", "^'others/dive': the token does not allow this.$"),
    ],
)
def test_who_may_not_upload_is_told_why(
    token: str | None, repo: str, message: str, hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(hub, tmp_path, monkeypatch, token)
    with pytest.raises(ValueError, match=message):
        upload(POLICY, repo, private=False)
    assert repo.startswith(USER) or repo not in hub.repos
