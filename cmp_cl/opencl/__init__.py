"""OpenCL: choosing a device, compiling kernels. Nothing here knows what a corner is."""

from cmp_cl.opencl import device as device
