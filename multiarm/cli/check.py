"""``multiarm check``: inspect a scene before a long run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import check_targets, write_json
from multiarm.cli.holding import carrying_rows, overload_warnings
from multiarm.cli.options import Arms, JsonFile, SceneFile
from multiarm.notation import number, numbers, value_text
from multiarm.terminal.console import (
    accuracy,
    columns,
    facts,
    output,
    print_warnings,
)
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.dynamics.system import StartReport
    from multiarm.simulation.inspection import (
        ArmFacts,
        Freedom,
        Inspection,
        JointFacts,
        ObjectFacts,
        RobotFacts,
        RunFacts,
    )


def check(
    scene: SceneFile,
    arms: Arms = None,
    json: JsonFile = None,
) -> None:
    """Show what a scene compiles to: robots, joints, effects, freedom, and how good its start is.

    All faults of a scene are listed together, each with its place and the alternatives; the exit
    code is then 2. Functions and classes that the scene names are not loaded; what needs them is
    left out. What each effect costs and changes, **multiarm effects** measures.

    The JSON has the keys scene, gravity, object, objects, arms, robots, joints, freedom,
    coming_and_going, effects, control, run, start, position_residual, velocity_residual, residuals,
    carrying, warnings, not_looked_at; their meaning and units are those of
    multiarm.simulation.inspection.Inspection.
    Numbers are finite, or null where there is none.
    """
    check_targets({"--json": json}, source=scene)
    from multiarm.assembly.compilation import compile_for_inspection
    from multiarm.scene import load_scene
    from multiarm.simulation.inspection import inspect_system

    loaded = load_scene(scene)
    print_warnings(loaded.warnings)
    with Progress() as progress:
        system, left = compile_for_inspection(loaded, arms)
        progress(0, 0, "inspecting")
        inspection = inspect_system(system, left)
        print_warnings(system.start_warnings)
    print_warnings(inspection.not_looked_at)
    print_warnings(overload_warnings(inspection.carrying))
    if json is not None:
        write_json(json, inspection.as_dict())
    console = output()
    for table in _tables(inspection):
        console.print(table)


def _tables(inspection: Inspection) -> list[RenderableType]:
    tables = [
        facts(inspection.scene, _general(inspection)),
        *(facts(f"Arm {name}", _arm(arm)) for name, arm in inspection.arms.items()),
        *(facts(f"Robot {name}", _robot(robot)) for name, robot in inspection.robots.items()),
        _joints(inspection),
        facts(
            "Effects",
            {name: value_text(parameters) for name, parameters in inspection.effects.items()}
            or {"none": "only control acts"},
        ),
    ]
    if inspection.freedom is not None:
        tables.append(facts("Freedom", _freedom(inspection.freedom, inspection.coming_and_going)))
    if inspection.start is not None:
        tables.append(facts("Start", _start(inspection, inspection.start)))
    return [*tables, facts("Run", _run(inspection.run))]


def _general(inspection: Inspection) -> dict[str, RenderableType]:
    rows: dict[str, RenderableType] = {
        "gravity": "none" if inspection.gravity is None else numbers(inspection.gravity, "m/s^2")
    }
    if inspection.object is not None:
        rows |= {"object": _body(inspection.object), "inertia": _inertia(inspection.object.inertia)}
    for name, body in inspection.objects.items():
        rows |= {name: _body(body), f"inertia of {name}": _inertia(body.inertia)}
    return {**rows, "control": inspection.control}


def _body(body: ObjectFacts) -> str:
    return f"{body.shape}, {number(body.mass, 'kg')}, at {numbers(body.position, 'm')}"


def _inertia(matrix: list[list[float]]) -> str:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = matrix
    products = f"; xy, xz, yz: {numbers([xy, xz, yz])}" if any((xy, xz, yz)) else ""
    return f"xx, yy, zz: {numbers([xx, yy, zz])}{products} kg m^2"


def _arm(arm: ArmFacts) -> dict[str, RenderableType]:
    """One arm; its joints with their positions at the start."""
    rows: dict[str, RenderableType] = {
        "robot": f"{arm.robot} ({Path(arm.urdf).name})",
        "base": _base(arm),
        "joints": _positions(arm),
        "tip": arm.tip if arm.tool is None else f"{arm.tip}, of the tool {arm.tool}",
        "computed by": _terms(arm),
        "posture": _posture(arm),
    }
    return rows | _not_driven(arm)


def _robot(robot: RobotFacts) -> dict[str, RenderableType]:
    """One robot with tips; its joints with their positions at the start."""
    moves = ", ".join(robot.base_joints)
    base = {
        "floats": "floats",
        "moves": f"moves by {moves}",
        "wheels": f"on wheels, moves by {moves}",
    }
    couplings = ", ".join(
        f"{mimic.joint} = {mimic.multiplier:g} {mimic.leader}"
        + (f" {mimic.offset:+g}" if mimic.offset else "")
        for mimic in robot.mimic
    )
    return {
        "robot": f"{robot.robot} ({Path(robot.urdf).name})",
        "base": f"{_base(robot)}, {base.get(robot.base, robot.base)}",
        "joints": _positions(robot),
        "tips": ", ".join(f"{tip} ({link})" for tip, link in robot.tips.items()) or "none",
        **({"couplings": couplings} if couplings else {}),
        "computed by": _terms(robot),
        "posture": _posture(robot),
        **_not_driven(robot),
    }


def _base(robot: ArmFacts | RobotFacts) -> str:
    from multiarm.scene.values import roll_pitch_yaw, rotation_matrix

    turn = roll_pitch_yaw(rotation_matrix((), robot.base_quaternion_xyzw))
    return f"at {numbers(robot.base_position, 'm')}, rpy {numbers(turn, 'rad')}"


def _positions(robot: ArmFacts | RobotFacts) -> str:
    joints = zip(robot.joints.items(), robot.posture, strict=True)
    texts = [f"{joint} {numbers([position], unit)}" for (joint, unit), position in joints]
    return f"{len(texts)}: {', '.join(texts)}"


def _not_driven(robot: ArmFacts | RobotFacts) -> dict[str, RenderableType]:
    locked = ", ".join(f"{joint} {value:g}" for joint, value in robot.locked.items())
    rows = {"locked": locked, "passive": ", ".join(robot.passive)}
    return {name: text for name, text in rows.items() if text}


def _terms(arm: ArmFacts | RobotFacts) -> Text:
    if arm.terms == "compiled":
        return Text("compiled code, verified against Pinocchio")
    if arm.not_compiled is None:
        return Text("Pinocchio")
    return Text.assemble("Pinocchio: ", (f"not compiled, since {arm.not_compiled}", "yellow"))


def _joints(inspection: Inspection) -> RenderableType:
    """The joints of the scene: by arms where all are between an arm and the object."""
    joints = inspection.joints
    of_arms = all(joint.arm is not None for joint in joints)
    if inspection.object is not None and not inspection.robots and of_arms:
        return columns(
            "Joints to the object (z: the joint's axis or normal)",
            ("arm", "kind", "rows", "free motions", "contacts"),
            [_joint(joint) for joint in joints],
        )
    return columns(
        "Connections (forces act on the second body; z: the joint's axis or normal)",
        ("connection", "kind", "rows", "free motions", "contacts"),
        [(_bodies(joint, len(inspection.objects) < 2), *_joint(joint)[1:]) for joint in joints],
    )


def _bodies(joint: JointFacts, one_object: bool) -> str:
    """Name of a joint in results, and the bodies where the name does not have both."""
    if joint.arm is not None:
        return joint.connection if one_object else f"{joint.connection}-\n{joint.second}"
    if joint.connection == f"{joint.first}-{joint.second}":
        return f"{joint.first}-\n{joint.second}"
    return f"{joint.connection}:\n{joint.first},\n{joint.second}"


def _joint(joint: JointFacts) -> tuple[RenderableType, ...]:
    """One joint by itself; its axes are those of the joint's frame."""
    limited = {limit.coordinate: limit for limit in joint.limits}
    free = [motion for motion in joint.free_motions if motion not in limited]
    for coordinate, limit in limited.items():
        bounds = f"{number(limit.low)} to {number(limit.high, limit.unit)}"
        free.append(f"{coordinate}: {bounds}, starts at {numbers([limit.start])}")
    contacts = Text(", ".join(joint.rows))
    if joint.redundant_rows:
        count = len(joint.rows) - joint.rank
        contacts.append(f"; {count} too many among: {', '.join(joint.redundant_rows)}", "yellow")
    rows = f"{len(joint.rows)}, rank {joint.rank}"
    kind = "\n".join(filter(None, [joint.kind, joint.times.replace(", ", ",\n")]))
    return joint.name or joint.connection, kind, rows, "\n".join(free) or "none", contacts


def _posture(arm: ArmFacts | RobotFacts) -> Text:
    if arm.verdict is None:
        return Text("not judged", "dim")
    good = arm.verdict == "good"
    text = Text(f"{arm.verdict} ({arm.conditioning:.2g})", "green" if good else "bold yellow")
    return text.append("".join(f"; {words}" for words in arm.lost_motions))


def _freedom(freedom: Freedom, loose: list[str]) -> dict[str, RenderableType]:
    smallest, dropped = freedom.smallest_kept, freedom.largest_dropped
    cut = "" if smallest is None else f" (smallest relative singular value {number(smallest)}"
    if cut:
        cut += ")" if dropped is None else f", next {number(dropped)})"
    parts = ["6 of the object" if freedom.objects == 1 else "6 of each object"]
    parts += ["6 of each floating base"] if freedom.floating_bases else []
    others = {"couplings": freedom.couplings, "wheels": freedom.wheels}
    further = "".join(f", {count} of {noun}" for noun, count in others.items() if count)
    of_connections = freedom.constraints - sum(others.values())
    sources = f" ({of_connections} of connections{further})" if further else ""
    rows: dict[str, RenderableType] = {
        "degrees of freedom": f"{freedom.degrees_of_freedom} ({', '.join(parts)}, one a joint)",
        "constraints": f"{freedom.constraints}{sources}, of which {freedom.rank} are independent"
        f"{cut}",
        "mobility": Text(str(freedom.mobility), "bold"),
    }
    if freedom.redundant_rows:
        count = freedom.constraints - freedom.rank
        text = f"{count} too many among: {', '.join(freedom.redundant_rows)}"
        rows["redundant"] = Text(text, "yellow")
    if loose:
        rows["unilateral"] = "\n".join(loose)
    return rows


def _start(inspection: Inspection, start: StartReport) -> dict[str, RenderableType]:
    left = inspection.residuals
    assert left is not None, "a start has been evaluated"
    robots = "robots" if inspection.robots else "arms"
    objects = "objects" if len(inspection.objects) > 1 else "object"
    rows: dict[str, RenderableType] = {
        "gaps as written": _by_arm(start.gaps, "m"),
        "gap rates as written": _by_arm(start.gap_rates, "m/s"),
        "corrections": "\n".join(start.lines()) or "none",
        "left after them": f"gap {number(inspection.position_residual, 'm')}, "
        f"rate {number(inspection.velocity_residual, 'm/s')}",
        "residuals of the equations": f"{robots} {number(left.arm, 'N m')}, {objects} "
        f"{number(left.object, 'N')}, constraints {number(left.constraint, 'm/s^2')}",
    }
    rows |= carrying_rows(inspection.carrying)
    return rows


def _run(run: RunFacts) -> dict[str, RenderableType]:
    if run.step is not None:
        steps = f"fixed step {number(run.step, 's')}"
    else:
        aim = "" if run.accuracy is None else f"accuracy {accuracy(run.accuracy)}, "
        steps = f"{aim}tolerance of a step {number(run.tolerance)}"
    return {
        "duration": f"{run.duration:g} s, a sample every {run.output_step:g} s",
        "integrator": f"{run.integrator}, {steps}",
        "stabilization": run.stabilization,
        "solver": run.solver,
    }


def _by_arm(values: dict[str, float], unit: str) -> str:
    return ", ".join(f"{arm} {number(value, unit)}" for arm, value in values.items())
