"""Depth from matching: fixed evidence, occlusion filling, two learned refinements over candidates, upsampling."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .agreement import CUES, agreement_cues, confirmation
from .behind import filled_from_behind
from .config import ModelConfig
from .cost_volume import PatchDescriptor, Views, local_matching, sweep
from .evidence import at_candidates, matching_evidence
from .gradients import no_gradient
from .layers import ResidualBlock, replicate_pad, resize_to, softmax_mean, softmax_of_channels
from .trunk import TrunkFeatures

REFINE_REACH = 2.0  # planes of the sweep
ALTERNATIVES = 2  # the unconfirmed depth and the network's own, beside those around the confirmed or filled one
ALTERNATIVE_BIAS = -4.0  # of their logits, to start with
SECOND_REACH = 0.5  # one step of the first refinement


@dataclass(frozen=True)
class DepthEstimate:
    """Normalised inverse depth (0 at far, 1 at near) at three resolutions, and what the heads build on."""

    quarter: Tensor  # (n, 1, H/4, W/4)
    refined: Tensor  # (n, 1, H/2, W/2) after the first refinement
    half: Tensor  # (n, 1, H/2, W/2) after the second
    full: Tensor  # (n, 1, H, W)
    confidence: Tensor  # (n, 1, H/4, W/4) probability of the best plane
    volume: Tensor  # (n, volume_channels, H/4, W/4) multi-view features of the cost volume
    guide: Tensor  # (n, refine_channels, H/2, W/2) features of the refinements


class DepthFromMatching(nn.Module):
    """Fixed evidence gives the initial depth; learned features, ZNCC and evidence score the refinements' candidates.

    In a training step that is `withheld` there is no evidence: the network's own coarse depth is the initial one, and
    the scores of learned features and ZNCC count everywhere, also where the views do not confirm the depth.
    """

    def __init__(self, config: ModelConfig, mono_channels: int) -> None:
        super().__init__()
        self.sparse = True  # see `matching_evidence`
        self.withheld = False  # a training step without evidence, in which the network must find the depths by itself
        self.planes, self.candidates = config.depth_planes, config.refine_candidates
        self.second_candidates = config.second_candidates
        c2, c4 = config.half_channels, config.quarter_channels
        cu, cr, cm = config.volume_channels, config.refine_channels, config.match_channels
        self.descriptor = PatchDescriptor()
        self.match_quarter = nn.Conv2d(c4, cm, 1)
        self.match_half = nn.Conv2d(c2 + c4 // 4, 16, 1)
        self.volume_net = nn.Sequential(
            nn.Conv2d(4 * self.planes + c4 + mono_channels, cu, 3, padding=1), ResidualBlock(cu), ResidualBlock(cu)
        )
        self.volume_logits = nn.Conv2d(cu, self.planes, 3, padding=1)
        self.volume_up = nn.Conv2d(cu, 4 * 32, 1)
        self.refine_net = nn.Sequential(
            nn.Conv2d(4 * (self.candidates + ALTERNATIVES) + c2 + 2 + 32 + 12 + CUES + 1, cr, 3, padding=1),
            ResidualBlock(cr),
            ResidualBlock(cr),
        )
        self.refine_logits = nn.Conv2d(cr, self.candidates + ALTERNATIVES, 3, padding=1)
        self.second_net = nn.Sequential(
            nn.Conv2d(cr + 4 * self.second_candidates + CUES, cr, 3, padding=1), ResidualBlock(cr)
        )
        self.second_logits = nn.Conv2d(cr, self.second_candidates, 3, padding=1)
        assert self.refine_logits.bias is not None
        with torch.no_grad():
            self.refine_logits.bias[-ALTERNATIVES:] = ALTERNATIVE_BIAS
        self.up_mask = nn.Conv2d(cr, 36, 1)
        self.learned_sharpness = nn.Parameter(torch.tensor([8.0, 8.0, 8.0]))
        self.zncc_sharpness = nn.Parameter(torch.tensor([4.0, 4.0, 4.0]))
        self.evidence_sharpness = nn.Parameter(torch.tensor([20.0, 200.0, 60.0, 60.0]))

    def forward(self, images: Tensor, features: TrunkFeatures, mono: Tensor, views: Views) -> DepthEstimate:
        """images (n, 3, H, W) in [0, 1]; mono (n, mono_channels, H/4, W/4) monocular cues."""
        grey = images.mean(1, keepdim=True) * 2 - 1
        colours = F.avg_pool2d(images, 2)
        quarter = F.normalize(self.match_quarter(features.quarter), dim=1)
        zncc_quarter = self.descriptor(F.avg_pool2d(grey, 2))
        (learned, zncc), seen = sweep([quarter, zncc_quarter], views, self.planes)
        alone = self.withheld and self.training
        evidence = self._evidence(colours, views, nothing=alone)
        pooled = F.avg_pool2d(evidence, 2)
        volume = self.volume_net(torch.cat([learned * 2, zncc, seen, features.quarter, mono, pooled], dim=1))
        logits = self.volume_logits(volume) + learned * self.learned_sharpness[0] + zncc * self.zncc_sharpness[0]
        probability = softmax_of_channels(logits + pooled * self.evidence_sharpness[0])
        bins = torch.linspace(0, 1, self.planes, device=images.device)
        coarse = (probability * bins.reshape(1, -1, 1, 1)).sum(1, keepdim=True)
        confidence = probability.amax(1, keepdim=True)

        start = resize_to(coarse, features.half) if alone else self._first_depth(evidence, bins)
        cues = agreement_cues(start, colours, views)
        sure = confirmation(cues)
        filled = start if alone else filled_from_behind(start, sure)

        context = resize_to(features.quarter[:, : features.quarter.shape[1] // 4], features.half)
        half = F.normalize(self.match_half(torch.cat([features.half, context], dim=1)), dim=1)
        matched = [half, self.descriptor(grey)]
        alternatives = [start.detach(), resize_to(coarse, features.half).detach()]
        candidates = torch.cat([self._around(filled, self.candidates, REFINE_REACH), *alternatives], dim=1)
        scores, votes = self._match(matched, evidence, candidates, views, 1)
        guide = self.refine_net(
            torch.cat(
                [
                    scores,
                    features.half,
                    filled,
                    resize_to(confidence, features.half),
                    F.pixel_shuffle(self.volume_up(volume), 2),
                    F.pixel_unshuffle(images * 2 - 1, 2),
                    cues,
                    sure,
                ],
                dim=1,
            )
        )
        # where a surface is occluded in the other views, matching scores are meaningless: only the network's count
        refined = _moved(filled, candidates, self.refine_logits(guide) + (votes if alone else votes * sure))

        candidates = self._around(refined, self.second_candidates, SECOND_REACH)
        scores, votes = self._match(matched, evidence, candidates, views, 2)
        cues = agreement_cues(refined, colours, views)
        guide = guide + self.second_net(torch.cat([guide, scores, cues], dim=1))
        second = _moved(refined, candidates, self.second_logits(guide) + votes)
        return DepthEstimate(coarse, refined, second, self._upsample(second, guide), confidence, volume, guide)

    def _evidence(self, colours: Tensor, views: Views, *, nothing: bool) -> Tensor:
        """(n, D, h, w) `matching_evidence` of pictures (n, 3, h, w), or zeros if `nothing`; no gradient."""
        if nothing:
            return colours.new_zeros(colours.shape[0], self.planes, *colours.shape[-2:])
        with no_gradient():
            return matching_evidence(colours, views, self.planes, sparse=self.sparse)

    def _first_depth(self, evidence: Tensor, bins: Tensor) -> Tensor:
        """(n, 1, h, w) normalised inverse depth: the soft argmax of evidence (n, D, h, w) over the `bins` (D,)."""
        return softmax_mean(evidence * self.evidence_sharpness[1], bins)

    def _around(self, centre: Tensor, count: int, reach: float) -> Tensor:
        """(n, count, h, w) candidates up to `reach` planes to both sides of centre (n, 1, h, w); no gradient."""
        offsets = torch.linspace(-reach, reach, count, device=centre.device) / (self.planes - 1)
        return (centre.detach() + offsets.reshape(1, -1, 1, 1)).clamp(-0.02, 1.1)

    def _match(
        self, matched: list[Tensor], evidence: Tensor, candidates: Tensor, views: Views, stage: int
    ) -> tuple[Tensor, Tensor]:
        """Matching scores (n, 4 K, h, w) as network input, and their weighted sum (n, K, h, w) as logits."""
        (learned, zncc), seen = local_matching(matched, candidates, views)
        fixed = at_candidates(evidence, candidates)
        votes = learned * self.learned_sharpness[stage] + zncc * self.zncc_sharpness[stage]
        votes = votes + fixed * self.evidence_sharpness[stage + 1]
        return torch.cat([learned * 2, zncc, seen, fixed], dim=1), votes

    def _upsample(self, half: Tensor, guide: Tensor) -> Tensor:
        """Each full-resolution pixel is a learned convex combination of the 3x3 half-resolution neighbours."""
        n, _, h, w = half.shape
        weights = softmax_of_channels(self.up_mask(guide).reshape(n, 9, 4, h, w))
        padded = replicate_pad(half, 1)
        shifted = [padded[:, :, dy : dy + h, dx : dx + w] for dy in range(3) for dx in range(3)]
        neighbours = torch.stack(shifted, dim=1)  # (n, 9, 1, h, w)
        return F.pixel_shuffle((weights * neighbours).sum(1), 2)


def _moved(centre: Tensor, candidates: Tensor, logits: Tensor) -> Tensor:
    """The centre (n, 1, h, w) moved to the softmax mean of the candidates, whose clamped values are averaged."""
    return centre + (softmax_of_channels(logits) * (candidates - centre.detach())).sum(1, keepdim=True)
