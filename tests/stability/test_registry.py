"""Every stability case is claimed by a test, by its id, and no test claims an unknown one."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent

CASES = {
    "E1": "one Gaussian of any length and thinness",
    "E2": "stiff scenes",
    "E3": "closed forms: sphere, dot, disk on edge",
    "E4": "the near plane",
    "E5": "many layers",
    "E6": "opacity 0 and 1",
    "E7": "equal depths",
    "E8": "alphas at the cut",
    "E9": "threads, repeats, tiles",
    "E10": "bounded memory",
    "E11": "sizes of pictures, no Gaussians",
    "E12": "numbers that are none, in each field",
    "E13": "everything as the background",
    "E14": "lenses of unequal focal lengths, far principal points",
    "E15": "exact skips by tile, row and block",
    "E16": "permuted Gaussians",
    "E17": "rigid motion of the world",
    "E18": "units",
    "E19": "far from the origin",
    "R1": "tied logits",
    "R2": "nearly tied logits",
    "R3": "huge logits, any temperature",
    "R4": "mixing weights",
    "R5": "sparse against dense experts, order, empties",
    "P1": "depth of a wall",
    "P2": "no parallax",
    "P3": "depth ranges and numbers of planes",
    "P4": "points behind, extreme positions, pictures of one pixel",
    "P5": "matrices that are no rotation",
    "P6": "relative poses far from the origin",
    "P7": "lenses of 1:100",
    "P8": "plain and noisy pictures",
    "P9": "sizes, crops, pixels there and back",
    "P10": "depth candidates",
    "P11": "cost volume and evidence",
    "A1": "quaternions of any length",
    "A2": "scales of any logit",
    "A3": "turned harmonics",
    "A4": "rotation of a camera as a quaternion",
    "I1": "extreme numbers in a .ply",
    "I2": "broken .ply files",
    "B1": "both runtimes agree",
    "B2": "fewer bits",
    "S1": "the bound of leaving out",
    "S2": "exact skips",
}


def claims() -> list[tuple[str, str]]:
    """(id, test) of every `case` marker in the sources of all tests, without importing them."""
    found = []
    for path in sorted(ROOT.rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for mark in getattr(node, "decorator_list", []):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.case":
                    assert mark.args, f"{path.name}: a case marker names no case"
                    found += [(ast.literal_eval(value), f"{path.name}::{node.name}") for value in mark.args]
    return found


def test_every_case_is_claimed_and_none_is_misspelt() -> None:
    claimed = claims()
    assert sorted({case for case, _ in claimed} - CASES.keys()) == []
    assert sorted(CASES.keys() - {case for case, _ in claimed}) == []


def test_no_test_claims_a_case_twice() -> None:
    claimed = claims()
    assert sorted({claim for claim in claimed if claimed.count(claim) > 1}) == []
