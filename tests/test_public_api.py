import ast
import dataclasses
import inspect
import itertools
import subprocess
import sys
import typing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import splatree
from splatree.view.options import ViewOptions

from .scenes import random_gaussians


def test_public_names_are_sorted_and_can_be_loaded():
    assert splatree.__all__ == sorted(splatree.__all__)
    assert dir(splatree) == splatree.__all__
    for name in splatree.__all__:
        assert not inspect.ismodule(getattr(splatree, name))
        assert getattr(splatree, name).__name__ == name


def test_public_structs_are_frozen():
    """Shapes are checked once, when a struct is made; they hold because nothing is replaced in it afterwards."""
    structs = [value for name in splatree.__all__ if dataclasses.is_dataclass(value := getattr(splatree, name))]
    assert len(structs) > 20
    assert [struct.__name__ for struct in structs if not struct.__dataclass_params__.frozen] == []


def test_type_checkers_see_the_names_that_are_loaded():
    tree = ast.parse(Path(splatree.__file__).with_suffix(".pyi").read_text())
    imports = [statement for statement in tree.body if isinstance(statement, ast.ImportFrom)]
    seen = {alias.asname: statement.module for statement in imports for alias in statement.names}
    assert seen == splatree._HOME, "run scripts/names"


def test_a_name_is_listed_once():
    listed = [name for names in splatree._NAMES.values() for name in names]
    assert sorted(listed) == splatree.__all__
    assert list(splatree._NAMES) == sorted(splatree._NAMES)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'renderer'"):
        splatree.renderer  # noqa: B018


@pytest.mark.parametrize("first", ["splatree.render.paths", "splatree.render", "splatree.cli.demo"])
def test_render_is_the_function_whatever_is_imported_first(first):
    code = f"import {first}, splatree; print(splatree.render.__name__, callable(splatree.render))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["render", "True"]


def test_public_names_say_what_they_are():
    silent = [name for name in splatree.__all__ if not inspect.getdoc(getattr(splatree, name))]
    assert silent == []


def test_import_loads_nothing_heavy():
    heavy = ("numpy", "PIL", "rich", "safetensors", "torch", "tyro", "imageio_ffmpeg", "splatree.cli")
    code = f"import sys, splatree; print(*(name for name in {heavy} if name in sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def _functions():
    return [getattr(splatree, name) for name in splatree.__all__ if inspect.isfunction(getattr(splatree, name))]


@pytest.mark.parametrize("function", _functions(), ids=lambda function: function.__name__)
def test_public_functions_name_an_argument_of_a_wrong_kind(function):
    """Whatever an argument may be, it may not be a lambda with two arguments, unless it may be anything or a function.

    Inputs, one path or several, are refused by who opens them (tests/io/test_local.py).
    """
    hints = {
        name: hint
        for name, hint in typing.get_type_hints(function).items()
        if name in inspect.signature(function).parameters
        and hint is not typing.Any
        and "Callable" not in str(hint)
        and "Selector" not in str(hint)
        and "Sequence[str | os.PathLike[str]]" not in str(hint)
    }
    kinds = {name: inspect.signature(function).parameters[name].kind for name in hints}
    for name in hints:
        if kinds[name] is not inspect.Parameter.VAR_KEYWORD:
            with pytest.raises(splatree.InputError, match="found"):
                function(**{name: lambda a, b: None})


@pytest.mark.parametrize("wrong", [0, "", (), False])
def test_what_is_false_is_not_taken_for_what_is_not_given(wrong):
    scene = splatree.Scene.flat(random_gaussians(5, degree=0))
    camera = splatree.Camera.look_at([0, 0, -5], [0, 0, 0], width=8, height=8)
    for name in ("select", "options", "device"):
        with pytest.raises(splatree.InputError, match=rf"^render: {name}: found .*, wanted"):
            splatree.render(scene, camera, **{name: wrong})
    with splatree.open_session(scene) as session:
        for name in ("select", "options"):
            with pytest.raises(splatree.InputError, match=rf"^draw: {name}: found .*, wanted"):
                session.draw(camera, **{name: wrong})


def test_what_worked_goes_on_to_work(tmp_path):
    """Cameras one after the other, in the place of a list; a number of NumPy; a path as a text."""
    scene, cameras = splatree.build_lod(_small()), [CAMERA, CAMERA]
    assert splatree.time_frames(scene, iter(cameras), views=1, warm_up=0).num_frames == 2
    splatree.write_cameras((camera for camera in cameras), str(tmp_path / "a.json"))
    assert len(splatree.measure_pops(scene, iter(cameras))) == 1
    assert splatree.calibrate(_small(), reversed(cameras)).threshold > 0
    assert splatree.psnr(PICTURE, PICTURE, peak=np.float32(1)) == np.inf
    with pytest.raises(splatree.InputError, match="cameras: found cycle"):
        splatree.through(itertools.cycle(cameras), 3)


def _small():
    return splatree.Scene.flat(random_gaussians(5, degree=0))


CAMERA = splatree.Camera.look_at([0, 0, -5], [0, 0, 0], width=8, height=8)
PICTURE = np.zeros((16, 16, 3), np.float32)
NONE = np.zeros((0, 3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: splatree.psnr(PICTURE, PICTURE, peak=float("nan")), "peak: found nan, wanted more than 0"),
        (lambda: splatree.ssim(PICTURE, PICTURE, peak=0), "peak: found 0, wanted more than 0"),
        (lambda: splatree.ssim(PICTURE, PICTURE, peak=1e308), r"peak: found 1e\+308, wanted"),
        (lambda: splatree.flyout(_small(), farthest=float("inf")), "found nearest 0.3 and farthest inf, wanted"),
        (lambda: splatree.frame_scene(_small(), aspect=-1.5), "aspect: found -1.5, wanted width over height"),
        (lambda: splatree.frame_scene(_small(), aspect=float("nan")), "aspect: found nan"),
        (
            lambda: splatree.clean(_small(), splatree.CleanOptions(max_distance=3), cameras=NONE),
            r"shape \(0, 3\), wanted",
        ),
        (
            lambda: splatree.clean(_small(), splatree.CleanOptions(max_distance=3), cameras=[1.0, 2.0]),
            r"shape \(2,\), wan",
        ),
        (lambda: splatree.read("a\0.ply"), r"'a\\x00.ply': found a zero in a path"),
        (lambda: splatree.write(_small(), "a\0.ply"), r"'a\\x00.ply': found a zero in a path"),
        (
            lambda: splatree.write(_small(), "a.splatree", depth=2.5),
            "write: depth: found 2.5, wanted a whole number or None",
        ),
        (lambda: splatree.through(CAMERA, 3), r"cameras: found one Camera, wanted some, such as \[camera\]"),
        (lambda: splatree.through(range(3), 3), "cameras: found int, wanted one|camera: found int, wanted one Camera"),
        (lambda: splatree.evaluate(_small(), [CAMERA], photos=0), "evaluate: photos: found 0, wanted"),
        (lambda: splatree.cull(_small(), CAMERA), "cull: clusters: found Scene, wanted ClusterIndex"),
        (
            lambda: splatree.frame_scene(_small().gaussians),
            r"^frame_scene: found Gaussians, wanted a Scene; make one with",
        ),
        (lambda: splatree.Camera.look_at("here", [0, 0, 1]), "look_at: found what is no point"),
        (
            lambda: splatree.Camera.look_at([0, 0, 0], [0, 0, 1], width=None),
            "look_at: width: found None, wanted a number",
        ),
        (
            lambda: splatree.Camera.look_at([0, 0, 0], [0, 0, 1], fov_y_deg=180),
            "found fov_y_deg 180, wanted more than 0",
        ),
        (lambda: replace(CAMERA, near=None), "found near = None, wanted a number"),
        (lambda: replace(_small(), blocks=0), "Scene.blocks: found 0, wanted BlockIndex or None"),
        (lambda: replace(_small(), gaussians=None), "Scene.gaussians: found None, wanted Gaussians"),
        (lambda: replace(_small().gaussians, sh=None), "Gaussians.sh: found NoneType, wanted a NumPy array"),
        (lambda: splatree.Moving(guard="wide"), "Moving.guard: found 'wide', wanted a number"),
        (
            lambda: ViewOptions(allow_origin="https://hub.example"),
            "allow_origin: found 'https://hub.example', wanted several",
        ),
        (lambda: ViewOptions(up=(0, 0, 0)), r"up: found \(0, 0, 0\), wanted a direction"),
    ],
)
def test_arguments_that_mean_nothing_are_named(call, message):
    with pytest.raises((splatree.InputError, splatree.ShapeError), match=message):
        call()
