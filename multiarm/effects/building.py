"""From the effects that a scene names to their pieces."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from multiarm.candidates.building import COME_AND_GO
from multiarm.effects.piece import Piece, Pieces, Site


def build_pieces(site: Site, further: Sequence[Piece] = ()) -> Pieces:
    """The pieces of the effects that the scene names, and further ones; no other is imported."""
    pieces = [*further]
    for name, spec in site.scene.effects.named.items():
        if name in COME_AND_GO:
            continue
        pieces += import_module(f"multiarm.effects.{name}").build(spec, site)
    return Pieces.of(pieces)
