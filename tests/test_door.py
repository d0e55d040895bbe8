"""`import cmp_cl` is quick, changes nothing in the process, and gives every public name."""

from children import python

import cmp_cl

IMPORT = """
import signal, sys
before = [signal.getsignal(number) for number in signal.valid_signals()]
import cmp_cl
assert [signal.getsignal(number) for number in signal.valid_signals()] == before
for name in cmp_cl.__all__:
    getattr(cmp_cl, name)
assert [signal.getsignal(number) for number in signal.valid_signals()] == before
unwanted = [name for name in sys.modules if name.startswith(("cmp_cl.cli", "cmp_cl.reference"))]
assert not unwanted, unwanted
cmp_cl.reference.detect
"""


def test_importing_the_library_imports_no_command_no_oracle_and_leaves_signals_alone():
    python("-c", IMPORT, check=True)


def test_a_name_that_is_not_there_is_an_attribute_error():
    assert not hasattr(cmp_cl, "no_such_name")
    assert not hasattr(cmp_cl, "__wrapped__")
