"""Draw a film: the Meshcat commands that show it in any Meshcat viewer."""

from __future__ import annotations

import numpy as np

from multiarm.viewer import camera, commands
from multiarm.viewer.commands import Command
from multiarm.viewer.film import Body, Film, continuous
from multiarm.viewer.hinges import Hinges
from multiarm.viewer.marks import Marks
from multiarm.viewer.mesh import ShadedMesh, shade, sharp_edges
from multiarm.viewer.script import Script
from multiarm.viewer.studio import furnish

TINT = 0.8  # of a body's own colour; the rest is light, which keeps dark parts readable
LAYERS = 32  # more would shift depths visibly


def draw(film: Film, speed: float = 1.0) -> list[Command]:
    """Return the commands that show a film.

    Everything in the world hangs below the node ``/world``, where poses are those of the film.

    Parameters
    ----------
    film : Film
    speed : float
        Seconds of the film per second of the viewer.
    """
    script, points = Script(), film.extent()
    marks, hinges = Marks(film, film.size()), Hinges(film, film.size())
    reach = [hinges.points(hinge) for hinge in film.hinges]
    view = camera.frame(np.concatenate([points, film.tails(marks.longest), *reach]))
    furnish(script, view, points, film.floor)
    shapes = {id(body.mesh): body.mesh for body in film.bodies}  # arms of a kind share meshes
    shaded = {key: shade(mesh) for key, mesh in shapes.items()}
    for i, body in enumerate(film.bodies):
        _draw_body(body, shaded[id(body.mesh)], i % LAYERS, script)
    for contacts in film.contacts:
        marks.draw(contacts, script)
    for hinge in film.hinges:
        hinges.draw(hinge, script)
    return script.finished((film.time - film.time[0]) / speed)


def _draw_body(body: Body, shape: ShadedMesh, layer: int, script: Script) -> None:
    material = commands.shiny(1 - TINT * (1 - body.color), body.opacity, layer)
    script.put(body.name, commands.mesh_object(shape, material))
    script.move(body.name, body.position, continuous(body.quaternion_xyzw))
    if body.opacity < 1:  # glass needs its outline
        ends = sharp_edges(body.mesh).reshape(-1, 3)
        rgba = np.tile(np.append(0.45 * body.color, 0.9), (len(ends), 1))
        script.put(f"{body.name}/edges", commands.line_object(ends, rgba))
