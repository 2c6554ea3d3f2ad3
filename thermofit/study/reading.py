"""What is read of a study while a record is made of it: the sections by which that record is fresh, and no other.

A record is fresh where its key is what it was. The key is a list of sections, and a list could forget one that is read: the record would
then stay fresh although what it was made of has changed. So while it is made every section that the key lacks refuses to be read, in this
process and in the workers that solve parts of it; nothing that was kept from an earlier evaluation can hide such a read, for it is not the
reads that are counted. Of a parameter that the key holds by its value alone, bounds and scale refuse as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from pydantic import BaseModel

from thermofit.study.section import ParameterStart

Key = Mapping[str, Any]
"""Sections of the study by dotted name ('mesh', 'stages.elastic'), and what else a record is fresh by."""
_key: ContextVar[Key | None] = ContextVar("sections that may be read", default=None)
FREELY = {"": ("name",), "numerics": ("threads",)}
"""What may be read by all, by section: the name of the study and the number of threads change no result."""


class UndeclaredRead(RuntimeError):
    """A section is read that the key of the record lacks: a mistake in the stage, not of the user."""


@contextmanager
def reading(key: Key | None) -> Iterator[None]:
    """Within it only the sections of `key` can be read; None: all."""
    token = _key.set(key)
    try:
        yield
    finally:
        _key.reset(token)


def read_by() -> Key | None:
    """The key of the record that is being made, None where none is."""
    return _key.get()


def seen(name: str, value: Any) -> Any:
    """A section of that name as it may be read now. UndeclaredRead where it may not, or later where a part of it is read that may not."""
    key = _key.get()
    if key is None or name in FREELY[""]:
        return value
    if name in key:
        return _values(value, key[name]) if name == "parameters" else value
    parts = {other.partition(".")[2] for other in key if other.startswith(f"{name}.")}
    if name == "parameters" and parts:
        return _Entries(value, parts)
    if parts or name in FREELY:
        return _PartOfSection(name, value, parts | {*FREELY.get(name, ())})
    raise _undeclared(name)


def _undeclared(name: str) -> UndeclaredRead:
    return UndeclaredRead(f"section '{name}' of the study is read, but the key of the record lacks it: add it where the key is made")


class _PartOfSection:
    """A section of which only some keys may be read."""

    def __init__(self, name: str, section: BaseModel, keys: set[str]) -> None:
        self._name, self._section, self._keys = name, section, keys

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = getattr(self._section, name)
        if name not in type(self._section).model_fields or name in self._keys:
            return value
        if parts := {key.partition(".")[2] for key in self._keys if key.startswith(f"{name}.")}:
            return _PartOfSection(f"{self._name}.{name}", value, parts)
        raise _undeclared(f"{self._name}.{name}")


class _Entries(dict[str, Any]):
    """Parameters of which only some may be read, one by one."""

    def __init__(self, values: Mapping[str, Any], names: set[str]) -> None:
        super().__init__({name: value for name, value in values.items() if name in names})
        self._names = names

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            raise _undeclared(f"parameters.{name}")
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        return self[name] if name in self else default

    def __contains__(self, name: object) -> bool:
        if name not in self._names:
            raise _undeclared(f"parameters.{name}")
        return super().__contains__(name)

    def __iter__(self) -> Iterator[str]:
        raise _undeclared("parameters")

    def __len__(self) -> int:
        raise _undeclared("parameters")

    def _whole(self) -> Any:
        raise _undeclared("parameters")

    items = keys = values = _whole


class _ValueOnly(ParameterStart):
    """A parameter of which the key holds the value alone."""

    def __getattribute__(self, name: str) -> Any:
        if name in ("bounds", "scale"):
            raise _undeclared(f"parameters.*.{name}")
        return super().__getattribute__(name)


def _values(settings: Mapping[str, float | ParameterStart], key: Mapping[str, Any]) -> dict[str, float | ParameterStart]:
    """The parameters as the key holds them."""
    out = dict(settings)
    for name, setting in settings.items():
        if isinstance(setting, ParameterStart) and isinstance(key.get(name), int | float):
            out[name] = _ValueOnly.model_construct(start=setting.start)
    return out
