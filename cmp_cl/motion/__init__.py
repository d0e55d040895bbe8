"""From the grids of a recording to their fields: in NumPy, and by a plan on an OpenCL device.

A plan serves one frame at rest: its tables, its buffers and its launches are made once. A frame
then costs the upload of its nodes, the launches and one read.
"""

from cmp_cl.motion.contact import Contact, contact_of
from cmp_cl.motion.displacement import displacement
from cmp_cl.motion.positions import filter_positions
from cmp_cl.motion.scale import PlaneScale

__all__ = ["Contact", "PlaneScale", "contact_of", "displacement", "filter_positions"]
