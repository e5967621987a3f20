"""From the effects that a scene names to their pieces."""

from __future__ import annotations

from importlib import import_module

from multiarm.effects.piece import Pieces, Site


def build_pieces(site: Site) -> Pieces:
    """The pieces of all effects that the scene names; nothing else is imported."""
    pieces = []
    for name, spec in site.scene.effects.named.items():
        pieces += import_module(f"multiarm.effects.{name}").build(spec, site)
    return Pieces.of(pieces)
