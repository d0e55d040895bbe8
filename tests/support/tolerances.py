"""The most by which floating-point results of a device may differ from the oracle's in float64.

Integer stages have no tolerance: they are equal.
"""

POSITION = 1e-3  # px, of refined positions and centroids
ANGLE = 1e-3  # rad, of the directions of boundaries
SIGMA = 1e-2  # of a standard deviation, relative
MARGIN = 1e-4  # of a check's quantity from its bound: nearer, float32 may decide otherwise
UNDECIDED = 0.01  # share of the corners that may be as near as that, beside one
CORRELATION = 1e-6  # of the spectral maps, which are float32
