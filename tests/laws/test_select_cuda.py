"""The selection on a device: the cut of the definition, that of the processor, and the same rows by the baselines."""

from dataclasses import replace

import numpy as np
import pytest

from splatree import InputError, Scene, SelectOptions, select
from splatree.kernels.cuda.baselines import Baselines
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.renderer import Renderer
from splatree.lod.blocks import with_blocks
from splatree.scene.view import view_of

from .test_select_kernel import PROFILES, VIEW_TESTS, assert_is_the_cut, random_camera, random_scene, random_tau

SEEDS = range(12)


def renderer_of(scene: Scene, device: Device, *, rows: int = 4096) -> Renderer:
    assert scene.blocks is not None
    return Renderer(device, scene.gaussians, scene.tree, scene.blocks, scene.ids, rows=rows, pairs=1)


@pytest.mark.parametrize("seed", SEEDS)
def test_rows_are_the_cut_of_the_definition(seed: int, device: Device) -> None:
    scene, camera = (
        with_blocks(random_scene(seed), rows_per_block=[16, 32, 100, 256, 1024][seed % 5]),
        random_camera(seed),
    )
    drawn = renderer_of(scene, device)
    for profile in PROFILES:
        view_test = VIEW_TESTS[(seed + len(profile)) % 3]
        options = SelectOptions(pixel_error=random_tau(seed), profile=profile, view_test=view_test)  # type: ignore[arg-type]
        rows, num_visited = drawn.select(view_of(scene, camera), options)
        assert np.all(np.diff(rows) > 0)
        assert len(rows) <= num_visited or options.view_test == "none"
        assert_is_the_cut(rows, scene, camera, options, 0.3)


@pytest.mark.parametrize("seed", SEEDS)
def test_device_and_processor_select_the_same_outside_the_band(seed: int, device: Device) -> None:
    scene, camera = with_blocks(random_scene(seed)), random_camera(seed)
    drawn = renderer_of(scene, device, rows=16)  # grows on the way
    options = SelectOptions(pixel_error=random_tau(seed))
    found, _ = drawn.select(view_of(scene, camera), options)
    wanted = select(scene, camera, options).rows
    # Rounding moves a node over τ_R or over the border of the image once in many thousand.
    assert len(np.setxor1d(found, wanted)) <= 2


@pytest.mark.parametrize("seed", SEEDS)
def test_baselines_find_the_same_rows(seed: int, device: Device) -> None:
    scene, camera = with_blocks(random_scene(seed)), random_camera(seed)
    options, view = SelectOptions(pixel_error=random_tau(seed)), view_of(scene, camera)
    drawn = renderer_of(scene, device)
    wanted, _ = drawn.select(view, options)
    others = Baselines(drawn.device, drawn.scene, scene.tree)
    for find in (others.serial, others.paper):
        np.testing.assert_array_equal(np.sort(find(view, options)), wanted)


def test_schedule_does_not_change_the_rows(emulator: Device) -> None:
    scene, camera = with_blocks(random_scene(3), rows_per_block=32), random_camera(3)
    drawn = renderer_of(scene, emulator)
    found = []
    for seed in (1, 2, 3):
        emulator.seed(seed)  # type: ignore[attr-defined]
        found.append(drawn.select(view_of(scene, camera), SelectOptions())[0])
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_other_rules_are_refused(device: Device) -> None:
    scene = with_blocks(random_scene(1))
    drawn, view = renderer_of(scene, device), view_of(scene, random_camera(1))
    for options in (SelectOptions(rule="release"), SelectOptions(max_radius=700)):
        with pytest.raises(InputError, match="use device 'cpu' for others"):
            drawn.select(view, options)
    with pytest.raises(InputError, match="found a budget"):
        drawn.select(view, replace(SelectOptions(), budget=10))
