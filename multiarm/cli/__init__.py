"""The command line, ``multiarm COMMAND``.

Each command is a function in a module of the same name; heavy libraries are imported when a command
runs, so that ``--help`` answers at once.  Exit codes: 0 success; 1 a run failed or was interrupted,
its results up to there are saved; 2 bad input, named in the message.
"""

from __future__ import annotations

import warnings
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

import multiarm
from multiarm.cli.accuracy import accuracy
from multiarm.cli.check import check
from multiarm.cli.effects import effects
from multiarm.cli.grasp import grasp_app
from multiarm.cli.joints import controls, joints, methods, shapes
from multiarm.cli.modes import modes
from multiarm.cli.new import new
from multiarm.cli.pose import pose
from multiarm.cli.robots import robots
from multiarm.cli.run import run
from multiarm.cli.schema import schema
from multiarm.cli.show import replay, report
from multiarm.cli.stability import stability
from multiarm.cli.sweep import sweep
from multiarm.cli.warmup import warmup
from multiarm.errors import MultiarmError, shortened
from multiarm.results.files import printable
from multiarm.terminal.console import print_error, print_warnings


class _Commands(TyperGroup):
    """All commands; prints warnings and multiarm's errors, the latter with exit code 2."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the first word names."""
        if args and self.get_command(ctx, args[0]) is None:
            from multiarm.scene.faults import unknown

            raise MultiarmError(unknown("command", args[0], self.list_commands(ctx)))
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; other exceptions pass through."""
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("default", category=UserWarning, module="multiarm")
                warnings.showwarning = _print_warning
                return super().invoke(ctx)
        except MultiarmError as error:
            print_error(str(error))
            raise typer.Exit(2) from None
        except OSError as error:
            if isinstance(error, BrokenPipeError):
                raise
            where = "a file" if error.filename is None else f"'{error.filename}'"
            print_error(shortened(f"cannot use {where}: {error.strerror or error}"))
            raise typer.Exit(2) from None
        except TyperException as error:  # a wrong command line
            error.message = shortened(printable(error.message))
            raise
        except KeyboardInterrupt:
            print_error("interrupted")
            raise typer.Exit(1) from None
        except SystemExit as error:  # no command raises this itself
            if isinstance(error.__context__, BrokenPipeError):  # Rich does, as in `| head`
                raise typer.Exit(1) from None
            print_error(f"code that was loaded ended the program: SystemExit: {error}")
            raise typer.Exit(1) from None


def _print_warning(message: Any, category: type[Warning], *_: Any, **__: Any) -> None:
    """A warning of multiarm's own as it is; of numerical libraries, what it means here."""
    if issubclass(category, RuntimeWarning):
        message = (
            "numbers leave the range of floating point, so that results may be wrong; check the "
            f"units of masses, lengths and gains ({message})"
        )
    print_warnings([str(message)])


app = typer.Typer(
    name="multiarm",
    cls=_Commands,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; the entry point of the program."""
    app(prog_name="multiarm")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"multiarm {multiarm.__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Simulate several robot arms that hold one object: closed kinematic chains.

    A scene is a YAML file that names arms, object, joints and control. Look at one with
    **multiarm check**, simulate it with **multiarm run**, and see the result with
    **multiarm replay** and **multiarm report**. **multiarm sweep** runs it many times with other
    values in it. **multiarm grasp** designs grasps, and the scenes
    in which arms hold a body so.

    Exit codes: 0 done; 1 a run failed or was interrupted, its results up to there are saved; 2 bad
    input, named in the message.
    """


_COMMANDS = (
    new, run, check, pose, robots, shapes, joints, controls, methods, schema, replay, report,
    accuracy, effects, stability, modes, sweep, warmup,
)  # fmt: skip
for _command in _COMMANDS:
    app.command()(_command)
app.add_typer(grasp_app, name="grasp")
