r"""Which faces seven fingertips of two grippers may touch, if the contacts are to close.

A choice is a multiset of regions for each gripper. It can close only if the normals span space
positively, which needs on both sides of every plane through two of them another one; and no more
than three normals are parallel (thesis, 2.2.1: of seven contacts that close any six are
independent).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, permutations

import numpy as np

from multiarm.grasp.touch_regions import TouchRegion

# Normals are parallel, or lie on a plane, within this.
PARALLEL = 1e-9
# Most normals that may be parallel, either sense.
MOST_PARALLEL = 3


@dataclass(frozen=True)
class FaceChoice:
    """Regions of seven fingertips, those of the first gripper in front.

    Attributes
    ----------
    places : tuple of int
        Where the two grippers sit.
    regions : tuple of TouchRegion
    """

    places: tuple[int, int]
    regions: tuple[TouchRegion, ...]


def face_choices(
    regions: Sequence[Sequence[TouchRegion]], fingers: tuple[int, int]
) -> Iterator[FaceChoice]:
    """All choices that may close, in a fixed order."""
    spanning: dict[frozenset[int], bool] = {}
    for a, b in permutations(range(len(regions)), 2):
        everything = [*regions[a], *regions[b]]
        if not _spans(everything, spanning):
            continue
        second = list(combinations_with_replacement(regions[b], fingers[1]))
        for first in combinations_with_replacement(regions[a], fingers[0]):
            for other in second:
                chosen = (*first, *other)
                if _spans(chosen, spanning) and _few_parallel(chosen):
                    yield FaceChoice((a, b), chosen)


def positively_spanning(normals: np.ndarray) -> bool:
    """Whether nonnegative combinations of normals (K, 3) fill space.

    They do not if and only if all lie on one side of a plane through the origin; if they span
    space, through two of them.
    """
    if len(normals) < 4 or np.linalg.svd(normals, compute_uv=False)[2] <= PARALLEL:
        return False
    i, j = np.array(list(combinations(range(len(normals)), 2))).T
    across = np.cross(normals[i], normals[j])
    length = np.linalg.norm(across, axis=1)
    across = across[length > PARALLEL] / length[length > PARALLEL, None]
    height = across @ normals.T
    return bool(np.all(height.max(axis=1) > PARALLEL) and np.all(height.min(axis=1) < -PARALLEL))


def _spans(chosen: Sequence[TouchRegion], known: dict[frozenset[int], bool]) -> bool:
    faces = frozenset(region.face for region in chosen)
    if faces not in known:
        one_each = {region.face: region.normal for region in chosen}
        known[faces] = positively_spanning(np.array(list(one_each.values())).reshape(-1, 3))
    return known[faces]


def _few_parallel(chosen: Sequence[TouchRegion]) -> bool:
    e = np.array([region.normal for region in chosen])
    return bool((np.abs(e @ e.T) > 1.0 - PARALLEL).sum(axis=1).max() <= MOST_PARALLEL)
