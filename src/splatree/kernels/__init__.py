"""The hot stages: one contract, several back ends with the same file names.

``contract.py``   what a back end has to have: the stages of a frame and their structs
``devices.py``    the back ends by name
``reference/``    NumPy float64: the specification; slow, short, obvious
``cpu/``          C++ loops and their Python glue; the maths is in ``shared/``
``cuda/``         kernels for NVIDIA GPUs and what launches them
``shared/``       headers of maths that cpu and cuda both include

A stage ``x`` of a frame is ``reference/x.py``; ``cpu/frame/x.py`` over ``x.cpp``; ``cuda/x.cu``, launched by ``cuda/plan.py``.
What builds levels (thinning, merging, visibility) and what file formats need (columns, codes) are functions of ``reference/``
and ``cpu/`` with one name and one signature.
"""
