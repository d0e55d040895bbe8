"""Series of measured frames, written and read in the formats of other programs."""

from cmp_cl.series.reading import read_series
from cmp_cl.series.writer import SERIES_SUFFIXES, SeriesWriter, complete

__all__ = ["SERIES_SUFFIXES", "SeriesWriter", "complete", "read_series"]
