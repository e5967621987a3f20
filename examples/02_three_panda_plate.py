"""Three Panda arms tilt a round plate that they hold by ball joints.

Seven joints an arm and three constraints each: the closed chains keep 18 degrees of freedom.  The
same run is repeated at three accuracies, to show what each costs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma

SCENE = Path(__file__).parent / "scenes" / "three_panda_plate.yaml"
ACCURACIES = (1e-3, 1e-5, 1e-7)


def main() -> None:
    """Simulate at three accuracies and compare the end of the plate's path."""
    system = ma.compile_system(ma.load_scene(SCENE))
    for accuracy in ACCURACIES:  # compiles what is not compiled yet
        ma.simulate(system, duration=2.0, accuracy=accuracy)
    finest = ma.simulate(system, duration=2.0, accuracy=1e-10)
    print("accuracy   evaluations   wall time   distance from the finest run")
    for accuracy in ACCURACIES:
        run = ma.simulate(system, duration=2.0, accuracy=accuracy)
        distance = np.max(np.abs(run.object_position - finest.object_position))
        print(
            f"{accuracy:8.0e} {run.statistics['evaluations']:13d} "
            f"{run.statistics['wall_time_s']:9.3f} s {distance:14.1e} m"
        )


if __name__ == "__main__":
    main()
