"""What all parts of a scene are: frozen tables with known keys.

A part that is made in Python is validated as one that is read from YAML, and raises the same error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import core_schema
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.public import public_names
from multiarm.scene.faults import explain, fault_at, invalid, listed, path_fault


class Spec(BaseModel):
    """Base of all parts of a scene: frozen, strict about keys.

    A part built in Python (``Pose(xyz=[0, 0, 1])``) is validated like one read from YAML, and
    raises the same :class:`~multiarm.errors.SceneError`.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        arbitrary_types_allowed=True,
        defer_build=True,  # at its first use: a scene uses few of all parts
    )

    def __dir__(self) -> list[str]:
        return [name for name in public_names(self) if not hasattr(BaseModel, name)]

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return written(self).items()

    def __init__(self, /, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise SceneError(explain(error, type(self), type(self).__name__)) from None

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read nested parts without our ``__init__``, where the first fault ends the search."""
        schema = handler(source)
        if cls.__init__ is Spec.__init__:
            model: Any = handler.resolve_ref_schema(schema)
            while model["type"] != "model":  # its validators are around it
                model = model["schema"]
            model["custom_init"] = False
        return schema

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            super().__setattr__(name, value)
        except ValidationError:
            problem = (
                "parts of a scene are not changed in place; another scene is made by "
                "scene.replace, such as scene.replace({'object.mass': 20})"
            )
            raise SceneError([fault_at((name,), problem, type(self).__name__)]) from None

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """Validate a mapping or an instance; raises SceneError."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise SceneError(explain(error, cls, cls.__name__)) from None

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy, with other values for some keys, which are validated; raises SceneError."""
        if not update:
            return super().model_copy(deep=deep)
        return type(self).model_validate({**written(self), **update})

    @model_serializer(mode="wrap")
    def _kind_is_always_written(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data = handler(self)
        kind = getattr(self, "kind", None)
        return data if kind is None else {"kind": kind, **data}


def written(value: Any) -> dict[str, Any]:
    """The entries of a table; of a part of a scene those that are written, and its kind."""
    if not isinstance(value, BaseModel):
        return dict(value) if isinstance(value, Mapping) else {}
    return {name: v for name, v in value if name in value.model_fields_set or name == "kind"}


def shorthand(key: str, written: Any, *types: type) -> BeforeValidator:
    """Let a value of some types stand for a table with one key; ``written`` is what may stand."""

    def table(value: Any) -> Any:
        bare = isinstance(value, types) and not isinstance(value, bool)
        return {key: value} if bare else value

    return BeforeValidator(table, json_schema_input_type=written)


class OneOf(Spec):
    """A table that has exactly one of its keys."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        written = [name for name, value in self if value is not None]
        if len(written) != 1:
            known = listed(type(self).model_fields)
            raise invalid(f"needs exactly one of {known}, got {written or 'none'}")
        return self


def _file_path(value: Any) -> Any:
    """Refuse the path of no file; whether there is a file is another question."""
    wrong = path_fault(value) if isinstance(value, (str, Path)) else ""
    if wrong:
        raise invalid(wrong)
    return value


FilePath = Annotated[Path, BeforeValidator(_file_path)]
