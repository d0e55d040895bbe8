"""The stages from an image to its corners, as kernels on a device.

A frame passes through these, from its upload to its corners:

    plan      buffers and bound kernels for one shape: upload, launch, read; grows the lists
    harmonic  with RingHarmonic: smoothing, responses, maxima, checks -> list of corners
    rings     with BinaryRings: binarize, criteria (or spectral), nms, gate -> list of corners
    refine    list of corners -> positions, as the host reads them

They share these:

    types     the type of every quantity, in NumPy and in OpenCL C
    layout    the layout of frames on the device; its launches
    maps      every intermediate image, for `Detector.maps`

Each says what a plan needs of it: `files` of kernels, `defines`, the macros that only these need,
`sizes` of buffers and of `scratch`, temporary arrays, layout by layout, bytes, and `launches`.

The table in kernels/README.md names the oracle of every kernel; tests/kernels/ compares the two.
"""
