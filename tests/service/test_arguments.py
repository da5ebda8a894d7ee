"""Numbers and sequences in Python: numpy's types count too, and all else is refused by name."""

import json
from fractions import Fraction

import numpy as np
import pytest
from plane_scene import PlaneScene

from gapmes.service.arguments import real_number, shown, whole_number
from gapmes.service.cameras.leave_one_out import checked_others
from gapmes.service.errors import InputError, ModelError
from gapmes.service.leaving_out.budget import Budget
from gapmes.service.mending.detail_level import checked_detail
from gapmes.service.mending.fade_passes import checked_passes
from gapmes.service.network.engine import Engine
from gapmes.service.reconstruct import Reconstructor
from gapmes.service.splat import Definition
from gapmes.service.splat.options import checked_definition
from gapmes.service.splat.parallel import checked_threads

WHOLE = [2, np.int64(2), np.uint8(2), np.array(2)]
NOT_WHOLE = ["2", True, np.True_, 2.0, np.float64(2), None, [2], np.array([2]), 2 + 0j]
NOT_REAL = ["0.5", True, np.True_, None, [0.5], np.array([0.5]), 0.5j, np.complex128(0.5), np.str_("0.5")]
CHECKS = [checked_passes, checked_detail, checked_others, checked_threads]


@pytest.fixture(scope="module")
def reconstructor(engine: Engine) -> Reconstructor:
    return Reconstructor(engine)


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("value", WHOLE)
def test_whole_numbers_of_any_type_are_taken_as_those_of_python(check, value: int) -> None:
    assert type(check(value)) is int
    assert check(value) == 2


@pytest.mark.parametrize("check", [checked_passes, checked_detail, checked_others])
@pytest.mark.parametrize("value", NOT_WHOLE)
def test_what_is_no_whole_number_is_refused_as_what_it_is(check, value: int) -> None:
    with pytest.raises(InputError) as caught:
        check(value)
    assert caught.value.message.startswith(f"is {shown(value)}, need ")


def test_text_that_looks_like_a_number_is_told_from_one() -> None:
    assert [shown(value) for value in (2, np.int64(2), "2", None)] == ["2", "2", "'2'", "None"]
    assert len(shown("x" * 1000)) == 50


@pytest.mark.parametrize("value", [0.5, np.float32(0.5), np.array(0.5), Fraction(1, 2)])
def test_numbers_of_any_type_are_numbers(value: float) -> None:
    assert (type(real_number(value)), real_number(value)) == (float, 0.5)
    assert real_number(10**400) == float("inf")


@pytest.mark.parametrize("value", NOT_REAL)
def test_what_is_no_number_is_none(value: object) -> None:
    assert real_number(value) is whole_number(value) is None


def test_a_budget_holds_plain_numbers() -> None:
    budget = Budget(np.float32(0.25), np.int64(3), np.array(["1", "0.5"]), np.float32(0.5), np.int32(2))
    assert budget == Budget(0.25, 3, ("0.5", "1"), 0.5, 2)
    plain = (budget.max_error, budget.certify, budget.min_opacity, budget.stride)
    assert json.loads(json.dumps(plain)) == [0.25, 3, 0.5, 2]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"certify": "1"}, "is '1', need a whole number from 0 to 30"),
        ({"stride": "2"}, "is '2', need one of (1, 2, 4)"),
        ({"stride": 2.0}, "is 2.0, need one of (1, 2, 4)"),
        ({"min_opacity": "0.5"}, "is '0.5', need 0 to 1"),
        ({"min_opacity": None}, "is None, need 0 to 1"),
        ({"max_error": "1/255"}, "is '1/255', need 0 to 1"),
        ({"max_error": 1j}, "is 1j, need 0 to 1"),
        ({"asked": 5}, "is a int, need several in a sequence"),
        ({"asked": ("1", 5)}, "is 5, need text"),
    ],
)
def test_a_budget_of_other_things_is_refused_by_name(given: dict, said: str) -> None:
    with pytest.raises(InputError) as caught:
        Budget(**given)
    assert [caught.value.field] == list(given)
    assert caught.value.message == said


def test_threads_and_planes_of_other_types_are_refused_by_name(engine: Engine) -> None:
    for threads in ("2", True, 1.5):
        with pytest.raises(InputError, match=f"threads: is {threads!r}, need a whole number"):
            checked_threads(threads)
        with pytest.raises(ModelError, match=f"threads = {threads!r}, need a whole number") as caught:
            Engine(threads=threads)
        assert caught.value.field == "threads"
    with pytest.raises(InputError, match="near: is '1', need a number"):
        checked_definition(None, "1", None)
    for field in ("near", "cut_radius", "max_entries"):
        with pytest.raises(InputError, match=f"definition.{field}: is '1', need"):
            Definition(**{field: "1"})


def test_iterators_and_numpy_numbers_make_the_same_scene(reconstructor: Reconstructor, plane_scene: PlaneScene) -> None:
    """And a document of plain JSON values; None is the budget that is there without one."""
    images, cameras = plane_scene.images, plane_scene.cameras
    options = {"near": np.float32(2), "far": np.array(8), "fade": np.int64(1), "detail": np.int32(1)}
    found = reconstructor.reconstruct(
        iter(images),
        (camera for camera in cameras),
        budget=None,
        leave_one_out=np.uint8(2),
        numbers=np.array([4, 9, 7]),
        **options,
    )
    expected = reconstructor.reconstruct(images, cameras, near=2, far=8, fade=1, numbers=[4, 9, 7])
    np.testing.assert_array_equal(found.gaussians.means, expected.gaussians.means)
    documents = [json.loads(json.dumps(scene.document, allow_nan=False)) for scene in (found, expected)]
    for document in documents:
        assert document.pop("timings") | document.pop("pruning")  # which hold seconds
    assert documents[0] == documents[1]


@pytest.mark.parametrize(
    ("changed", "field", "index", "said"),
    [
        ({"images": 5}, "images", None, "is a int, need several in a sequence"),
        ({"images": "a.jpg"}, "images", None, "is a str, need several in a sequence"),
        ({"cameras": None}, "cameras", None, "is a NoneType, need several in a sequence"),
        ({"budget": {"max_error": 0.1}}, "budget", None, "is a dict, need a Budget"),
        ({"numbers": ["a", 2, 3]}, "numbers", 0, "is 'a', need a whole number"),
        ({"numbers": [1, 2.5, 3]}, "numbers", 1, "is 2.5, need a whole number"),
        ({"near": "1", "far": "2"}, "near", None, "near = '1', need a finite depth above 0"),
        ({"near": 1, "far": np.array([2.0])}, "far", None, "far = array([2.]), need a finite depth above 0"),
        ({"near": 1, "far": 10**400}, "far", None, "far = inf, need a finite depth above 0"),
    ],
)
def test_a_reconstruction_names_what_is_no_number_or_sequence(
    reconstructor: Reconstructor, plane_scene: PlaneScene, changed: dict, field: str, index: int | None, said: str
) -> None:
    given = {"images": plane_scene.images, "cameras": plane_scene.cameras, **changed}
    with pytest.raises(InputError) as caught:
        reconstructor.reconstruct(**given)
    assert (caught.value.field, caught.value.index, caught.value.message) == (field, index, said)


def test_a_number_of_more_digits_than_python_writes_is_refused_too() -> None:
    with pytest.raises(InputError, match="is a number of more digits than can be written, need a whole number from 0"):
        Budget(certify=10**5000)
