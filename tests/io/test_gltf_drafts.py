"""glTF of drafts, and of extensions that are required and not known."""

import json

import numpy as np
import pytest

import splatree
from splatree import FormatError
from splatree.constants import SH_C0

from ..scenes import random_gaussians
from .conftest import same_bits
from .test_gltf import changed, glb, parts, primitive, written

PREFIX = "KHR_gaussian_splatting:"


@pytest.mark.parametrize("prefix", ["_", ""])
def test_attributes_of_drafts(tmp_path, prefix):
    def change(content):
        attributes = primitive(content)["attributes"]
        primitive(content)["attributes"] = {k.replace(PREFIX, prefix): v for k, v in attributes.items()}

    g = random_gaussians(40, 2)
    path = changed(tmp_path, change, g)
    now = splatree.read(tmp_path / "a.glb").gaussians
    found = splatree.read(path).gaussians
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert same_bits(getattr(found, name), getattr(now, name))


@pytest.mark.parametrize("name", ["CESIUM_gaussian_splatting", "CESIUM_gaussian_splats"])
def test_the_first_draft_has_opacity_in_the_colour(tmp_path, name):
    def change(content):
        attributes = primitive(content)["attributes"]
        kept = ("POSITION", "COLOR_0", f"{PREFIX}ROTATION", f"{PREFIX}SCALE")
        primitive(content)["attributes"] = {k.replace(PREFIX, "_"): v for k, v in attributes.items() if k in kept}
        primitive(content)["extensions"] = {name: {}}

    g = random_gaussians(40, 0)
    found = splatree.read(changed(tmp_path, change, g)).gaussians
    np.testing.assert_allclose(found.opacities(), g.opacities(), atol=0.51 / 255)
    np.testing.assert_allclose(0.5 + SH_C0 * found.sh, np.clip(0.5 + SH_C0 * g.sh, 0, 1), atol=0.51 / 255)


def test_colour_and_higher_harmonics_stand_together(tmp_path):
    def change(content):
        primitive(content)["attributes"].pop(f"{PREFIX}SH_DEGREE_0_COEF_0")

    g = random_gaussians(40, 1)
    found = splatree.read(changed(tmp_path, change, g)).gaussians
    np.testing.assert_allclose(0.5 + SH_C0 * found.sh[:, 0], np.clip(0.5 + SH_C0 * g.sh[:, 0], 0, 1), atol=0.51 / 255)
    assert same_bits(found.sh[:, 1:].copy(), splatree.read(tmp_path / "a.glb").gaussians.sh[:, 1:].copy())


@pytest.mark.parametrize(
    "name",
    [
        "KHR_gaussian_splatting_compression_spz",
        "KHR_gaussian_splatting_spz_compression",
        "KHR_spz_gaussian_splats_compression",
        "KHR_spz_compression",
    ],
)
@pytest.mark.parametrize("is_nested", [True, False])
def test_packed_extensions_of_drafts(tmp_path, name, is_nested):
    written(random_gaussians(40, 1), tmp_path / "a.glb", packing="spz")
    content, binary = parts((tmp_path / "a.glb").read_bytes())
    extension = primitive(content)["extensions"]["KHR_gaussian_splatting"]
    packed = {name: extension.pop("extensions")["KHR_gaussian_splatting_compression_spz_2"]}
    if is_nested:
        extension["extensions"] = packed
    else:
        primitive(content)["extensions"] = packed
    content["extensionsUsed"] = content["extensionsRequired"] = [name]
    (tmp_path / "b.glb").write_bytes(glb(content, binary))
    assert same_bits(splatree.read(tmp_path / "b.glb").gaussians.sh, splatree.read(tmp_path / "a.glb").gaussians.sh)


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_draco_mesh_compression", "KHR_gaussian_splatting_3"])
def test_required_extensions_that_are_not_known_are_refused(tmp_path, name):
    path = changed(tmp_path, lambda content: content.update(extensionsRequired=[name]))
    with pytest.raises(FormatError, match=f"requires the extension '{name}'"):
        splatree.read(path)


def test_instances_that_are_required_have_advice_of_their_own(tmp_path):
    path = changed(tmp_path, lambda content: content.update(extensionsRequired=["EXT_mesh_gpu_instancing"]))
    with pytest.raises(FormatError, match=r"'EXT_mesh_gpu_instancing', .*; write each copy as a node of its own"):
        splatree.read(path)


@pytest.mark.parametrize("where", ["buffers", "accessors"])
def test_numbers_that_an_optional_extension_packs_are_missing_by_its_name(tmp_path, where):
    """EXT_meshopt_compression may leave a buffer without data behind, Draco an accessor without a view."""

    def change(content):
        content["extensionsUsed"] += ["KHR_materials_unlit", "EXT_meshopt_compression"]
        if where == "accessors":
            content["accessors"][0].pop("bufferView")
            return
        content["buffers"].append(
            content["buffers"][0] | {"extensions": {"EXT_meshopt_compression": {"fallback": True}}}
        )
        content["bufferViews"][0]["buffer"] = 1

    with pytest.raises(
        FormatError, match=rf"{where}\[\d\]: found .*; the file uses EXT_meshopt_compression, not known here"
    ):
        splatree.read(changed(tmp_path, change))


def test_required_extensions_of_what_is_not_drawn_do_not_matter(tmp_path):
    required = ["KHR_gaussian_splatting", "KHR_materials_unlit", "KHR_texture_basisu", "KHR_mesh_quantization"]
    assert len(splatree.read(changed(tmp_path, lambda content: content.update(extensionsRequired=required)))) == 40


def test_attributes_that_are_not_known_are_named_as_lost(tmp_path):
    def change(content):
        primitive(content)["attributes"]["_FEATURE_ID_0"] = 0
        primitive(content)["attributes"]["KHR_gaussian_splatting:SH_DEGREE_4_COEF_0"] = 0

    lost = json.loads(splatree.read(changed(tmp_path, change)).source.metadata["lost"])
    assert lost == [
        "the attributes _FEATURE_ID_0, KHR_gaussian_splatting:SH_DEGREE_4_COEF_0: splatree does not know them, and draws "
        "without them"
    ]
