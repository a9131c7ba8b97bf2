"""Base of every settings class: frozen, strict about names, tolerant about number types, documented by its fields.

An option is declared once, as a field with its description, limits and example. The commented configuration file, the
documentation page and the help texts of the command line are generated from these fields.
"""

from __future__ import annotations

import difflib
import inspect
import re
import reprlib
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    WithJsonSchema,
    model_validator,
)


@dataclass(frozen=True)
class Tuning:
    """Limits of options."""

    #: [1/s] largest frame rate
    #: convention: chosen; no camera is near it
    max_fps: int = 10**9
    #: [characters] of the text of a frame rate
    #: convention: a fraction of two whole numbers has fewer
    most_characters: int = 60
    #: [1] that a message lists
    #: convention: a few lines of text
    most_problems: int = 8
    #: [characters] of a key in a message
    #: convention: a line of text
    longest_key: int = 120


TUNING = Tuning()

_EXPONENT = re.compile(r"^[^eE]*([eE][+-]?[0-9]{1,2})?$")
# Annotations of numbers; those of true or false have no number in them.
_NUMBER = re.compile(r"\b(int|float)\b")
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = TUNING.longest_key


def parse_fps(value: object) -> Fraction:
    """Frame rate as an exact fraction, from 1000, 59.94, "30000/1001" or a Fraction.

    Raises
    ------
    ValueError
        If the value is not a number, not positive, or above 1e9.
    """
    # Repr shortens a long text, and an int of more digits than Python converts.
    found = reprlib.repr(value)
    msg = f"expected frames per second, a positive number such as 1000, 59.94 or 30000/1001; found {found}"
    if isinstance(value, bool) or not isinstance(value, int | float | str | Fraction):
        raise ValueError(msg)  # noqa: TRY004 - pydantic turns ValueError into a message with the key's path
    # Of the text: 59.94 is 5994/100, not the nearest binary number.
    text = str(value).strip()
    # The fraction of 1e999999999 would have a billion digits.
    if len(text) > TUNING.most_characters or not _EXPONENT.search(text):
        raise ValueError(msg)
    try:
        fps = Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise ValueError(msg) from None
    if not 0 < fps <= TUNING.max_fps:
        raise ValueError(msg)
    return fps


def write_fps(fps: Fraction) -> float | str:
    """Frame rate for a TOML file: a number where that is exact, otherwise a fraction as text."""
    return float(fps) if Fraction(str(float(fps))) == fps else str(fps)


Fps = Annotated[
    Fraction,
    BeforeValidator(parse_fps),
    PlainSerializer(write_fps, return_type=float | str),
    WithJsonSchema({"type": "number", "exclusiveMinimum": 0}),
]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
# In mm or mm/px, from nanometres to kilometres, and in Hz: beyond, the unit is another one.
Length = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
Frequency = Annotated[float, Field(ge=1e-9, le=TUNING.max_fps, allow_inf_nan=False)]
Point = tuple[Finite, Finite]


class Options(BaseModel):
    """A group of options; NumPy numbers and arrays are accepted wherever plain numbers and lists are."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Append the fields to the class docstring, in numpydoc's form, and shorten the signature to the defaults."""
        head = inspect.cleandoc(cls.__doc__ or "").partition("\n\nAttributes\n")[0]
        fields = (
            f"{name} : {'required' if field.is_required() else f'default {field.default!r}'}\n    {field.description}"
            for name, field in cls.model_fields.items()
            if field.description
        )
        cls.__doc__ = "\n".join([head, "", "Attributes", "----------", *fields])
        cls.__signature__ = inspect.Signature(
            [
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=field.default)
                for name, field in cls.model_fields.items()
            ]
        )

    @model_validator(mode="before")
    @classmethod
    def _plain_numbers(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        arrays = {key for key, field in cls.model_fields.items() if "ndarray" in str(field.annotation)}
        plain = {
            key: value.tolist() if hasattr(value, "tolist") and key not in arrays else value
            for key, value in data.items()
        }
        numbers = {key for key, field in cls.model_fields.items() if _NUMBER.search(str(field.annotation))}
        return {key: _without_truth(value) if key in numbers else value for key, value in plain.items()}


def _without_truth(value: Any) -> Any:
    """The value with ``true`` and ``false``, which would be 1 and 0, as text, which is refused for a number."""
    if isinstance(value, bool):
        return str(value).lower()
    return [_without_truth(one) for one in value] if isinstance(value, list | tuple) else value


class Settings(Options):
    """Options that are given in Python; mistakes raise a one-line `ValueError`."""

    def __init__(self, /, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            msg = "; ".join(problems(error, type(self)))
            raise ValueError(msg) from None


def problems(error: ValidationError, model: type[BaseModel]) -> Iterator[str]:
    """One sentence per mistake in values of `model`: the option's path, what was expected and what was found.

    Of many mistakes the first few are named, and the keys of a section once; long values are shortened.
    """
    listed: set[type[BaseModel]] = set()
    for count, detail in enumerate(error.errors()):
        if count == TUNING.most_problems:
            yield f"and {error.error_count() - count} more"
            return
        path = ".".join(str(part + 1) if isinstance(part, int) else part for part in detail["loc"])
        if detail["type"] == "extra_forbidden":
            section = section_at(model, detail["loc"][:-1])
            known = list(section.model_fields)
            close = difflib.get_close_matches(str(detail["loc"][-1])[: TUNING.longest_key], known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            if not close and section not in listed:
                listed.add(section)
                hint = "; known keys are " + ", ".join(known)
            yield f"unknown key {_SHORT.repr(path)}{hint}"
            continue
        text = detail["msg"].removeprefix("Value error, ")
        found = (
            "" if detail["type"] in ("missing", "value_error") else f", found {_SHORT.repr(detail['input'])}"
        )
        yield f"{path}: {text[:1].lower()}{text[1:]}{found}" if path else text


def section_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> type[BaseModel]:
    """Model of the section at an error's location; list indices and pydantic's own tags are skipped."""
    for part in loc:
        field = model.model_fields.get(str(part))
        model = model if field is None else next(models_in(field.annotation), model)
    return model


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models that an annotation such as ``tuple[Section, ...] | None`` mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from models_in(argument)
