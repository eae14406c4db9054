import dataclasses
import importlib
import inspect
import json
import pkgutil
import re
from fractions import Fraction
from pathlib import Path
from typing import Literal, get_type_hints

import numpy as np
import pytest

import splatree
from splatree import InputError, Scene
from splatree.scene.literals import _Choices, _choices_from_field, check_literals
from splatree.scene.options import RenderOptions

from ..scenes import gaussians


@dataclasses.dataclass(frozen=True)
class Struct:
    name: Literal["red", "green"] = "red"
    other: Literal["red", "green"] | None = None
    size: float | Literal["auto"] | None = None
    repair: bool | Literal["drop"] = False
    several: tuple[Literal["x", "y"], ...] = ()
    count: int = 1
    share: float | None = None
    place: tuple[float, float, float] | None = None
    file: int | Path = 8
    host: str = "here"

    def __post_init__(self) -> None:
        check_literals(self)


@pytest.mark.parametrize(
    "fields",
    [
        {"name": "green"},
        {"name": np.str_("green")},
        {"other": "green"},
        {"size": 1},
        {"size": np.float32(1)},
        {"size": "auto"},
        {"repair": True},
        {"repair": "drop"},
        {"repair": np.True_},
        {"count": np.int64(3)},
        {"share": 1},
        {"share": np.float64("nan")},
        {"place": [1, 2.5, np.float32(3)]},
        {"place": np.zeros(3)},
        {"file": 3},
        {"file": Path("names.txt")},
    ],
)
def test_values_of_the_annotation_pass(fields):
    Struct(**fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"name": "gren"}, "Struct.name: found 'gren', wanted 'red' or 'green'; did you mean 'green'?"),
        ({"name": None}, "Struct.name: found None, wanted 'red' or 'green'"),
        ({"name": ["red"]}, "Struct.name: found ['red'], wanted 'red' or 'green'"),
        ({"other": "blue"}, "Struct.other: found 'blue', wanted 'red', 'green' or None"),
        ({"size": "atuo"}, "Struct.size: found 'atuo', wanted 'auto', a number or None; did you mean 'auto'?"),
        ({"repair": 1}, "Struct.repair: found 1, wanted 'drop' or True or False"),
        ({"count": 1.0}, "Struct.count: found 1.0, wanted a whole number"),
        ({"count": True}, "Struct.count: found True, wanted a whole number"),
        ({"count": "3"}, "Struct.count: found '3', wanted a whole number"),
        ({"count": 2**63}, "Struct.count: found 9223372036854775808, wanted a whole number"),
        ({"count": None}, "Struct.count: found None, wanted a whole number"),
        ({"share": "0.5"}, "Struct.share: found '0.5', wanted a number or None"),
        ({"place": (1, 2)}, "Struct.place: found (1, 2), wanted 3 numbers or None"),
        ({"place": "xyz"}, "Struct.place: found 'xyz', wanted 3 numbers or None"),
        ({"place": (1, 2, "3")}, "Struct.place: found (1, 2, '3'), wanted 3 numbers or None"),
        ({"file": 1.5}, "Struct.file: found 1.5, wanted a whole number or a path"),
        ({"host": Path("here")}, f"Struct.host: found {Path('here')!r}, wanted a text"),
    ],
)
def test_other_values_are_named_with_what_was_wanted(fields, message):
    with pytest.raises(InputError) as error:
        Struct(**fields)
    assert str(error.value) == message


def test_a_path_may_be_a_text():
    assert Struct(file="names.txt").file == Path("names.txt")


@pytest.mark.parametrize(
    ("fields", "settled"),
    [
        ({"name": np.str_("green")}, "green"),
        ({"size": np.float32(1.5)}, 1.5),
        ({"size": np.longdouble(1.5)}, 1.5),
        ({"share": np.int16(2)}, 2),
        ({"share": Fraction(1, 4)}, 0.25),
        ({"repair": np.True_}, True),
        ({"count": np.uint8(3)}, 3),
        ({"place": np.array([1, 2.5, 3], np.float32)}, (1.0, 2.5, 3.0)),
        ({"place": [1, np.float64(2), 3]}, (1, 2.0, 3)),
        ({"file": np.int64(3)}, 3),
    ],
)
def test_numbers_and_texts_of_numpy_become_pythons_own(fields, settled):
    [name] = fields
    value = getattr(Struct(**fields), name)
    assert repr(value) == repr(settled) and type(value) is type(settled)


_NUMPYS = {bool: np.bool_, int: np.int64, float: np.float32, str: np.str_}


@pytest.mark.parametrize(
    "struct",
    [
        splatree.RefineOptions,
        splatree.TrainOptions,
        splatree.BuildOptions,
        splatree.RenderOptions,
        splatree.SelectOptions,
        splatree.PathOptions,
    ],
)
def test_options_of_numpys_numbers_can_be_written_down(struct):
    own = dataclasses.asdict(struct())
    given = {name: _NUMPYS[type(value)](value) for name, value in own.items() if type(value) in _NUMPYS}
    assert given and any(type(value) in (np.int64, np.float32) for value in given.values())
    rounded = {name: float(np.float32(value)) if type(value) is float else value for name, value in own.items()}
    assert json.dumps(dataclasses.asdict(struct(**given))) == json.dumps(rounded)


def _structs_that_users_build() -> list[type]:
    """Every dataclass of the package that is called options, or is a public name, and that has a field with a Literal."""
    found = set()
    for module in pkgutil.walk_packages(splatree.__path__, "splatree."):
        if module.name.startswith("splatree.cli") or module.name.endswith(("__main__", "._core")):
            continue  # the command line's own parser checks its names
        try:
            loaded = importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] == "splatree":
                raise
            continue  # a module of an extra that is not installed, such as the circuit's
        for name, value in vars(loaded).items():
            if inspect.isclass(value) and dataclasses.is_dataclass(value) and value.__module__ == module.name:
                is_public = name.endswith("Options") or name in splatree.__all__
                has_names = any("Literal" in str(hint) for hint in get_type_hints(value).values())
                if is_public and (has_names or (name.endswith(("Options", "RunFiles")) and name in splatree.__all__)):
                    found.add(value)
    return sorted(found, key=lambda struct: struct.__name__)


def _example(struct: type) -> object:
    """An instance of the struct with plausible values in the fields that have no default."""
    if struct is Scene:
        return Scene.flat(gaussians(3, 0))
    if struct is splatree.SceneHead:
        return splatree.SceneHead(3, 0)
    if struct is splatree.Selection:
        return splatree.Selection(np.zeros(0, np.int32), "cut", "pixel", 1.0)
    values = {}
    for field in dataclasses.fields(struct):
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            choices = _choices_from_field(struct).get(field.name)
            values[field.name] = _plausible(choices) if choices else None
    return struct(**values)


def _plausible(choices: _Choices) -> object:
    if choices.values:
        return choices.values[0]
    kind = choices.types[0]
    if dataclasses.is_dataclass(kind):
        return Scene.flat(gaussians(3, 0)) if kind is Scene else object.__new__(kind)
    return kind()


STRUCTS = _structs_that_users_build()


def test_the_structs_with_names_are_found():
    assert {"MergeOptions", "RenderOptions", "ReadOptions", "CalibrateOptions", "Scene"} <= {
        s.__name__ for s in STRUCTS
    }


@pytest.mark.parametrize("struct", STRUCTS, ids=lambda struct: struct.__name__)
def test_every_name_in_every_struct_is_checked(struct):
    example = _example(struct)
    choices = _choices_from_field(struct)
    assert choices
    is_chosen = struct.__name__.endswith(("Options", "RunFiles")) and struct.__name__ in splatree.__all__
    for name in choices:
        if not (is_chosen or choices[name].values):
            continue  # of what the library makes itself
        value = "nonsense" if choices[name].values else [None]
        with pytest.raises(InputError, match=rf"^{struct.__name__}\.{name}: found {re.escape(repr(value))}, wanted "):
            dataclasses.replace(example, **{name: value})


def test_a_typo_in_the_mode_draws_nothing():
    with pytest.raises(InputError, match="did you mean 'antialiased'"):
        RenderOptions(mode="antialised")
