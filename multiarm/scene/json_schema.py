"""JSON Schema of scene and sweep files, from which editors complete, explain and check them.

All of it derives from the models: the descriptions are those of :mod:`multiarm.scene.parameters`,
and the registry of each sort adds the user classes that are registered or installed.  Where a
validator lets a bare value stand for a table (``control: gravity_compensation``, one number for a
gain), it is asked: it is given a number, a word, a list and a table, and where it makes another
table of one of them, the values that this table's first key may have are allowed as well.

What a schema cannot say, such as whether arms and joints fit together, only loading checks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from multiarm.errors import USER_FAULTS
from multiarm.scene.parameters import description_of, summary_of
from multiarm.scene.registry import ByName, Registry

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_ASKED = "x-asked"
# Pydantic's words, where a bound belongs to a validator, in JSON Schema
_BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
# JSON type -> a value of it that is given to validators
_PROBES = {"number": 1.0, "string": "word", "array": [1.0, 1.0, 1.0], "object": {"arm": 1.0}}


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
    resolved = _resolved(schema, schema.get("$defs", {}))
    return {"$schema": _DIALECT, "title": model.__name__.removesuffix("Spec").lower(), **resolved}


class _Generator(GenerateJsonSchema):
    """Pydantic's generator with our descriptions, user classes, and notes where to ask."""

    def __init__(self, only_ours: bool) -> None:
        super().__init__()
        self.only_ours = only_ours

    def field_title_should_be_set(self, schema: Any) -> bool:
        """Say nothing that the key does not say."""
        return False

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Describe a table and its keys; add the user classes that may be keys."""
        made, model = super().model_schema(schema), schema["cls"]
        made.pop("title", None)
        made["description"] = summary_of(model)
        properties = made.get("properties", {})
        for name, own in properties.items():
            own["description"] = description_of(model, name)
            if not own["description"]:
                del own["description"]
            default = own.get("default", 0)
            values = list(default.values()) if isinstance(default, dict) else [default]
            if values and all(value is None for value in values):  # a file cannot say it
                del own["default"]
        if issubclass(model, ByName):
            made["additionalProperties"] = False
            for name, own in self._user_classes(model.registry).items():
                properties[name] = {"anyOf": [self.generate_inner(own), {"type": "null"}]}
        return made

    def function_wrap_schema(
        self, schema: core_schema.WrapValidatorFunctionSchema
    ) -> JsonSchemaValue:
        """Add user kinds to ours; tables without a kind have none of them."""
        registry = getattr(schema["function"]["function"], "__self__", None)
        kinds = schema["schema"]
        if not isinstance(registry, Registry) or kinds["type"] != "tagged-union":
            return super().function_wrap_schema(schema)
        whole: Any = {**kinds, "choices": {**kinds["choices"], **self._user_classes(registry)}}
        made = self.tagged_union_schema(whole)
        made.pop("discriminator", None)  # a key of OpenAPI
        return {**made, "required": ["kind"]}

    def function_before_schema(
        self, schema: core_schema.BeforeValidatorFunctionSchema
    ) -> JsonSchemaValue:
        """Note a validator that may let bare values stand for a table."""
        made = super().function_before_schema(schema)
        if schema["function"]["type"] != "no-info" or "properties" in made:
            return made
        return {"anyOf": [made], _ASKED: schema["function"]["function"]}

    def _user_classes(self, registry: Registry) -> dict[str, Any]:
        """The schemas of the user classes of a sort."""
        found = {} if self.only_ours else registry.classes()[0]
        models = {name: registry.parameters_of(own) for name, own in found.items()}
        return {name: model.__pydantic_core_schema__ for name, model in models.items()}


def _resolved(schema: Any, definitions: Mapping) -> Any:
    """The schema with the bare values that its validators take."""
    if isinstance(schema, list):
        return [_resolved(item, definitions) for item in schema]
    if not isinstance(schema, dict):
        return schema
    made = {
        _BOUNDS.get(key, key): _resolved(item, definitions)
        for key, item in schema.items()
        if key != _ASKED
    }
    if _ASKED in schema:
        bare = _bare(schema[_ASKED], list(_tables(schema, definitions)))
        made["anyOf"] += [_resolved(item, definitions) for item in bare]
    choices: list[Any] = []
    for one in made.pop("anyOf", ()):
        choices += [own for own in one.get("anyOf", [one]) if own not in choices]
    if len(choices) == 1:
        return {**choices[0], **made}
    return {**made, "anyOf": choices} if choices else made


def _bare(reads: Callable[[Any], Any], tables: list[dict]) -> list[dict]:
    """The values that a validator lets stand for one of some tables."""
    found: list[dict] = []
    for sort, probe in {**_PROBES, "null": None}.items() if tables else ():
        try:
            table = reads(probe)
        except USER_FAULTS:
            continue
        if not isinstance(table, dict) or table == probe:
            continue
        key = next(iter(table))
        if key not in tables[0]["properties"]:
            continue
        if sort == "null":
            found.append({"type": "null"})
        elif key == "kind" and len(tables) > 1:  # a kind that needs no more than its name
            plain = [own for own in tables if set(own.get("required", ())) <= {"kind"}]
            found.append({"enum": [own["properties"]["kind"]["const"] for own in plain]})
        else:
            values = tables[0]["properties"][key]
            found += [one for one in _alternatives(values) if sort in _types(one)]
    return found


def _tables(schema: dict, definitions: Mapping) -> Iterator[dict]:
    """The tables among the alternatives of a schema."""
    for one in _alternatives(schema):
        if "$ref" in one:
            one = definitions[re.sub(r".*/", "", one["$ref"])]
            yield from _tables(one, definitions)
        elif "properties" in one:
            yield one


def _alternatives(schema: dict) -> Iterator[dict]:
    choices = schema.get("anyOf") or schema.get("oneOf")
    if choices is None:
        yield schema
    bounds = {key: schema[key] for key in _BOUNDS if key in schema}
    for one in choices or ():
        yield from _alternatives({**one, **bounds} if one.get("type") != "null" else one)


def _types(schema: dict) -> set[str]:
    found = schema.get("type")
    found = "number" if found == "integer" else found
    return {found} if found else {"string"} if "enum" in schema else set()
