"""The lattice of a checkerboard: from corners to numbers, by a few ideas."""
