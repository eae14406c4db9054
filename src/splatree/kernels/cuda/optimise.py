"""A step of the optimiser on a device (optimise.cu); kernels/reference/optimise.py is the definition."""

import numpy as np

from splatree.kernels.cpu.train.optimise import corrections
from splatree.kernels.cuda.driver import Device
from splatree.kernels.cuda.job import pack_fields
from splatree.kernels.cuda.sources import threads_of
from splatree.kernels.reference.optimise import BETA_1, BETA_2, COLUMNS, EPSILON
from splatree.scene.gaussians import Gaussians
from splatree.scene.gradients import GaussianGradients, Moments
from splatree.shapes import Array, Float32

__all__ = ["step"]

WARP = 32


def step(
    device: Device,
    gaussians: Gaussians,
    gradients: GaussianGradients,
    moments: Moments,
    rates: Float32[Array, "e"],
    ramp_steps: int,
) -> None:
    """Change the columns of the Gaussians and the moments in place; only the rows that were drawn travel."""
    rows = gradients.rows
    if not len(rows):
        return
    steps = moments.steps[rows].astype(np.uint32)
    given = {
        "rows": np.arange(len(rows), dtype=np.int32),
        **{f"by_{name}": getattr(gradients, name) for name in COLUMNS},
        **{name: getattr(gaussians, name)[rows] for name in COLUMNS},
        "moments": moments.values[rows],
        "steps": steps,
        "rates": rates,
        "corrections": corrections()[: int(steps.max()) + 2],
        "numbers": np.array([1 / ramp_steps, BETA_1, BETA_2, EPSILON], np.float32),
    }
    arrays = {name: device.upload(np.ascontiguousarray(values), name=name) for name, values in given.items()}
    pointers = {name: array.pointer for name, array in arrays.items()}
    sizes = {"num_rows": len(rows), "num_coefficients": gaussians.sh.shape[1], "num_moments": len(rates)}
    job = device.upload(pack_fields("cuda/optimise.h", "StepJob", pointers, sizes))
    device.launch("step_rows", -(-len(rows) * WARP // threads_of("step_rows")), job)
    for name in COLUMNS:
        getattr(gaussians, name)[rows] = arrays[name].numpy()
    moments.values[rows], moments.steps[rows] = arrays["moments"].numpy(), arrays["steps"].numpy()
