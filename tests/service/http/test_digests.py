"""Every file of Gaussians comes with its SHA-256: whole, in part, converted, and as the answer to photographs."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from http_requests import photograph, post

from gapmes.service.app import EXPOSED
from gapmes.service.http.digests import REPR_DIGEST, repr_digest, repr_digest_of


def sha256(data: bytes) -> str:
    return f"sha-256=:{base64.b64encode(hashlib.sha256(data).digest()).decode()}:"


def test_of_no_bytes_it_is_the_known_one(tmp_path: Path) -> None:
    """FIPS 180-4's of the empty message, in base64."""
    assert repr_digest(b"") == "sha-256=:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=:"
    (tmp_path / "empty").touch()
    assert repr_digest_of(tmp_path / "empty", '"0-0"') == repr_digest(b"")


def test_the_ply_whole_in_part_and_its_head(client: TestClient) -> None:
    link = post(client).json()["links"]["ply"]
    answer = client.get(link)
    digest = answer.headers[REPR_DIGEST]
    assert digest == sha256(answer.content)
    part = client.get(link, headers={"Range": "bytes=0-9"})
    assert (part.status_code, part.headers[REPR_DIGEST]) == (206, digest)
    assert client.head(link).headers[REPR_DIGEST] == digest


@pytest.mark.parametrize("extension", ["compressed.ply", "splat", "spz"])
def test_a_converted_file(client: TestClient, extension: str) -> None:
    link = post(client).json()["links"]["files"][extension]
    answer = client.get(link)
    assert answer.headers[REPR_DIGEST] == sha256(answer.content)
    assert REPR_DIGEST not in client.head(link).headers  # none is made


def test_what_the_viewer_reads_has_none(client: TestClient) -> None:
    answer = client.get(f"{post(client).json()['links']['self']}/viewer.ply")
    assert answer.content.startswith(b"ply")
    assert REPR_DIGEST not in answer.headers


def test_a_scene_that_is_made_again_has_the_same(client: TestClient) -> None:
    digests = set()
    for _ in range(2):
        links = post(client, [photograph(300), photograph(301)]).json()["links"]
        digests.add(client.get(links["ply"]).headers[REPR_DIGEST])
        assert client.delete(links["self"]).status_code == 204
    assert len(digests) == 1


def test_the_answer_to_photographs(client: TestClient) -> None:
    answer = post(client, accept="application/octet-stream")
    assert answer.headers[REPR_DIGEST] == sha256(answer.content)
    assert REPR_DIGEST not in post(client, accept="application/zip").headers


def test_scripts_of_other_origins_may_read_it() -> None:
    assert REPR_DIGEST in EXPOSED
