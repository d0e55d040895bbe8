"""Plans of the lattice, and gels for them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl import Corners, Device
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.plan import LatticePlan
from cmp_cl.synthetic import Indenter, random_scene, render

K = LatticeConstants()


def plan_for(
    device: Device,
    image: NDArray[np.integer],
    count: int,
    full_scale: int = 255,
    constants: LatticeConstants = K,
) -> LatticePlan:
    """Return a plan for images like this one, with so many corners."""
    return LatticePlan(device, image.shape, image.dtype, full_scale, count, constants)


def started(
    device: Device, image: NDArray[np.integer], corners: Corners, **given: Any
) -> LatticePlan:
    """Return a plan that has found the parts of an image; given: as for `plan_for`."""
    plan = plan_for(device, image, len(corners), **given)
    plan.take(image, corners)
    plan.start()
    return plan


def gel(
    severity: float, *, bits: int = 8, seed: int = 5, indenter: Indenter | None = None
) -> NDArray[np.integer]:
    """Return the image of a worn gel of 20 x 20 corners."""
    scene = random_scene(
        seed, markers=20, severity=severity, shape=(240, 320), indenter=indenter, corrosion=1.5
    )
    image = render(scene).image
    return image if bits == 8 else image.astype(np.uint16) * 16 + 5
