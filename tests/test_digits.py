"""Numbers in a CSV, written many at a time, are those that were given."""

import json

import numpy as np
import pytest

from cmp_cl.series.digits import nested, rows_of

RNG = np.random.default_rng(900000)
COLUMNS = {
    "lengths": RNG.normal(0, 300, 500),
    "pixels": (RNG.random(500) * 640).astype(np.float32),
    "whole": np.arange(500) - 20,
    "large": RNG.integers(0, 2**40, 500),
    "small": RNG.normal(0, 1e-7, 500),
    "huge": RNG.normal(0, 1e12, 500),
    "mixed": 10.0 ** RNG.uniform(-12, 5, 500),
    "flags": RNG.random(500) > 0.5,
    "nothing": np.zeros(500),
    "missing": np.where(RNG.random(500) > 0.5, np.nan, 7.25),
    "no number": np.full(500, np.nan),
    "endless": np.where(np.arange(500) == 3, -np.inf, 1.0),
    "carried": np.full(500, 0.9999999999),
    "edges": np.resize([999_998.9999999999, -0.0, -1e-12, 0.1, -0.5, 100.0], 500),
}


def test_numbers_are_read_back_to_nine_digits_or_decimals():
    lines = rows_of("12,0.5", list(COLUMNS.values())).decode().splitlines()
    assert len(lines) == 500
    table = np.array([[float(word) for word in line.split(",")] for line in lines])
    np.testing.assert_array_equal(table[:, :2], np.tile([12, 0.5], (500, 1)))
    for found, (name, given) in zip(table[:, 2:].T, COLUMNS.items(), strict=True):
        # Half a unit of the ninth digit or decimal, with 2 % of room for rounding.
        relative = 5.1e-9 if name in ("small", "huge", "mixed") else 0
        absolute = 0 if name in ("small", "huge", "whole", "flags", "large") else 5.1e-10
        np.testing.assert_allclose(found, given.astype(float), rtol=relative, atol=absolute)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        *((0.25, "0.25"), (-0.5, "-0.5"), (100, "100"), (0, "0"), (-0.0, "0"), (-1e-12, "0")),
        *((1.0, "1"), (0.9999999999, "1"), (123456.125, "123456.125"), (np.nan, "nan")),
    ],
)
def test_trailing_zeros_are_left_out(value, text):
    assert rows_of("0", [np.array([value, 9.5])]) == f"0,{text}\n0,9.5\n".encode()


def test_a_column_of_small_or_large_numbers_keeps_nine_digits():
    assert rows_of("0", [np.array([-1.23456789e-5, 0])]) == b"0,-12.3456789e-6\n0,0e-6\n"
    assert rows_of("0", [np.array([1.23456789e-95])]) == b"0,1.23456789e-95\n"
    assert rows_of("0", [np.array([1.23456789e20, 0.5])]) == b"0,1.23456789e+20\n0,0.5\n"


@pytest.mark.parametrize("shape", [(500,), (20, 25), (4, 25, 5), (2, 1, 25, 10), (500, 1)])
@pytest.mark.parametrize("name", COLUMNS)
def test_an_array_as_json_is_the_array(name, shape):
    given = COLUMNS[name].reshape(shape)
    found = np.array(json.loads(nested(given)), float)
    finite = np.where(np.isfinite(given), given, np.nan).astype(float)
    largest = np.nanmax(np.abs(finite), initial=0)
    np.testing.assert_allclose(found, finite, rtol=5.1e-9, atol=min(5.1e-10, 1e-9 * largest))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (np.array([[1, -2], [3, 0]]), b"[[1,-2],[3,0]]"),
        (np.array([[np.nan, np.inf], [-np.inf, 0.5]]), b"[[null,null],[null,0.5]]"),
        (np.array([1500.0, -0.25, 1e-12]), b"[1500,-0.25,0]"),
        (np.array([True, False]), b"[true, false]"),
        (np.float64(0.1), b"0.1"),
        (np.float64(np.nan), b"null"),
        (np.empty((0, 2)), b"[]"),
        (np.array("mm"), b'"mm"'),
    ],
)
def test_json_has_no_superfluous_characters(given, text):
    assert nested(np.asarray(given)) == text
