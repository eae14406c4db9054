"""Every back end has the stages of the contract, by their names and with their arguments."""

import inspect
from typing import get_args

import numpy as np
import pytest

import splatree as st
from splatree.kernels import contract, cuda
from splatree.kernels.cuda.stages import Stages
from splatree.kernels.devices import (
    DLPACK_KINDS,
    DeviceName,
    back_end,
    feature_of,
    stages_of,
    training_stages_of,
)

from ..scenes import camera, gaussians

STAGES = ("select", "project", "bin", "blend")
OPTIONAL = ("blend_backward", "project_backward", "photo_loss", "step")


def arguments_of(stage: object) -> list[tuple[str, object, object]]:
    """Name, kind and default of each argument, the object itself left out."""
    found = inspect.signature(stage).parameters.values()  # type: ignore[arg-type]
    return [(p.name, p.kind, p.default) for p in found if p.name != "self"]


def stages_by_name(device: str) -> object:
    """The stages, of the class where the device is not there."""
    return Stages if back_end(device) is cuda else stages_of(device)


@pytest.mark.parametrize("device", get_args(DeviceName))
@pytest.mark.parametrize("stage", STAGES)
def test_a_back_end_has_the_stages_of_the_contract(device: str, stage: str) -> None:
    wanted = arguments_of(getattr(contract.FrameStages, stage))
    found = arguments_of(getattr(stages_by_name(device), stage))
    assert found[: len(wanted)] == wanted
    # What a back end takes beside that is for its own tests.
    assert all(
        kind == inspect.Parameter.KEYWORD_ONLY and default is not None for _, kind, default in found[len(wanted) :]
    )


@pytest.mark.parametrize("device", get_args(DeviceName))
@pytest.mark.parametrize("stage", OPTIONAL)
def test_an_optional_stage_is_missing_or_as_the_contract_says(device: str, stage: str) -> None:
    found = getattr(stages_by_name(device), stage, None)
    assert found is None or arguments_of(found) == arguments_of(getattr(contract.BackwardStages, stage))


@pytest.mark.parametrize("device", ["cpu", "reference"])
def test_cuts_of_a_range_are_found_as_the_contract_says(device: str) -> None:
    assert arguments_of(stages_of(device).select_range) == arguments_of(contract.RangeStages.select_range)


def test_stages_of_one_back_end_take_what_those_of_another_leave() -> None:
    scene, view = st.Scene.flat(gaussians(100, 1)), st.View(camera())
    rows = np.arange(100, dtype=np.int32)
    cpu, reference = stages_of("cpu"), stages_of("reference")
    splats = reference.project(scene.gaussians, None, rows, view)
    picture = reference.blend(splats, cpu.bin(splats, view), view)
    own = cpu.blend(splats, cpu.bin(splats, view), view)
    assert st.psnr(picture.image, own.image) > 80


def test_a_name_that_no_back_end_has_is_refused() -> None:
    with pytest.raises(st.InputError, match="device: found 'metal', wanted one of cpu, cuda, reference"):
        stages_of("metal")


def test_what_a_back_end_does_not_have_is_not_supported() -> None:
    assert feature_of("cpu", "hold") is None
    assert feature_of("reference", "borrow") is None
    assert set(DLPACK_KINDS.values()) <= set(get_args(DeviceName))


def test_back_ends_that_train_say_so() -> None:
    for device in ("cpu", "reference"):
        assert all(hasattr(training_stages_of(device), stage) for stage in (*STAGES, *OPTIONAL))
