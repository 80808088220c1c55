"""YAML files are checked against pydantic models, and one sentence tells
what is wrong.
"""

from __future__ import annotations

import reprlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from dextar_control.contract.errors import ParameterError
from dextar_control.contract.yaml_text import load_document

M = TypeVar("M", bound=BaseModel)


def load_yaml(model: type[M], path: str | Path, what: str) -> M:
    """Return the model that a YAML file holds.

    Args:
        model: its class.
        path: of the file.
        what: names the kind of file in messages.

    Raises:
        ParameterError: the file cannot be read, or something in it is unknown, missing
            or out of its range.
    """
    return validate(model, load_document(path, what), f"{what} {path}")


def validate(model: type[M], data: object, source: str) -> M:
    """Return the model that plain data hold.

    Args:
        model: its class.
        data: mappings, lists and scalars.
        source: names the data in messages.

    Raises:
        ParameterError: something in it is unknown, missing or out of its range.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(
            str(part) for part in first["loc"] if part not in ("float", "str")
        )
        if first["type"] == "dextar":
            said = first["msg"]
        elif first["type"] == "missing":
            said = "it is missing"
        else:
            said = (
                f"{reprlib.repr(first['input'])} is not valid:"
                f" {first['msg'][0].lower()}{first['msg'][1:]}"
            )
        raise ParameterError(
            f"{source}: {where}: {said}" if where else f"{source}: {said}"
        ) from error


def problem(text: str) -> PydanticCustomError:
    """Return the error that a validator raises to be quoted in its own words."""
    return PydanticCustomError("dextar", "{text}", {"text": text})


def unknown(name: str, known: Collection[str], what: str) -> str:
    """Return the sentence that tells of a name that does not exist."""
    return f"unknown {what} '{name}'; known are: {', '.join(known)}"


class Section(BaseModel):  # type: ignore[explicit-any]  # pydantic's own, unseen
    """A part of a YAML file: a mapping of known keys to values of the right types,
    which never change.
    """

    model_config = ConfigDict(strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: object) -> object:
        if not isinstance(data, Mapping):
            raise problem(
                f"it must be a mapping with some of: {', '.join(cls.model_fields)}"
            )
        for key in data:
            if key not in cls.model_fields:
                raise problem(unknown(key, cls.model_fields, "key"))
        return data
