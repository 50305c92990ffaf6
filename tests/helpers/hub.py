"""A Hugging Face Hub on this machine: what of its HTTP API an upload and a download of a model use."""

from __future__ import annotations

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

USER, TOKEN = "me", "hf_of_this_test"
Files = dict[str, bytes]


@dataclass
class Repo:
    private: bool = False
    commits: list[Files] = field(default_factory=lambda: [{}])

    @staticmethod
    def sha(number: int) -> str:
        return hashlib.sha1(str(number).encode()).hexdigest()

    def at(self, revision: str) -> tuple[str, Files] | None:
        names = {self.sha(number): number for number in range(len(self.commits))} | {"main": len(self.commits) - 1}
        return (self.sha(names[revision]), self.commits[names[revision]]) if revision in names else None


@dataclass
class Hub:
    endpoint: str = ""
    repos: dict[str, Repo] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    files_taken: list[str] = field(default_factory=list)

    def add(self, name: str, files: Files, private: bool = False) -> Repo:
        return self.repos.setdefault(name, Repo(private, [files]))


class _Handler(BaseHTTPRequestHandler):
    hub: Hub

    def log_message(self, *_: Any) -> None:
        pass

    def _answer(self, status: int, content: Any = None, **headers: str) -> None:
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    @property
    def _token(self) -> str | None:
        return (self.headers.get("Authorization") or "").removeprefix("Bearer ") or None

    def _refused(self) -> bool:
        if self._token not in (None, TOKEN):
            self._answer(401, {"error": "Invalid credentials in Authorization header"})
            return True
        return False

    def _repo(self, name: str) -> Repo | None:
        repo = self.hub.repos.get(name)
        if repo is None or (repo.private and self._token != TOKEN):
            self._answer(
                401 if self._token is None else 404, {"error": "Repository not found"}, X_Error_Code="RepoNotFound"
            )
            return None
        return repo

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self.hub.asked.append(f"{self.command} {path}")
        parts = path.strip("/").split("/")
        if self._refused():
            return
        if parts[:2] == ["api", "models"] and (repo := self._repo("/".join(parts[2:4]))):
            kind, revision = (*parts[4:], "revision", "main")[:2]
            found = repo.at(revision)
            if found is None:
                self._answer(404, {"error": "Invalid rev id"}, X_Error_Code="RevisionNotFound")
            elif kind == "tree":
                entries = [
                    {"type": "file", "path": name, "size": len(data), "oid": hashlib.sha1(data).hexdigest()}
                    for name, data in found[1].items()
                ]
                self._answer(200, entries)
            else:
                siblings = [{"rfilename": name} for name in found[1]]
                name = "/".join(parts[2:4])
                self._answer(200, {"id": name, "modelId": name, "sha": found[0], "siblings": siblings, "tags": []})
        elif parts[2:3] == ["resolve"] and (repo := self._repo("/".join(parts[:2]))):
            sha, files = repo.at(parts[3]) or ("", {})
            data = files["/".join(parts[4:])]
            self.hub.files_taken.append("/".join(parts[4:]))
            self._answer(200, data, ETag=f'"{hashlib.sha1(data).hexdigest()}"', X_Repo_Commit=sha)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self.hub.asked.append(f"POST {path}")
        body = self._body()
        parts = path.strip("/").split("/")
        if path == "/api/validate-yaml":
            self._answer(200, {"errors": [], "warnings": []})
        elif self._token != TOKEN:
            self._answer(401, {"error": "Invalid username or password."})
        elif path == "/api/repos/create":
            self._create(json.loads(body))
        elif parts[4] == "preupload":
            files = json.loads(body)["files"]
            answer = [{"path": file["path"], "uploadMode": "regular", "shouldIgnore": False} for file in files]
            self._answer(200, {"files": answer})
        else:
            self._commit(self.hub.repos["/".join(parts[2:4])], [json.loads(line) for line in body.splitlines()])

    def _body(self) -> bytes:
        if "chunked" not in self.headers.get("Transfer-Encoding", ""):
            return self.rfile.read(int(self.headers.get("Content-Length", 0)))
        body = b""
        while length := int(self.rfile.readline(), 16):
            body += self.rfile.read(length)
            self.rfile.readline()
        self.rfile.readline()
        return body

    def _create(self, data: dict[str, Any]) -> None:
        owner = data.get("organization") or USER
        name = f"{owner}/{data['name']}"
        if owner != USER:
            self._answer(403, {"error": "You don't have the rights to create a model under this namespace"})
        elif name in self.hub.repos:
            self._answer(409, {"error": "You already created this model repo", "url": f"{self.hub.endpoint}/{name}"})
        else:
            self.hub.add(name, {}, private=bool(data.get("private")) or data.get("visibility") == "private")
            self._answer(200, {"url": f"{self.hub.endpoint}/{name}", "name": name, "id": name})

    def _commit(self, repo: Repo, lines: list[dict[str, Any]]) -> None:
        files = dict(repo.commits[-1])
        for line in lines:
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "deletedFile":
                files.pop(value["path"], None)
        repo.commits.append(files)
        sha = repo.sha(len(repo.commits) - 1)
        self._answer(
            200, {"success": True, "commitOid": sha, "commitUrl": f"{self.hub.endpoint}/{USER}/x/commit/{sha}"}
        )


@contextmanager
def running_hub() -> Iterator[Hub]:
    """A Hub that answers in the body, and that nothing is in at first."""
    hub = Hub()
    handler = type("Handler", (_Handler,), {"hub": hub})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    hub.endpoint = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield hub
    finally:
        server.shutdown()
        server.server_close()


def use(hub: Hub, cache: Path, monkeypatch: pytest.MonkeyPatch, token: str | None = TOKEN) -> None:
    """Have ``huggingface_hub`` ask this Hub, as ``HF_ENDPOINT``, ``HF_HOME`` and ``HF_TOKEN`` do before its import."""
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "ENDPOINT", hub.endpoint)
    template = hub.endpoint + "/{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(cache))
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(cache / "token"))
    if token is None:
        monkeypatch.delenv("HF_TOKEN", raising=False)
    else:
        monkeypatch.setenv("HF_TOKEN", token)
