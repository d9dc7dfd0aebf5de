"""Errors of a rig file in one line: file, field, value, what is allowed, and the nearest name to a typo."""

from __future__ import annotations

import difflib
import json
import re
from typing import TYPE_CHECKING, Any, get_args

from pydantic import BaseModel
from pydantic_core import PydanticCustomError

from rig.errors import BadInput

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pydantic import ValidationError
    from pydantic_core import ErrorDetails

_CROSS_FIELD = "cross_field"
_LONGEST_VALUE = 60
_PLAIN = re.compile(r"[A-Za-z0-9_-]+")


def cross_field(field: str, value: object, allowed: str) -> PydanticCustomError:
    """Describe a value that is fine alone and contradicts another one.

    Parameters
    ----------
    field : str
        Dotted path of the field.
    value : object
        What the file says.
    allowed : str
        What would do.
    """
    context = {"field": field, "value": _show(value), "allowed": allowed}
    return PydanticCustomError(_CROSS_FIELD, "{field} = {value} does not fit; allowed: {allowed}", context)


def nearest(name: str, names: Iterable[str]) -> str:
    """Suggest the name that was probably meant, as the end of a sentence; empty when none is close.

    Parameters
    ----------
    name : str
        What was written.
    names : iterable of str
        What could have been.
    """
    known = list(names)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f", did you mean {close[0]}?" if close else f" ({', '.join(known)})"


def explain(error: ValidationError, content: dict[str, Any], model: type[BaseModel], where: str) -> BadInput:
    """Turn pydantic's findings into one line about the first of them.

    Parameters
    ----------
    error : ValidationError
        What pydantic found.
    content : dict
        What the file says.
    model : type
        The model that the file was read as.
    where : str
        The file.
    """
    findings = error.errors(include_url=False)
    # A typo in a required field is reported twice, as missing and as unknown: the unknown name is the cause.
    findings.sort(key=lambda finding: finding["type"] != "extra_forbidden")
    what, todo = _describe(findings[0], content, model)
    more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    return BadInput(what, where=where, todo=todo + more)


def _describe(finding: ErrorDetails, content: dict[str, Any], model: type[BaseModel]) -> tuple[str, str]:
    location, _ = _walk(finding["loc"], model)
    field = _dotted(location)
    if finding["type"] == _CROSS_FIELD:
        context = finding["ctx"]
        return f"{context['field']} = {context['value']} does not fit", f"allowed: {context['allowed']}"
    if finding["type"] == "extra_forbidden":
        known = list(_walk(finding["loc"][:-1], model)[1].model_fields)
        return f"unknown field {field}", f"use a known name{nearest(str(location[-1]), known)}"
    allowed = _description(finding["loc"], model)
    if finding["type"] == "missing":
        return f"{field} is missing", f"add it: {allowed}" if allowed else "add it"
    todo = f"allowed: {allowed}" if allowed else "correct it"
    if finding["type"] in {"too_short", "too_long"} or not _has(content, location):
        return f"{field}: {_lower(finding['msg'])}", todo
    return f"{field} = {_show(_value(content, location))}: {_lower(finding['msg'])}", todo


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for step in location:
        if step == "[key]":
            continue
        if isinstance(step, int):
            text += f"[{step}]"
        else:
            text += f".{step}" if _PLAIN.fullmatch(step) else f".{_show(step)}"
    return text.removeprefix(".")


def _walk(
    location: tuple[int | str, ...], model: type[BaseModel]
) -> tuple[tuple[int | str, ...], type[BaseModel]]:
    """Follow a location through the models: the way as the file has it, and the model at its last step.

    Where a field may hold one of several models, pydantic adds the tag of the one it took.
    """
    path: list[int | str] = []
    choices: list[type[BaseModel]] = []
    for step in location:
        tagged = [choice for choice in choices if _has_tag(choice, step)]
        if tagged:
            model, choices = tagged[0], []
            continue
        path.append(step)
        if isinstance(step, str) and step in model.model_fields:
            choices = _models_in(model.model_fields[step].annotation)
            model = choices[0] if choices else model
    return tuple(path), model


def _models_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and not get_args(annotation):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for inner in get_args(annotation) for model in _models_in(inner)]


def _has_tag(model: type[BaseModel], tag: int | str) -> bool:
    return any(get_args(field.annotation) == (tag,) for field in model.model_fields.values())


def _description(location: tuple[int | str, ...], model: type[BaseModel]) -> str:
    """Find what the innermost documented field on the way says of itself."""
    text = ""
    for depth, step in enumerate(location):
        fields = _walk(location[:depth], model)[1].model_fields
        if isinstance(step, str) and step in fields:
            text = fields[step].description or text
    return text


def _value(content: Any, location: tuple[int | str, ...]) -> Any:
    for step in location:
        content = content[step]
    return content


def _has(content: Any, location: tuple[int | str, ...]) -> bool:
    try:
        _value(content, location)
    except (KeyError, IndexError, TypeError):
        return False
    return True


def _show(value: object) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:]
