"""Learned perceptual image patch similarity, version 0.1 (Zhang 2018): needs the extra ``lpips`` (torch) and its weights.

Both pictures, scaled to [−1, 1] and standardised, go through the convolutions of a classifier (the *trunk*). At five layers
the features are normalised over the channels at each pixel, subtracted, squared, weighted by a trained non-negative vector
(the *heads*), averaged over the picture and summed (Zhang 2018, Eq. 1)::

    d = Σ_l mean_hw ( w_l · (y_l(a) − y_l(b))² )

Smaller is nearer; 0 for equal pictures. Papers of the field report ``vgg`` (Kerbl 2023, whose code feeds [0, 1] instead of
[−1, 1], which lowers the values); the authors of LPIPS recommend ``alex``.

Nothing is downloaded. Weights come from files that you name, or else from where torch and the packages ``lpips`` and
``torchmetrics`` keep theirs.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from splatree.errors import FormatError, InputError, MissingExtraError
from splatree.metrics.psnr import comparable
from splatree.shapes import Array, Float32

Net = Literal["alex", "vgg"]
"""The trunk: AlexNet, or VGG-16."""

_POOL2, _POOL3 = (2, 2), (3, 2)  # edge and stride of a max-pooling, px
_Conv = tuple[
    int, int, int, int, int
]  # index in torchvision's `features`, channels in, channels out, edge px, stride px

LAYERS: Final[dict[Net, tuple[tuple[_Conv | tuple[int, int], ...], ...]]] = {
    "alex": (
        ((0, 3, 64, 11, 4),),
        (_POOL3, (3, 64, 192, 5, 1)),
        (_POOL3, (6, 192, 384, 3, 1)),
        ((8, 384, 256, 3, 1),),
        ((10, 256, 256, 3, 1),),
    ),
    "vgg": (
        ((0, 3, 64, 3, 1), (2, 64, 64, 3, 1)),
        (_POOL2, (5, 64, 128, 3, 1), (7, 128, 128, 3, 1)),
        (_POOL2, (10, 128, 256, 3, 1), (12, 256, 256, 3, 1), (14, 256, 256, 3, 1)),
        (_POOL2, (17, 256, 512, 3, 1), (19, 512, 512, 3, 1), (21, 512, 512, 3, 1)),
        (_POOL2, (24, 512, 512, 3, 1), (26, 512, 512, 3, 1), (28, 512, 512, 3, 1)),
    ),
}
"""Steps between the five compared layers; each convolution is followed by a ReLU (Krizhevsky 2014; Simonyan 2015)."""

TRUNK_FILE: Final[dict[Net, str]] = {"alex": "alexnet-owt-7be5be79.pth", "vgg": "vgg16-397923af.pth"}
"""Names of torchvision's ImageNet weights, at https://download.pytorch.org/models/."""

SHIFT: Final = (-0.030, -0.088, -0.188)
"""Mean of ImageNet's pictures in [−1, 1], RGB (Zhang 2018, code)."""

SCALE: Final = (0.458, 0.448, 0.450)
"""Standard deviation of the same (Zhang 2018, code)."""

EPSILON: Final = 1e-10
"""Added to the length of a feature, so that a zero feature stays zero (Zhang 2018, code)."""


class Lpips:
    """A loaded network: ``Lpips()(image, reference)``."""

    def __init__(self, net: Net = "alex", *, trunk: Path | None = None, heads: Path | None = None) -> None:
        """Load the weights: ``trunk`` from torchvision, ``heads`` of LPIPS version 0.1; None: from torch's and pip's folders.

        Raises:
            MissingExtraError: torch is not installed.
            InputError: a file of weights was not found.
            FormatError: a file does not hold the weights of this network.
        """
        if net not in LAYERS:
            raise InputError(f"lpips: found net {net!r}, wanted one of {', '.join(LAYERS)}")
        self._torch = _import_torch()
        self._net: Net = net
        features = self._load(trunk or self._find_trunk())
        linear = self._load(heads or self._find_heads())
        self._convolutions = {
            conv[0]: (
                self._tensor(features, f"features.{conv[0]}.weight", (conv[2], conv[1], conv[3], conv[3])),
                self._tensor(features, f"features.{conv[0]}.bias", (conv[2],)),
            )
            for layer in LAYERS[net]
            for conv in layer
            if len(conv) == 5
        }
        self._heads = [
            self._tensor(linear, f"lin{i}.model.1.weight", (1, layer[-1][2], 1, 1))  # type: ignore[misc]
            for i, layer in enumerate(LAYERS[net])
        ]

    def __call__(self, image: Float32[Array, "h w 3"], reference: Float32[Array, "h w 3"]) -> float:
        """Return the distance of two pictures with values 0 to 1; what is above or below is clipped."""
        torch = self._torch
        a, b = (np.clip(x, 0, 1).astype(np.float32) for x in comparable(image, reference))
        if a.ndim != 3 or a.shape[2] != 3:
            raise InputError(f"lpips: found pictures of shape {a.shape}, wanted (h w 3)")
        if min(a.shape[:2]) < 32:  # the trunk shrinks a picture by 16 and pools over 3: less leaves an empty layer
            raise InputError(f"lpips: found pictures of {a.shape[1]} × {a.shape[0]} px, wanted at least 32 × 32")
        x = torch.from_numpy(np.stack([a, b])).permute(0, 3, 1, 2) * 2 - 1
        x = (x - torch.tensor(SHIFT).view(1, 3, 1, 1)) / torch.tensor(SCALE).view(1, 3, 1, 1)
        distance = 0.0
        with torch.inference_mode():
            for layer, head in zip(LAYERS[self._net], self._heads, strict=True):
                for step in layer:
                    x = self._step(x, step)
                y = x / (x.square().sum(dim=1, keepdim=True).sqrt() + EPSILON)
                distance += float(((y[:1] - y[1:]).square() * head).sum(dim=1).mean())
        return distance

    def _step(self, x: Any, step: tuple[int, ...]) -> Any:
        functional = self._torch.nn.functional
        if len(step) == 2:
            return functional.max_pool2d(x, step[0], step[1])
        weight, bias = self._convolutions[step[0]]
        padding = 2 if step[3] == 11 else step[3] // 2  # AlexNet's first layer pads 2 of its 11 px
        return functional.relu(functional.conv2d(x, weight, bias, stride=step[4], padding=padding))

    def _find_trunk(self) -> Path:
        name = TRUNK_FILE[self._net]
        path = Path(self._torch.hub.get_dir()) / "checkpoints" / name
        if not path.exists():
            raise InputError(
                f"lpips: the trunk's weights {path} do not exist; download https://download.pytorch.org/models/{name} "
                "there, or name your copy with trunk="
            )
        return path

    def _find_heads(self) -> Path:
        for package, folder in (("lpips", "weights/v0.1"), ("torchmetrics", "functional/image/lpips_models")):
            spec = find_spec(package)
            if spec is not None and spec.origin is not None:
                path = Path(spec.origin).parent / folder / f"{self._net}.pth"
                if path.exists():
                    return path
        raise InputError(
            f"lpips: found no weights of the heads; pip install lpips, or name a copy of its weights/v0.1/{self._net}.pth "
            "with heads="
        )

    def _load(self, path: Path) -> dict[str, Any]:
        if not path.exists():
            raise InputError(f"lpips: {path} does not exist")
        try:
            loaded = self._torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # torch raises whatever its unpickler or zip reader raises
            raise FormatError(f"{path}: is not a file of torch weights ({error})") from error
        if not isinstance(loaded, dict):
            raise FormatError(f"{path}: found a {type(loaded).__name__}, wanted a dict of tensors")
        return loaded

    def _tensor(self, weights: dict[str, Any], key: str, shape: tuple[int, ...]) -> Any:
        found = tuple(weights[key].shape) if key in weights else "nothing"
        if found != shape:
            raise FormatError(
                f"lpips {self._net}: weight {key}: found {found}, wanted {shape}; is it another network's file?"
            )
        return weights[key].float()


def _import_torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise MissingExtraError("torch", "lpips", "LPIPS") from error
    return torch
