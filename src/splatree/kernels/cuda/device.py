"""The GPU of this process, and the scenes that lie on it."""

from functools import cache
from weakref import WeakKeyDictionary

from splatree.kernels.cpu.blocks import index_blocks
from splatree.kernels.cuda.compile import load_compiler
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.library import load_driver
from splatree.kernels.cuda.renderer import Renderer
from splatree.scene.scene import Scene

__all__ = ["open_device", "renderer_of"]


@cache
def open_device(ordinal: int = 0) -> Device:
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
        renderer = Renderer(open_device(), scene.gaussians, scene.tree, blocks, scene.ids)
        _renderers[scene] = renderer
    return renderer


_renderers: WeakKeyDictionary[Scene, Renderer] = WeakKeyDictionary()
