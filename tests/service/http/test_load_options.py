"""POST /scenes: how a file is read, by its options, and what the answer says of it."""

from __future__ import annotations

import numpy as np
import pytest
from format_cases import moderate
from http_requests import assert_problem, post
from loading import file_of, load_form, load_raw
from ply_cases import binary_file, columns
from starlette.testclient import TestClient

from gapmes.service.formats.ply import ply_bytes

pytestmark = pytest.mark.usefixtures("no_scene_stays")


def test_what_was_not_taken_as_it_was_is_in_the_document(client: TestClient) -> None:
    table = columns(ply_bytes(moderate(60, 4, 0)))
    table = {**{name: column.copy() for name, column in table.items()}, "label": np.zeros(60, np.int32)}
    table["x"][5] = np.nan
    data = binary_file(table)
    assert_problem(load_raw(client, data), 422, "ply_invalid", "vertex.x", 5)
    scene = load_raw(client, data, drop_invalid="true").json()
    assert scene["dropped"] == [{"reason": "invalid x", "count": 1}]
    assert (scene["gaussians"]["count"], scene["file"]["rows"]) == (59, 60)
    messages = [warning["message"] for warning in scene["warnings"]]
    assert messages == ["properties ignored: label", "1 of 60 Gaussians dropped, invalid in x (1)"]
    other = load_raw(client, binary_file(columns(ply_bytes(moderate(60, 4, 0)))), rotation="xyzw").json()
    assert other["id"] != scene["id"]
    assert other["warnings"] == []


@pytest.mark.parametrize(
    ("data", "cure"),
    [
        (file_of("spz"), "; axes=rdf keeps them"),
        (binary_file(columns(ply_bytes(moderate(60, 6, 0))) | {"opacity": np.full(60, 0.6, "f4")}), "; opacity=linear"),
    ],
)
def test_what_says_otherwise_is_named_as_a_field_of_the_request(client: TestClient, data: bytes, cure: str) -> None:
    messages = [warning["message"] for warning in load_raw(client, data).json()["warnings"]]
    assert any(cure in message for message in messages), messages
    assert "--" not in "".join(messages)


@pytest.mark.parametrize("said", ["yes", "1", "on"])
def test_a_flag_is_true_or_false_as_in_the_form_of_reconstruct(client: TestClient, said: str) -> None:
    data = file_of("ply", 3)
    for answer in (load_raw(client, data, drop_invalid=said), load_form(client, data, drop_invalid=said)):
        problem = assert_problem(answer, 422, "parameter_invalid", "drop_invalid")
        assert problem["detail"] == f"is {said!r}: input should be true or false"
    assert_problem(post(client, trust_poses=said), 422, "invalid_input", "trust_poses")
    assert load_raw(client, data, drop_invalid="TRUE").status_code in (200, 201)


def test_a_stored_scene_is_not_guessed_at_again(client: TestClient) -> None:
    """Opacities that are told to be linear may lie between 0.5 and 0.73: their logits look like opacities."""
    table = columns(ply_bytes(moderate(60, 6, 0))) | {"opacity": np.linspace(0.51, 0.72, 60, dtype=np.float32)}
    scene = load_raw(client, binary_file(table), opacity="linear").json()
    kept = client.app.state.runtime.store.gaussians(scene["id"])  # type: ignore[attr-defined]
    assert np.abs(kept.opacities - table["opacity"]).max() <= 1e-6
