"""Claims about the tables of the studies, which terminals and pages show from one description."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from multiarm.cli.studies import rendered
from multiarm.notation import NOTHING
from multiarm.reports.pages import scientific
from multiarm.studies.tables import REMARK, TEXT, Cell, Column, Table
from multiarm.terminal.console import columns

TABLE = Table(
    "Some methods",
    (
        Column("method", TEXT, about="in the order of their names"),
        Column("error", write="{:.0e}".format, on_page=scientific),
        Column("steps", wide=True),
        Column("", REMARK),
    ),
    (
        ("rk4", Cell(2e-9, "good", "at 0.1 s"), 12, ""),
        ("dop853", None, 7, Cell("not converged", "bad")),
        ("euler", Cell("the run fails", "bad")),
    ),
    ("measured once",),
)


def test_a_page_has_all_columns_and_numbers_in_powers_of_ten():
    first, second, third = TABLE.written(on_page=True)
    assert [cell.text for cell in first] == ["rk4", "2\N{MULTIPLICATION SIGN}10⁻⁹", "12", ""]
    assert (first[1].tone, first[1].note) == ("good", "at 0.1 s")
    assert [cell.text for cell in second] == ["dop853", "\N{EN DASH}", "7", "not converged"]
    assert [cell.span for cell in third] == [1, 3]
    assert third[1].kind == REMARK


def test_a_terminal_has_numbers_to_be_typed_again_and_remarks_below():
    console = Console(width=60)
    with console.capture() as capture:
        for part in rendered(TABLE):
            console.print(part)
    lines = [line.split() for line in capture.get().splitlines()]
    assert [line for line in lines if line[:1] in (["rk4"], ["dop853"], ["euler"])] == [
        ["rk4", "2e-09"], ["dop853", NOTHING], ["euler"],
    ]  # fmt: skip
    assert "steps" not in capture.get()
    assert capture.get().split("dop853: ")[1].splitlines()[:4] == [
        "not converged", "euler: the run fails", "method: in the order of their names.",
        "measured once",
    ]  # fmt: skip


def test_a_narrow_terminal_has_the_columns_in_several_tables():
    console = Console(width=60)
    heads = [Column("name", TEXT), *(Column(f"quantity{k}") for k in range(12))]
    rows = tuple((name, *(f"{name}{k}" for k in range(12))) for name in ("a", "b"))
    with console.capture() as capture:
        for part in rendered(Table("Much", tuple(heads), rows)):
            console.print(part)
    words = capture.get().split()
    for k in range(12):
        assert {f"quantity{k}", f"a{k}", f"b{k}"} <= set(words)
    assert words.count("name") == words.count("a") > 1
    assert max(map(len, capture.get().splitlines())) <= 60


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


def test_a_wide_column_is_narrowed_before_others_are_cut():
    cells = [
        Text("corner_grippers_near_loss\nCorner grippers that have nearly lost a constraint"),
        Text("run ended early 0 / 0\nenergy error / largest kinetic energy 3.8e-11 / 1e-05"),
        Text("rank 8, 21 events\n712 steps, 0.405 s"),
        Text("pass"),
    ]
    for width in (70, 80, 90):
        console = Console(width=width)
        with console.capture() as capture:
            console.print(columns("Cases", ("case", "criteria", "run", "verdict"), [cells]))
        assert max(map(len, capture.get().splitlines())) <= width
        words = {word for cell in cells for word in cell.plain.split()}
        assert {"verdict", *words} <= set(capture.get().split())


def test_two_columns_that_are_too_wide_are_broken_and_not_cut():
    console = Console(width=30)
    with console.capture() as capture:
        console.print(columns("", ("arm", "kind"), [("left_upper_gripper_arm", "x" * 24)]))
    assert capture.get().count("x") == 24
