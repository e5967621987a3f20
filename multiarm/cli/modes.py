"""``multiarm modes``: the natural motions of a scene about its start or an equilibrium."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.text import Text

from multiarm.cli.files import check_targets, scene_to_run, write_json
from multiarm.cli.options import FILES, JsonFile, NoCode, SceneFile, file_option, option, switch
from multiarm.cli.show import show_replay
from multiarm.notation import number
from multiarm.terminal.console import columns, facts, output, print_warnings

if TYPE_CHECKING:
    from multiarm.linear.linearisation import LinearSystem
    from multiarm.linear.modes import Mode

NOT_AT_REST = 1e-6  # [m/s^2, rad/s^2]


def modes(
    scene: SceneFile,
    time: Annotated[float, option("Time at which control and loads are looked at [s].", "T")] = 0.0,
    equilibrium: Annotated[
        bool, switch("--equilibrium", "First move to the nearest posture that stays at rest.")
    ] = False,
    open_loop: Annotated[
        bool, switch("--open-loop", "Hold the torques of the control as they are.")
    ] = False,
    amplitude: Annotated[
        float, option("Largest displacement in the replay [m, rad].", "A", min=0.0)
    ] = 0.1,
    replay: Annotated[
        bool, switch("--replay", "Show the modes moving, one after another, in the browser.", FILES)
    ] = False,
    replay_html: Annotated[
        Path | None, file_option("Write their motion to one HTML file.", "FILE.html")
    ] = None,
    json: JsonFile = None,
    no_code: NoCode = False,
) -> None:
    """Show the natural motions of a scene: frequencies, damping, what moves, what torques reach.

    The scene is linearised on the motions that its joints allow, about its start at rest, or with
    --equilibrium about a posture that its control holds.

    The JSON has the keys scene, stability, largest_acceleration, states, rate, A, B, inputs and
    modes: eigenvalue_real and eigenvalue_imag [1/s], frequency [Hz], damping_ratio,
    time_constant [s] or null, kind, moving, controllable.
    """
    check_targets({"--replay-html": replay_html, "--json": json}, source=scene)
    loaded = scene_to_run(scene, no_code)
    from multiarm.assembly.compilation import compile_system
    from multiarm.linear.equilibrium import find_equilibrium
    from multiarm.linear.linearisation import linearise

    system = compile_system(loaded)
    state = system.initial_state()
    state.velocity[:] = 0.0
    if equilibrium:
        state = find_equilibrium(system, state, t=time).state
    linear = linearise(system, time, state, closed_loop=not open_loop)
    acceleration = linear.largest_acceleration
    if acceleration > NOT_AT_REST:
        print_warnings(
            [
                f"this posture is no equilibrium: it accelerates by {number(acceleration)} m/s^2 "
                "or rad/s^2, and the modes are those of the linear terms there; --equilibrium "
                "moves to one"
            ]
        )
    if json is not None:
        write_json(json, _as_dict(loaded.name, linear))
    console = output()
    console.print(facts(loaded.name, _general(linear)))
    rows = [_row(k, mode) for k, mode in enumerate(linear.modes, 1)]
    heads = ("", "motion", "frequency", "damping", "time", "moves most")
    console.print(columns("Modes, the slowest first", heads, rows))
    if not replay and replay_html is None:
        return
    from multiarm.linear.modes_trajectory import modes_trajectory

    motion = modes_trajectory(linear, amplitude=amplitude)
    if replay_html is not None:
        show_replay(motion, replay_html)
    if replay:
        show_replay(motion)


def _general(linear: LinearSystem) -> dict[str, Any]:
    p = len(linear.coordinates.positions)
    stable = {"stable": "green", "unstable": "bold red"}.get(linear.stability, "yellow")
    missed = [str(k) for k, mode in enumerate(linear.modes, 1) if not mode.controllable]
    return {
        "coordinates": ", ".join(linear.state_names[:p]) or "none: nothing can move",
        "stability": Text(linear.stability, stable),
        "torques reach": Text(f"all modes but {', '.join(missed)}", "yellow")
        if missed
        else "all modes",
    }


def _row(place: int, mode: Mode) -> tuple[Any, ...]:
    grows = mode.kind in ("grows", "oscillates and grows")
    return (
        str(place),
        Text(mode.kind, "bold red" if grows else ""),
        number(mode.frequency or None, "Hz"),
        number(mode.damping_ratio if mode.frequency else None),
        number(None if math.isinf(mode.time_constant) else mode.time_constant, "s"),
        "\n".join(mode.moving) or "states of effects",
    )


def _as_dict(name: str, linear: LinearSystem) -> dict[str, Any]:
    return {
        "scene": name,
        "stability": linear.stability,
        "largest_acceleration": linear.largest_acceleration,
        "states": linear.state_names,
        "rate": linear.rate.tolist(),
        "A": linear.A.tolist(),
        "B": linear.B.tolist(),
        "inputs": linear.input_names,
        "modes": [
            {
                "eigenvalue_real": mode.eigenvalue.real,
                "eigenvalue_imag": mode.eigenvalue.imag,
                "frequency": mode.frequency,
                "damping_ratio": mode.damping_ratio,
                "time_constant": None if math.isinf(mode.time_constant) else mode.time_constant,
                "kind": mode.kind,
                "moving": mode.moving,
                "controllable": mode.controllable,
            }
            for mode in linear.modes
        ],
    }
