"""User classes of controls, effects, joints and surfaces, found by their names in scenes.

A name that is none of ours is looked for

1. among the classes that were registered in this process, such as by
   :func:`multiarm.register_effect`;
2. among the entry points of the installed packages, in a group for each sort:

   .. code-block:: toml

       [project.entry-points."multiarm.effects"]
       magnet = "my_package.magnet:Magnet"

3. in a file or module, where the name is written as that of a function is:
   ``effects: {"magnet.py:Magnet": {strength: 2}}``, ``kind: "hinges.py:Hinge"``.

Reading a scene imports no package and runs no file: the parameters of a class that is not
registered stay as they are written until a system is compiled.  The class then validates them, and
every fault has its place, as for our own classes.

The registry uses of a class its name, the model of its parameters, and its method
``definition_fault()``, which says why the class cannot be used and is empty when it can.  A part of
a scene names a class by its key ``kind`` (:meth:`Registry.by_kind`) or as a key of a table
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
    GetCoreSchemaHandler,
    SerializeAsAny,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError, core_schema
from typing_extensions import Self

from multiarm.errors import USER_FAULTS, ModelError, MultiarmError
from multiarm.scene.code import CodeReference, is_reference, load_code
from multiarm.scene.faults import Parts, invalid, listed, sentences, unknown
from multiarm.scene.spec import Spec, written

Kind = TypeVar("Kind")
AnyClass = TypeVar("AnyClass", bound=type)


Classes = Mapping[tuple[str, str], type]
"""User classes that were loaded for a scene, by their sort and name."""
USER_KINDS = "multiarm_user_kinds"
"""In the metadata of a schema: the registry that adds kinds to those of the schema."""


class UserSpec(Spec):
    """Parameters of a user class: keys that are not declared, NaN and infinity are refused."""

    model_config = ConfigDict(allow_inf_nan=False)

    @classmethod
    def field_fault(cls) -> str:
        """Why its fields are not known yet; empty when they are."""
        known = cls.model_rebuild(raise_errors=False) is not False
        return "" if known else "an annotation names what is not known where the class is defined"


class UserKind(UserSpec):
    """Parameters of a class that scenes name by its key ``kind``."""

    class_sort: ClassVar[str] = ""
    picture: ClassVar[str] = ""
    example: ClassVar[str] = ""

    @classmethod
    def sample(cls) -> Self:
        """What the example describes."""
        raise NotImplementedError

    @classmethod
    def example_fault(cls) -> str:
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
    def kind_fault(cls) -> str:
        """Why the class cannot be found by its ``kind``; empty when it can."""
        if cls.field_fault():
            return cls.field_fault()
        kind = cls.kind_name()
        only = get_origin(annotation := cls.model_fields["kind"].annotation) is Literal
        if not only or get_args(annotation) != (kind,) or not str(kind).isidentifier():
            return "'kind' must be a word, written as kind: Literal['word'] = 'word'"
        return ""


@dataclass(eq=False)
class Registry(Generic[Kind]):
    """The user classes of one sort.

    Attributes
    ----------
    sort : str
        The word in the names of the base class, of the function that registers a class, and of the
        group of entry points: ``multiarm.Effect``, ``multiarm.register_effect``,
        ``multiarm.effects``.  Classes have it as ``class_sort``.
    noun, plural : str
        For messages, such as ``control kind`` and ``kinds``.
    built_in : dict
        Our own classes by name.
    not_loaded : type, optional
        Of a sort that is named by ``kind``: what a part is whose class is not loaded.
    registered : dict
        The user classes known to this process, by name; those of files by their references.
    """

    sort: str
    noun: str
    plural: str
    built_in: Mapping[str, Any]
    not_loaded: type[Spec] | None = None
    registered: dict[str, type[Kind]] = field(default_factory=dict)

    @property
    def group(self) -> str:
        """Of the entry points."""
        return f"multiarm.{self.sort}s"

    @property
    def base(self) -> str:
        """Public name of the base class."""
        return f"multiarm.{self.sort.capitalize()}"

    @staticmethod
    def name_of(user_class: Any) -> str:
        """A class's name in scenes."""
        named_by_kind = hasattr(user_class, "kind_name")
        return user_class.kind_name() if named_by_kind else user_class.name

    @staticmethod
    def parameters_of(user_class: Any) -> Any:
        """The model of a class's parameters: itself, or its ``Spec``."""
        return user_class if issubclass(user_class, BaseModel) else user_class.Spec

    def add(self, user_class: AnyClass) -> AnyClass:
        """Let scenes name a class.  Defined and registered once more, it replaces the former one.

        Raises
        ------
        ModelError
            The class cannot be used, or another one has its name.
        """
        self._check(user_class, "cannot be registered")
        name = self.name_of(user_class)
        taken = self.registered.get(name)
        reason = ""
        if taken is not None and _path(taken) != _path(user_class):
            reason = f"{_path(taken)} is registered under that name already"
        for point in self._entry_points(name):
            if point.value.replace(" ", "") != _path(user_class):
                reason = reason or f"{_offered(point)} has that name already; choose another one"
        if reason:
            raise ModelError(f"{self.noun} {name!r}: {reason}")
        self.registered[name] = user_class
        return user_class

    def offers(self, name: str) -> str:
        """The packages, or the file, with a class of a name, in words; empty where none has it."""
        if is_reference(name):
            return CodeReference(name).home
        return " and ".join(sorted({_offered(point) for point in self._entry_points(name)}))

    def find(self, name: str) -> type[Kind] | None:
        """The class of a name, loaded from its package if need be; None where there is none.

        Raises
        ------
        ModelError
            Its package is broken, or several have one.
        """
        if name in self.registered:
            return self.registered[name]
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
            user_class = point.load()
        except USER_FAULTS as error:
            raise ModelError(
                f"{self.noun} {name!r}: {_offered(point)} cannot be loaded, "
                f"{type(error).__name__}: {error}"
            ) from error
        self._check(user_class, f"of {_offered(point)} cannot be used", name)
        self.registered[name] = user_class
        return user_class

    def load(self, name: str) -> type[Kind]:
        """The class of a name, from its package, or from its file as that is now.

        One of a file that is named by ``kind`` gets the reference as its kind.

        Raises
        ------
        ModelError
            There is none; it cannot be loaded (:func:`multiarm.scene.code.load_code`), or is no
            class of this sort.
        """
        if not is_reference(name):
            offered = self.find(name)
            if offered is None:
                raise ModelError(self.unknown(name))
            return offered
        user_class: Any = load_code(CodeReference(name), "class")
        self._check(user_class, "cannot be used")
        if issubclass(user_class, UserKind):
            user_class = _renamed(user_class, name)
        self.registered[name] = user_class
        return user_class

    def names(self) -> list[str]:
        """Names of all classes that are registered or installed."""
        points = metadata.entry_points(group=self.group)
        registered = (name for name in self.registered if not is_reference(name))
        return sorted({*registered, *(point.name for point in points)})

    def classes(self) -> tuple[dict[str, type[Kind]], list[str]]:
        """All classes by name, for which packages are loaded, and why others cannot be used."""
        classes, faults = {}, []
        for name in self.names():
            try:
                user_class = self.find(name)
                assert user_class is not None, "it is registered or installed"
                classes[name] = user_class
            except ModelError as error:
                faults.append(str(error))
        return classes, faults

    def unknown(self, name: object) -> str:
        """The message for a name that no class has."""
        text = unknown(self.noun, name, [*self.built_in, *self.names()], self.plural)
        return (
            f"{text}; {self.plural} of your own need multiarm.register_{self.sort} or their "
            "package, or are named 'file.py:Class'"
        )

    # --- reading scenes ---------------------------------------------------------------------------

    def by_kind(self) -> Any:
        """The type of a table whose key ``kind`` names one of our classes, or a user's."""
        ours: Any = reduce(or_, self.built_in.values())
        tagged: Any = Annotated[ours, Field(discriminator="kind")]
        with_fields: Any = SerializeAsAny[tagged]  # type: ignore[misc]
        return Annotated[with_fields, self]

    def __get_pydantic_core_schema__(
        self, ours: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Validate a table whose type is annotated with the registry."""
        return core_schema.with_info_wrap_validator_function(
            self._read_kind, handler(ours), metadata={USER_KINDS: self}
        )

    def _read_kind(self, value: Any, ours: Callable[[Any], Any], info: ValidationInfo) -> Any:
        """A part with a key ``kind``: ``ours`` reads it if its kind is ours, else a user class."""
        assert self.not_loaded is not None, "the sort is named by 'kind'"
        if isinstance(value, UserKind) and value.class_sort == self.sort:
            return value
        if not isinstance(value, (Mapping, Spec)):
            return ours(value)
        data = written(value)
        if "kind" not in data:
            known = [*self.built_in, *self.names()]
            raise invalid(f"'kind' is missing; kinds are {listed(known)}")
        if str(data["kind"]) in self.built_in:
            return ours(value)
        return self._read_user(data, info)

    def _read_user(self, data: dict[str, Any], info: ValidationInfo) -> Any:
        """A table of a user kind; where its class is not to be loaded, as it is written."""
        kind = self.located(str(data["kind"]), info)
        try:
            user_class = self.class_for(kind, info)
        except PydanticCustomError as error:
            raise validation_error([((kind, "kind"), error.message(), kind)], kind) from None
        model = self.not_loaded if user_class is None else self.parameters_of(user_class)
        return self.validated(kind, model, {**data, "kind": kind}, info, kind)

    @staticmethod
    def located(name: str, info: ValidationInfo) -> str:
        """A name; that of a file gets an absolute path, which starts at the scene's folder."""
        folder = (info.context or {}).get("folder")
        if folder is None or not is_reference(name):
            return name
        return str(CodeReference(name).located(folder))

    def class_for(self, name: str, info: ValidationInfo) -> type[Kind] | None:
        """The class that a scene names; None where it is not loaded yet.

        The context of validators has the ``classes`` that were loaded for the scene, and whether
        it may name ``code``: then a name must be that of a class that can be loaded.
        """
        context = info.context or {}
        loaded: Classes = context.get("classes", {})
        if (self.sort, name) in loaded:
            return loaded[self.sort, name]
        if name in self.registered and not is_reference(name):  # a file is read again
            return self.registered[name]
        if context.get("code", True) and not self.offers(name):
            raise invalid(self.unknown(name))
        return None

    def validated(
        self, name: str, model: Any, value: Any, info: ValidationInfo, *where: str
    ) -> Any:
        """The scene's text read by a model, every fault at its place below ``where``."""
        try:
            return TypeAdapter(model).validate_python(value, context=info.context)
        except ValidationError as error:
            faults = [
                ((*where, *parts), text, wrong) for parts, text, wrong in sentences(error, model)
            ]
            raise validation_error(faults, name) from None
        except PydanticCustomError:
            raise
        except USER_FAULTS as error:
            raise invalid(
                f"the {model.__name__} of {self.noun} {name!r} raised "
                f"{type(error).__name__}: {error}"
            ) from None

    def _check(self, user_class: Any, trouble: str, name: str | None = None) -> None:
        """Raise unless this is a class of the sort, with the name that its package offers."""
        if not isinstance(user_class, type) or getattr(user_class, "class_sort", None) != self.sort:
            raise ModelError(f"{user_class!r} {trouble}: it is no subclass of {self.base}")
        reason = user_class.definition_fault()  # type: ignore[attr-defined]
        class_name = self.name_of(user_class)
        if not reason and name is not None and class_name != name:
            reason = f"its name is {class_name!r}, not {name!r}"
        if reason:
            raise ModelError(f"{_path(user_class)} {trouble}: {reason}")
        if class_name in self.built_in:
            raise ModelError(
                f"{self.noun} {class_name!r}: multiarm itself has one of that name; choose another"
            )

    def _entry_points(self, name: str) -> list[metadata.EntryPoint]:
        return list(metadata.entry_points(group=self.group, name=name))


def _renamed(user_class: type[UserKind], kind: str) -> Any:
    """The class under another name in scenes."""
    field: Any = (Literal[kind], kind)  # type: ignore[valid-type]
    return create_model(
        user_class.__name__,
        __base__=user_class,
        __module__=user_class.__module__,
        __doc__=user_class.__doc__,
        kind=field,
    )


class _Named(NamedTuple):
    """An entry of a table that is no field of its model: its name and its value."""

    registry: Registry
    name: str
    value: Any


def _read_named(entry: Any, info: ValidationInfo) -> Any:
    """The validated parameters of a user class; None where a scene writes null.

    They stay as they are written where the class is not to be loaded.
    """
    if not isinstance(entry, _Named):
        return entry
    registry, name, value = entry
    if isinstance(value, Spec):  # validated by its class already
        return value
    user_class = registry.class_for(name, info)
    if user_class is None or value is None:
        return value
    return registry.validated(name, registry.parameters_of(user_class), value, info)


class ByName(Spec):
    """A table whose keys name classes of a sort: ours are its fields, others are user classes."""

    model_config = ConfigDict(extra="allow")
    registry: ClassVar[Registry]
    __pydantic_extra__: dict[str, Annotated[Any, BeforeValidator(_read_named)]]

    @model_validator(mode="before")
    @classmethod
    def _user_classes_know_their_names(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, Mapping):
            return data
        registry, entries = cls.registry, {}
        for name, value in data.items():
            if name in registry.built_in or not isinstance(name, str):
                entries[name] = value
            else:
                name = registry.located(name, info)
                entries[name] = _Named(registry, name, value)
        return entries

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


def validation_error(faults: list[tuple[Parts, str, Any]], title: str) -> ValidationError:
    """Pydantic's error for faults with their places and the values there."""
    details = [
        InitErrorDetails(type=invalid(text), loc=tuple(parts), input=value)
        for parts, text, value in faults
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


def _path(user_class: type) -> str:
    return f"{user_class.__module__}:{user_class.__qualname__}"
