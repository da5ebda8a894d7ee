"""Several models in one service: chosen by name, loaded on first use, kept within a budget."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from http_requests import assert_problem, photograph, post, wait_until_ready
from openvino_precisions import precisions
from standin_model import METADATA, write_standin
from starlette.testclient import TestClient

from gapmes.service import cli
from gapmes.service.app import create_app
from gapmes.service.errors import InputError, ModelError
from gapmes.service.jobs.spool import Spool
from gapmes.service.model_names import model_paths
from gapmes.service.models import Models
from gapmes.service.network.model_file import model_file
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.settings import Settings
from gapmes.service.shipped import sample_folder


@pytest.fixture(scope="module")
def further(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Two more networks, each a file of its own."""
    folder = tmp_path_factory.mktemp("further")
    paths = {name: write_standin(folder / f"{name}.onnx", METADATA | {"preset": name}) for name in ("base", "other")}
    return ",".join(f"{name}={path}" for name, path in paths.items())


@contextmanager
def serving(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        wait_until_ready(client)
        yield client


@pytest.fixture
def several(settings: Settings, further: str, tmp_path: Path) -> Iterator[TestClient]:
    with serving(settings.model_copy(update={"models": further, "store": tmp_path / "scenes"})) as client:
        yield client


def loaded(client: TestClient) -> list[str]:
    return [model["name"] for model in client.get("/models").json()["models"] if model["loaded"]]


def test_the_list_tells_what_there_is_before_it_is_loaded(several: TestClient, settings: Settings) -> None:
    answer = several.get("/models").json()
    assert [model["name"] for model in answer["models"]] == ["default", "base", "other"]
    assert [model["preset"] for model in answer["models"]] == ["standin", "base", "other"]
    assert [model["loaded"] for model in answer["models"]] == [True, False, False]
    first = answer["models"][0]
    assert settings.model is not None
    assert first["file_sha256"] == model_file(settings.model).info.file_sha256
    assert (first["width"], first["height"], first["precision"]) == (64, 48, "fp32")
    assert first["engine"]["name"] == "onnxruntime"
    assert answer["loaded_bytes"] == first["bytes"] == settings.model.stat().st_size
    assert (answer["default"], answer["budget_bytes"]) == ("default", None)
    ready = several.get("/readyz").json()
    assert ready["model"] == first
    assert ready["loaded"] == {"default": True, "base": False, "other": False}


def test_a_request_names_its_model_and_the_scene_says_which(several: TestClient) -> None:
    plain, named = post(several), post(several, model="base")
    assert (plain.status_code, named.status_code) == (201, 201)
    assert plain.json()["id"] != named.json()["id"]
    assert named.json()["model"]["preset"] == "base"
    assert named.json()["model"]["file_sha256"] == several.get("/models").json()["models"][1]["file_sha256"]
    assert loaded(several) == ["default", "base"]
    for same in ("default", "", " default "):
        assert post(several, model=same).json()["id"] == plain.json()["id"]
    assert post(several, model="base").status_code == 200


def test_a_name_that_is_none_is_refused_with_those_that_are(several: TestClient) -> None:
    body = assert_problem(post(several, model="huge"), 422, "model_unknown", "model")
    assert "'huge'" in body["detail"]
    assert body["cure"] == "there is default, base, other"
    assert_problem(post(several, model="../base"), 422, "model_unknown", "model")


def test_asked_for_at_once_a_model_is_loaded_once(
    settings: Settings, further: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, original = [], Reconstructor.__init__

    def counted(self: Reconstructor, model: Path, **options: Any) -> None:
        calls.append(model.name)
        original(self, model, **options)

    change = {"models": further, "store": tmp_path / "scenes", "concurrency": 4}
    with serving(settings.model_copy(update=change)) as client, ThreadPoolExecutor(4) as threads:
        monkeypatch.setattr(Reconstructor, "__init__", counted)
        asked = [[photograph(seed), photograph(9)] for seed in range(4)]
        answers = list(threads.map(lambda images: post(client, images, model="base"), asked))
    assert [answer.status_code for answer in answers] == [201] * 4
    assert calls == ["base.onnx"]


def test_over_the_budget_the_one_unused_longest_goes(settings: Settings, further: str, tmp_path: Path) -> None:
    assert settings.model is not None
    size = settings.model.stat().st_size
    change = {"models": further, "store": tmp_path / "scenes", "model_bytes": 2 * size + 20}
    with serving(settings.model_copy(update=change)) as client:
        steps = (
            ("base", ["default", "base"]),
            ("default", ["default", "base"]),
            ("other", ["default", "other"]),
            ("base", ["base", "other"]),
            ("default", ["default", "base"]),
        )
        for seed, (name, there) in enumerate(steps):
            assert post(client, [photograph(seed), photograph(seed + 1)], model=name).status_code == 201
            assert loaded(client) == there
            document = client.get("/models").json()
            assert document["loaded_bytes"] <= document["budget_bytes"] == 2 * size + 20
        assert client.get("/readyz").status_code == 200


def test_a_model_over_the_budget_is_an_error_of_the_start(settings: Settings) -> None:
    with pytest.raises(ModelError, match=r"the model 'default' has \d+ bytes, the budget is 1000") as caught:
        Models(settings.model_copy(update={"model_bytes": 1000}))
    assert caught.value.field == "GAPMES_MODEL_BYTES"


def test_a_further_model_that_is_missing_is_an_error_of_the_start(settings: Settings, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"base: .*nothing\.onnx cannot be read") as caught:
        Models(settings.model_copy(update={"models": f"base={tmp_path / 'nothing.onnx'}"}))
    assert caught.value.field == "GAPMES_MODELS"


@pytest.mark.parametrize(
    ("text", "message", "index"),
    [
        ("base", "'base' is no model", 0),
        ("a=1.onnx,", "'' is no model", 1),
        ("a=1.onnx, =2.onnx", "'' is no name", 1),
        ("Big=1.onnx", "'Big' is no name", 0),
        ("a=1.onnx,a=2.onnx", "the name 'a' is taken", 1),
        ("default=1.onnx", "the name 'default' is taken", 0),
    ],
)
def test_a_malformed_list_names_the_entry(text: str, message: str, index: int) -> None:
    with pytest.raises(InputError, match=message) as caught:
        model_paths(None, text)
    assert (caught.value.field, caught.value.index) == ("GAPMES_MODELS", index)


def test_a_list_is_read_in_order_and_paths_may_hold_anything_but_commas() -> None:
    found = model_paths(Path("d.onnx"), " a = /x/one=1.onnx , b.2=two words.onnx ")
    assert found == {"default": Path("d.onnx"), "a": Path("/x/one=1.onnx"), "b.2": Path("two words.onnx")}


def left_by_a_service(settings: Settings, further: str, store: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A queued job for the model `base` of a process that never came to it."""
    with (
        monkeypatch.context() as patch,
        serving(settings.model_copy(update={"models": further, "store": store, "drain_seconds": 0})) as client,
    ):
        patch.setattr(client.app.state.runtime.jobs._runner, "_next", lambda: None)
        job = post(client, model="base", prefer="respond-async").json()
        assert job["state"] == "queued"
        work = Spool(store / ".jobs").get(job["id"])
        assert work.model == "base"
    return job


def ended(client: TestClient, job: dict[str, Any]) -> dict[str, Any]:
    with client.stream("GET", job["links"]["events"]) as stream:  # ends with the job
        "".join(stream.iter_text())
    return client.get(job["links"]["self"]).json()


def test_a_job_is_computed_by_its_model_after_a_restart(
    settings: Settings, further: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = left_by_a_service(settings, further, tmp_path / "scenes", monkeypatch)
    with serving(settings.model_copy(update={"models": further, "store": tmp_path / "scenes"})) as client:
        done = ended(client, job)
        assert done["state"] == "done"
        assert client.get(done["links"]["scene"]).json()["model"]["preset"] == "base"
        stages = client.get(job["links"]["events"]).text
        assert '"stage": "load model"' in stages


def test_a_job_whose_model_is_not_configured_any_more_says_so(
    settings: Settings, further: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = left_by_a_service(settings, further, tmp_path / "scenes", monkeypatch)
    with serving(settings.model_copy(update={"store": tmp_path / "scenes"})) as client:
        failed = ended(client, job)
        assert (failed["state"], failed["problem"]["code"]) == ("failed", "model_changed")
        assert "'base', which is not configured any more" in failed["problem"]["detail"]
        assert "default" in failed["problem"]["cure"]


def test_a_model_that_breaks_when_it_is_loaded_fails_its_job_and_no_other(
    several: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ModelError("/srv/base.onnx is damaged", field="model")

    with monkeypatch.context() as patch:
        patch.setattr(Reconstructor, "__init__", broken)
        body = assert_problem(post(several, model="base"), 500, "model_invalid")
        assert "srv" not in json.dumps(body)
        assert post(several).status_code == 201
    assert post(several, model="base").status_code == 201


def test_a_file_that_was_replaced_meanwhile_is_told_apart(settings: Settings, tmp_path: Path) -> None:
    """Its scenes would have the name of what it was."""
    path = write_standin(tmp_path / "base.onnx")
    models = Models(settings.model_copy(update={"models": f"base={path}"}))
    write_standin(path, METADATA | {"preset": "another"})
    with pytest.raises(ModelError, match="when the service started") as caught, models.using("base"):
        pass
    assert caught.value.cure == "restart the service"


@pytest.mark.skipif(find_spec("openvino") is None, reason="pip install 'gapmes[openvino]'")
@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"something else")])
def test_a_model_that_cannot_be_loaded_takes_no_other_along(
    settings: Settings, tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    path = write_standin(tmp_path / "base.onnx", METADATA | {"preset": "base"})
    budget = 3 * model_file(path).bytes // 2  # one of the two
    models = Models(settings.model_copy(update={"models": f"base={path}", "model_bytes": budget}))
    with models.using("default"):
        pass
    damage(path)
    with pytest.raises(ModelError), models.using("base"):
        pass
    assert models.loaded("default")


def test_another_engine_is_another_scene(several: TestClient, settings: Settings, tmp_path: Path) -> None:
    ids = {post(several).json()["id"]}
    for engine in (f"openvino-{precision}" for precision in precisions()):
        with serving(settings.model_copy(update={"engine": engine, "store": tmp_path / engine})) as client:
            scene = post(client).json()
            ids.add(scene["id"])
            assert scene["model"]["engine"]["precision"] == engine.removeprefix("openvino-")
            assert client.get("/models").json()["models"][0]["engine"] == scene["model"]["engine"]
    assert len(ids) == 1 + len(precisions())


@pytest.mark.parametrize(
    ("arguments", "environment", "said"),
    [
        (["--models", "base"], {}, "GAPMES_MODELS: 'base' is no model"),
        (["--model", str(sample_folder() / "cameras.json")], {}, "cameras.json cannot be loaded, it is no ONNX file"),
        (["--model", "nothing.onnx"], {}, "nothing.onnx cannot be read"),
        ([], {"GAPMES_MODEL_BYTES": "1000"}, "GAPMES_MODEL_BYTES: the model 'default' has"),
        (
            [],
            {"GAPMES_ENGINE": "tpu"},
            "GAPMES_ENGINE: Input should be 'onnxruntime', 'openvino-fp32' or 'openvino-bf16'",
        ),
        (["--engine", "tpu"], {}, "engine: 'tpu' is no engine (one of onnxruntime, openvino-fp32, openvino-bf16)"),
    ],
)
def test_the_server_does_not_start_with_what_cannot_work(
    arguments: list[str],
    environment: dict[str, str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as ended:
        cli.main(["serve", *arguments])
    assert ended.value.code == 1
    assert said in capfd.readouterr().err
