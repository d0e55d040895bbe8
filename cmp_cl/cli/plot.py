"""`cmp-cl plot`: draw what a series shows: displacement, strain, height, sigma."""

import argparse

from cmp_cl.cli.arguments import add, check_files, check_suffix
from cmp_cl.cli.messages import counted, shown, tell
from cmp_cl.errors import FieldError
from cmp_cl.series import read_series
from cmp_cl.viz import Quantity, map_figure, save_figure, sheet_figure
from cmp_cl.viz.moments import NEEDED, Summary, moments_of

DESCRIPTION = """\
Draws a series of cmp-cl run: by default one sheet with the maps of the frame of the largest
displacement, and curves over time. With one view, lengths are in px, or in mm if run had --cell,
and strain is in the plane; with two views, lengths are in the rig's unit, and strain is in the
surface.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    what = "the series, .npz or .h5, or its .part while it is written or after a kill"
    add(parser, "series SERIES", what)
    add(parser, "--out FILE", "the picture, .png", required=True)
    what = "one map in place of the sheet (strain is two, the principal strains)"
    add(parser, "--what", what, choices=[quantity.value for quantity in Quantity])
    what = "number of the frame; default: that of the largest displacement that is not in doubt"
    add(parser, "--frame N", what, type=int)


def run(arguments: argparse.Namespace) -> int:
    check_suffix("--out", arguments.out, ".png")
    check_files([arguments.series], [arguments.out])
    moments = moments_of(read_series(arguments.series, NEEDED))
    summary = Summary(moments)
    if any(summary.doubtful):
        tell(
            f"in {counted(sum(summary.doubtful), 'frame')} all displacements may be wrong (the "
            "arrays `ambiguous` and `misfit` say which): cmp-cl run says why"
        )
    moment = summary.moment
    if arguments.frame is not None:
        moment = next((each for each in moments if each.index == arguments.frame), None)
    if moment is None:
        first, last = moments[0].index, moments[-1].index
        raise FieldError(
            f"there is no frame {arguments.frame}: those from {first} to {last} are recorded"
        )
    figure = (
        sheet_figure(moment, summary)
        if arguments.what is None
        else map_figure(moment, Quantity(arguments.what))
    )
    save_figure(arguments.out, figure)
    frames = counted(len(moments), "frame")
    print(f"wrote {shown(arguments.out)}: frame {moment.index}, one of {frames}")
    return 0
