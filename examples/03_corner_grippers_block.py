"""Two arms hold a block at opposite corners with four frictionless fingertips each.

The eight contacts enclose the block.  Real fingertips only push: the scene's control squeezes so
much that the smallest of all forces stays above zero.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "corner_grippers_block.yaml"


def main() -> None:
    """Simulate, and tell for every fingertip how hard it pushes."""
    system = ma.compile_system(ma.load_scene(SCENE))
    trajectory = ma.simulate(system)
    print(f"{trajectory.status}: {trajectory.message}")
    for arm, forces in trajectory.contact_forces.items():
        for contact, force in zip(system.contacts[arm], forces.T, strict=True):
            print(f"{arm:6s} {contact.name:24s} {np.min(force):8.1f} N to {np.max(force):8.1f} N")
    least = min(np.min(forces) for forces in trajectory.contact_forces.values())
    print(f"all fingertips push with {least:.1f} N or more")
    print(f"largest gap {trajectory.position_drift.max():.1e} m over {trajectory.time[-1]:g} s")


if __name__ == "__main__":
    main()
