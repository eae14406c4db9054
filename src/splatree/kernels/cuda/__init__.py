"""The stages on a GPU: kernels (*.cu) compiled at first use, and Python that launches them through the driver.

::

    sources.py   what device code there is           library.py    the CUDA driver's functions (driver.h), and its errors
    compile.py   NVRTC, and the cache of its output  driver.py     a GPU: memory, streams, launches, graphs
    device.py    the GPU of this process             job.py        the struct that every kernel takes
    plan.py      the launches of a frame             workspace.py  its arrays
    renderer.py  a frame that stays on the device    stages.py     the stages one by one, as other back ends have them

Nothing here is loaded by ``import splatree``.
"""
