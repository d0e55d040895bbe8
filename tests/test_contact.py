"""Contact and normals of surfaces whose shape is known."""

import numpy as np
import pytest

from cmp_cl.errors import FieldError
from cmp_cl.field import DisplacementField, contact_of, surface_normals

DEPTH, RADIUS, TOP = 30.0, 4.0, 0.8  # mm: distance of the gel, sigma and height of the bell


def surface(tilt):
    """Return the nodes of a gel of 20 mm, and its rotation about y."""
    row, column = np.indices((81, 81))
    flat = np.stack([(column - 40) * 0.25, (row - 40) * 0.25, np.zeros((81, 81))], axis=2)
    rotation = np.array(
        [[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]]
    )
    return flat, rotation


def pressed(tilt=0.0, sigma=0.01):
    """Return a bell of height TOP towards the camera on a gel rotated about y, and the gel."""
    flat, rotation = surface(tilt)
    bell = TOP * np.exp(-np.square(flat).sum(axis=2) / (2 * RADIUS**2))
    shift = np.zeros_like(flat)
    shift[..., 2] = -bell
    covariance = np.broadcast_to(np.eye(3) * sigma**2, (81, 81, 3, 3))
    field = DisplacementField(
        position=flat @ rotation.T + [0, 0, DEPTH],
        displacement=shift @ rotation.T,
        covariance=covariance,
        position_covariance=covariance,
        status=np.ones((81, 81), np.uint8),
        source=np.ones((81, 81), np.uint8),
        unit="mm",
    )
    return field, bell, rotation


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_depth_area_and_normals_are_those_of_the_bell(tilt):
    field, bell, rotation = pressed(tilt)
    contact = contact_of(field, deeper_than=TOP / 2)
    np.testing.assert_allclose(contact.depth, bell, atol=1e-9)
    np.testing.assert_allclose(contact.sigma, 0.01)
    assert contact.deepest == pytest.approx(TOP)
    np.testing.assert_array_equal(contact.inside, bell > TOP / 2)
    disc = np.pi * 2 * np.log(2) * RADIUS**2  # the area on which the bell is above half its height
    assert contact.area == pytest.approx(disc, rel=0.01)
    along = np.array([1.0, 0, 0]) @ rotation.T
    slope = (contact.normal @ along)[40, 40 - 16]  # one RADIUS from the top
    steepest = TOP * np.exp(-0.5) / RADIUS
    assert slope == pytest.approx(-np.sin(np.arctan(steepest)), rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(contact.normal, axis=2), 1)
    np.testing.assert_allclose(contact.normal[40, 40], [0, 0, -1] @ rotation.T, atol=1e-9)


def test_normals_point_to_the_cameras_whichever_way_rows_run():
    field, _, _ = pressed()
    for positions in (field.position, field.position[::-1], field.position.transpose(1, 0, 2)):
        np.testing.assert_allclose(surface_normals(positions)[3, 3], [0, 0, -1], atol=1e-12)


def test_missing_nodes_have_no_depth_and_no_area():
    field, _, _ = pressed()
    whole = contact_of(field, deeper_than=0.7).area
    field.displacement[38:43, 38:43] = np.nan
    contact = contact_of(field, deeper_than=0.7)
    assert np.isnan(contact.depth[40, 40])
    assert not contact.inside[38:43, 38:43].any()
    assert 0 < contact.area < whole
    field.displacement[:] = np.nan
    nothing = contact_of(field, deeper_than=0.7)
    assert nothing.area == 0
    assert np.isnan(nothing.deepest)
    line = np.full((5, 5, 3), np.nan)
    line[2] = np.arange(15).reshape(5, 3)
    assert np.isnan(surface_normals(line)).all()


@pytest.mark.parametrize("depth", [np.nan, np.inf])
def test_a_depth_that_is_not_finite_is_refused(depth):
    with pytest.raises(FieldError, match="finite"):
        contact_of(pressed()[0], deeper_than=depth)
