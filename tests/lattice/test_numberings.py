"""A numbering is sure only if no other explains the frame as well."""

import numpy as np
import pytest

from cmp_cl.lattice.arrays import NOT_SEEN, Board
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.numbers import Reference, like_rest
from cmp_cl.lattice.printing import Prints, agreement, prints_of

K = LatticeConstants()
SIDE = 30  # nodes


def whole_board(degrees: float) -> Board:
    """Return a board that is seen whole and whose last squares reach one cell, turned."""
    place = np.arange(SIDE) - SIDE / 2
    at = 240 + 240j + 10 * np.exp(1j * np.radians(degrees)) * np.add.outer(1j * place, place)
    return Board(
        x=at.real.astype(np.float32),
        y=at.imag.astype(np.float32),
        owner=np.arange(SIDE**2).reshape(SIDE, SIDE),
        torn=np.zeros((SIDE, SIDE), np.bool_),
        sign=1,
        border=NOT_SEEN._replace(reach=np.ones(4)),
    )


@pytest.mark.parametrize(("degrees", "sure"), [(0, True), (15, True), (45, False), (54, False)])
def test_a_board_that_turned_nearly_as_far_as_another_way_round_is_not_sure(degrees, sure):
    rest = whole_board(0)
    reference = Reference(rest, prints_of(rest.at, K.print_clip), (0, 0))
    decision = like_rest(whole_board(degrees), reference, None, K)
    assert (decision.margin > K.sure_nats) == sure, decision


@pytest.mark.parametrize("seed", range(3))
def test_a_few_large_printing_errors_in_common_prove_nothing(seed):
    """Errors are larger in one corner of each print, and none belong together."""
    draw = np.random.default_rng(seed)
    errors = draw.normal(0, 0.02, (2, SIDE, SIDE, 2)) @ [1, 1j]
    errors[0, :6, :6] *= 4
    errors[1, -6:, -6:] *= 4
    one, other = (Prints(each, np.ones((SIDE, SIDE), np.bool_), 20.0) for each in errors)
    shifts = np.arange(1 - SIDE, SIDE)
    assert agreement(one, other, shifts, shifts, K).max() < K.sure_nats
    nats = agreement(one, one, shifts, shifts, K)
    assert np.unravel_index(nats.argmax(), nats.shape) == (SIDE - 1, SIDE - 1)
