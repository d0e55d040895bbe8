"""How the command line says that something cannot be done."""


def fails_in_one_line(result, *words):
    """Assert status 2 and one line on stderr that has these words."""
    status, _, err = result
    assert status == 2
    assert err.startswith("cmp-cl")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    for word in words:
        assert word in err
