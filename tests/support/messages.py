"""Checks of the error messages of the command line."""

import re

OF_PYTHON = r"\b(device|full_scale|like|previous|shape)=|invalid (int|float) value"


def fails_in_one_line(result, *words):
    """Assert that a command ended with status 2 and one line on stderr that has these words."""
    status, _, err = result
    assert status == 2
    assert err.startswith("cmp-cl")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert re.search(OF_PYTHON, err) is None
    for word in words:
        assert word in err, err
