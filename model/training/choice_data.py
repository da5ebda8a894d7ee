"""Training data of the choice: unconfirmed pixels of generated scenes, their candidates and the errors of these."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gapmes.service import Reconstructor
from gapmes.service.cameras.depth_range import depth_range
from gapmes.service.mending.after_network import matched_depths
from gapmes.service.mending.choice.candidates import Candidates, Matched

from .generated_views import input_views
from .scenes import SceneBatch, SceneSampler

SIZE = 256  # px: what the shipped network is exported for
BASELINE = (0.08, 0.8)  # in median depths
FIELD_OF_VIEW = (30.0, 80.0)  # degrees
CLOSE_SHARE = 0.4  # of scenes with something close at the edge of one input
PIXELS = 1_500  # of a view, at most
FEWEST = 200  # of a view; one with fewer is left out


class Samples(NamedTuple):
    """N pixels with K candidates."""

    known: NDArray[np.float16]  # (K, F, N)
    about: NDArray[np.float16]  # (G, N)
    error: NDArray[np.float32]  # (K, N) px of parallax from the true depth, nearer ones positive
    scene: NDArray[np.int64]  # (N,) its number


def joined(parts: list[Samples]) -> Samples:
    return Samples(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


def scene_batch(seed: int, number: int) -> SceneBatch:
    """Two inputs and a target, which is not used."""
    sampler = SceneSampler(seed, "train", first=number)
    return sampler.batch(1, 2, 1, SIZE, baseline=BASELINE, field_of_view=FIELD_OF_VIEW, close_share=CLOSE_SHARE)


def scene_samples(reconstructor: Reconstructor, seed: int, number: int) -> Samples | None:
    """Samples of scene `number`, with two views and its depth range given; None if nearly all pixels are confirmed."""
    batch = scene_batch(seed, number)
    views = input_views(batch)
    near, far = map(float, batch.near_far[0])
    outputs, frame, _ = reconstructor.run_network(views, depth_range([view.camera for view in views], near, far))
    network = frame.depths(outputs)
    matched, planed = matched_depths(views, network, 1)
    rng = np.random.default_rng((seed, number))
    together = Matched(views, planed, (network, matched))
    found = []
    for index in range(len(views)):
        one = together.candidates(index)
        if one is not None and one.undecided.sum() >= FEWEST:
            found.append(_of_view(one, batch, index, number, rng))
    return joined(found) if found else None


def _of_view(one: Candidates, batch: SceneBatch, index: int, number: int, rng: np.random.Generator) -> Samples:
    places = np.flatnonzero(one.undecided)
    taken = np.sort(rng.choice(len(places), min(PIXELS, len(places)), replace=False))
    background, depth = batch.background[0, index].ravel(), batch.depths[0, index].ravel().astype(np.float64)
    inverse = np.where(background, 0, 1 / depth)[places[taken]]
    error = one.inverse.reshape(len(one.inverse), -1)[:, places[taken]] - one.disparity_scale * inverse
    return Samples(one.known[..., taken], one.about[:, taken], error.astype(np.float32), np.full(len(taken), number))
