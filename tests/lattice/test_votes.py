"""Ways across tears: the kernel equals the oracle to the bit."""

import numpy as np
import pytest
from lattice_plans import K, gel, plan_for

from cmp_cl import detect
from cmp_cl.lattice.joins import units_of
from cmp_cl.reference import harmonic
from cmp_cl.reference.lattice import parts as lattice
from cmp_cl.reference.lattice import votes as lattice_votes
from cmp_cl.synthetic import Indenter


def parts_and_units(device, image):
    corners = detect(image)
    plan = plan_for(device, image, len(corners))
    plan.take(image, corners.xy, corners.edges, corners.refusal)
    plan.start()
    found = plan.parts()
    return plan, corners, found, units_of(found, corners.xy, K)


@pytest.mark.parametrize("seed", [7, 8, 9, 10])
@pytest.mark.parametrize("holes", [0, 3])
def test_gels(device, seed, holes):
    """Torn gels, and gels in which grey stripes part the pattern."""
    image = gel(2.0 if holes == 0 else 0.5, seed=seed, indenter=Indenter.TORUS).copy()
    for n in range(holes):
        image[30 + 70 * n : 44 + 70 * n] = 120
    plan, corners, found, units = parts_and_units(device, image)
    plane = harmonic.smoothed(image, 255)[0]
    directed = lattice.directed(plane, corners.xy, corners.edges, K)
    wanted = lattice_votes.votes(plane, directed, found.twin, units, K)
    got = plan.votes(units)
    order = np.lexsort((wanted.second, wanted.first, wanted.steps))
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_array_equal(one, other[order] if len(other) else other)
    if holes:
        assert len(got.first) > 5


def test_the_parts_are_those_of_the_oracle(device):
    image = gel(2.0, seed=8, indenter=Indenter.TORUS)
    _, corners, found, _ = parts_and_units(device, image)
    plane = harmonic.smoothed(image, 255)[0]
    wanted = lattice.parts(plane, corners.xy, corners.edges, corners.refusal != 0, K)
    for name in ("twin", "face", "agree", "root", "contradicted"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
