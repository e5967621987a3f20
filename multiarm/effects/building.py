"""From the effects that a scene names to their pieces."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from multiarm.effects.piece import Piece, Pieces, Site
from multiarm.errors import ModelError
from multiarm.scene.effects import WITH_EVENTS
from multiarm.scene.registry import find_effect


def build_pieces(site: Site, further: Sequence[Piece] = ()) -> Pieces:
    """The pieces of the effects that the scene names, and further ones; no other is imported."""
    pieces = [*further]
    for name, spec in site.scene.effects.named.items():
        if name in WITH_EVENTS:
            continue
        if name in type(site.scene.effects).model_fields:
            pieces += import_module(f"multiarm.effects.{name}").build(spec, site)
        else:
            pieces += _own_pieces(name, spec, site)
    return Pieces.of(pieces)


def _own_pieces(name: str, spec: Any, site: Site) -> list[Piece]:
    """What an effect of the user's own adds."""
    effect = find_effect(name)
    if effect is None:
        raise ModelError(
            f"effects.{name}: the package of this effect is not installed; install it, or register "
            "its class with multiarm.register_effect"
        )
    try:
        found = effect(spec).build(site)
    except SystemExit as error:
        raise ModelError(f"effects.{name}: build raised SystemExit: {error}") from error
    if not isinstance(found, list) or not all(isinstance(piece, Piece) for piece in found):
        raise ModelError(
            f"effects.{name}: build returned {type(found).__name__}; return a list of "
            "multiarm.effects.piece.Piece"
        )
    return found
