"""User classes of controls, effects, joints and surfaces, found by their names in scenes.

A name that is none of ours is looked for among the classes that were registered in this process,
for instance by :func:`multiarm.register_effect`, and then among the entry points of the installed
packages, in a group for each sort:

.. code-block:: toml

    [project.entry-points."multiarm.effects"]
    magnet = "my_package.magnet:Magnet"

A package is imported only for scenes that name its class: when one is made in Python, and when one
that was read from a file is compiled.  The class then validates the parameters, and every fault has
its place, as for our own classes.

To the registry, a class is a name, a model of its parameters, and a class method ``lacks()`` that
says in words what it lacks to be of its sort; empty when nothing is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from operator import attrgetter
from typing import Any, ClassVar, Generic, Literal, NamedTuple, TypeVar, get_args, get_origin

from pydantic import ConfigDict, TypeAdapter, ValidationError, ValidationInfo
from pydantic_core import InitErrorDetails, PydanticCustomError
from typing_extensions import Self

from multiarm.errors import USER_FAULTS, ModelError, MultiarmError
from multiarm.scene.faults import Parts, fault, listed, sentences, unknown
from multiarm.scene.values import Spec, written

Kind = TypeVar("Kind")
AnyClass = TypeVar("AnyClass", bound=type)


class OwnSpec(Spec):
    """Parameters of a user class: keys that are not declared, NaN and infinity are refused."""

    model_config = ConfigDict(allow_inf_nan=False)

    @classmethod
    def incomplete(cls) -> str:
        """Why its fields are not known yet, in words; empty when they are."""
        known = cls.model_rebuild(raise_errors=False) is not False
        return "" if known else "an annotation names what is not known where the class is defined"


class OwnKind(OwnSpec):
    """Parameters of a class that scenes name by its key ``kind``."""

    picture: ClassVar[str] = ""
    example: ClassVar[str] = ""

    @classmethod
    def sample(cls) -> Self:
        """What the example describes."""
        raise NotImplementedError

    @classmethod
    def lacks_sample(cls) -> str:
        """Why the example cannot be read; empty when it can, or there is none."""
        try:
            if cls.example:
                cls.sample()
        except USER_FAULTS as error:
            return f"its example does not load, {type(error).__name__}: {error}"
        return ""

    @classmethod
    def kind_name(cls) -> Any:
        """The value of ``kind`` in scenes."""
        return cls.model_fields["kind"].default

    @classmethod
    def lacks_kind(cls) -> str:
        """What the class lacks to be found by its ``kind``; empty when nothing is missing."""
        if cls.incomplete():
            return cls.incomplete()
        kind = cls.kind_name()
        only = get_origin(annotation := cls.model_fields["kind"].annotation) is Literal
        if not only or get_args(annotation) != (kind,) or not str(kind).isidentifier():
            return "'kind' must be a word, written as kind: Literal['word'] = 'word'"
        return ""


class Named(NamedTuple):
    """An entry of a table that is no field of its model: its name and its value."""

    name: str
    value: Any


@dataclass
class Registry(Generic[Kind]):
    """The user classes of one sort.

    Attributes
    ----------
    sort : str
        The word in the names of the base class, of the function that registers a class, and of the
        group of entry points: ``multiarm.Effect``, ``multiarm.register_effect``,
        ``multiarm.effects``.
    noun, plural : str
        For messages, such as ``control kind`` and ``kinds``.
    built_in : callable
        The names of our own classes, which are taken.
    name_of, parameters_of : callable
        A class's name in scenes, and the model of its parameters.
    registered, loaded : dict
        The classes known to this process: by registration, and by entry points.
    """

    sort: str
    noun: str
    plural: str
    built_in: Callable[[], Collection[str]]
    name_of: Callable[[Any], str] = attrgetter("name")
    parameters_of: Callable[[Any], Any] = lambda own: own
    registered: dict[str, type[Kind]] = field(default_factory=dict)
    loaded: dict[str, type[Kind]] = field(default_factory=dict)

    @property
    def group(self) -> str:
        """Of the entry points."""
        return f"multiarm.{self.sort}s"

    @property
    def base(self) -> str:
        """Public name of the base class."""
        return f"multiarm.{self.sort.capitalize()}"

    def add(self, own: AnyClass) -> AnyClass:
        """Let scenes name a class.  Defined and registered once more, it replaces the former one.

        Raises
        ------
        ModelError
            It lacks something, or another class has its name.
        """
        self._check(own, "cannot be registered")
        name = self.name_of(own)
        taken = self.registered.get(name)
        reason = ""
        if name in self.built_in():
            reason = "multiarm itself has one of that name; choose another"
        elif taken is not None and _path(taken) != _path(own):
            reason = f"{_path(taken)} is registered under that name already"
        for point in self._entry_points(name):
            if point.value.replace(" ", "") != _path(own):
                reason = reason or f"{_offered(point)} has that name already; choose another one"
        if reason:
            raise ModelError(f"{self.noun} {name!r}: {reason}")
        self.registered[name] = own
        return own

    def known(self, name: str) -> type[Kind] | None:
        """The class that was registered or loaded before; None where none was."""
        return self.registered.get(name) or self.loaded.get(name)

    def offers(self, name: str) -> str:
        """Which installed packages offer a class of a name; empty where none does."""
        return " and ".join(sorted({_offered(point) for point in self._entry_points(name)}))

    def find(self, name: str) -> type[Kind] | None:
        """The class of a name; None where there is none.

        Raises
        ------
        ModelError
            Its package is broken, or several have one.
        """
        known = self.known(name)
        if known is not None:
            return known
        points = {point.value: point for point in self._entry_points(name)}
        if not points:
            return None
        if len(points) > 1:
            offers = " and ".join(_offered(point) for point in points.values())
            raise ModelError(
                f"{self.noun} {name!r} is ambiguous: {offers} have that name; remove one"
            )
        (point,) = points.values()
        try:
            found = point.load()
        except USER_FAULTS as error:
            raise ModelError(
                f"{self.noun} {name!r}: {_offered(point)} cannot be loaded, "
                f"{type(error).__name__}: {error}"
            ) from error
        self._check(found, f"of {_offered(point)} cannot be used", name)
        self.loaded[name] = found
        return found

    def names(self) -> list[str]:
        """Names of all classes that are registered or installed."""
        points = metadata.entry_points(group=self.group)
        return sorted({*self.registered, *(point.name for point in points)})

    def classes(self) -> tuple[dict[str, type[Kind]], list[str]]:
        """All classes by name, for which packages are loaded, and why others cannot be used."""
        found, faults = {}, []
        for name in self.names():
            try:
                own = self.find(name)
                assert own is not None, "it is registered or installed"
                found[name] = own
            except ModelError as error:
                faults.append(str(error))
        return found, faults

    def unknown(self, name: object) -> str:
        """The message for a name that no class has."""
        text = unknown(self.noun, name, [*self.built_in(), *self.names()], self.plural)
        own = f"{self.plural} of your own need multiarm.register_{self.sort}, or their package"
        return f"{text}; {own}"

    # --- reading scenes ---------------------------------------------------------------------------

    def set_apart(self, data: Any) -> Any:
        """A table with entries of other names than ours as :class:`Named`, for :meth:`read`."""
        if not isinstance(data, Mapping):
            return data
        ours = self.built_in()
        return {
            name: value if name in ours or not isinstance(name, str) else Named(name, value)
            for name, value in data.items()
        }

    def read(self, entry: Any, info: ValidationInfo) -> Any:
        """The validated parameters of a user class; None where a scene leaves it out by null.

        They stay as they are where :meth:`class_for` finds no class.
        """
        if not isinstance(entry, Named):
            return entry
        own = self.class_for(entry.name, info)
        if own is None or entry.value is None:
            return entry.value
        return self.validated(entry.name, self.parameters_of(own), entry.value, info)

    def read_kind(
        self, value: Any, ours: Callable[[Any], Any], info: ValidationInfo, unloaded: type[Spec]
    ) -> Any:
        """A part of a scene with a key ``kind``, read by ``ours`` if its kind is ours.

        Otherwise by a user class, or as ``unloaded`` where :meth:`class_for` finds no class; what
        has been left unloaded stays so until its table is read again.
        """
        if isinstance(value, unloaded):
            return value
        if not isinstance(value, (Mapping, Spec)):
            return ours(value)
        data = written(value)
        if "kind" not in data:
            known = [*self.built_in(), *self.names()]
            raise fault(f"'kind' is missing; kinds are {listed(known)}")
        kind = data["kind"] if isinstance(data["kind"], str) else str(data["kind"])
        if kind in self.built_in():
            return ours(value)
        try:
            own = self.class_for(kind, info)
        except PydanticCustomError as error:
            raise faults_at([((kind, "kind"), error.message(), kind)], kind) from None
        if own is None:
            return self.validated(kind, unloaded, data, info, kind)
        if isinstance(value, own):
            return value
        return self.validated(kind, self.parameters_of(own), data, info, kind)

    def class_for(self, name: str, info: ValidationInfo) -> type[Kind] | None:
        """The class that a scene names; None where its parameters are kept as they are written.

        A scene that is read from a file loads no package, and a stored one does without it, see
        :mod:`multiarm.scene.loading`.
        """
        context = info.context or {}
        if not context.get("load", True) and not self.known(name) and self.offers(name):
            return None
        try:
            own = self.find(name)
        except ModelError as error:
            raise fault(str(error)) from None
        if own is None and not context.get("stored"):
            raise fault(self.unknown(name))
        return own

    def validated(
        self, name: str, model: Any, value: Any, info: ValidationInfo, *where: str
    ) -> Any:
        """The scene's text read by a model, every fault at its place below ``where``."""
        try:
            return TypeAdapter(model).validate_python(value, context=info.context)
        except ValidationError as error:
            found = [
                ((*where, *parts), text, given) for parts, text, given in sentences(error, model)
            ]
            raise faults_at(found, name) from None
        except PydanticCustomError:
            raise
        except USER_FAULTS as error:
            raise fault(
                f"the {model.__name__} of {self.noun} {name!r} raised "
                f"{type(error).__name__}: {error}"
            ) from None

    def _check(self, own: Any, trouble: str, name: str | None = None) -> None:
        """Raise unless this is a class of the sort, with the name that its package offers."""
        bases = [one.__name__ for one in own.__mro__] if isinstance(own, type) else []
        if not hasattr(own, "lacks") or self.base.rpartition(".")[2] not in bases:
            raise ModelError(f"{own!r} {trouble}: it is no subclass of {self.base}")
        reason = own.lacks()
        if not reason and name is not None and self.name_of(own) != name:
            reason = f"its name is {self.name_of(own)!r}, not {name!r}"
        if reason:
            raise ModelError(f"{_path(own)} {trouble}: {reason}")

    def _entry_points(self, name: str) -> list[metadata.EntryPoint]:
        return list(metadata.entry_points(group=self.group, name=name))


def faults_at(found: list[tuple[Parts, str, Any]], title: str) -> ValidationError:
    """One error for faults with their places and the values there."""
    details = [
        InitErrorDetails(type=fault(text), loc=tuple(parts), input=given)
        for parts, text, given in found
    ]
    return ValidationError.from_exception_data(title, details)


def called(function: Callable[[], Any], who: str) -> Any:
    """What a method of a user class returns; messages begin with ``who``.

    Raises
    ------
    ModelError
        It raised something.
    """
    try:
        return function()
    except MultiarmError:
        raise
    except USER_FAULTS as error:
        raise ModelError(f"{who} raised {type(error).__name__}: {error}") from error


def _offered(point: metadata.EntryPoint) -> str:
    package = "an installed package" if point.dist is None else f"package {point.dist.name!r}"
    return f"{package} ({point.value})"


def _path(own: type) -> str:
    return f"{own.__module__}:{own.__qualname__}"
