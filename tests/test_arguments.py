"""Arguments of another type: one line names the argument, its type and the one expected."""

import numpy as np
import pytest
from stereo_data import grid_of, toed_in_rig

from cmp_cl import CmpClError, drop_marks
from cmp_cl.field import contact_of, displacement, motion_of, plane_displacement, plane_strain
from cmp_cl.grid import filter_positions
from cmp_cl.measure import TwoViews

GRID = grid_of(np.moveaxis(10.0 * np.mgrid[:5, :6], 0, -1))
IMAGE = np.zeros((60, 70), np.uint8)


@pytest.mark.parametrize(
    ("call", "name", "expected"),
    [
        (lambda: filter_positions(None), "now", "Grid"),
        (lambda: filter_positions(GRID, rest=3), "rest", "Grid"),
        (lambda: plane_displacement(None, GRID), "rest", "Grid"),
        (lambda: plane_displacement(GRID, None), "now", "Grid"),
        (lambda: plane_displacement(GRID, GRID, 0.1), "scale", "PlaneScale"),
        (lambda: displacement(GRID, GRID), "rest", "Points3D"),
        (lambda: plane_strain(GRID), "field", "PlaneField"),
        (lambda: motion_of(GRID), "field", "PlaneField"),
        (lambda: contact_of(GRID, deeper_than=1.0), "field", "DisplacementField"),
        (lambda: drop_marks(GRID, IMAGE), "corners", "Corners"),
        (lambda: TwoViews(IMAGE, None, None), "rig", "StereoRig"),
        (lambda: TwoViews(IMAGE, toed_in_rig(), (0, 1)), "split", "BinocularSplit"),
        (lambda: toed_in_rig().triangulate(GRID, IMAGE), "right", "Grid"),
    ],
)
def test_an_argument_of_another_type_is_named(call, name, expected):
    with pytest.raises(CmpClError, match=f"^{name} must be of type {expected}, not "):
        call()
