"""OpenVINO against onnxruntime: the same network within rounding, in the requested precision, as reported."""

from __future__ import annotations

import builtins
import sys
import warnings
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from external_model import write_external
from openvino_precisions import precisions
from test_engine import inputs

from gapmes.service import cli
from gapmes.service.captures.capture import load_scene_folder
from gapmes.service.errors import ModelError
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.network.backends import choice, openvino_session
from gapmes.service.network.backends.choice import ENGINES, checked_engine, identity, made_by
from gapmes.service.network.contract import AMBIGUOUS_MARGIN
from gapmes.service.network.engine import Arrays, Engine
from gapmes.service.photographs.images import decode_image, fit_view
from gapmes.service.pictures.picture_error import psnr
from gapmes.service.reconstruct import Reconstructor, Scene
from gapmes.service.shipped import sample_folder
from gapmes.service.splat import render
from gapmes.service.viewpoints.scene_views import SceneViews

if find_spec("openvino") is None:
    warnings.warn("openvino is not installed, its tests are skipped: pip install 'gapmes[openvino]'", stacklevel=1)
needed = pytest.mark.skipif(find_spec("openvino") is None, reason="pip install 'gapmes[openvino]'")
needs_bf16 = pytest.mark.skipif("bf16" not in precisions(), reason="OpenVINO has no bf16 on this processor")

# Both sum up in float32, in another order; limits of the network (the best depth, its neighbours) amplify that where
# two candidates are nearly as good. Measured on the sample from two to six views: at most 1.5e-4 (the margins), means
# and depths 7e-6; pictures agree to 61 dB and more (0.05 of a colour in single pixels).
FP32_RELATIVE = 2e-3
FP32_DB = 50.0
# bf16 has 8 bits of mantissa and routes a twelfth of the patches to other experts: pictures are at 35 dB beside those
# of fp32 (31 without fading), and equal beside photographs that were held back (0.4 to 0.9 dB worse without fading).
# Limits: room for other processors.
BF16_DB = 30.0
BF16_COST_DB = 0.7


class Recording(Engine):
    """Keeps the outputs of its last run."""

    def run(self, *arguments: Any, **named: Any) -> Arrays:
        self.last = super().run(*arguments, **named)
        return self.last


class Sample:
    """The packaged scene from two photographs under each engine, and beside the third."""

    def __init__(self) -> None:
        self._folder = load_scene_folder(sample_folder(), lambda _: (1, 5, 3))
        paths = enumerate(self._folder.image_paths)
        self._photos = [decode_image(path.read_bytes(), index=index) for index, path in paths]
        self._made: dict[str, tuple[Scene, Arrays, np.ndarray]] = {}

    def made(self, engine: str) -> tuple[Scene, Arrays, np.ndarray]:
        """Scene, outputs of the network, and the picture from the camera that was held back."""
        if engine not in self._made:
            loaded = Recording(threads=2, engine=checked_engine(engine))
            file = self._folder.file
            given: dict[str, Any] = {"near": file.near, "far": file.far, "budget": Budget(None)}
            scene = Reconstructor(loaded).reconstruct(self._photos[:2], file.cameras[:2], **given)
            near = SceneViews(scene.view_cameras, scene.document["near"], scene.document["far"]).near_plane
            picture = render(scene.gaussians, self._truth(loaded).camera, outputs=(), **near).rgb
            self._made[engine] = scene, loaded.last, np.clip(picture, 0, 1).transpose(2, 0, 1)
        return self._made[engine]

    def quality(self, engine: str) -> float:
        """PSNR in dB against the photograph."""
        return psnr(self.made(engine)[2], self._truth(Engine(threads=1)).image)

    def _truth(self, engine: Engine) -> Any:
        return fit_view(self._photos[2], self._folder.file.cameras[2], engine.info.height, engine.info.width)


@pytest.fixture(scope="module")
def sample() -> Sample:
    return Sample()


@needed
def test_in_fp32_the_outputs_are_those_of_onnxruntime_within_rounding(sample: Sample) -> None:
    ours, theirs = sample.made("openvino-fp32")[1], sample.made("onnxruntime")[1]
    assert set(ours) == set(theirs)
    clear = theirs["route_margin"] > AMBIGUOUS_MARGIN
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(ours["expert_index"][clear], theirs["expert_index"][clear])
    for name, value in theirs.items():
        assert ours[name].dtype == value.dtype
        if name != "expert_index":
            error = np.linalg.norm((ours[name] - value).ravel()) / np.linalg.norm(value.ravel())
            assert error < FP32_RELATIVE, (name, error)


@needed
def test_in_fp32_the_picture_is_that_of_onnxruntime_within_rounding(sample: Sample) -> None:
    ours, theirs = sample.made("openvino-fp32")[2], sample.made("onnxruntime")[2]
    assert psnr(ours, theirs) > FP32_DB
    assert abs(sample.quality("openvino-fp32") - sample.quality("onnxruntime")) < 0.05


@needs_bf16
def test_bf16_costs_what_it_costs(sample: Sample) -> None:
    """It differs from fp32, so the precision was really taken, and by no more than was measured, loosely."""
    ours, theirs = sample.made("openvino-bf16")[2], sample.made("onnxruntime")[2]
    assert BF16_DB < psnr(ours, theirs) < FP32_DB
    assert sample.quality("openvino-bf16") > sample.quality("onnxruntime") - BF16_COST_DB


@needed
@pytest.mark.parametrize("engine", ["onnxruntime", *(f"openvino-{precision}" for precision in precisions())])
def test_the_scene_says_what_computed_it(sample: Sample, engine: str) -> None:
    package, _, precision = engine.partition("-")
    told = {"name": package, "version": version(package), "precision": precision or "fp32"}
    assert sample.made(engine)[0].document["model"]["engine"] == told


@needed
@pytest.mark.parametrize("outside", [False, True], ids=["inside", "weights beside it"])
def test_every_number_of_views_and_the_same_bits_again(
    tmp_path: Path, standin_model: Path, engine: Engine, outside: bool
) -> None:
    path = standin_model
    if outside:
        write_external(standin_model, tmp_path / "m.onnx")
        path = tmp_path / "m.onnx"
    loaded = Engine(path, threads=1, engine="openvino-fp32")
    for views in (2, 3, 6, 2):
        found, expected = loaded.run(**inputs(views)), engine.run(**inputs(views))
        again = loaded.run(**inputs(views))
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, atol=1e-5, err_msg=name)
            np.testing.assert_array_equal(found[name], again[name])
    session = loaded._session
    assert isinstance(session, openvino_session.OpenVinoSession)
    assert list(session._compiled) == [6, 2]


@needed
def test_nothing_is_left_to_the_defaults(standin_model: Path) -> None:
    """On a processor with bf16 that would be OpenVINO's own choice."""
    for precision in precisions():
        native = {"fp32": "f32", "bf16": "bf16"}[precision]
        loaded = Engine(standin_model, threads=1, engine=checked_engine(f"openvino-{precision}"))
        session = loaded._session
        assert isinstance(session, openvino_session.OpenVinoSession)
        compiled = session._for(2)
        assert compiled.get_property("INFERENCE_PRECISION_HINT").get_type_name() == native
        assert compiled.get_property("INFERENCE_NUM_THREADS") == 1
        assert compiled.get_property("NUM_STREAMS") == 1
        assert compiled.get_property("ENABLE_CPU_PINNING") is False


@needed
def test_a_precision_that_the_processor_has_not_is_refused(
    standin_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # a processor with all of them does here what one without bf16 does by itself: it takes another precision
    taken = {"INFERENCE_PRECISION_HINT": "f32"}
    monkeypatch.setattr(openvino_session.OpenVinoSession, "_properties", lambda _: taken)
    with pytest.raises(ModelError, match="computes in f32 on this processor, asked for was bf16") as caught:
        Engine(standin_model, threads=1, engine="openvino-bf16")
    assert "openvino-fp32" in str(caught.value.cure)


def test_without_the_package_the_cure_is_named(standin_model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(choice, "version", missing)
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(ModelError, match="needs the package openvino, which is not installed") as caught:
        Engine(standin_model, engine="openvino-fp32")
    assert "pip install 'gapmes[openvino]'" in str(caught.value.cure)
    assert caught.value.field == "engine"


def test_a_name_that_is_no_engine_lists_those_that_are(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ModelError, match="'openvino' is no engine"):
        checked_engine("openvino")
    with pytest.raises(SystemExit):
        cli.main(["reconstruct", str(sample_folder()), "-o", str(tmp_path / "x.ply"), "--engine", "tpu"])
    assert "one of onnxruntime, openvino-fp32, openvino-bf16" in capfd.readouterr().err


def test_the_default_engine_leaves_the_identity_to_the_file() -> None:
    found = {identity("a" * 64, engine) for engine in ENGINES}
    assert "a" * 64 in found
    assert len(found) == len(ENGINES)


def test_the_default_engine_loads_no_openvino(monkeypatch: pytest.MonkeyPatch, standin_model: Path) -> None:
    original = builtins.__import__

    def guarded(name: str, *arguments: Any, **named: Any) -> Any:
        assert not name.startswith("openvino")
        return original(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", guarded)
    assert Engine(standin_model, threads=1).made_by == made_by("onnxruntime")
