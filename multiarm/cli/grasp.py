"""``multiarm grasp``: design a form-closure grasp, and judge the grasp of a scene.

Bodies are written on the command line as ``box:1.2,0.8,0.6``, ``prism:6,0.3,0.8`` or a mesh file.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import RenderableType
from rich.text import Text

from multiarm.cli.files import check_targets, scene_to_run, write_json
from multiarm.cli.holding import carrying_rows, overload_warnings
from multiarm.cli.options import JsonFile, NoCode, SceneFile, file_option, option
from multiarm.errors import GraspError, MultiarmError
from multiarm.notation import count_of, number, numbers
from multiarm.results.files import printable, save_figure, write_text
from multiarm.terminal.console import (
    columns,
    facts,
    messages,
    output,
    print_warnings,
    print_written,
)
from multiarm.terminal.progress import Progress

if TYPE_CHECKING:
    from multiarm.grasp.body.polyhedron import Polyhedron
    from multiarm.grasp.grasp import Grasp
    from multiarm.grasp.scenes.judging import ContactFacts, GraspJudgement
    from multiarm.scene import Scene
    from multiarm.simulation.holding import Carrying


# Reach of an optimised gripper around its corner, in sizes of the body.
USUAL_SIZE = 0.2
# So many further grasps are tried where arms do not reach the first.
FURTHER = 4
SEARCHED = "the arms do not reach the grasp that a construction gives, or that was found first"
# Cosine of the tilt of an object that stands upright.
UPRIGHT = 1.0 - 1e-9
GRIPPERS, SCENE, RESULTS = "Grippers", "The scene", "Results"

grasp_app = typer.Typer(
    no_args_is_help=True,
    help="Form-closure grasps: design one for a body, or judge the grasp in a scene.",
)


class Objective(str, Enum):
    """The quantity that an optimised grasp maximises."""

    margin = "margin"


@grasp_app.command("design")
def design(
    context: typer.Context,
    body: Annotated[
        str,
        typer.Argument(
            help=f"{', '.join(form for form, *_ in FORMS.values())} (lengths in m), or an STL or "
            "OBJ file.",
            metavar="BODY",
        ),
    ],
    arms: Annotated[
        tuple[str, str],
        option("The robots that carry the two grippers.", "ROBOT ROBOT", panel=SCENE),
    ] = ("panda", "panda"),
    scale: Annotated[float, option("Metres per unit of a mesh file.", "X")] = 1.0,
    offset: Annotated[
        float | None,
        option(
            "Distance of the contacts from the edges of a block, in m.",
            "A",
            default="0.15 of the shortest edge",
            panel=GRIPPERS,
        ),
    ] = None,
    gripper_size: Annotated[
        float | None,
        option(
            "Largest distance between two contacts of a gripper, in m; with --optimise, of "
            "a contact from its corner.",
            "D",
            default="as it comes; 0.2 of the body with --optimise",
            panel=GRIPPERS,
        ),
    ] = None,
    optimise: Annotated[
        Objective | None,
        option(
            "Search for the best placements: the largest margin; says how far from the best it "
            "may be.",
            default="a construction of the thesis",
            panel=GRIPPERS,
        ),
    ] = None,
    gap: Annotated[
        float,
        option(
            "The search ends when value and bound are this close, as a part of the bound.",
            panel=GRIPPERS,
        ),
    ] = 0.05,
    tip_radius: Annotated[float, option("Of the fingertips, in m.", "R", panel=GRIPPERS)] = 0.01,
    mass: Annotated[float, option("Of the body, in kg.", "KG", panel=SCENE)] = 1.0,
    height: Annotated[
        float | None,
        option(
            "Of the body's centre at the start, in m.",
            "Z",
            default="where the arms reach best",
            panel=SCENE,
        ),
    ] = None,
    duration: Annotated[float, option("Of the run, in s.", "S", panel=SCENE)] = 10.0,
    seed: Annotated[int, option("Of the search for postures.", panel=SCENE, min=0)] = 0,
    out: Annotated[
        Path | None,
        option("Write the scene here.", "FILE.yaml", default="standard output", panel=RESULTS),
    ] = None,
    plot: Annotated[
        Path | None,
        option("A picture of the grasp: PNG, SVG or PDF.", "FILE", default="none", panel=RESULTS),
    ] = None,
) -> None:
    """Design a grasp of a body by two small grippers, and write a scene that runs.

    The contacts have no friction, and hold the body fully. The scene has hands of rigid fingers on
    real arms, postures, a path, and a control that squeezes: run it with multiarm run.

        multiarm grasp design box:1.2,0.8,0.6 > block.yaml
    """
    check_targets({"--out": out, "--plot": plot})
    from multiarm.scene import dump_scene

    solid = body_of_text(body, scale)
    grasp, scene = _first_in_reach(
        _designs(solid, offset, gripper_size, optimise, gap, tip_radius, seed),
        arms,
        mass=mass,
        tip_radius=tip_radius,
        height=height,
        duration=duration,
        seed=seed,
        mesh=_mesh_file(solid, out, body),
        name=f"{_who(arms)} hold {body} by two corners",
        progress=True,
    )
    comments = "".join(f"# {line}\n" for line in (_command_line(context, body), *grasp.notes))
    text = comments + dump_scene(scene)
    rows = design_facts(grasp)
    if scene.one_object("a grasp").pose.matrix()[2, 2] < UPRIGHT:
        rows["object"] = "turned at the start: upright, the arms do not reach it"
    squeeze = number(getattr(scene.control, "squeeze", None), "N")
    rows["squeeze"] = f"{squeeze} in the mean, so that no contact opens"
    carrying = _carrying(scene)
    rows |= carrying_rows(carrying)
    messages().print(facts("Grasp", rows))
    print_warnings(overload_warnings(carrying))
    if plot is not None:
        _draw(grasp, plot)
    if out is None:
        typer.echo(printable(text), nl=False)
        return
    write_text(out, text, "--out")
    print_written("scene", out)


@grasp_app.command("check")
def check(
    scene: SceneFile,
    json: JsonFile = None,
    plot: Annotated[
        Path | None,
        file_option(
            "A picture of the contacts and their regions: PNG, SVG or PDF; for objects with "
            "plane faces."
        ),
    ] = None,
    no_code: NoCode = False,
) -> None:
    """Judge the grasp of any scene: do the contacts hold the object, and how well?

    The question is whether the object can move while the arms hold still. Contacts that only push
    count as such; those of a weld or a hinge hold both ways.

    The exit code is 0 whatever the verdict. The JSON has the fields of
    multiarm.grasp.scenes.judging.GraspJudgement; numbers are finite, or null where there is none.
    """
    check_targets({"--json": json, "--plot": plot}, source=scene)
    loaded = scene_to_run(scene, no_code)
    from multiarm.assembly.compilation import compile_system
    from multiarm.grasp.scenes.judging import judge_grasp, read_grasp

    with Progress() as progress:
        system = compile_system(loaded)
        scene_grasp = read_grasp(system)
        judgement = judge_grasp(system, scene_grasp, progress)
    if json is not None:
        write_json(json, judgement.as_dict())
    console = output()
    for table in judgement_tables(judgement):
        console.print(table)
    print_warnings(overload_warnings(judgement.carrying))
    if plot is not None:
        _draw(scene_grasp.as_grasp(), plot)
        print_written("picture", plot)


def _command_line(context: typer.Context, body: str) -> str:
    """The command that designs this grasp again: the options that were used, but for files."""
    words = ["multiarm", "grasp", "design", body]
    for name, value in context.params.items():
        source = context.get_parameter_source(name)
        if name in ("body", "out", "plot") or source is None or source.name != "COMMANDLINE":
            continue
        parts = value if isinstance(value, tuple) else (value,)
        words += [f"--{name.replace('_', '-')}", *(_word(part) for part in parts)]
    return shlex.join(words)


def _word(value: object) -> str:
    if isinstance(value, Enum):
        return str(value.value)
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def _first_in_reach(
    grasps: Iterable[Grasp], arms: tuple[str, str], **options: Any
) -> tuple[Grasp, Scene]:
    """The first of the grasps that the arms reach, and its scene.

    Raises
    ------
    GraspError
        They reach none; the reason for the last.
    """
    from multiarm.grasp.scenes import UnreachableError

    faults = []
    for grasp in grasps:
        try:
            return grasp, grasp.to_scene(arms, **options)
        except UnreachableError as error:
            faults.append(str(error))
    tried = f"of {len(faults)} grasps none can be reached; the last: " if len(faults) > 1 else ""
    raise GraspError(tried + faults[-1])


def _designs(
    body: Any,
    offset: float | None,
    gripper_size: float | None,
    optimise: Objective | None,
    gap: float,
    tip_radius: float,
    seed: int,
) -> Iterator[Grasp]:
    """The grasp as asked for, and others that serve where arms do not reach this one."""
    import numpy as np

    from multiarm.grasp import design_grasp, optimise_grasp, search_grasp

    rng = np.random.default_rng(seed)
    if optimise is None:
        yield design_grasp(
            body, offset=offset, gripper_size=gripper_size, generator=rng, progress=True
        )
        if offset is None and gripper_size is None:
            for _ in range(FURTHER):
                yield search_grasp(body, rng).noted(SEARCHED)
        return
    if offset is not None:
        raise MultiarmError("--offset belongs to the construction for blocks, not to --optimise")
    for _ in range(1 + FURTHER):
        best = optimise_grasp(
            body,
            gripper_size=gripper_size or USUAL_SIZE * body.size,
            tip_radius=tip_radius,
            gap=gap,
            progress=True,
            rng=rng,
        )
        yield best.grasp.noted(best.message)


def _carrying(scene: Scene) -> Carrying | None:
    from multiarm.assembly.compilation import compile_system
    from multiarm.events.evaluation import evaluate
    from multiarm.simulation.holding import carrying_capacity

    system = compile_system(scene)
    return carrying_capacity(system, evaluate(system))


def _mesh_file(solid: Any, out: Path | None, body: str) -> Path | None:
    """The file of the object's mesh, next to the scene, for a body that is not convex."""
    if solid.convex:
        return None
    if out is None:
        raise MultiarmError(
            "the body is not convex, so that its scene needs a mesh file: name the scene with "
            "--out, and the mesh is written next to it"
        )
    mesh = out.with_suffix(".stl")
    if mesh.expanduser().resolve() == Path(body).expanduser().resolve():
        raise MultiarmError(
            f"--out: the object's mesh, next to the scene, would replace '{body}'; give the scene "
            "another name"
        )
    return mesh


def _who(arms: tuple[str, str]) -> str:
    return f"two {arms[0]} arms" if arms[0] == arms[1] else f"{arms[0]} and {arms[1]}"


def _draw(grasp: Grasp, path: Path) -> None:
    from multiarm.plots.grasp_figures import draw_grasp

    save_figure(draw_grasp(grasp), path)


def design_facts(grasp: Grasp) -> dict[str, RenderableType]:
    """The facts of a designed grasp."""
    closure = grasp.closure
    rows: dict[str, RenderableType] = {
        "body": f"{count_of(len(grasp.body.faces), 'face')}, size {number(grasp.body.size, 'm')}",
        "verdict": _verdict(bool(closure), closure.message),
        "margin": f"{number(closure.margin)} (of 1, shared by {len(grasp.contacts)} contacts)",
    }
    for gripper in grasp.grippers:
        names = ", ".join(
            f"{grasp.contacts.names[j]} on {grasp.body.faces[grasp.faces[j]].name}"
            for j in gripper.contacts
        )
        size = number(grasp.gripper_size(gripper.name), "m")
        rows[gripper.name] = f"{names}; {size} across"
    for k, note in enumerate(grasp.notes):
        rows["notes" if k == 0 else " " * k] = note
    return rows


def judgement_tables(judgement: GraspJudgement) -> list[RenderableType]:
    """The contacts of a scene's grasp, and its properties."""
    table = columns(
        "Contacts, in the object's frame, at the start; numbers are those of the picture",
        ("no.", "arm", "contact", "face", "at, m", "force", "may slide by", "share"),
        [
            (str(place), *_contact(contact, judgement))
            for place, contact in enumerate(judgement.contacts, 1)
            if not contact.pulls
        ],
    )
    table.padding, table.pad_edge = (0, 1, 0, 0), False
    return [table, facts("Grasp", _grasp_facts(judgement))]


def _contact(contact: ContactFacts, judgement: GraspJudgement) -> tuple[RenderableType, ...]:
    pulled = contact.force < 0.0 and judgement.only_pushes
    force = Text(number(contact.force, "N"), "yellow" if pulled else "")
    return (
        contact.arm,
        contact.name.removeprefix(f"{contact.arm}/"),
        contact.face or "-",
        numbers(contact.point, digits=3),
        force,
        number(contact.room, "m") if contact.room is not None else "-",
        number(contact.coefficient),
    )


def _grasp_facts(judgement: GraspJudgement) -> dict[str, RenderableType]:
    rows: dict[str, RenderableType] = {
        "verdict": _verdict(judgement.closed, judgement.verdict),
        "contacts": "all can only push"
        if judgement.only_pushes
        else "some hold both ways, as joints do",
    }
    if judgement.borderline:
        rows["borderline"] = Text("roundings decide; move the contacts apart", "yellow")
    if judgement.left_out:
        rows["left out"] = f"no contacts in points: {', '.join(judgement.left_out)}"
    if judgement.closed:
        rows["margin"] = f"smallest share {number(judgement.margin)} of 1 at best"
    elif judgement.immobility_order == 2:
        rows["to second order"] = "held, by what turning does to the flat faces"
    if judgement.carrying_force is not None:
        rows["weight"] = f"carried with at most {number(judgement.carrying_force, 'N')} a contact"
    rows |= carrying_rows(judgement.carrying)
    stability = judgement.stability
    if stability is not None:
        if stability.closure_radius is not None:
            rows["all may slide by"] = (
                f"{number(stability.closure_radius, 'm')} at once, in any direction"
            )
        rows["six independent"] = (
            f"{', '.join(stability.six)}; they stay so within "
            f"{number(stability.independence_limit, 'm')}"
        )
    if judgement.frame_position is not None and judgement.frame_rotation is not None:
        rows["object's frame"] = (
            f"from contact points known to 0.1 mm: within "
            f"{number(1e3 * judgement.frame_position)} mm and "
            f"{number(1e3 * judgement.frame_rotation)} mrad (standard deviations)"
        )
    return rows


def _verdict(closed: bool, words: str) -> Text:
    return Text(words, "bold green" if closed else "bold yellow")


# Kind -> (how it is written, with how many numbers at least and at most).
FORMS: dict[str, tuple[str, int, int]] = {
    "box": ("box:LX,LY,LZ", 3, 3),
    "wedge": ("wedge:LX,LY,LZ[,TOP]", 3, 4),
    "prism": ("prism:SIDES,RADIUS,HEIGHT", 3, 3),
    "pyramid": ("pyramid:SIDES,RADIUS,HEIGHT", 3, 3),
}
MESHES = (".stl", ".obj")
MOST_SIDES = 1000
LONGEST = 1e6  # [m]


def body_of_text(text: str, scale: float = 1.0) -> Polyhedron:
    """The body of a text: numbers in metres, or a mesh file times ``scale``.

    Raises
    ------
    MultiarmError
        The text has none of the forms, which the message lists.
    GraspError
        The numbers make no body; the mesh is not closed.
    """
    if not 0.0 < scale < math.inf:
        raise MultiarmError(f"--scale: must be metres per unit, greater than 0, got {scale}")
    if Path(text).suffix.lower() in MESHES:
        from multiarm.grasp.body.polyhedron import Polyhedron

        return Polyhedron.mesh(Path(text).expanduser(), scale)
    kind, _, numbers = text.partition(":")
    if kind not in FORMS:
        raise _unknown(text)
    _, least, most = FORMS[kind]
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        raise _unknown(text) from None
    lengths = values[1:] if kind in ("prism", "pyramid") else values  # without their sides
    if not least <= len(values) <= most or not all(abs(length) <= LONGEST for length in lengths):
        raise _unknown(text)
    return _built(kind, values)


def _unknown(text: str) -> MultiarmError:
    forms = ", ".join(form for form, *_ in FORMS.values())
    return MultiarmError(
        f"'{text}' is no body; write {forms} (lengths in metres), or name an STL or OBJ file"
    )


def _built(kind: str, values: list[float]) -> Polyhedron:
    from multiarm.grasp.body.polyhedron import Polyhedron

    if kind == "box":
        return Polyhedron.box(values)
    if kind == "wedge":
        return Polyhedron.wedge(values[:3], *values[3:])
    if kind == "prism":
        return Polyhedron.prism(_regular(values[0], values[1]), values[2])
    return Polyhedron.pyramid(_regular(values[0], values[1]), [0.0, 0.0, values[2]])


def _regular(sides: float, radius: float) -> list[list[float]]:
    """Corners of a regular polygon."""
    if not 3 <= sides <= MOST_SIDES or sides != int(sides):
        raise MultiarmError(f"a polygon has 3 to {MOST_SIDES} sides, not {sides:g}")
    if radius <= 0.0:
        raise MultiarmError(f"the radius of a polygon is greater than 0, not {radius:g}")
    turns = [2.0 * math.pi * k / int(sides) for k in range(int(sides))]
    return [[radius * math.cos(turn), radius * math.sin(turn)] for turn in turns]
