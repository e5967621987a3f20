"""JSON Schema of scene and sweep files, from which editors complete, explain and check them.

All of it is Pydantic's, from the models: a validator that lets a bare value stand for a table
(``control: gravity_compensation``, one number for a gain) says so by ``json_schema_input_type``.
The descriptions are those of :mod:`multiarm.scene.parameters`, and the registry of each sort adds
the user classes that are registered or installed.

What a schema cannot say, such as whether arms and joints fit together, only loading checks.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from multiarm.scene.parameters import description_of, summary_of
from multiarm.scene.registry import USER_KINDS, ByName, Registry

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(model: type[BaseModel], built_in: bool = False) -> dict[str, Any]:
    """The JSON Schema of what a model reads, draft 2020-12.

    Parameters
    ----------
    model : type
        Such as :class:`multiarm.Scene`.
    built_in : bool
        Leave out all user classes; those that cannot be loaded are left out always.
    """
    model.model_rebuild()
    schema = _Generator(built_in).generate(model.__pydantic_core_schema__)
    return {"$schema": _DIALECT, "title": model.__name__.removesuffix("Spec").lower(), **schema}


class _Generator(GenerateJsonSchema):
    """Pydantic's generator with our descriptions, and with user classes."""

    def __init__(self, only_ours: bool) -> None:
        super().__init__()
        self.only_ours = only_ours

    def field_title_should_be_set(self, schema: Any) -> bool:
        """No titles: the keys say as much."""
        return False

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Describe a table and its keys; add the user classes that may be keys."""
        table, model = super().model_schema(schema), schema["cls"]
        table.pop("title", None)
        table["description"] = summary_of(model)
        properties = table.get("properties", {})
        for name, key_schema in properties.items():
            key_schema["description"] = description_of(model, name)
            if not key_schema["description"]:
                del key_schema["description"]
            default = key_schema.get("default", 0)
            values = list(default.values()) if isinstance(default, dict) else [default]
            if values and all(value is None for value in values):  # a file cannot say it
                del key_schema["default"]
        if issubclass(model, ByName):
            table["additionalProperties"] = False
            for name, user_class in self._user_classes(model.registry).items():
                properties[name] = {"anyOf": [self.generate_inner(user_class), {"type": "null"}]}
        return table

    def function_wrap_schema(
        self, schema: core_schema.WrapValidatorFunctionSchema
    ) -> JsonSchemaValue:
        """Add user kinds to ours; tables without a kind have none of them."""
        registry, kinds = schema.get("metadata", {}).get(USER_KINDS), schema["schema"]
        if registry is None or kinds["type"] != "tagged-union":
            return super().function_wrap_schema(schema)
        choices = {**kinds["choices"], **self._user_classes(registry)}
        all_kinds: Any = {**kinds, "choices": choices}
        union = self.tagged_union_schema(all_kinds)
        union.pop("discriminator", None)  # a key of OpenAPI
        return {**union, "required": ["kind"]}

    def _user_classes(self, registry: Registry) -> dict[str, Any]:
        """The schemas of the user classes of a sort."""
        classes = {} if self.only_ours else registry.classes()[0]
        models = {name: registry.parameters_of(cls) for name, cls in classes.items()}
        return {name: model.__pydantic_core_schema__ for name, model in models.items()}
