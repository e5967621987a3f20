"""What a user keeps of every run: quantities by their names, and functions of one's own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, TypeAdapter

from multiarm.scene import function_text
from multiarm.scene.faults import fault, shown, unknown
from multiarm.scene.functions import UserFunction, located
from multiarm.scene.values import Spec
from multiarm.sweeps.quantities import KNOWN, MEASURED, Quantity, digest

__all__ = ["DEFAULT_KEEP", "Kept", "OwnQuantity"]

DEFAULT_KEEP = (
    "final_position_error",
    "final_rotation_error",
    "largest_contact_force",
    "position_drift",
    "energy_balance",
)
"""What is kept where nothing is named."""


def _column(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_][\w.\-]*", value):
        raise fault(
            f"{shown(value)} cannot name a quantity; use letters, digits, '_', '-' and '.', with "
            "a letter first (names become columns of tables)"
        )
    return value


Column = Annotated[str, BeforeValidator(_column)]


class OwnQuantity(Spec):
    """A function of the user's, of a run's trajectory.

    Attributes
    ----------
    function : callable or str
        ``f(trajectory) -> number``, or where it is: ``file.py:name``, ``package.module:name``.
    name : str, optional
        Of the quantity; that of the function when left out.
    gives : list of str, optional
        The function returns a table with these names; each is a quantity ``name.entry``.
    unit, words : str
        What the number is.
    """

    function: UserFunction = Field(description="file.py:name of a function of the trajectory")
    name: Column | None = None
    gives: Annotated[tuple[Column, ...], Field(min_length=1)] | None = None
    unit: str = "1"
    words: str = ""

    def quantities(self) -> list[Quantity]:
        """The quantities that the function gives."""
        own = re.sub(r"\W", "", function_text(self.function).rpartition(":")[2].split(".")[-1])
        name, text = self.name or own or "quantity", digest(self.function)
        if self.gives is None:
            return [Quantity(name, self.unit, self.words, self.function, None, text)]
        return [
            Quantity(f"{name}.{key}", self.unit, self.words, self.function, key, text)
            for key in self.gives
        ]

    def located(self, folder: Path) -> OwnQuantity:
        """The same with the path of its file made absolute."""
        return self.model_copy(update={"function": located(self.function, folder)})


def _read(value: Any) -> Any:
    """A quantity by its name, or a function: as a table, as where it is, as it is."""
    if isinstance(value, (Mapping, OwnQuantity)):
        return TypeAdapter(OwnQuantity).validate_python(value)
    if callable(value) or (isinstance(value, str) and ":" in value):
        return TypeAdapter(OwnQuantity).validate_python({"function": value})
    if isinstance(value, str) and (value in KNOWN or value == MEASURED):
        return value
    names = [*KNOWN, MEASURED]
    told = unknown("quantity", value, names, "quantities")
    raise fault(f"{told}; one of your own is 'file.py:name', f(trajectory) -> number")


Kept = Annotated[Any, BeforeValidator(_read)]
"""An entry of ``keep``: the name of a quantity, or an :class:`OwnQuantity`."""
