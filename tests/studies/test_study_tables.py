"""Claims about the tables of the studies, which terminals and pages show from one description."""

from __future__ import annotations

from rich.console import Console

from multiarm.cli.studies import rendered
from multiarm.studies.tables import NUMBER, REMARK, TEXT, TextTable
from multiarm.terminal.console import columns


def test_a_terminal_has_remarks_below_and_columns_in_several_tables_where_it_is_narrow():
    console = Console(width=60)
    heads = ("name", *(f"quantity{k}" for k in range(12)), "")
    rows = tuple((name, *(f"{name}{k}" for k in range(12)), "far off") for name in ("a", "b"))
    with console.capture() as capture:
        for part in rendered(TextTable("Much", (TEXT, *12 * [NUMBER], REMARK), heads, rows)):
            console.print(part)
    words = capture.get().split()
    for k in range(12):
        assert {f"quantity{k}", f"a{k}", f"b{k}"} <= set(words)
    assert words.count("name") == words.count("a") > 1
    assert max(map(len, capture.get().splitlines())) <= 60
    assert capture.get().splitlines()[-2:] == ["a: far off", "b: far off"]


def test_no_column_of_a_commands_table_is_lost_and_no_number_cut():
    heads = ("arm", "kind", "free motions", "share of the load")
    rows = [
        (f"{side}_upper_gripper_arm", "my_package.joint_of_mine", "axes_at_once", "12.5 ± 0.5 µs")
        for side in ("left", "right")
    ]
    table = columns("Joints", heads, rows, numbers=(3,))
    for width in (60, 80, 1000, 60):
        console = Console(width=width)
        with console.capture() as capture:
            console.print(table)
        shown = capture.get()
        for text in (*heads, *rows[0], *rows[1]):
            assert text in shown, f"{width} columns: {text}"
        assert shown.count("Joints") == 1
