"""What a step from outside costs: the loop in compiled code, and Python around it.

    python tests/support/time_stepper.py [--steps 200]

Two UR5s hold a box still and are advanced by a millisecond at a time.  The medians of the calls of
`Stepper.advance` are printed, and those of the calls of the compiled loop within them.
"""

from __future__ import annotations

import argparse
import statistics
import time

from repository import SCENES

import multiarm as ma
from multiarm.simulation import driver

SCENE = SCENES / "two_ur5_box.yaml"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--steps", type=int, default=2000)
    steps = options.parse_args().steps
    scene = ma.load_scene(SCENE)
    system = ma.compile_system(scene.replace(control="gravity_compensation"), arms="compiled")
    torques = dict(ma.evaluate(system).joint_torques)
    loop, in_loop = driver.advance, []

    def timed(*arguments):
        begin = time.perf_counter()
        reason = loop(*arguments)
        in_loop.append(time.perf_counter() - begin)
        return reason

    print("microseconds   whole   loop   Python")
    for name, record in (("not recorded", False), ("recorded", True)):
        stepper = ma.Stepper(system, record=record, output_step=1e-3)
        for _ in range(50):  # compiles, and warms up
            stepper.advance(1e-3, torques)
        driver.advance = timed
        rows = []
        for _ in range(steps):
            in_loop.clear()
            begin = time.perf_counter()
            stepper.advance(1e-3, torques)
            whole = time.perf_counter() - begin
            rows.append((whole, sum(in_loop), whole - sum(in_loop)))
        driver.advance = loop
        whole, inside, python = (1e6 * statistics.median(own) for own in zip(*rows, strict=True))
        print(f"{name:12} {whole:7.1f} {inside:6.1f} {python:8.1f}")


if __name__ == "__main__":
    main()
