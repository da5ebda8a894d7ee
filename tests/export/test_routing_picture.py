"""The routing picture: every patch has its place and colour, masked patches have none, and shares count patches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from PIL import Image

from gapmes.export import routing_picture as rp
from gapmes.export.routing_picture import Routed
from gapmes.service.shipped import sample_folder

PATCH, ROWS, COLUMNS, EXPERTS = 16, 2, 3, 6


def routed(views: int = 2, seed: int = 0) -> Routed:
    """Random photographs of 2 x 3 patches and random routes; the last patch of view 0 is left out."""
    random = np.random.default_rng(seed)
    patches = ROWS * COLUMNS
    order = np.argsort(random.random((views, patches, EXPERTS)), axis=-1)[..., :2]
    first = random.uniform(0.5, 1, (views, patches, 1))
    tasks = random.dirichlet(np.ones(4), (views, patches))
    weight = np.concatenate([first, 1 - first], axis=-1)
    weight[0, -1], tasks[0, -1] = 0, 0
    photos = random.random((views, 3, ROWS * PATCH, COLUMNS * PATCH)).astype(np.float32)
    places = tuple(range(3, 3 + views))
    return Routed(photos, places, PATCH, 1.0, EXPERTS, order, weight.astype(np.float32), tasks.astype(np.float32))


def test_more_choices_than_have_a_name_are_numbered() -> None:
    choices = np.tile(np.arange(10), (2, ROWS * COLUMNS, 1))
    many = replace(routed(), experts=10, expert_index=choices, expert_weight=np.full(choices.shape, 0.1, np.float32))
    titles = [panel.title for row in rp.view_rows(many, 0) for panel in row]
    assert titles[8:11] == ["eighth expert, weight 0.10", "9th expert, weight 0.10", "10th expert, weight 0.10"]
    rp.draw_routing(many)


@pytest.mark.parametrize(
    "said", ["9th", "10th", "11th", "12th", "13th", "21st", "22nd", "23rd", "24th", "101st", "111th", "113th", "122nd"]
)
def test_numbers_of_choices_end_as_they_are_read(said: str) -> None:
    assert rp._ordinal(int(said[:-2]) - 1) == said


def expected_pixel(photo: np.ndarray, colour: str, y: int, x: int) -> np.ndarray:
    red, green, blue = photo[:, y, x]
    grey = 0.299 * red + 0.587 * green + 0.114 * blue
    return (1 - rp.TINT) * grey + rp.TINT * np.array(to_rgb(colour))


def test_every_pixel_has_the_colour_of_its_own_patch() -> None:
    case = routed()
    for view in range(2):
        panels = {panel.title.split(",")[0]: panel.pixels for row in rp.view_rows(case, view) for panel in row}
        for place, name in enumerate(("first expert", "second expert")):
            for y in range(ROWS * PATCH):
                for x in range(COLUMNS * PATCH):
                    patch = (y // PATCH) * COLUMNS + x // PATCH
                    if view == 0 and patch == ROWS * COLUMNS - 1:
                        wanted = case.photos[view, :, y, x]
                    else:
                        colour = rp.EXPERT_COLOURS[case.expert_index[view, patch, place]]
                        wanted = expected_pixel(case.photos[view], colour, y, x)
                    # float32 photographs and one sum: measured below 1e-7
                    np.testing.assert_allclose(panels[name][y, x], wanted, atol=1e-6)


def test_task_panels_show_the_strongest_and_each_weight() -> None:
    case = replace(routed(), photos=np.ones((2, 3, ROWS * PATCH, COLUMNS * PATCH), np.float32))
    for view in range(2):
        panels = {panel.title: panel.pixels for row in rp.view_rows(case, view) for panel in row}
        for patch in range(ROWS * COLUMNS - 1):
            y, x = PATCH * (patch // COLUMNS) + 5, PATCH * (patch % COLUMNS) + 11
            weight = case.task_weight[view, patch]
            wanted = expected_pixel(case.photos[view], rp.TASK_COLOURS[int(weight.argmax())], y, x)
            np.testing.assert_allclose(panels["strongest task"][y, x], wanted, atol=1e-6)
            for task, name in enumerate(rp.TASKS):
                colour = rp.WEIGHTS(float(weight[task]))[:3]
                wanted = expected_pixel(case.photos[view], colour, y, x)
                np.testing.assert_allclose(panels[f"task weight: {name}"][y, x], wanted, atol=1e-6)


def test_the_drawn_picture_has_the_colours_where_the_axes_say() -> None:
    """Through matplotlib to pixels: the centre of every patch of every first-expert panel."""
    case = replace(routed(), photos=np.full((2, 3, ROWS * PATCH, COLUMNS * PATCH), 0.5, np.float32))
    figure = rp.draw_routing(case)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    panels = [axes for axes in figure.axes if axes.get_title().startswith("first expert")]
    assert [axes.get_title() for axes in figure.axes if axes.get_title().startswith("view")] == ["view 3", "view 4"]
    assert len(panels) == 2
    for view, axes in enumerate(panels):
        for patch in range(ROWS * COLUMNS - (view == 0)):
            middle = PATCH * (patch % COLUMNS) + 7.5, PATCH * (patch // COLUMNS) + 7.5
            x, y = axes.transData.transform(middle)
            colour = rp.EXPERT_COLOURS[case.expert_index[view, patch, 0]]
            wanted = 255 * expected_pixel(case.photos[view], colour, 0, 0)
            assert np.abs(pixels[len(pixels) - 1 - int(y), int(x)] - wanted).max() <= 1


def test_pixels_are_as_tall_as_they_are_in_the_photograph() -> None:
    """The network sees a tall photograph resampled to its own aspect; it is drawn in the photograph's."""
    figure = rp.draw_routing(replace(routed(), tall=1.75))
    FigureCanvasAgg(figure).draw()  # the layout is computed here
    axes = figure.axes[0]
    columns, rows = axes.images[0].get_size()[::-1]
    low, high = axes.transData.transform([(0, rows), (columns, 0)])
    width, height = high - low
    assert height / width == pytest.approx(1.75 * rows / columns, rel=1e-3)


def test_shares_count_kept_patches() -> None:
    case = routed(views=3, seed=2)
    kept = case.expert_weight.sum(-1).ravel() > 0
    found = rp.shares(case.expert_index[..., 0].ravel(), kept, EXPERTS)
    chosen = [int(e) for e, keep in zip(case.expert_index[..., 0].ravel(), kept, strict=True) if keep]
    assert len(chosen) == 3 * ROWS * COLUMNS - 1
    assert found.tolist() == pytest.approx([chosen.count(e) / len(chosen) for e in range(EXPERTS)])
    assert rp.shares(np.zeros(4, np.int64), np.zeros(4, bool), 2).tolist() == [0, 0]
    legend = next(axes.get_legend() for axes in rp.draw_routing(case).axes if axes.get_legend())
    assert [text.get_text().split(",")[0] for text in legend.get_texts()] == [
        f"expert {e}: {100 * share:.0f} %" for e, share in enumerate(found)
    ]


def test_a_network_without_a_gate_has_no_panels_for_it() -> None:
    case = routed()
    without_tasks = replace(case, task_weight=None)
    without_experts = replace(case, expert_index=None, expert_weight=None)
    titles = [[len(row) for row in rp.view_rows(c, 0)] for c in (case, without_tasks, without_experts)]
    assert titles == [[4, 4], [3], [2, 4]]
    for small in (without_tasks, without_experts):
        assert len(rp.draw_routing(small).axes) > 3


def test_colours_of_experts_differ() -> None:
    for count in (1, 6, 8, 9, 24):
        assert len(set(rp.expert_colours(count))) == count
    assert not set(rp.TASK_COLOURS) & set(rp.EXPERT_COLOURS)


def test_the_shipped_network_is_drawn_from_a_scene(tmp_path: Path) -> None:
    three = rp.route(sample_folder(), ["1", "3", "5"])
    assert len(three.photos) == len(three.expert_index) == 3
    case = rp.route(sample_folder(), ["5", "1"])
    assert case.views == (5, 1)
    with Image.open(sample_folder() / "images" / "005.png") as image:
        np.testing.assert_array_equal(np.round(case.photos[0].transpose(1, 2, 0) * 255), np.asarray(image))
    np.testing.assert_allclose(case.expert_weight.sum(-1), 1, atol=1e-5)
    np.testing.assert_allclose(case.task_weight.sum(-1), 1, atol=1e-5)
    out = tmp_path / "routing.png"
    rp.draw_routing(case).savefig(out)
    with Image.open(out) as image:
        assert image.width == rp.WIDTH_PX


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--views", "0", "9"], "view 9 does not exist"), (["--views", "0"], "1 view"), (["nowhere"], "nowhere")],
)
def test_bad_requests_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    out = tmp_path / "routing.png"
    assert rp.main([*arguments, "--out", str(out)]) == 1
    assert message in capsys.readouterr().err
    assert not out.exists()
    assert rp.main(["--out", str(tmp_path / "none" / "routing.png")]) == 1
    assert f"out: {tmp_path / 'none'} is not a folder" in capsys.readouterr().err
    assert rp.main(["--out", str(tmp_path / "routing.xyz")]) == 1
    assert "'routing.xyz' has another ending than .png, .svg, .pdf" in capsys.readouterr().err
