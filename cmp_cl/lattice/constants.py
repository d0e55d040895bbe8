"""Every number that the lattice is tuned by.

All were set by hand, on rendered gels and boards that no report uses, but for a regression on the
scores of nodes. What other values of one did there is said with it; where nothing is said, none was
found that is better on all families. What each idea is worth, bench/numbering.py measures with
--ablation.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True, kw_only=True)
class LatticeConstants:
    """The constants of the lattice: unit, and meaning.

    contrast_radius_px: px, distance from a corner at which the levels of its four cells are
        read; the inner ring of the detector. No place nearer to the edge of the image gets a node.
    link_neighbours: corners, bins around a corner are added until they hold so many; 24 are the
        places within 2.8 cells, and its own bin is not in their middle. With 24, stretched patterns
        lose 45 of 20 250 nodes.
    link_rings: bins, most rings of bins around a corner, which bounds the work. With 4, stretched
        patterns lose 783 of 20 250 nodes.
    turn_price: lengths, price of a bend between a way and a boundary. With 4 the corners that dots
        make in cells of 24 px took the links; with 8 a part of 300 nodes in 24 torn gels was lost.
    least_cosine: least cosine of that bend; .9 for ways of several steps changed nothing.
    side_middle: share, of the contrast of both corners that the middle of a link must show. With 0,
        rows on both sides of a bar are linked as neighbours; .05 and .2 do the same on 240 torn
        gels, and on 9 401 corners of bent boards.
    deep_cells: shares of a side, how far beside it levels are read too, where those near it do not
        show it, as beside the tabs of a puzzle. Without it torn gels lose nodes, and boards before
        clutter take squares of it (bench/numbering.py --ablation). With .35, a row behind one of
        60 bars was linked to the wrong one; .3 does the same.
    side_depth_cells: shares of a side, how far beside a way the levels are read; with .2 marks
        in the cells are met.
    side_depth_px: px, the same, at least: the smoothed image is three pixels wide. With 0, torn
        gels lose 2 387 of 168 497 nodes.
    wide_px: px, the depths at which the levels of wider cells are read are those of cells so wide:
        blur is of pixels, and there may be marks farther within. Of 1583 corners of boards with
        marks of .6 to .85 of a cell 928 are nodes without it, 1417 with 40, 1479 with 35 and 1495
        with 30; of 1894 of boards in a fisheye 1814, 1824, 1822 and 1810, and 1794 with 25.
    agree: shares of a step, greatest difference between faces that share a link. With .4, 262 335
        torn corners lose 798 nodes, and a fisheye's rim whole blocks of cells.
    agree_cut: factor, by which that tolerance falls for a part that contradicts itself.
    cuts: times, that it falls at most; .5 becomes .04. 128 torn gels need 5, with which a
        dislocation of 8 cells stays without numbers.
    torn_corners: corners, that a face may have torn; for each further one it falls once: a squeezed
        rim of them hangs on the wrong side of a tear. With 1, and with 4, one of 100 torn gels has
        wrong numbers, with 2 none; if it falls twice, their 206 847 corners have 1408 right nodes
        fewer.
    least_board: nodes, of a board, and faces, of a part that begins one; smaller parts, of two
        faces or more, only lie beside others. Without them 241 477 corners of torn gels lose 333
        right nodes, and a board of 53 125 corners in noise all but 18 493 of 48 462. A single face
        agrees with none: of 734 placed ones 8 are wrong, of 588 larger parts 2.
    least_line: share, of its places in view that an outer line must hold, and a board of a known
        size; and of the corners beside a board that must lie on its lattice. With .7 a line of
        noise beside one of 75 boards was taken for theirs; .8 loses nothing on 50 005 corners of
        gels, and .9 refuses two of 110 boards in clutter. A line of which half is firm stays: of
        125 true ones that an object hid in part 87 do, and none of 7 false ones of boards in
        clutter.
    span: steps, of the longest way across a tear; nodes within half of that and a half cell beside
        it show the surface. Within 4 cells 4 of 45 parts of torn gels were ranked wrong, within 2.5
        one, and none of 24 others.
    join_votes: votes, by which a placement must lead the second, counted as often as the surface
        bends more at its second best. With 10, 579 163 corners of torn gels have 352 more right
        nodes and 6 more wrong ones, and one more of 150 boards in clutter goes on into the ground;
        with 20 they have 39 fewer and 4 fewer.
    tear_most: nodes, of each side of a tear, and of a board that is continued; the cost of a
        placement grows with its cube. With 32 torn gels lost 262 of 47 893 nodes; 48 does as well
        as 64.
    prediction_weights: shares, in the prediction of a node, of a cubic through four neighbours, of
        the middle of two, of the fourth corner of a cell, of an extrapolation.
    cell_depth: steps, from a node along both axes, at which its four cells are read. With .2, 192
        torn gels have 707 of 379 121 right nodes fewer; with .14, 128 have 298 more, and wrong
        numbers in 7 gels and not in 3: nearer to the node any corner looks right.
    rough_weight_per_px2: 1/px^2, weight of a rough corner among the predictions of its
        neighbours, per area of a cell: 14 at cells of 13 px. Least false nodes and least error
        of 6 to 30 tried there.
    worn_sigmas: sigmas, by which wear moves a corner that fits the corner model; its mean with its
        prediction weighs that against the scatter of its neighbours' predictions. With the
        prediction alone, corners under sharp bends moved by up to 4 px; without a mean, worn gels
        err by 1.24 px for .70.
    near_cells: cells, a node farther from its prediction is rough; nodes whose motions differ by
        less moved alike. .08 to .2 do the same.
    reach_cells: cells, a corner so far from a prediction or a place is another; .4 does the same.
    side_nats: nats, for each whole side (this and the next: regression). The least side tells
        nothing more: of 19 522 torn nodes it is not less in the 37 false ones than in the others.
    cells_nats: nats, for the whole contrast of the four cells.
    sd_cells: cells, standard deviation from a prediction; that of a torn corner is half as large.
        With .118 for all, 206 847 corners of torn gels have 360 right nodes fewer; with .118 only
        between neighbours, 569 more, and 46 false ones for 35.
    prior_nats: nats, of a node without evidence; it is one if it is more likely than not. Without
        torn_nats, -4.1 for all loses 487 of 579 163 right nodes of torn gels and 156 of 4868 of
        boards behind fingers, and has 8 wrong ones fewer; -3.5 for all has 2193 more, and 20 wrong
        ones; 3 of 280 gels are silent about them, for 1.
    torn_nats: nats, by which a torn corner, or a place without a corner, is less likely a node.
    beyond_cells: cells, where a further square is looked for. 1.3 does nearly the same on 110
        boards in clutter and 48 photographs behind fingers; a gel near the edge of the image is not
        tracked with it.
    border_step_cells: cells, steps between the levels that are read at a border; so far the squares
        at one border may reach differently. With .12 the size of 3 in 20 photographs is
        no longer sure.
    passing: share, of the contrast; levels two cells apart that differ by less show that cells
        follow, and a side beyond which cells differ by less is an end. Between .2 and .3 nearly
        all is the same.
    end_nats: nats, against a border that is not there, a line that a known size lacks, and one
        whose places in view are empty. With 5, the motion from a board at rest made its numbers
        ambiguous.
    bare_nats: nats, against an end of a known size that is in view and shows no border; four of
        them are not taken for a line that lacks. 2 does the same; with 0, of 220 boards behind arms
        37 numbers are wrong and told, for 20.
    rest_sd_cells: cells, standard deviation of the motion since rest.
    step_sd_cells: cells, the same from one frame to the next.
    turn_sd_degrees: degrees, standard deviation of the rotation since rest.
    motion_nats: nats, the most against any motion and rotation: a motion by more than half a cell
        between frames is not sure then, and the borders of a board that a hand turned decide. With
        as much for each of the two, 85 and not 74 of 112 perfect prints that turn by 8 to 60
        degrees in a frame are sure; but of 300 that turn about a point up to 10 cells beside the
        middle, 60 and not 33 are wrong in silence.
    camera_px: px, printing errors as small as that may be the camera's, of nodes that moved alike.
        With 0, 16 of 300 perfect prints that moved by a period were wrong in silence.
    print_clip: times, the median of printing errors, to which larger ones are clipped. Without it 4
        of 200 perfect prints behind dust were wrong in silence; 1 loses a third of those that are
        sure.
    sure_nats: nats, least confidence of numbers that are not ambiguous.
    beside: corners, beside a board on its lattice, that are told.
    few: share, of the corners that no other board has, that a board must hold, unless it has all
        nodes of a known size. With 0, 13 of 565 boards in clutter are right that are refused, but
        of 60 grounds of noise without a board one is numbered in silence and five are told.
    gap: share, of the places inside a board; so many without a node are told. It is told of 30 of
        128 torn gels; without it two with wrong numbers are silent.
    """

    # Links
    contrast_radius_px: float = 3.0
    link_neighbours: int = 32
    link_rings: int = 16
    turn_price: float = 6.0
    least_cosine: float = 0.8
    side_middle: float = 0.1
    deep_cells: float = 0.25
    side_depth_cells: float = 0.12
    side_depth_px: float = 1.25
    wide_px: float = 30.0
    # Faces and parts
    agree: float = 0.5
    agree_cut: float = 1.3
    cuts: int = 10
    torn_corners: int = 2
    least_board: int = 9
    least_line: float = 0.8
    # Joins
    span: int = 4
    join_votes: float = 15.0
    tear_most: int = 48
    # Nodes
    prediction_weights: tuple[float, float, float, float] = (12.0, 4.0, 1.5, 0.7)
    cell_depth: float = 0.17
    rough_weight_per_px2: float = 0.08
    worn_sigmas: float = 10.0
    near_cells: float = 0.1
    reach_cells: float = 0.3
    side_nats: float = 2.35
    cells_nats: float = 1.65
    sd_cells: float = 0.236
    prior_nats: float = -3.5
    torn_nats: float = 0.6
    # Borders, numberings, boards
    beyond_cells: float = 1.2
    border_step_cells: float = 0.15
    passing: float = 0.25
    end_nats: float = 6.0
    bare_nats: float = 1.2
    rest_sd_cells: float = 1.0
    step_sd_cells: float = 0.2
    turn_sd_degrees: float = 8.0
    motion_nats: float = 8.5
    camera_px: float = 0.1
    print_clip: float = 2.5
    sure_nats: float = 5.0
    beside: int = 6
    few: float = 0.1
    gap: float = 0.04

    def face_tolerances(self) -> NDArray[np.float32]:
        """Return the squared tolerance of faces after so many cuts, (cuts + 1,) float32."""
        tolerance = self.agree / self.agree_cut ** np.arange(self.cuts + 1)
        return (tolerance**2).astype(np.float32)
