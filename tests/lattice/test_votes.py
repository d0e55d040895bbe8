"""Ways across tears: the kernel equals the oracle to the bit."""

import numpy as np
import pytest
from lattice_plans import K, gel, started

from cmp_cl import detect
from cmp_cl.lattice import kernels
from cmp_cl.reference.lattice import parts as lattice
from cmp_cl.reference.lattice import votes as lattice_votes
from cmp_cl.synthetic import Indenter


def linked(device, image):
    """Return a plan whose parts have been found, the corners, and the same from the oracle."""
    corners = detect(image)
    plan = started(device, image, corners)
    plane = lattice.levels_of(image, 255)
    directed = lattice.directed(plane, corners.xy, corners.edges, K)
    twin = lattice.links(plane, directed, K)
    return plan, corners, plane, directed, twin


def striped(image, rows, wide):
    """Return the image with grey stripes from these rows on, which part the pattern."""
    image = image.copy()
    for row in rows:
        image[row : row + wide] = 120
    return image


@pytest.mark.parametrize("seed", [7, 8, 9, 10])
@pytest.mark.parametrize("holes", [0, 3])
def test_gels(device, seed, holes):
    """Torn gels, and gels in which grey stripes part the pattern."""
    image = striped(
        gel(2.0 if holes == 0 else 0.5, seed=seed, indenter=Indenter.TORUS),
        (30, 100, 170)[:holes],
        14,
    )
    plan, corners, plane, directed, twin = linked(device, image)
    plan.alone()
    units, got = plan.parts(corners.xy)
    wanted = lattice_votes.votes(plane, directed, twin, units, K)
    order = np.lexsort((got.offset.imag, got.offset.real, got.quarter, got.second, got.first))
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_array_equal(one[order], other)
    if holes:
        assert got.weight.sum() > 5


def test_the_nodes_of_parts_are_those_of_the_oracle(device):
    """Of every corner in a part: its number, its rotation, and how many of its faces are there."""
    image = gel(2.0, seed=8, indenter=Indenter.TORUS)
    plan, corners, _, directed, twin = linked(device, image)
    parts = lattice.parts_of(directed, corners.refusal != 0, twin, K)
    wanted: dict[tuple[int, int], list[tuple[complex, int]]] = {}
    for h in np.flatnonzero((parts.root >= 0) & ~parts.contradicted):
        node = (parts.column[h] + 1j * parts.row[h], (parts.direction[h] - h) % 4)
        wanted.setdefault((parts.root[h], h >> 2), []).append(node)
    faces = np.bincount([root for (root, _), nodes in wanted.items() for _ in nodes]) // 4
    large = np.flatnonzero(faces > 1)
    ranked = sorted(large, key=lambda root: (-faces[root], root))
    units, _ = plan.parts(corners.xy)
    assert (np.diff(units.part) >= 0).all()
    found = zip(units.part, units.corner, units.number, units.rotation, units.rim, strict=True)
    expected = [
        (ranked.index(root), corner, *nodes[0], len(nodes) < 4)
        for (root, corner), nodes in wanted.items()
        if root in ranked
    ]
    assert sorted(found, key=str) == sorted(expected, key=str)
    np.testing.assert_array_equal(units.at.real, corners.xy[units.corner, 0])


def test_a_list_of_votes_that_is_too_short_grows(device, monkeypatch):
    image = striped(gel(0.5, seed=8), range(40, 220, 30), 8)
    plan, corners, *_ = linked(device, image)
    plan.alone()
    wanted = plan.parts(corners.xy)[1]
    monkeypatch.setattr(kernels, "ROOM", 1)
    plan, *_ = linked(device, image)
    room = plan.capacity
    for _ in range(2):
        plan.start()
        plan.alone()
        found = plan.parts(corners.xy)[1]
        counted = plan.read("layout", np.int32)[kernels.VOTES]
        assert room < counted <= plan.values["room"]
        assert plan.buffers["votes"].size >= 24 * counted
        for one, other in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(one, other)
