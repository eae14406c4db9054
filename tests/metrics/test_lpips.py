"""The network with random weights of the right shapes: what can be known without the trained ones."""

import importlib.util
import sys

import numpy as np
import pytest

from splatree.errors import FormatError, InputError, MissingExtraError
from splatree.metrics.lpips import LAYERS, Lpips

needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="torch (extra lpips) is not installed"
)


@pytest.fixture(scope="module", params=["alex", "vgg"])
def weights(request, tmp_path_factory):
    """Files of random weights: net, trunk, heads."""
    torch = pytest.importorskip("torch", reason="torch (extra lpips) is not installed")
    generator = torch.Generator().manual_seed(5)

    def random(*shape):
        return torch.randn(shape, generator=generator) / np.sqrt(np.prod(shape[1:]))

    net, folder = request.param, tmp_path_factory.mktemp("lpips")
    convolutions = [step for layer in LAYERS[net] for step in layer if len(step) == 5]
    trunk = {f"features.{i}.weight": random(out, into, edge, edge) for i, into, out, edge, _ in convolutions}
    trunk |= {f"features.{i}.bias": random(out, 1)[:, 0] for i, _, out, _, _ in convolutions}
    heads = {f"lin{i}.model.1.weight": random(1, layer[-1][2], 1, 1).abs() for i, layer in enumerate(LAYERS[net])}
    torch.save(trunk, folder / "trunk.pth")
    torch.save(heads, folder / "heads.pth")
    return net, folder / "trunk.pth", folder / "heads.pth"


@pytest.fixture(scope="module")
def distance(weights):
    net, trunk, heads = weights
    return Lpips(net, trunk=trunk, heads=heads)


@pytest.fixture(scope="module")
def pictures():
    return np.random.default_rng(0).random((2, 64, 80, 3)).astype(np.float32)


def test_equal_pictures_have_distance_zero(distance, pictures):
    assert distance(pictures[0], pictures[0]) == 0.0


def test_distance_is_symmetric_and_positive(distance, pictures):
    a, b = pictures
    assert distance(a, b) > 0
    assert distance(a, b) == pytest.approx(distance(b, a), rel=1e-6)  # float32 sums of a batch in another order


def test_distance_grows_with_the_difference(distance, pictures):
    a, b = pictures
    assert distance(a, a + 0.01 * (b - a)) < distance(a, a + 0.1 * (b - a)) < distance(a, b)


def test_small_picture_is_refused(distance):
    with pytest.raises(InputError, match="at least 32"):
        distance(np.zeros((31, 64, 3)), np.zeros((31, 64, 3)))


def test_weights_of_another_network_are_refused(weights):
    net, trunk, heads = weights
    with pytest.raises(FormatError, match=r"features\.0\.weight|lin0"):
        Lpips("vgg" if net == "alex" else "alex", trunk=trunk, heads=heads)


def test_file_without_weights_is_refused(weights, tmp_path):
    (tmp_path / "weights.pth").write_bytes(b"not a pickle")
    with pytest.raises(FormatError, match=r"weights\.pth"):
        Lpips(weights[0], trunk=tmp_path / "weights.pth", heads=weights[2])


@needs_torch
def test_missing_weights_say_where_to_get_them(tmp_path, monkeypatch):
    import torch

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    with pytest.raises(InputError, match=r"download https://download\.pytorch\.org/models/alexnet"):
        Lpips("alex")
    with pytest.raises(InputError, match="does not exist"):
        Lpips("alex", trunk=tmp_path / "none.pth")


def test_unknown_network_is_refused():
    with pytest.raises(InputError, match="squeeze"):
        Lpips("squeeze")


def test_missing_torch_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'splatree\[lpips\]'"):
        Lpips()
