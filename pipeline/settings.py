"""Settings of a stage: frozen, complete and range-checked. On the command line they are written as ``stage.key=value``.

What several stages share is written ``group.key=value`` and reaches all of them. The command line, the cache key and the record for
replaying a run are all derived from the same object.
"""

import difflib
import inspect
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from .errors import SettingsError


class Settings(BaseModel):
    """Base class of every stage's settings. Give each field a range and a description (``Field(8, ge=0, description=...)``).

    A field of type ``Path`` enters the cache key as the content of the file, not its name.

    group: of a class from which the settings of several stages inherit: its own fields are written ``group.key`` and are set for all of
    them at once. "" for the settings of a single stage.
    renamed: names that settings had in earlier versions, with their present full names. The old names are understood, and said.
    dropped: names of settings that earlier versions had, with what is done now. They have no effect, which is said.
    respelled: older spellings of values, by setting: ``{"motion": {"auto": None}}``.
    """

    group: ClassVar[str] = ""
    renamed: ClassVar[Mapping[str, str]] = {}
    dropped: ClassVar[Mapping[str, str]] = {}
    respelled: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with other values. Raises ValueError for a name that is no setting: pydantic would keep it beside the settings."""
        if unknown := set(update or ()) - set(type(self).model_fields):
            raise ValueError(f"{type(self).__name__} has no setting {', '.join(sorted(unknown))}")
        return super().model_copy(update=update, deep=deep)


def split_assignment(text: str) -> tuple[str, str, str]:
    """``"fine.iterations=300"`` -> ``("fine", "iterations", "300")``; raises SettingsError."""
    name, equals, value = text.partition("=")
    stage, dot, key = name.strip().partition(".")
    if not equals or not dot or not stage or not key:
        raise SettingsError(f"--set {text}: expected stage.key=value, for example --set frames.holdout=8")
    return stage, key, value.strip()


def build_settings(
    classes: Mapping[str, type[Settings]], assignments: Iterable[tuple[str, Any]], say: Callable[[str], None] = lambda line: None
) -> dict[str, Settings]:
    """The settings of every stage: the defaults, then the assignments in order (a later one wins).

    ``classes`` maps stage names to settings classes. An assignment is ``("stage.key", value)`` or ``("group.key", value)``; a string value
    is parsed according to the field's type. ``say`` gets a line for each name or value in an older spelling. Raises a SettingsError that
    lists the valid keys or the field's range.
    """
    names = settings_by_name(classes)
    values: dict[str, dict[str, Any]] = {stage: {} for stage in classes}
    for given, value in assignments:
        if given not in names and (now := _dropped(given, classes)):
            say(f"{given} is no longer a setting and has no effect: {now}")
            continue
        name = given if given in names else _present_name(given, classes, names)
        key, (stages, field) = name.partition(".")[2], names[name]
        if name != given:
            say(f"{given} is now {name}" + (f", which {' and '.join(stages)} share" if len(stages) > 1 else ""))
        older = _older_values(classes[stages[0]], key)
        if isinstance(value, str) and value in older:
            say(f"{name}={value} is now {name}={'none' if older[value] is None else older[value]}")
            value = older[value]
        for stage in stages:
            values[stage][key] = _parse(name, field, value)
    built = {}
    for stage, cls in classes.items():
        try:
            built[stage] = cls(**values[stage])
        except ValidationError as error:
            raise SettingsError(f"settings of {stage}: {_messages(error)}") from None
    return built


def settings_by_name(classes: Mapping[str, type[Settings]]) -> dict[str, tuple[list[str], FieldInfo]]:
    """Every setting by its full name, ``stage.key`` or ``group.key``: the stages that have it, and its field."""
    found: dict[str, tuple[list[str], FieldInfo]] = {}
    for stage, cls in classes.items():
        for key, field in cls.model_fields.items():
            found.setdefault(_full_name(stage, cls, key), ([], field))[0].append(stage)
    return found


def _full_name(stage: str, cls: type[Settings], key: str) -> str:
    """The group is that of the class that defines the field: a stage's own class may define it anew."""
    definer = next(base for base in cls.__mro__ if key in inspect.get_annotations(base))
    return f"{definer.__dict__.get('group') or stage}.{key}"


def _older_values(cls: type[Settings], key: str) -> Mapping[str, Any]:
    """What the values of a setting were called, by its own class or by one that it inherits from."""
    return next((found for base in cls.__mro__ if (found := base.__dict__.get("respelled", {}).get(key))), {})


def _dropped(given: str, classes: Mapping[str, type[Settings]]) -> str | None:
    """What is done now in place of a setting that earlier versions had; None if there was none of that name."""
    stage, _, key = given.partition(".")
    found = (base.__dict__.get("dropped", {}).get(key) for base in (classes[stage].__mro__ if stage in classes else ()))
    return next(filter(None, found), None)


def _present_name(given: str, classes: Mapping[str, type[Settings]], names: Mapping[str, tuple[list[str], FieldInfo]]) -> str:
    """The name today of a setting in an older spelling. Raises SettingsError if there never was such a setting."""
    first, _, key = given.partition(".")
    members = {first: [first]} if first in classes else {}
    for name, (stages, _) in names.items():
        members.setdefault(name.partition(".")[0], stages)
    if first not in members:
        known = ", ".join(dict.fromkeys([*classes, *members]))
        raise SettingsError(f"{given}: there is no stage {first!r}{_hint(first, members)}; stages: {known}")
    for stage in members[first]:
        if key in classes[stage].model_fields:
            return _full_name(stage, classes[stage], key)
        for cls in classes[stage].__mro__:
            if new := cls.__dict__.get("renamed", {}).get(key):
                return new
    own = {name: field for name, (_, field) in names.items() if name.startswith(f"{first}.")}
    listed = "\n  ".join(describe(name, field) for name, field in own.items()) or "(none)"
    hint = _hint(key, [name.partition(".")[2] for name in own])
    raise SettingsError(f"{given}: {first} has no setting {key!r}{hint}; its settings are:\n  {listed}")


def describe(name: str, field: FieldInfo) -> str:
    """One line that describes the setting ``name``: its type, range, default and description."""
    kind = getattr(field.annotation, "__name__", None) if not getattr(field.annotation, "__args__", None) else None
    kind = kind or str(field.annotation).replace("typing.", "").replace("pathlib.", "")
    limits = []
    for item in field.metadata:
        for attribute, sign in (
            ("ge", ">="),
            ("gt", ">"),
            ("le", "<="),
            ("lt", "<"),
            ("min_length", "length >="),
            ("max_length", "length <="),
        ):
            if (limit := getattr(item, attribute, None)) is not None:
                limits.append(f"{sign} {limit}")
    default = "required" if field.is_required() else f"default {field.get_default(call_default_factory=True)!r}"
    text = f"{name}: {' '.join([kind, ' and '.join(limits)]).strip()}, {default}"
    return f"{text}. {field.description}" if field.description else text


def _parse(name: str, field: FieldInfo, value: Any) -> Any:
    kind: Any = Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    candidates = [value]
    if isinstance(value, str):
        if value.lower() in ("none", "null"):
            candidates.insert(0, None)
        elif value[:1] in ("[", "{"):
            candidates.append(_json(value))
        elif "," in value or _wants_list(adapter, value):
            candidates.append([part.strip() for part in value.split(",")])
    first: ValidationError | None = None
    for candidate in candidates:
        try:
            return adapter.validate_python(candidate)
        except ValidationError as error:
            first = error
    assert first is not None
    raise SettingsError(f"{name}={value}: {_messages(first)}\n  {describe(name, field)}") from None


def _wants_list(adapter: TypeAdapter[Any], value: str) -> bool:
    """Whether a field refuses ``value`` because it is no list; then a single value is a list of one."""
    try:
        adapter.validate_python(value)
    except ValidationError as error:
        return any(item["type"] in ("tuple_type", "list_type") for item in error.errors())
    return False


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def _messages(error: ValidationError) -> str:
    parts = []
    found = error.errors()
    for item in found:
        if item["type"] == "too_short" and len(found) > 1:
            continue  # pydantic counts what is left without the entries that are wrong, and those have messages of their own
        told = f"give at least {item['ctx']['min_length']}, separated by commas" if item["type"] == "too_short" else item["msg"]
        *where, last = item["loc"] or ("",)
        if isinstance(last, int) and item["type"] == "literal_error":
            told, last = f"{item['input']!r} is not allowed; give {item['ctx']['expected']}", f"entry {last + 1}"
        place = ".".join(map(str, [*where, last]))
        parts.append(f"{place}: {told}" if place else told)
    return "; ".join(dict.fromkeys(parts))


def _hint(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
