"""The stages on the processor: Python glue, one file a stage, over the compiled loops in ``_core``.

``frame/``    what a frame runs: selection, culling, projection, binning, blending
``build/``    what builds levels and clusters: thinning, pairs, merging, visibility, K-means
``codec/``    what file formats need: columns, quantisation, palettes, rotation of harmonics
``runtime/``  what all of them stand on: threads, instruction sets, memory, files
"""
