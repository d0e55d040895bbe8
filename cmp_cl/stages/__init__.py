"""The stages from an image to its corners, as kernels on a device."""
