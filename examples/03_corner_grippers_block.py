"""Two arms hold a block at opposite corners with four frictionless fingertips each.

The eight contacts enclose the block; none of them pulls as long as the squeeze is large enough.
Here they are bilateral, so the sign of each force tells which fingertips would let go.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "corner_grippers_block.yaml"


def main() -> None:
    """Simulate, and tell for every fingertip how hard it pushes or pulls."""
    system = ma.compile_system(ma.load_scene(SCENE))
    trajectory = ma.simulate(system)
    print(f"{trajectory.status}: {trajectory.message}")
    for arm, forces in trajectory.contact_forces.items():
        for contact, force in zip(system.contacts[arm], forces.T, strict=True):
            print(f"{arm:6s} {contact.name:24s} {np.min(force):8.1f} N to {np.max(force):8.1f} N")
    print(f"largest gap {trajectory.position_drift.max():.1e} m over {trajectory.time[-1]:g} s")


if __name__ == "__main__":
    main()
