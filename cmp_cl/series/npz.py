"""A recording as one .npz, for numpy.load."""

import json
from collections.abc import Mapping
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from cmp_cl.field import SeriesWriter
from cmp_cl.series.base import Description, Frame, Series


class NpzSeries(Series):
    """`cmp_cl.SeriesWriter` with a description: `about`, a text of JSON, and the constants."""

    def __init__(
        self,
        path: str | PathLike[str],
        description: Description,
        constants: Mapping[str, ArrayLike],
    ) -> None:
        super().__init__(description, constants)
        about = json.dumps({"units": dict(description.units), **description.entries()})
        self._series = SeriesWriter(path, about=np.array(about), **self.constants)

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        self._series.append(index=index, time_ms=time_ms, **frame)

    def _finish(self) -> None:
        self._series.close()
