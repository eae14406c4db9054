"""The GPU of this process."""

from functools import cache

from splatree.kernels.cuda.compile import load_compiler
from splatree.kernels.cuda.driver import Device, load_driver

__all__ = ["open_device"]


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
