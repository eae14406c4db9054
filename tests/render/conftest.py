"""A GPU for what the library opens."""

from functools import partial

import pytest

from splatree.kernels.cuda import device as cuda_device
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.renderer import Renderer


@pytest.fixture
def at_hand(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """The device is every GPU that the library opens; with little room at first, as the emulator watches every word."""
    monkeypatch.setattr(cuda_device, "open_device", lambda ordinal: device)
    monkeypatch.setattr(cuda_device, "Renderer", partial(Renderer, rows=256, pairs=1024))
    return device
