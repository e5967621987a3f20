"""User classes in tests: registries that begin empty, and packages that seem to be installed."""

from __future__ import annotations

from importlib import metadata
from types import SimpleNamespace

from multiarm.scene import REGISTRIES, registry


def empty_registries(monkeypatch) -> None:
    """Only our classes are known, and no installed package offers others, until the test ends."""
    for own in REGISTRIES:
        monkeypatch.setattr(own, "registered", {})
    offered(monkeypatch)


def offered(monkeypatch, *classes: str) -> None:
    """Let an installed package offer these classes, such as ``effects spring module:Spring``."""
    points = [
        metadata.EntryPoint(name, value, f"multiarm.{sort}")
        for sort, name, value in map(str.split, classes)
    ]

    def entry_points(**wanted):
        return [p for p in points if all(getattr(p, key) == v for key, v in wanted.items())]

    monkeypatch.setattr(registry, "metadata", SimpleNamespace(entry_points=entry_points))
