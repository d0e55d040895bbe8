"""OpenCL: choosing a device, compiling kernels. Nothing here knows what a corner is."""
