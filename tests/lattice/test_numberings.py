"""A numbering is sure only if no other explains the frame as well."""

import dataclasses

import numpy as np
import pytest

from cmp_cl.lattice.arrays import NOT_SEEN, Board, Border
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.numbers import Reference, in_shape, like_rest
from cmp_cl.lattice.printing import Prints, agreement, prints_of

K = LatticeConstants()
SIDE = 30  # nodes


def whole_board(degrees: float, reach: float = 1) -> Board:
    """Return a board that is turned, and whose last squares reach one cell, NaN without an end."""
    place = np.arange(SIDE) - SIDE / 2
    at = 240 + 240j + 10 * np.exp(1j * np.radians(degrees)) * np.add.outer(1j * place, place)
    return Board(
        x=at.real.astype(np.float32),
        y=at.imag.astype(np.float32),
        owner=np.arange(SIDE**2).reshape(SIDE, SIDE),
        torn=np.zeros((SIDE, SIDE), np.bool_),
        sign=1,
        border=NOT_SEEN._replace(reach=np.full(4, reach)),
    )


@pytest.mark.parametrize(("degrees", "sure"), [(0, True), (15, True), (45, False), (54, False)])
def test_a_board_that_turned_nearly_as_far_as_another_way_round_is_not_sure(degrees, sure):
    rest = whole_board(0)
    reference = Reference(rest, prints_of(rest.at, K.print_clip), (0, 0))
    decision = like_rest(whole_board(degrees), reference, None, K)
    assert (decision.margin > K.sure_nats) == sure, decision


@pytest.mark.parametrize("bottom", [1.0, np.nan])
def test_an_end_in_view_that_shows_no_border_may_be_none(bottom):
    """Of 6 x 4 nodes, 4 x 3 are seen. If the last of the four lines shows the border, they are all
    of the four columns; if it shows nothing, they may be some of the six rows."""
    whole = whole_board(0)
    seen = {name: getattr(whole, name)[:4, :3] for name in ("x", "y", "owner", "torn")}
    border = Border(
        reach=np.array([1, bottom, np.nan, 1]),
        follows=np.array([False, False, True, False]),
        room=np.array([True, True, False, True]),
    )
    part = dataclasses.replace(whole, **seen, border=border)
    decision = in_shape(part, (6, 4), K)
    assert (decision.margin > K.sure_nats) == np.isfinite(bottom), decision


def test_numbers_that_nothing_tells_are_those_of_the_least_motion():
    rest, now = whole_board(0, np.nan), whole_board(40, np.nan)
    reference = Reference(rest, prints_of(rest.at, K.print_clip), (0, 0))
    decision = like_rest(now, reference, None, K)
    assert decision.best[2:] == (0, 0, 0)
    assert decision.margin < K.sure_nats


@pytest.mark.parametrize(("degrees", "sure"), [(0, False), (15, True)])
def test_small_errors_may_be_a_cameras_where_all_nodes_moved_alike(degrees, sure):
    """The same errors at the same pixels are no print's. Where the pattern turned, they are."""

    def worn(degrees):
        board = whole_board(degrees, np.nan)
        error = np.random.default_rng(0).normal(0, 0.05, (SIDE, SIDE, 2)) @ [1, 1j]
        error *= np.exp(1j * np.radians(degrees))
        board.x, board.y = (board.x + error.real, board.y + error.imag)
        return board

    rest = worn(0)
    reference = Reference(rest, prints_of(rest.at, K.print_clip), (0, 0))
    decision = like_rest(worn(degrees), reference, None, K)
    assert (decision.margin > K.sure_nats) == sure, decision


def printed(size: tuple[int, int], cells: float, seed: int) -> Prints:
    """Return drawn errors in cells of 20 px, for each node or, of size (1, SIDE), each column."""
    error = np.random.default_rng(seed).normal(0, cells, (*size, 2)) @ [1, 1j]
    known = np.ones((SIDE, SIDE), np.bool_)
    return Prints(np.where(known, error, 0), known, 20.0)


@pytest.mark.parametrize("seed", range(6))
def test_errors_that_all_nodes_of_a_column_have_prove_nothing(seed):
    """The pixels of a frame cut the straight edge of a column in one way."""
    one, other = (printed((1, SIDE), 0.02, 2 * seed + n) for n in range(2))
    shifts = np.arange(1 - SIDE, SIDE)
    assert agreement(one, other, shifts, shifts, 0.0, K).max() < K.sure_nats


@pytest.mark.parametrize(("alike", "sure"), [(0.0, True), (1.0, False)])
def test_small_errors_tell_where_the_camera_cannot_have_made_them(alike, sure):
    one = printed((SIDE, SIDE), 0.004, 1)
    nats = agreement(one, one, np.arange(3), np.arange(3), alike, K)
    assert (nats[0, 0] > K.sure_nats) == sure
    assert nats[1:, 1:].max() == 0
