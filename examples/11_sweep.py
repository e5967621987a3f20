"""A scene run many times on all cores: what mass, damping and a grip that is off do to the box.

The sweep is stopped half way, on purpose, and goes on where it was: rows that are in its folder are
there for good.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import multiarm as ma

HERE = Path(__file__).parent
SCENE = HERE / "scenes" / "two_ur5_box.yaml"
OVER = HERE / "sweeps" / "mass_and_grip.yaml"


def end_half_way(done: int, count: int, failed: int) -> None:
    """A progress that acts as if Ctrl-C was pressed."""
    if done >= count // 2:
        raise KeyboardInterrupt


def main() -> None:
    """Run the sweep in two parts, tell what came out, and look at one run again."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--plot", type=Path, help="write a picture here")
    asked = options.parse_args()
    scene = ma.load_scene(SCENE)
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run.sweep"
        first = ma.sweep(scene, OVER, out=out, progress=end_half_way)
        print(f"ended half way: {len(first) < first.count}")
        sweep = ma.sweep(scene, OVER, out=out)
        print(f"{len(sweep)} of {sweep.count} runs: {sweep.status_counts}")
        table = sweep.table
        for mass, runs in table.groupby("object.mass"):
            force, error = (
                runs["largest_contact_force"].max(),
                runs["final_position_error"].median(),
            )
            print(
                f"{mass:4.0f} kg: contact forces up to {force:5.1f} N, "
                f"off its path by {1e3 * error:.2f} mm at the end"
            )
        worst = int(table["run"][table["final_position_error"].argmax()])
        again = sweep.trajectory(worst)
        print(f"run {worst} once more: {again.status}")
        if asked.plot is not None:
            from multiarm.plots.sweep_figures import sweep_overview

            sweep_overview(sweep).savefig(asked.plot, dpi=150)


if __name__ == "__main__":
    main()
