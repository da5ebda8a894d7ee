"""Jobs over HTTP: requested, followed, cancelled, and computed once for all requests."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from http_requests import assert_problem, camera_object, photograph, post, wait_until_ready
from starlette.testclient import TestClient

from gapmes.service.app import create_app
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.settings import Settings


@pytest.fixture
def held(
    settings: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[TestClient, threading.Event]]:
    """A service whose reconstructions wait for the event before their first stage ends."""
    going, original = threading.Event(), Reconstructor.reconstruct

    def slow(self: Reconstructor, *arguments: Any, **options: Any) -> Any:
        going.wait(120)
        return original(self, *arguments, **options)

    monkeypatch.setattr(Reconstructor, "reconstruct", slow)
    changed = {"store": tmp_path / "scenes", "max_waiting": 3, "heartbeat_seconds": 0.05, "drain_seconds": 1.0}
    with TestClient(create_app(settings.model_copy(update=changed)), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client, going
        going.set()


def ask(client: TestClient, seed: int = 0) -> dict[str, Any]:
    answer = post(client, [photograph(seed), photograph(seed + 1)], prefer="respond-async")
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == answer.json()["links"]["self"]
    assert answer.headers["preference-applied"] == "respond-async"
    return answer.json()


def followed(client: TestClient, job: dict[str, Any], **headers: str) -> list[dict[str, str]]:
    """Every event until the stream ends, as its fields; comments as {"": text}."""
    with client.stream("GET", job["links"]["events"], headers=headers) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        blocks = "".join(stream.iter_text()).split("\n\n")
    assert blocks[-1] == ""
    return [dict(line.split(": ", 1) for line in block.split("\n")) for block in blocks[:-1]]


def test_a_job_from_its_answer_to_its_scene(client: TestClient) -> None:
    job = ask(client, 100)
    events = followed(client, job)
    assert events[0] == {"retry": "2000"}
    told = [(event["event"], json.loads(event["data"])) for event in events[1:]]
    assert [event["id"] for event in events[1:]] == [str(k + 1) for k in range(len(told))]
    assert [data["state"] for name, data in told if name == "state"] == ["queued", "running", "done"]
    ended = [data["stage"] for name, data in told if name == "stage" and "seconds" in data]
    assert ended == ["cameras", "images", "network", "refine", "gaussians", "fade", "leave out", "check"]
    job = client.get(job["links"]["self"]).json()
    assert (job["state"], job["stage"], job["ahead"]) == ("done", None, 0)
    scene = client.get(job["links"]["scene"])
    assert scene.status_code == 200
    assert list(scene.json()["timings"]) == ended
    again = ask(client, 100)
    assert again["id"] != job["id"]
    assert (again["state"], again["links"]["scene"]) == ("done", job["links"]["scene"])
    assert [json.loads(e["data"])["state"] for e in followed(client, again)[1:]] == ["done"]


def test_what_belongs_to_the_request_is_in_its_answer(client: TestClient) -> None:
    """The scene document that the job leads to has none of it."""
    cameras = camera_object()
    for view, name in zip(cameras["views"], ("a.png", "b.png"), strict=True):
        view["image"] = name
    images, names = [photograph(310), photograph(311)], ["x.png", "y.png"]
    job = post(client, images, cameras, names=names, prefer="respond-async").json()
    followed(client, job)
    answer = post(client, images, cameras, names=names).json()
    assert [warning["code"] for warning in job["warnings"]] == ["names_differ"]
    assert job["warnings"][0] in answer["warnings"]
    for name in ("images", "paired_by", "selection"):
        assert job[name] == answer[name]
        assert name not in client.get(f"/jobs/{job['id']}").json()
    assert job["warnings"][0] not in client.get(answer["links"]["self"]).json()["warnings"]


def test_a_stream_goes_on_where_it_was_left(client: TestClient) -> None:
    job = ask(client, 102)
    every = followed(client, job)[1:]
    assert followed(client, job, **{"Last-Event-ID": "3"})[1:] == every[3:]
    for query in ("after=5", "lastEventId=5", "after=2&lastEventId=5"):
        with client.stream("GET", f"{job['links']['events']}?{query}") as stream:
            text = "".join(stream.iter_text())
        assert f"id: {every[5]['id']}\n" in text
        assert f"id: {every[4]['id']}\n" not in text
    assert followed(client, job, **{"Last-Event-ID": "no number"})[1:] == every
    assert followed(client, job, **{"Last-Event-ID": "9" * 40})[1:] == []


def test_those_who_wait_for_scenes_keep_no_job_out(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who prefers a job has its answer at once, and takes no place among them."""
    waiting = client.app.state.runtime.scenes
    monkeypatch.setattr(waiting, "taken", waiting.most)
    assert_problem(post(client, [photograph(98), photograph(99)]), 503, "service_busy")
    wait_for(client, ask(client, 98), "done")


def test_waiting_jobs_are_counted_followed_and_cancelled(held: tuple[TestClient, threading.Event]) -> None:
    client, going = held
    jobs = [ask(client, 2 * k) for k in range(4)]
    running = wait_for(client, jobs[0], "running")
    assert [client.get(job["links"]["self"]).json()["ahead"] for job in jobs] == [0, 1, 2, 3]
    assert_problem(post(client, [photograph(90), photograph(91)], prefer="respond-async"), 503, "service_busy")
    cancelled = client.delete(jobs[1]["links"]["self"]).json()
    assert (cancelled["state"], cancelled["problem"]["code"]) == ("cancelled", "job_cancelled")
    assert not (client.app.state.runtime.store.root / ".jobs" / jobs[1]["id"]).exists()  # its photographs go with it
    assert ask(client, 4)["id"] == jobs[2]["id"]  # the same photographs are the same job
    assert client.delete(running["links"]["self"]).json()["state"] == "running"
    going.set()
    assert wait_for(client, jobs[0], "cancelled")["problem"]["status"] == 409
    for job in jobs[2:]:
        wait_for(client, job, "done")
    assert len(client.get("/scenes").json()["scenes"]) == 2


def test_a_request_that_waits_keeps_a_cancelled_job_going(held: tuple[TestClient, threading.Event]) -> None:
    client, going = held
    job = ask(client)
    wait_for(client, job, "running")
    answers: list[Any] = []
    waiting = threading.Thread(target=lambda: answers.append(post(client)))
    waiting.start()
    table = client.app.state.runtime.jobs.table
    while table.get(job["id"]).waiting == 0:
        time.sleep(0.01)
    assert client.delete(job["links"]["self"]).json()["state"] == "running"
    going.set()
    waiting.join()
    assert answers[0].status_code == 200  # the job was there before it
    assert client.get(job["links"]["self"]).json()["state"] == "done"


def test_a_failed_job_says_why_as_a_request_does(client: TestClient) -> None:
    noise = photograph(3)
    answer = post(client, [noise, noise[: len(noise) // 2]], prefer="respond-async", near="1", far="10")
    assert answer.status_code == 202
    job = wait_for(client, answer.json(), "failed")
    assert (job["problem"]["code"], job["problem"]["index"]) == ("image_unreadable", 1)
    direct = post(client, [noise, noise[: len(noise) // 2]])
    assert_problem(direct, 415, "image_unreadable", "images", 1)


AWAY = [[-1.0, 0, 0, 0.2], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]  # beside the first camera, looking backwards


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda c: c.update(near=10.0, far=1.0), "depth_range_invalid"),
        (lambda c: c["views"][1].update(c2w=c["views"][0]["c2w"]), "no_baseline"),
        (lambda c: c["views"][1].update(c2w=AWAY), "views_do_not_overlap"),
    ],
)
def test_what_shows_without_the_photographs_makes_no_job(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, change: Any, code: str
) -> None:
    monkeypatch.setattr(client.app.state.runtime.jobs, "submit", None)
    cameras = camera_object(2)
    change(cameras)
    for prefer in ("respond-async", None):
        assert_problem(post(client, cameras=cameras, prefer=prefer), 422, code)


def test_a_client_that_goes_away_takes_its_work_along(held: tuple[TestClient, threading.Event]) -> None:
    """One request waits behind a job; its client disconnects; its work never begins."""
    client, going = held
    wait_for(client, ask(client), "running")
    prepared = post_scope(client, 50)
    left = threading.Event()

    async def request_that_leaves() -> None:
        sent = False

        async def receive() -> dict[str, Any]:
            nonlocal sent
            if not sent:
                sent = True
                return {"type": "http.request", "body": prepared[1], "more_body": False}
            if left.is_set():
                return {"type": "http.disconnect"}
            await asyncio.sleep(3600)
            raise AssertionError("never")

        async def send(_: dict[str, Any]) -> None:
            return

        await client.app(prepared[0], receive, send)

    task = client.portal.start_task_soon(request_that_leaves)
    table = client.app.state.runtime.jobs.table
    while table.counts()["queued"] == 0:
        time.sleep(0.01)
    left.set()
    task.result(timeout=120)
    assert table.counts() == {"queued": 0, "running": 1}
    assert len(list((client.app.state.runtime.store.root / ".jobs").iterdir())) == 1
    going.set()


def post_scope(client: TestClient, seed: int) -> tuple[dict[str, Any], bytes]:
    """A request as the server passes it on."""
    sent: list[Any] = []
    client.event_hooks["request"].append(sent.append)
    try:
        post(client, [photograph(seed), photograph(seed + 1)], near="no number")
    finally:
        client.event_hooks["request"].clear()
    body = sent[0].read().replace(b"no number", b"1.0      ")
    headers = [(b"content-type", sent[0].headers["content-type"].encode())]
    scope = {"type": "http", "method": "POST", "path": "/reconstruct", "query_string": b"", "headers": headers}
    return scope, body


@pytest.mark.parametrize("path", ["/jobs/nothing", "/jobs/nothing/events", "/jobs/a/b", "/jobs/" + "x" * 3000])
def test_unknown_jobs(client: TestClient, path: str) -> None:
    assert_problem(client.get(path), 404, "job_not_found", "job")


def test_cancelling_an_unknown_job(client: TestClient) -> None:
    assert_problem(client.delete("/jobs/nothing"), 404, "job_not_found", "job")


@pytest.mark.parametrize("prefer", ["respond-async", "wait=10, Respond-Async", "RESPOND-ASYNC"])
def test_preferences_for_a_job(client: TestClient, prefer: str) -> None:
    assert post(client, prefer=prefer).status_code == 202


@pytest.mark.parametrize("prefer", ["", "return=minimal", "respond-asyncronously"])
def test_other_preferences(client: TestClient, prefer: str) -> None:
    assert post(client, prefer=prefer).status_code in (200, 201)


def test_a_quiet_stream_shows_signs_of_life(
    held: tuple[TestClient, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job goes on once the stream has looked for its events in vain."""
    client, going = held
    job = ask(client)
    wait_for(client, job, "running")
    table, looks = client.app.state.runtime.jobs.table, []
    real = table.events

    def looked(*arguments: Any) -> Any:
        looks.append(1)
        if len(looks) == 4:
            going.set()
        return real(*arguments)

    monkeypatch.setattr(table, "events", looked)
    comments = [event for event in followed(client, job) if "" in event]
    assert comments


def wait_for(client: TestClient, job: dict[str, Any], state: str) -> dict[str, Any]:
    deadline = time.monotonic() + 120
    while (found := client.get(job["links"]["self"]).json())["state"] != state:
        assert time.monotonic() < deadline, found
        time.sleep(0.01)
    return found


def test_a_job_of_another_model_file_is_not_computed_by_this_one(
    held: tuple[TestClient, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scene's id tells which model made it: a service that was started anew with another one says so."""
    client, going = held
    checked, slow = threading.Event(), Reconstructor.reconstruct

    def reported(self: Reconstructor, *arguments: Any, **options: Any) -> Any:
        checked.set()
        return slow(self, *arguments, **options)

    monkeypatch.setattr(Reconstructor, "reconstruct", reported)
    first, job = ask(client), ask(client, 10)
    assert checked.wait(60)  # "running" alone is told before the model is compared
    monkeypatch.setattr("gapmes.service.jobs.work.ALGORITHM_REVISION", -1)
    going.set()
    assert wait_for(client, job, "failed")["problem"]["code"] == "model_changed"
    assert wait_for(client, first, "done")


def test_so_many_follow_jobs_at_once(held: tuple[TestClient, threading.Event], monkeypatch: pytest.MonkeyPatch) -> None:
    client, _ = held
    job = ask(client)
    monkeypatch.setattr(client.app.state.runtime.streams, "most", 0)
    assert_problem(client.get(job["links"]["events"]), 503, "service_busy")
