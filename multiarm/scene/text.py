"""YAML text, without three habits of YAML 1.1 that bite.

``1e-6`` is a number (not text), ``on`` is a word (not true), and a key that stands twice in one
table is a fault (not a silent loss of the first).
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from typing import Any

import yaml

from multiarm.errors import SceneError


def parse_yaml(text: str) -> Any:
    """The content of a YAML text, without the habits above.

    Raises
    ------
    SceneError
        When it is not YAML, or a key stands twice.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise SceneError(f"{where}{error.problem or error.context}; this is not YAML") from None
    except yaml.YAMLError as error:
        raise SceneError(f"this is not YAML: {error}") from None


_MERGE, _TRUTH = "tag:yaml.org,2002:merge", "tag:yaml.org,2002:bool"


class _Loader(yaml.SafeLoader):
    """YAML with ``1e-6`` as a number, ``on`` as a word, and without repeated keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """Refuse keys that stand twice."""
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen and key_node.tag != _MERGE:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} stands twice in one table", key_node.start_mark
                )
            seen.add(key if isinstance(key, Hashable) else str(key))
        return super().construct_mapping(node, deep=deep)


# of the truth values, only those of YAML 1.2
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if first in "tTfF" or tag != _TRUTH]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?[0-9]+(?:\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)
