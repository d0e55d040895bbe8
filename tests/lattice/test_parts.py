"""Links, faces and parts: the kernels equal the oracle to the bit."""

import numpy as np
import pytest
from lattice_plans import K, gel, plan_for

from cmp_cl import detect
from cmp_cl.reference import harmonic
from cmp_cl.reference.lattice import parts as lattice
from cmp_cl.synthetic import Indenter


def run(device, image, xy, edges, refusal, full_scale=255):
    """Return what the kernels say of each half-edge, by the names of the oracle."""
    plan, count = plan_for(device, image, len(xy), full_scale), 4 * len(xy)
    plan.take(image, xy, edges, refusal)
    plan.start()
    found = {
        name: plan.read(buffer, np.int32)[:count]
        for name, buffer in (("twin", "twin"), ("face", "face"), ("root", "part"))
    }
    state = plan.read("state", np.int32).reshape(-1, 4)[:count]
    levels, cut = plan.read("levels", np.uint16), plan.read("cut", np.uint8)[:count]
    found |= {"column": state[:, 0], "row": state[:, 1], "direction": state[:, 2]}
    found["cut"] = np.where(found["face"] >= 0, cut[np.maximum(found["face"], 0)], 0)
    found["faces"] = plan.read("faces_of_part", np.int32)[:count]
    found["plane"] = levels.reshape(image.shape[0], plan.step)[:, plan.pad :][:, : image.shape[1]]
    return found


def assert_equal_to_the_oracle(device, image, xy, edges, refusal=None, full_scale=255):
    refusal = np.zeros(len(xy), np.uint8) if refusal is None else refusal
    plane = harmonic.smoothed(image, full_scale)[0]
    found = run(device, image, xy, edges, refusal, full_scale)
    wanted = lattice.parts(plane, xy, edges, refusal != 0, K)
    np.testing.assert_array_equal(found["plane"], plane)
    for name in ("twin", "face", "root", "cut"):
        np.testing.assert_array_equal(found[name], getattr(wanted, name), err_msg=name)
    numbered = (wanted.root >= 0) & ~wanted.contradicted
    for name in ("column", "row", "direction"):
        np.testing.assert_array_equal(found[name][numbered], getattr(wanted, name)[numbered])
    faces = np.bincount(wanted.root[numbered], minlength=4 * len(xy)) // 4
    np.testing.assert_array_equal(found["faces"], faces)
    return wanted


@pytest.mark.parametrize("severity", [0.5, 1.5, 2.0])
def test_gels(device, severity):
    image = gel(severity, indenter=Indenter.TORUS)
    corners = detect(image)
    wanted = assert_equal_to_the_oracle(device, image, corners.xy, corners.edges, corners.refusal)
    assert np.count_nonzero(wanted.root >= 0) > 4 * 250


def test_a_crop_in_sixteen_bits(device):
    image = np.ascontiguousarray(gel(1.0, bits=16)[31:170, 47:250])
    corners = detect(image)
    assert_equal_to_the_oracle(device, image, corners.xy, corners.edges, full_scale=4085)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 9])
def test_few_corners(device, count):
    image = gel(0.5)
    corners = detect(image)
    assert_equal_to_the_oracle(device, image, corners.xy[:count], corners.edges[:count])


def test_points_on_a_line(device):
    image = gel(0.5)
    xy = np.stack([np.arange(20, 300, 9.5), np.full(30, 100.25)], axis=1).astype(np.float32)
    edges = np.tile(np.array([0, 1.5, 3.1, -1.6], np.float32), (30, 1))
    assert_equal_to_the_oracle(device, image, xy, edges)


@pytest.mark.parametrize("seed", range(6))
def test_drawn_lattices(device, seed):
    """Lattices that are torn, sheared and shuffled on a plane image, so that links contradict."""
    draw = np.random.default_rng(seed)
    rows, columns, cell = 14, 17, 10.0
    y, x = np.mgrid[:160, :200]
    image = (((x // 10 + y // 10) % 2) * 150 + 50).astype(np.uint8)
    row, column = (each.ravel() for each in np.mgrid[1:rows, 1:columns])
    xy = np.stack([column, row], axis=1) * cell - 0.5
    xy += draw.normal(0, [0, 0.4, 1.0, 1.8, 2.6, 4.0][seed], xy.shape)
    turn = np.where((row + column) % 2, 0, np.pi / 2) + draw.normal(0, 0.1 * seed, len(xy))
    edges = turn[:, None] + np.arange(4) * (np.pi / 2) + draw.normal(0, 0.05 * seed, (len(xy), 4))
    edges = ((edges + np.pi) % (2 * np.pi) - np.pi).astype(np.float32)
    edges[draw.random(len(xy)) < 0.02 * seed] = np.nan
    order = draw.permutation(len(xy))
    xy, edges = xy.astype(np.float32)[order], edges[order]
    assert_equal_to_the_oracle(device, image, xy, edges)


@pytest.mark.parametrize(("radius", "has_numbers"), [(4, True), (9, False)])
def test_a_dislocation(device, radius, has_numbers):
    """Around the middle a column is two columns farther, so that no numbers fit. Faces are cut
    apart until all parts have numbers; a large part, smooth far from the middle, stays without."""
    middle, cell = 12 * radius + 0.3, 10.0
    y, x = np.mgrid[: 24 * radius, : 24 * radius] - middle
    column, row = x / cell + np.arctan2(y, x) / np.pi, y / cell
    level = np.cos(np.pi * column) * np.cos(np.pi * row)
    level[np.hypot(x, y) > cell * radius] = 0
    image = (128 + 90 * np.tanh(3 * level)).astype(np.uint8)
    corners = detect(image)
    wanted = assert_equal_to_the_oracle(device, image, corners.xy, corners.edges)
    assert wanted.cut.max() > 0
    assert wanted.contradicted.any() != has_numbers


def test_noise(device):
    """Points and directions at random, on noise."""
    draw = np.random.default_rng(3)
    image = draw.integers(0, 256, (101, 133)).astype(np.uint8)
    xy = (draw.random((700, 2)) * [140, 110] - 4).astype(np.float32)
    edges = draw.uniform(-np.pi, np.pi, (700, 4)).astype(np.float32)
    assert_equal_to_the_oracle(device, image, xy, edges)
