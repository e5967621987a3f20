"""What accuracy costs: the same motion at several accuracies, a stiff scene, a long faithful run.

Two arms carry a disc and are driven by sinusoidal torques. Every run of some accuracy is checked by
a second one with smaller tolerances; its certificate says what the error is estimated to be.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma

SCENES = Path(__file__).parent / "scenes"


def accuracies(system: ma.System) -> None:
    """Ask for more and more, and see what it takes."""
    for accuracy in (1e-3, 1e-6, 1e-9):
        run = ma.simulate(system, accuracy=accuracy)
        error = run.certificate["estimated_error"]
        verdict = "met" if run.certificate["met"] else "not met"
        print(
            f"asked {accuracy:.0e}: {verdict}, estimated {error['position_m']:.1e} m and "
            f"{error['rotation_rad']:.1e} rad, {run.statistics['integrator']}, "
            f"{run.statistics['evaluations']} evaluations"
        )


def stiff(scene: ma.Scene) -> None:
    """Joints in strong dampers: what is fast dies out, and the steps need not follow it."""
    for damping in (1e2, 1e4, 1e6):
        damped = ma.compile_system(scene.replace(effects={"joint_damping": damping}))
        run = ma.simulate(damped, accuracy=1e-5)
        count = run.statistics
        print(f"damping {damping:.0e}: {count['integrator']}, {count['steps']} steps")


def long_and_faithful(scene: ma.Scene) -> None:
    """Push the arms, in springs: the symplectic method does not lose energy, and gains none."""
    pushed = scene.object.model_copy(update={"twist": (0.3, 0.2, 0.2, 0.0, 0.0, 1.0)})
    springs = {"kind": "joint_pd", "stiffness": 300.0, "damping": 0.0}
    swinging = ma.compile_system(scene.replace(object=pushed, control=springs))
    run = ma.simulate(
        swinging, duration=40.0, integrator="variational", step=2e-3, output_step=0.01
    )
    used = 100.0 * run.limit_use[["effort", "speed", "range"]].max()
    off = run.energy_balance / run.kinetic_energy.max()
    quarter = len(off) // 4
    print(f"{run.statistics['steps']} steps of {1e3 * 2e-3:g} ms: {run.status}")
    print("effort, speed and range: up to {:.0f}, {:.0f}, {:.0f} % of a limit".format(*used))
    print(
        f"mean energy error of the first quarter {np.mean(off[:quarter]):.0e}, "
        f"of the last {np.mean(off[-quarter:]):.0e} of the largest kinetic energy"
    )


def main() -> None:
    """Print what accuracy, stiffness and long times cost."""
    scene = ma.load_scene(SCENES / "ring_weld.yaml")
    accuracies(ma.compile_system(scene))
    stiff(scene)
    long_and_faithful(scene)


if __name__ == "__main__":
    main()
