"""Draw a film: the Meshcat commands that show it in any Meshcat viewer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multiarm.viewer import camera, commands
from multiarm.viewer.commands import Command
from multiarm.viewer.film import Body, Film, continuous
from multiarm.viewer.flashes import draw_flashes
from multiarm.viewer.hinges import Hinges
from multiarm.viewer.marks import HAIR, Marks
from multiarm.viewer.mesh import ShadedMesh, shade, sharp_edges
from multiarm.viewer.script import Script
from multiarm.viewer.studio import furnish

FAINT = 0.3  # of a surface's opacity, while nothing touches it
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
    time = (film.time - film.time[0]) / speed
    flashes = [replace(m, time=(m.time - film.time[0]) / speed) for m in film.moments]
    draw_flashes(flashes, time, film.size(), script)
    return script.finished(time)


def _draw_body(body: Body, shape: ShadedMesh, layer: int, script: Script) -> None:
    if body.touched is None or body.touched.all():
        _put_shape(body.name, body, shape, layer, 1.0, script)
        script.move(body.name, body.position, continuous(body.quaternion_xyzw))
        return
    script.move(body.name, body.position, continuous(body.quaternion_xyzw))
    for name, strength, seen in (("touched", 1.0, body.touched), ("open", FAINT, ~body.touched)):
        if seen.any():
            path = f"{body.name}/{name}"
            _put_shape(path, body, shape, layer, strength, script)
            script.set(path, "scale", np.where(seen, 1.0, HAIR)[:, None] * np.ones(3))


def _put_shape(
    path: str, body: Body, shape: ShadedMesh, layer: int, strength: float, script: Script
) -> None:
    opacity = strength * body.opacity
    material = commands.shiny(1 - TINT * (1 - body.color), opacity, layer)
    script.put(path, commands.mesh_object(shape, material))
    if opacity < 1:  # glass needs its outline
        ends = sharp_edges(body.mesh).reshape(-1, 3)
        rgba = np.tile(np.append(0.45 * body.color, 0.9 * strength), (len(ends), 1))
        script.put(f"{path}/edges", commands.line_object(ends, rgba))
