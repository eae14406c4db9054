"""The GPU of this process, and the scenes that lie on it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from weakref import WeakKeyDictionary

from splatree.kernels.cpu.frame.blocks import index_blocks
from splatree.kernels.cuda.compile import load_compiler
from splatree.kernels.cuda.driver import Device, DeviceArray
from splatree.kernels.cuda.library import load_driver
from splatree.kernels.cuda.renderer import Renderer
from splatree.scene.gaussians import Gaussians
from splatree.scene.scene import Mode, Scene

__all__ = ["keep_on_device", "open_device", "renderer_of"]


@cache
def open_device(ordinal: int) -> Device:
    """The GPU of that number, opened once.

    Raises:
        DeviceError: there is no driver, no GPU or no compiler, or one that is too old; the message says what to do.
    """
    driver = load_driver()
    version = driver.version()
    compiler = load_compiler(version)
    return Device(driver, lambda stage, architecture: compiler.cubin_of(stage, architecture, version), ordinal=ordinal)


def renderer_of(scene: Scene) -> Renderer:
    """The renderer that holds a scene's columns on the device; made once, and gone with the scene."""
    renderer = _renderers.get(scene)
    if renderer is None:
        blocks = scene.blocks or index_blocks(scene.gaussians, scene.tree)
        renderer = Renderer(open_device(0), scene.gaussians, scene.tree, blocks, scene.ids)
        _renderers[scene] = renderer
    return renderer


def keep_on_device(ordinal: int, mode: Mode, columns_on: Callable[[Device], dict[str, DeviceArray]]) -> Scene:
    """A flat scene of columns that lie on the GPU of that number, drawn from where they lie."""
    device = open_device(ordinal)
    columns = columns_on(device)
    scene = Scene.flat(Gaussians(**{name: column.numpy() for name, column in columns.items()}), mode=mode).to("cuda")
    blocks = index_blocks(scene.gaussians, scene.tree)
    scene = replace(scene, blocks=blocks)
    _renderers[scene] = Renderer(device, scene.gaussians, scene.tree, blocks, columns=columns)
    return scene


_renderers: WeakKeyDictionary[Scene, Renderer] = WeakKeyDictionary()
