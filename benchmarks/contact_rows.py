"""The cost of one row of W, for every kind of surface and of row.

    python benchmarks/contact_rows.py [--rounds N] [--json FILE]

The timed functions are those that an evaluation calls for the contacts of an arm
(:func:`multiarm.contacts.kernel.write_rows_in_closed_form`, and ``write_row`` for other rows), on
tables of many rows of one kind between two moving bodies, in interleaved bursts of which the
fastest counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import output
import pandas
from matplotlib.figure import Figure
from timing import Burst, fastest, measure

from multiarm.contacts.kernel import (
    CONTACT_WIDTH,
    ROW_LANES,
    ContactSearch,
    make_search,
    write_row,
    write_rows_in_closed_form,
)
from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.contacts.surfaces import user_surface_callback
from multiarm.contacts.table import ContactTable, is_in_closed_form, open_code, pack
from multiarm.dynamics.references import Reference
from multiarm.geometry.records import (
    Contact,
    cone,
    cylinder,
    ellipsoid,
    plane,
    point,
    smooth,
    sphere,
    torus,
)
from multiarm.geometry.smooth_surfaces import SignedDistanceSurface
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import PythonCallback
from multiarm.jit.rows import fields_of
from multiarm.jit.structs import count_entries, struct_of, view
from multiarm.plots.style import BLUE
from multiarm.threads import one_thread

ROWS = 24
"""Of a table: a multiple of the rows that a kind has together."""
BURSTS_PER_ROUND = 2
X, Y, Z = np.eye(3)


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    arguments = output.options(__doc__, "contact_rows").parse_args(words)
    with output.Clock() as clock, one_thread():
        costs = measure_rows(arguments.rounds)
    output.save(arguments, clock, "contact_rows", costs, figure)


def figure(rows: pandas.DataFrame) -> Figure:
    """A bar for each kind of row."""
    drawing, (axes,) = output.panels(1)
    axes.barh(rows["row"][::-1], rows["microseconds"][::-1], color=BLUE)
    axes.set(xscale="log", xlabel="microseconds", title="One row of W")
    return drawing


def row_kinds() -> dict[str, list[Contact]]:
    """The rows that are timed, by name; each touches near (0.5, 0, 0)."""
    tip = sphere((0.5, 0.0, 0.0), 0.01)
    ball = SignedDistanceSurface(
        lambda p: np.sqrt(p @ p) - 0.49,
        gradient=lambda p: p / np.sqrt(p @ p),
        hessian=lambda p: (np.eye(3) - np.outer(p, p) / (p @ p)) / np.sqrt(p @ p),
    )
    on_plane = Contact("tip", tip, plane((0.49, 0.0, 0.0), X))
    oval = ellipsoid((0.0, 0.0, 0.0), np.eye(3), (0.4, 0.5, 0.6))
    across = cylinder((0.5, 0.0, 0.0), Z, 0.1)
    return {
        "tip on plane": [on_plane],
        "tip on sphere": [Contact("tip", tip, sphere((0.0, 0.0, 0.0), 0.49))],
        "tip on cylinder": [Contact("tip", tip, cylinder((0.0, 0.0, 0.0), Z, 0.49))],
        "tip on cone": [Contact("tip", tip, cone((0.0, 0.0, -1.0), Z, math.atan(0.49)))],
        "tip on torus": [Contact("tip", tip, torus((0.0, 0.0, 0.0), Z, 0.4, 0.09))],
        "tip on ellipsoid": [
            Contact("tip", tip, ellipsoid((0.0, 0.0, 0.0), np.eye(3), (0.49, 0.6, 0.7)))
        ],
        "difference of two contacts": [replace(on_plane, minus=replace(on_plane, name="other"))],
        "tip on plane, no slip (3 rows)": [
            on_plane,
            replace(on_plane, tangent=1),
            replace(on_plane, tangent=2),
        ],
        "ellipsoid on plane": [
            Contact("pair", ellipsoid((0.8, 0, 0), np.eye(3), (0.3, 0.2, 0.4)), on_plane.object)
        ],
        "cylinder on cylinder": [Contact("pair", across, cylinder((0.3, 0, 0), Y, 0.1))],
        "ellipsoid on ellipsoid": [
            Contact("pair", ellipsoid((0.8, 0, 0), np.eye(3), (0.3, 0.2, 0.4)), oval)
        ],
        "point on a Python function": [Contact("point", point((0.5, 0.0, 0.0)), smooth(ball))],
    }


def measure_rows(rounds: int = 7) -> pandas.DataFrame:
    """Microseconds a row, for every kind in :func:`row_kinds`."""
    bursts = {name: _burst(contacts) for name, contacts in row_kinds().items()}
    costs = fastest(measure(bursts, rounds * BURSTS_PER_ROUND))
    microseconds = np.array([*costs.values()]) / ROWS
    return pandas.DataFrame({"row": [*costs], "microseconds": microseconds})


def _burst(contacts: list[Contact]) -> Burst:
    """Write a table of ``ROWS`` rows of one kind, again and again."""
    table, surfaces = pack(contacts * (ROWS // len(contacts)))
    link, body = _moving(0.01), _moving(-0.02)
    packs, rows = np.zeros(ROW_LANES), np.zeros((ROWS, CONTACT_WIDTH))
    parts = np.zeros((len(table.codes) - ROWS, CONTACT_WIDTH))
    search = make_search(np.tile([0.47, 0.01, 0.01], (len(table.shapes), 1)))
    answer = user_surface_callback(surfaces, search.query)
    call = PythonCallback(answer, np.zeros(1, dtype=np.int64))
    search.user.callback = call.address
    system = Reference(struct_of(table, search), (table, search))

    def burst(repeats: int) -> None:
        _write_often(repeats, system.struct, link, body, packs, rows, parts)
        call.reraise()
        assert np.all(np.isfinite(rows)), "the rows that are timed exist"

    return burst


def _moving(speed: float) -> np.ndarray:
    body = np.zeros(BODY_WIDTH)
    motion = fields_of(BodyMotion, body)
    motion.rotation[:], motion.velocity[:], motion.spin[:] = np.eye(3), speed, speed
    return body


_open_table, _open_search = view(ContactTable), view(ContactSearch, count_entries(ContactTable))


@kernel
def _write_often(repeats, struct, link, body, packs, rows, parts):
    table, search = _open_table(struct), _open_search(struct)
    for _ in range(repeats):
        complete = write_rows_in_closed_form(
            0, rows.shape[0], link, body, table, search.relative, packs, rows
        )
        for k in range(0 if complete else rows.shape[0]):
            if not is_in_closed_form(open_code(table.codes[k]).kind):
                write_row(k, link, body, table, rows, parts, search)


if __name__ == "__main__":
    main()
