"""From the grids of a recording to their fields, on an OpenCL device.

A plan serves one frame at rest: its tables, its buffers and its launches are made once. A frame
then costs the upload of its nodes, the launches and one read.
"""
