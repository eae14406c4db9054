"""Draw Gaussians that are in tensors already, as after training: torch's, CuPy's or NumPy's, on the processor or on a GPU.

On a GPU nothing is copied there: kernels read the tensors where they lie, and the picture is handed on as a tensor.
"""

import numpy as np

import splatree as st

try:
    import torch

    on_gpu = torch.cuda.is_available()
except ImportError:
    on_gpu = False

rng = np.random.default_rng(0)
columns = {
    "means": rng.normal(size=(2000, 3)),
    "quats": rng.normal(size=(2000, 4)),
    "log_scales": rng.uniform(-5, -3, size=(2000, 3)),
    "logit_opacities": rng.normal(size=2000),
    "sh": 0.5 * rng.normal(size=(2000, 4, 3)),
}
tensors = {name: column.astype(np.float32) for name, column in columns.items()}
if on_gpu:
    tensors = {name: torch.from_numpy(column).cuda() for name, column in tensors.items()}

scene = st.scene_from_tensors(**tensors)
camera = st.Camera.look_at((0, 0, -4), (0, 0, 0), width=320, height=180)
if on_gpu:
    with st.open_session(scene) as session:
        image = torch.from_dlpack(session.draw_on_device(camera).image)  # stays on the GPU
    print(f"drawn on {image.device}: {tuple(image.shape)}, mean {image.mean().item():.3f}")
else:
    image = st.render(scene, camera).image
    print(f"drawn on the processor: {image.shape}, mean {image.mean():.3f}")
