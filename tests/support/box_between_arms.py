"""Scenes with joints that hold for some of the time: two plain arms and a box between them."""

from __future__ import annotations

from typing import Any

from event_scenes import arm, box
from mechanics import G

NEAR = """
def near(t, state):
    return 0.05 - t
"""


def two_arms(effects=None, control="gravity_compensation", right=None, **joint: Any) -> dict:
    """A box that the left arm holds; the right arm's joint has further keys, such as times.

    Both arms slide along x, y, z and turn about these; ``right`` are keys of the right one.
    """
    arms = {"left": arm("xyzXYZ"), "right": {**arm("xyzXYZ"), **(right or {})}}
    return {
        "gravity": list(G),
        "object": box(),
        "arms": arms,
        "joints": [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "weld", **joint}],
        "control": control,
        "effects": {"joint_damping": 1.0, **(effects or {})},
    }


def from_(begin: Any) -> dict[str, Any]:
    """The key ``from`` of a joint, a word of Python."""
    return {"from": begin}
