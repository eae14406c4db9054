"""The stages on a GPU: kernels (*.cu) compiled at first use, and Python that launches them through the driver.

::

    sources.py   what device code there is           driver.py     the CUDA driver: memory, stream, launches, graphs
    compile.py   NVRTC, and the cache of its output  job.py        the struct that every kernel takes
    plan.py      the launches of a frame             workspace.py  its arrays
    renderer.py  a frame that stays on the device    stages.py     the stages one by one, as other back ends have them

Nothing here is loaded by ``import splatree``.
"""
