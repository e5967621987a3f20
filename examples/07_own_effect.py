"""An effect of one's own: a magnet that pulls the object, first in Python, then compiled.

Both classes have the same parameters and the same equation. The first one is called back at every
evaluation; the second one is a kernel, which costs what its arithmetic costs. A package offers its
effects to every scene by an entry point, as the small one in the folder own_effect does:

    [project.entry-points."multiarm.effects"]
    magnet = "magnet_effect:Magnet"

and a script registers them while it runs, as is done here.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import multiarm as ma

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "own_effect"))

from magnet_effect import CompiledMagnet, Magnet  # noqa: E402 (found in the folder above)

MAGNET = {"at": [0.1, 0.0, 0.6], "strength": 0.1}


def compare(scene: ma.Scene) -> None:
    """Run the scene without a magnet, and with each of the two."""
    free = ma.simulate(ma.compile_system(scene))
    for name in ("magnet", "compiled_magnet"):
        run = ma.simulate(ma.compile_system(scene.replace(effects={name: MAGNET})))
        moved = np.linalg.norm(run.object_position - free.object_position, axis=1).max()
        work = run.channel(f"effects/{name}/work")
        print(
            f"{name}: {run.status}, moves the object by {1e3 * moved:.3f} mm, does "
            f"{1e3 * work[-1]:.3f} mJ of work, energy is balanced to "
            f"{np.abs(run.energy_balance).max():.0e} J"
        )


def refuse(scene: ma.Scene) -> None:
    """Faults in the parameters are told at their place."""
    try:
        scene.replace(effects={"magnet": {"at": [0.1, 0.0], "strenght": 0.5}})
    except ma.MultiarmError as error:
        print(error)


def main() -> None:
    """Register both effects, and print what they do."""
    ma.register_effect(Magnet)
    ma.register_effect(CompiledMagnet)
    scene = ma.load_scene(HERE / "scenes" / "ring_weld.yaml")
    compare(scene)
    refuse(scene)


if __name__ == "__main__":
    main()
