"""Settings of a stage: frozen, complete and range-checked. On the command line they are written as ``stage.key=value``.

The command line, the cache key and the record for replaying a run are all derived from the same object.
"""

import difflib
import json
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from .errors import SettingsError


class Settings(BaseModel):
    """Base class of every stage's settings. Give each field a range and a description (``Field(8, ge=0, description=...)``).

    A field of type ``Path`` enters the cache key as the content of the file, not its name.

    renamed: names that settings had in earlier versions, with their present names. The old names are not accepted; errors mention the new.
    """

    renamed: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)


def split_assignment(text: str) -> tuple[str, str, str]:
    """``"fine.iterations=300"`` -> ``("fine", "iterations", "300")``; raises SettingsError."""
    name, equals, value = text.partition("=")
    stage, dot, key = name.strip().partition(".")
    if not equals or not dot or not stage or not key:
        raise SettingsError(f"--set {text}: expected stage.key=value, for example --set frames.holdout=8")
    return stage, key, value.strip()


def build_settings(classes: Mapping[str, type[Settings]], assignments: Iterable[tuple[str, Any]]) -> dict[str, Settings]:
    """The settings of every stage: the defaults, then the assignments in order (a later one wins).

    ``classes`` maps stage names to settings classes. An assignment is ``("stage.key", value)``; a string value is parsed
    according to the field's type. Raises a SettingsError that lists the valid keys or the field's range.
    """
    values: dict[str, dict[str, Any]] = {stage: {} for stage in classes}
    for name, value in assignments:
        stage, _, key = name.partition(".")
        if stage not in classes:
            raise SettingsError(f"{name}: there is no stage {stage!r}{_hint(stage, classes)}; stages: {', '.join(classes)}")
        fields = classes[stage].model_fields
        if key not in fields:
            known = "\n  ".join(describe(stage, k, f) for k, f in fields.items()) or "(none)"
            hint = f" (it is now {new!r})" if (new := classes[stage].renamed.get(key)) else _hint(key, fields)
            raise SettingsError(f"{name}: {stage} has no setting {key!r}{hint}; its settings are:\n  {known}")
        values[stage][key] = _parse(stage, key, fields[key], value)
    built = {}
    for stage, cls in classes.items():
        try:
            built[stage] = cls(**values[stage])
        except ValidationError as error:
            raise SettingsError(f"settings of {stage}: {_messages(error)}") from None
    return built


def describe(stage: str, key: str, field: FieldInfo) -> str:
    """One line that describes a setting: its type, range, default and description."""
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
    text = f"{stage}.{key}: {' '.join([kind, ' and '.join(limits)]).strip()}, {default}"
    return f"{text}. {field.description}" if field.description else text


def _parse(stage: str, key: str, field: FieldInfo, value: Any) -> Any:
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
    raise SettingsError(f"{stage}.{key}={value}: {_messages(first)}\n  {describe(stage, key, field)}") from None


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
    for item in error.errors():
        where = ".".join(str(part) for part in item["loc"])
        parts.append(f"{where}: {item['msg']}" if where else item["msg"])
    return "; ".join(dict.fromkeys(parts))


def _hint(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
