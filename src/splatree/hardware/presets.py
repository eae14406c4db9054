"""Named machines, and machines from TOML files and ``group.name=value`` settings."""

import dataclasses
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from splatree.errors import InputError
from splatree.hardware.config import BackEnd, Dram, Machine, Records, Step1, Step2

__all__ = ["PRESETS", "changed", "machine_from_toml", "machine_to_toml", "preset"]

PRESETS: Mapping[str, Machine] = {
    "jo2024": Machine(),
    "gscore-like": Machine(
        name="gscore-like",
        clock_mhz=1000.0,
        clustering=False,
        order="index",
        sram_kb=272.0,
        dram=Dram(bandwidth_gbps=51.2),
        step1=Step1(buffer_kb=16.0),
        step2=Step2(buffer_kb=32.0),
        back=BackEnd(bin_kb=32.0, sort_kb=8.0, renderers=1, cache_kb=32.0),
        records=Records("fp16"),
    ),
    "neo-like": Machine(
        name="neo-like",
        clock_mhz=1000.0,
        clustering=False,
        order="index",
        back=BackEnd(renderers=4),
        records=Records("fp16"),
    ),
    "splatree": Machine(
        name="splatree",
        dram=Dram(line_bytes=32),
        back=BackEnd(overlaps=True),
        records=Records("fixed"),
    ),
}
"""`jo2024` is the paper's; `gscore-like` has GSCore's units and memory, `neo-like` the four renderers of Neo, both without
identification of clusters. `splatree` is ours, with the area and the bandwidth of `jo2024`: records of 8 and 24 bits, the DRAM's
bursts of 32 bytes as requests, and frames that overlap."""


def preset(name: str) -> Machine:
    """A machine by name.

    Raises:
        InputError: there is none of that name.
    """
    if name not in PRESETS:
        raise InputError(f"preset: found {name!r}, wanted one of {', '.join(PRESETS)}")
    return PRESETS[name]


def changed(machine: Machine, settings: Iterable[str]) -> Machine:
    """The machine with settings such as ``dram.bandwidth_gbps=51.2`` or ``clustering=false``.

    Raises:
        InputError: a setting has no ``=``, names nothing, or its value is of another type.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator:
            raise InputError(f"set: found {setting!r}, wanted NAME=VALUE, as in dram.bandwidth_gbps=51.2")
        *groups, name = key.strip().split(".")
        inner = values
        for group in groups:
            inner = inner.setdefault(group, {})
            if not isinstance(inner, dict):
                raise InputError(f"{key}: {group!r} is one setting, found {name!r} of it")
        inner[name] = text.strip()
    result: Machine = _with(machine, values, "")
    return result


def machine_from_toml(path: Path) -> Machine:
    """Read a machine; what the file leaves out is as in the preset that it names under ``preset``, else as in `jo2024`.

    Raises:
        InputError: the file is not TOML, or a name or value is none of a machine.
    """
    try:
        values = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: found text that is not TOML, wanted a machine: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    result: Machine = _with(preset(str(values.pop("preset", "jo2024"))), values, "")
    return result


def machine_to_toml(machine: Machine) -> str:
    """The machine as TOML, every field written out."""
    top, groups = [], []
    for entry in dataclasses.fields(machine):
        value = getattr(machine, entry.name)
        if dataclasses.is_dataclass(value):
            lines = [f"{f.name} = {_toml(getattr(value, f.name))}" for f in dataclasses.fields(value)]
            groups.append("\n".join([f"\n[{entry.name}]", *lines]))
        else:
            top.append(f"{entry.name} = {_toml(value)}")
    return "\n".join([*top, *groups]) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _with(part: Any, values: Mapping[str, Any], prefix: str) -> Any:
    """The struct with all of the values at once: what holds of it together is checked when all are there."""
    fields = {f.name: getattr(part, f.name) for f in dataclasses.fields(part)}
    new = {}
    for name, value in values.items():
        key = prefix + name
        if name not in fields:
            near = get_close_matches(name, fields, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"{key}: found no such setting, wanted one of {', '.join(fields)}{hint}")
        is_group = dataclasses.is_dataclass(fields[name])
        if is_group and not isinstance(value, dict):
            inner = ", ".join(f"{key}.{f.name}" for f in dataclasses.fields(fields[name]))
            raise InputError(f"{key}: found a group of settings, wanted one of {inner}")
        if isinstance(value, dict) and not is_group:
            raise InputError(f"{key}: is one setting, found {', '.join(map(repr, value))} of it")
        kind = get_type_hints(type(part))[name]
        new[name] = _with(fields[name], value, f"{key}.") if is_group else _parsed(value, kind, key)
    return dataclasses.replace(part, **new)


def _parsed(value: object, kind: Any, key: str) -> Any:
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise InputError(f"{key}: found {value!r}, wanted one of {', '.join(get_args(kind))}")
        return value
    if kind is bool:
        if str(value).lower() not in ("true", "false"):
            raise InputError(f"{key}: found {value!r}, wanted true or false")
        return str(value).lower() == "true"
    if kind is str:
        return str(value)
    try:
        number = float(str(value))
    except ValueError:
        raise InputError(f"{key}: found {value!r}, wanted a number") from None
    if kind is int:
        if number != int(number):
            raise InputError(f"{key}: found {value!r}, wanted a whole number")
        return int(number)
    return number
