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
says in words what it lacks to be of its sort; empty when nothing is missing.  A part of a scene
names a class by its key ``kind`` (:meth:`Registry.by_kind`) or as a key of a table
(:class:`ByName`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import reduce
from importlib import metadata
from operator import or_
from typing import (
    Annotated,
    Any,
    ClassVar,
    Generic,
    Literal,
    NamedTuple,
    TypeVar,
    get_args,
    get_origin,
)

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializeAsAny,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WrapValidator,
    create_model,
    model_validator,
)
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
    built_in : dict
        Our own classes by name.
    stand_ins : tuple of types
        Of a sort that is named by ``kind``: the class of a part whose class is not loaded, and
        others that are not read again.
    registered, loaded : dict
        The classes known to this process: by registration, and by entry points.
    """

    sort: str
    noun: str
    plural: str
    built_in: Mapping[str, Any]
    stand_ins: tuple[type[Spec], ...] = ()
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

    @staticmethod
    def name_of(own: Any) -> str:
        """A class's name in scenes."""
        return own.kind_name() if hasattr(own, "kind_name") else own.name

    @staticmethod
    def parameters_of(own: Any) -> Any:
        """The model of a class's parameters: itself, or its ``Spec``."""
        return own if issubclass(own, BaseModel) else own.Spec

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
        if name in self.built_in:
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
        text = unknown(self.noun, name, [*self.built_in, *self.names()], self.plural)
        own = f"{self.plural} of your own need multiarm.register_{self.sort}, or their package"
        return f"{text}; {own}"

    # --- reading scenes ---------------------------------------------------------------------------

    def by_kind(self) -> Any:
        """The type of a table whose key ``kind`` names one of our classes, or a user's."""
        ours: Any = reduce(or_, self.built_in.values())
        tagged: Any = Annotated[ours, Field(discriminator="kind")]
        kept: Any = SerializeAsAny[tagged]  # type: ignore[misc]
        return Annotated[kept, WrapValidator(self._read_kind)]

    def _read_kind(self, value: Any, ours: Callable[[Any], Any], info: ValidationInfo) -> Any:
        """A part with a key ``kind``, read by ``ours`` if its kind is ours, else by a user class.

        Where :meth:`class_for` finds no class it is a stand-in, and stays so until its table is
        read again.
        """
        if type(value) in self.stand_ins:
            return value
        if not isinstance(value, (Mapping, Spec)):
            return ours(value)
        data = written(value)
        if "kind" not in data:
            known = [*self.built_in, *self.names()]
            raise fault(f"'kind' is missing; kinds are {listed(known)}")
        kind = data["kind"] if isinstance(data["kind"], str) else str(data["kind"])
        if kind in self.built_in:
            return ours(value)
        try:
            own = self.class_for(kind, info)
        except PydanticCustomError as error:
            raise faults_at([((kind, "kind"), error.message(), kind)], kind) from None
        if own is not None and isinstance(value, own):
            return value
        model = self.stand_ins[0] if own is None else self.parameters_of(own)
        return self.validated(kind, model, data, info, kind)

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


class _Named(NamedTuple):
    """An entry of a table that is no field of its model: its name and its value."""

    registry: Registry
    name: str
    value: Any


def _read_named(entry: Any, info: ValidationInfo) -> Any:
    """The validated parameters of a user class; None where a scene leaves it out by null.

    They stay as they are where :meth:`Registry.class_for` finds no class.
    """
    if not isinstance(entry, _Named):
        return entry
    own = entry.registry.class_for(entry.name, info)
    if own is None or entry.value is None:
        return entry.value
    model = entry.registry.parameters_of(own)
    return entry.registry.validated(entry.name, model, entry.value, info)


class ByName(Spec):
    """A table whose keys name classes of a sort: ours are its fields, others are user classes."""

    model_config = ConfigDict(extra="allow")
    registry: ClassVar[Registry]
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(_read_named)]]

    @model_validator(mode="before")
    @classmethod
    def _user_classes_know_their_names(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        own = cls.registry
        return {
            name: value
            if name in own.built_in or not isinstance(name, str)
            else _Named(own, name, value)
            for name, value in data.items()
        }

    @classmethod
    def with_keys(cls, name: str, keys: Mapping[str, tuple[Any, str]]) -> Any:
        """The table with optional keys besides: what each holds, and its meaning."""
        fields: dict[str, Any] = {
            key: (held | None, Field(None, description=meaning))
            for key, (held, meaning) in keys.items()
        }
        return create_model(
            name, __base__=cls, __doc__=cls.__doc__, __module__=cls.__module__, **fields
        )


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
