"""The plan of a detector: buffers and bound kernels for frames of one shape.

A plan is fixed to a shape, a pixel type and a number of frames; it allocates once, and a
frame costs its upload, its launches and the download of its corners.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl import spectrum
from cmp_cl.config import (
    AdaptiveMean,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Fit,
    Midlines,
    RapidCriteria,
    SectorContrast,
    SpectralCriteria,
)
from cmp_cl.device import Device, DeviceKind
from cmp_cl.errors import CapacityError
from cmp_cl.program import Kernels, build, sum_of_terms
from cmp_cl.resampling import resampling_weights, working_shape
from cmp_cl.results import GreyImage

RING_REACH = 5  # rows and columns that the outer ring looks at
REACH = 16  # columns on either side of the pixels, at least: what rings and tents need
ALIGNMENT = 128  # bytes that every device accepts as the start of a part of a buffer
GROUP = 64  # work-items of a group over a list
WORDS = 64  # words of a group of the criteria: small enough to share them out evenly
NOISE_BAND = 8  # rows that a work-item of the noise estimate takes
BEYOND = 8  # elements behind a row's running sums that a vector may reach
BEHIND = 16  # entries behind a list of contrasts that a vector may reach
CHANNELS = 48  # samples that the gate copies per candidate: inner, outer, colours
RESULT_FIELDS = 12  # of kernels/refine.cl
CONTRASTS = ("inner_contrast", "contrast", "mean_difference", "sector_response")
START_FIELDS = 2
POINT_FIELDS = 27
LINE_FIELDS = 6
EDGE_SAMPLES = 68  # of the three rings
BINS = 256


class Launch(NamedTuple):
    """A kernel with its arguments, which must outlive it, and the work-items it runs over."""

    stage: str
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...] | None
    arguments: tuple[Any, ...]


class Overflow(Exception):
    """A list was too short; holds the largest counts that were seen."""

    def __init__(self, candidates: int, corners: int) -> None:
        super().__init__(f"{candidates} candidates, {corners} corners")
        self.candidates = candidates
        self.corners = corners


class Plan:
    """Buffers and bound kernels for `frames` frames of one shape at one working scale.

    scale: the working scale, or None for the image as it is.
    mask: (H, W) bool, where candidates may be centred, or None.
    rooms: entries of the list of candidates and of corners of a frame, or None for a guess.
    """

    def __init__(
        self,
        queue: cl.CommandQueue,
        device: Device,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        config: DetectorConfig,
        scale: float | None,
        mask: NDArray[np.bool_] | None,
        frames: int,
    ) -> None:
        self.queue = queue
        self.device = device
        self.shape = shape
        self.dtype = dtype
        self.config = config
        self.scale = None if scale == 1 else scale
        self.frames = frames
        self.masks = config.threshold.masks
        self.working = shape if self.scale is None else working_shape(shape, self.scale)
        self.pad = _multiple(max(REACH, config.threshold.window // 2), REACH)
        self.step = _multiple(self.working[1] + 2 * self.pad, GROUP)
        self.full_step = _multiple(shape[1] + 2 * self.pad, GROUP)
        self.awaited = False  # a stream is waiting for its results
        self.events: list[tuple[str, cl.Event]] = []
        self.uploads: list[cl.Event] = []  # on their way, and with them the frames
        self._mask = mask
        pixels = self.working[0] * self.working[1]
        self.candidate_room = _multiple(pixels // 14 + 1, GROUP)
        self.corner_room = _multiple(min(config.max_corners, pixels // 96 + 256), GROUP)
        self.buffers: dict[str, cl.Buffer] = {}
        self.kernels = self._build()
        self._allocate()
        self._bind()

    @property
    def _in_words(self) -> bool:
        """Whether the criteria take 32 pixels in a word: what is fastest on CPUs."""
        rapid = isinstance(self.config.criteria, RapidCriteria)
        return rapid and self.device.kind is DeviceKind.CPU

    @property
    def _by_eight(self) -> bool:
        """Whether refinement takes eight corners in a vector: what is fastest on CPUs."""
        lines = isinstance(self.config.refinement, EdgeLines | EdgeStep)
        return lines and self.scale is None and self.device.kind is DeviceKind.CPU

    @property
    def plane_words(self) -> int:
        """Words of a plane, with the rows above and below."""
        return _multiple((self.working[0] + 2 * RING_REACH) * self.step // 32, WORDS)

    @property
    def words_margin(self) -> int:
        """Words before and after the planes that rings may look at."""
        return _multiple(RING_REACH * self.step // 32 + 8, 32)

    # What is compiled

    def _build(self) -> Kernels:
        rapid = isinstance(self.config.criteria, RapidCriteria)
        deep = self.dtype == np.uint16
        defines: dict[str, str | int] = {
            "PAD": self.pad,
            "PIXEL": "ushort" if deep else "uchar",
            "PIXEL_BITS": 16 if deep else 8,
            "MASKS": self.masks,
            "OUTER_RADIUS": self.config.outer_radius,
            "RAPID": int(rapid),
            "IN_WORDS": int(self._in_words),
            "WORDS_MARGIN": self.words_margin,
            "GATE": int(self.config.contrast is not None),
            "CORROSION": int(self.config.criteria.corrosion_threshold is not None),
            "BEYOND": BEYOND,
            "COLUMN": "uint" if deep else "ushort",
            "COLUMN8": "uint8" if deep else "ushort8",
            "LEVEL": ("ulong" if self.config.threshold.offset else "uint") if deep else "int",
            "SQUARE": "ulong" if deep else "uint",
            "VARIANCE": "ulong" if deep else "long",
            "DISTANCE": "long" if deep else "int",
            "NOISE": "uint" if deep else "ushort",
            "NOISE_BAND": NOISE_BAND,
            "BAND_NOISE": "ulong" if deep else "uint",
            "CURVATURE": "int" if deep else "short",
            "GROUP": GROUP,
            "LANES": 8 if self._by_eight else 1,
            "CONTRAST": "int" if deep else "short",
            "SUM": "uint" if deep else "ushort",
            "MEANS": "int" if deep else "short",
            "RADIUS": self.config.nms_radius,
            "RESPONSE": "uchar" if rapid else "int",
            "SCORE": "ushort" if rapid else "int",
            "SCALED": int(self.scale is not None),
            "REFINED": int(self.config.refinement is not None),
            "EDGE_STEP": int(isinstance(self.config.refinement, EdgeStep)),
            "MIDLINES": int(isinstance(self.config.refinement, Midlines)),
            "QUADRATIC": int(
                isinstance(self.config.refinement, Midlines)
                and self.config.refinement.fit is Fit.QUADRATIC
            ),
        }
        distances = range(1, self.config.nms_radius + 1)
        macros = {
            **({} if self._in_words else self._window_sums()),
            "OVER_SUPPRESSION(F)": " ".join(f"F({d})" for d in distances),
        }
        return build(self.queue.context, self.stages, defines, macros)

    def _window_sums(self) -> dict[str, str]:
        """The macros of binarize.cl: the sum over the window, and the one of sums of columns,
        as many of which are added in their own type as it can hold."""
        window = self.config.threshold.window
        terms = [f"F({k})" for k in range(-(window // 2), window // 2 + 1)]
        fits = window if self.dtype == np.uint16 else 65535 // (255 * window)
        groups = [
            f"(T)({sum_of_terms(terms[start : start + fits], 'COLUMN')})"
            for start in range(0, window, fits)
        ]
        return {
            "WINDOW_SUM(T, F)": sum_of_terms(terms, "T"),
            "WIDE_SUM(T, F)": sum_of_terms(groups, "T"),
        }

    @property
    def stages(self) -> list[str]:
        """The kernel files that the configuration needs."""
        stages = ["binarize_bands" if self._in_words else "binarize"]
        if self.scale is not None:
            stages.append("scale")
        rapid = isinstance(self.config.criteria, RapidCriteria)
        stages.append("criteria" if rapid else "spectral")
        if self._in_words:
            stages.append("criteria_words")
        if self.config.contrast is not None:
            stages.append("gate")
        eight = ["refine_eight"] if self._by_eight else []
        if self._by_eight and isinstance(self.config.refinement, EdgeStep):
            eight.append("edge_step_eight")
        if not self._in_words:
            return [*stages, "nms", "collect", "refine", *eight]
        if self.config.contrast is not None:
            stages.append("gate_words")
        return [*stages, "nms", "nms_bands", "refine", *eight]

    # What is allocated

    @property
    def sizes(self) -> dict[str, int]:
        """Bytes of every buffer."""
        planes = self.frames * self.masks
        plane = self.working[0] * self.step
        spare = 2 * self.step
        rapid = isinstance(self.config.criteria, RapidCriteria)
        pixel = self.dtype.itemsize
        response, score = (1, 2) if rapid else (4, 4)
        room, rows = planes * self.candidate_room, self.frames * self.corner_room
        gate = self.config.contrast is not None
        sizes = {
            "image": (self.frames * self.shape[0] + 2) * self.full_step * pixel,
            "mask": 4 * self.plane_words if self._in_words else plane + spare,
            "work": max(
                sum(_multiple(size, ALIGNMENT) for size in layout.values())
                for layout in self._layouts
            ),
            "row_counts": 4 * planes * self.working[0],
            "corners": 8 * rows,
            "result": 4 * (RESULT_FIELDS + 1) * rows,  # and the totals, fetched with it
        }
        if self._in_words:
            sizes["words"] = 4 * (planes * self.plane_words + 2 * self.words_margin)
            sizes["candidate_words"] = 4 * planes * self.plane_words
            sizes["row_starts"] = 4 * planes * self.working[0]
            sizes["maxima"] = self.frames * plane // 8
            sizes["response"] = self.frames * plane + spare
        else:
            sizes["binary"] = planes * plane + spare
            sizes["responses"] = response * (planes * plane + spare)
            sizes["zeros"] = score * self.step
        if self.scale is not None:
            sizes["working"] = (self.frames * plane + spare) * pixel
        if self.masks == 3:
            sizes["response"] = response * (self.frames * plane + spare)
        if gate and not self._in_words:
            sizes["candidates"] = 8 * room
        if gate:
            sizes["noise"] = 8 * self.frames * self._bands
            sizes["bins"] = 4 * planes * self._parts * BINS
            sizes["found"] = 8 * planes
            sizes["bounds"] = 8 * planes
        return sizes

    @property
    def _layouts(self) -> list[dict[str, int]]:
        """Bytes of the arrays that are needed only in passing. Those of a layout lie one after
        the other in the buffer "work", where each layout takes the place of the one before."""
        pixel = self.dtype.itemsize
        plane = (self.frames * self.working[0] + 2) * self.step
        score = 2 if isinstance(self.config.criteria, RapidCriteria) else 4
        room = self.frames * self.masks * self.candidate_room
        gate = self.config.contrast is not None
        bands = self.frames * self._bands
        layouts = []
        if self._in_words:
            row, long_row = bands * self.step, bands * (self.step + BEYOND)
            black = self.masks * row
            layouts.append({"sums": 2 * pixel * row, "prefix": 4 * long_row, "black": black})
            if self.masks == 3:
                layouts[-1] |= {"squares": 4 * pixel * row, "square_prefix": 4 * pixel * long_row}
            if gate:
                layouts[-1]["curved"] = 2 * pixel * row
        else:
            layouts.append({"sums": 2 * pixel * plane})
            if self.masks == 3:
                layouts[-1]["squares"] = 4 * pixel * plane
            if gate:
                layouts.append({"noise_sums": 2 * pixel * bands * self.step})
        lists = dict.fromkeys(
            CONTRASTS if gate else ("sector_response",), 2 * pixel * (room + BEHIND)
        )
        if self._in_words:
            kept = 2 * (2 * self.config.nms_radius + 3) + 1  # rows of a band
            layouts.append({**lists, "kept": 2 * kept * self.step * bands})
        else:
            if gate and isinstance(self.config.criteria, RapidCriteria):
                lists["samples"] = CHANNELS * pixel * room
            if gate:
                layouts.append(lists)
            layouts.append({"key": score * plane, "tent": score * plane})
        return [*layouts, self._refinement_layout]

    @property
    def _refinement_layout(self) -> dict[str, int]:
        """The same for what the kernels of refinement leave to one another."""
        refinement = self.config.refinement
        step = isinstance(refinement, EdgeStep)
        fields = {}
        if step or not self._by_eight:
            fields["start"] = START_FIELDS
        if step:
            fields["lines"] = LINE_FIELDS
        if refinement is not None and not self._by_eight:
            fields["points"] = POINT_FIELDS
            if self.scale is None:
                fields["edge_samples"] = EDGE_SAMPLES
        return {name: 4 * n * self.frames * self.corner_room for name, n in fields.items()}

    @property
    def _bands(self) -> int:
        """Bands of rows: those that a work-item on a CPU takes, and those of the noise estimate."""
        return -(-self.working[0] // self._band_rows)

    @property
    def _band_rows(self) -> int:
        """Rows of a band. On CPUs a band's start costs a share of the window and the rows beside
        it, and eight bands for each of a device's units share the work out evenly."""
        if not self._in_words:
            return NOISE_BAND
        share = -(-self.working[0] // (8 * self.device.handle.max_compute_units))
        return max(share, self.config.threshold.window // 4, 16)

    @property
    def _parts(self) -> int:
        """Shares of the list of candidates whose contrasts are counted apart."""
        if self._in_words:
            return self._bands
        return 16 if self.device.kind is DeviceKind.CPU else 256

    def _allocate(self) -> None:
        needed = sum(self.sizes.values())
        if needed > self.device.memory:
            raise CapacityError(
                f"the plan needs {needed} bytes, {self.device} has {self.device.memory}; "
                "use smaller images, fewer frames at a time or a mask of the active area"
            )
        try:
            for name, size in self.sizes.items():
                if name not in self.buffers:
                    buffer = cl.Buffer(self.queue.context, cl.mem_flags.READ_WRITE, max(size, 4))
                    self._clear(buffer)
                    self.buffers[name] = buffer
            self.queue.finish()
            self.arrays = {**self.buffers, **self._parts_of_work(), **self._parts_of_result()}
        except cl.Error as error:  # of memory, or of a size above the device's largest
            raise self.refused(error) from error
        self._upload_mask()

    def refused(self, error: cl.Error) -> CapacityError:
        """The error for a device that has no room left, though its memory would be enough."""
        return CapacityError(
            f"{self.device} has no room for a plan of {sum(self.sizes.values())} bytes, though "
            f"it has {self.device.memory}: {error}; close what else uses it, or use smaller "
            "images or fewer frames at a time"
        )

    def _parts_of_result(self) -> dict[str, cl.Buffer]:
        """Behind the columns the totals: candidates of each plane, corners of each frame."""
        result, columns = self.buffers["result"], 4 * RESULT_FIELDS * self.frames * self.corner_room
        totals = 4 * self.frames * (self.masks + 1)
        return {
            "result": result.get_sub_region(0, columns),
            "totals": result.get_sub_region(columns, totals),
        }

    def _clear(self, buffer: cl.Buffer) -> None:
        cl.enqueue_fill_buffer(self.queue, buffer, np.zeros(1, np.uint8), 0, buffer.size)

    def _parts_of_work(self) -> dict[str, cl.Buffer]:
        parts = {}
        for layout in self._layouts:
            place = 0
            for name, size in layout.items():
                parts[name] = self.buffers["work"].get_sub_region(place, size)
                place += _multiple(size, ALIGNMENT)
        return parts

    def _constant(self, table: NDArray[Any]) -> cl.Buffer:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.queue.context, flags, hostbuf=np.ascontiguousarray(table))

    def _upload_mask(self) -> None:
        rows, columns = self.working
        allowed = np.ones(self.working, np.bool_)
        if self._mask is not None:
            y = np.minimum(
                ((np.arange(rows) + 0.5) / (self.scale or 1)).astype(int), self.shape[0] - 1
            )
            x = np.minimum(
                ((np.arange(columns) + 0.5) / (self.scale or 1)).astype(int), self.shape[1] - 1
            )
            allowed = self._mask[np.ix_(y, x)]
        if self._in_words:
            bits = np.zeros(self.plane_words * 32, np.bool_)
            image = bits[: (rows + 2 * RING_REACH) * self.step].reshape(-1, self.step)
            image[RING_REACH:-RING_REACH, self.pad : self.pad + columns] = allowed
            plane = np.packbits(bits, bitorder="little")
        else:
            plane = np.zeros((rows + 2, self.step), np.uint8)
            plane[1:-1, self.pad : self.pad + columns] = allowed
        cl.enqueue_copy(self.queue, self.buffers["mask"], plane)

    def release(self) -> None:
        """Give the device's memory back."""
        for buffer in self.buffers.values():
            buffer.release()
        self.buffers.clear()

    # What is launched

    def _bind(self) -> None:
        self.front = [*self._scale_stage(), *self._binarize_stages(), *self._criteria_stages()]
        if self.config.contrast is not None:
            self.front += self._gate_stages(self.config.contrast)
        self.front += self._suppression_in_bands() if self._in_words else self._suppression_stages()
        self.launches = [*self.front, *self._refinement_stages()]
        self._likely = self.corner_room  # corners of a frame, at most

    def _stage(
        self, name: str, items: tuple[int, ...], group: tuple[int, ...] | None, *arguments: Any
    ) -> Launch:
        return Launch(name, self.kernels.bind(name, *arguments), items, group, arguments)

    def _dense(self, name: str, planes: int, *arguments: Any) -> Launch:
        """A kernel with one work-item per pixel."""
        items = (self.step, self.working[0], planes)
        return self._stage(name, items, (self._width, 1, 1), *arguments)

    @property
    def _width(self) -> int:
        """Work-items of a group of a dense kernel: a share of the row, pads included."""
        most = min(self.device.handle.max_work_group_size, 1024)
        if self.device.kind is not DeviceKind.CPU:
            most = min(most, 128)
        units = self.step // GROUP
        return max(
            GROUP * n
            for n in range(1, units + 1)
            if units % n == 0 and GROUP * n <= max(most, GROUP)
        )

    def _rows(self, name: str, rows: int, planes: int, *arguments: Any) -> Launch:
        """A kernel with one work-item per row."""
        group = (1, 1) if self.device.kind is DeviceKind.CPU else None
        return self._stage(name, (rows, planes), group, *arguments)

    def _list(self, name: str, *arguments: Any) -> Launch:
        """A kernel with one work-item per entry of the list of candidates."""
        items = (self.candidate_room, self.frames * self.masks)
        return self._stage(name, items, (GROUP, 1), *arguments)

    def _scale_stage(self) -> list[Launch]:
        if self.scale is None:
            self.image = self.buffers["image"]
            return []
        self.image = self.buffers["working"]
        tables: list[Any] = []
        for size, working in zip(self.shape, self.working, strict=True):
            first, weights = resampling_weights(size, working, self.scale)
            tables += [
                self._constant(first.astype(np.int32)),
                self._constant(weights.astype(np.int32)),
            ]
            tables.append(np.uint32(weights.shape[1]))
        arguments = [
            self.buffers["image"],
            *tables,
            *(np.uint32(n) for n in self.shape),
            np.uint32(self.full_step),
            np.uint32(self.working[0]),
            np.uint32(self.step),
            self.image,
        ]
        items = (self.working[1], self.working[0], self.frames)
        return [self._stage("resample", items, None, *arguments)]

    def _binarize_stages(self) -> list[Launch]:
        threshold: AdaptiveMean = self.config.threshold
        rows, columns, step = (np.uint32(n) for n in (*self.working, self.step))
        deep = self.dtype == np.uint16
        column = np.uint32 if deep else np.uint16
        count = threshold.window**2
        level: type[np.integer[Any]] = np.int32
        if deep:
            level = np.uint64 if threshold.offset else np.uint32
        # No mean of bytes is above 255.
        offset = level(threshold.offset if deep else min(threshold.offset, 255))
        if self._in_words:
            return [self._bands_stage(offset)]
        b = self.arrays
        planes = self.frames * self.masks
        stages = [
            self._rows(
                "repeat_border", self.frames * self.working[0], 1, rows, columns, step, self.image
            ),
            self._dense("column_sums", self.frames, self.image, rows, step, column(0), b["sums"]),
        ]
        if self.masks == 1:
            levels = (level(count), offset, np.uint32(0))
            images = (self.image, b["sums"], rows, step)
            stages.append(self._dense("binarize", self.frames, *images, *levels, b["binary"]))
        else:
            zero = np.uint64(0) if deep else np.uint32(0)
            arguments = (self.image, b["sums"], b["squares"], rows, step, np.uint64(count))
            stages += [
                self._dense(
                    "column_squares", self.frames, self.image, rows, step, zero, b["squares"]
                ),
                self._dense("binarize_three", self.frames, *arguments, np.uint64(0), b["binary"]),
            ]
        border = (rows, columns, step, b["binary"])
        stages.append(self._rows("repeat_border_binary", planes * self.working[0], 1, *border))
        return stages

    def _bands_stage(self, offset: np.integer[Any]) -> Launch:
        """Binarization to words, and the noise of the bands."""
        sizes = (*self.working, self.step, self._band_rows, self.config.threshold.window)
        b = self.arrays
        arguments = [self.image, *(np.uint32(n) for n in (*sizes, self.plane_words))]
        arguments += [b["sums"], b["prefix"]]
        arguments += [offset] if self.masks == 1 else [b["squares"], b["square_prefix"]]
        if self.config.contrast is not None:
            arguments += [b["curved"], b["noise"]]
        arguments += [b["black"], b["words"]]
        return self._rows("binarize_bands", self._bands, self.frames, *arguments)

    def _criteria_stages(self) -> list[Launch]:
        rows, step = np.uint32(self.working[0]), np.uint32(self.step)
        criteria = self.config.criteria
        corrosion = criteria.corrosion_threshold or 0
        b = self.arrays
        planes = self.frames * self.masks
        if isinstance(criteria, SpectralCriteria):
            arguments = self._spectral(criteria, np.int8(corrosion))
            stages = [self._dense("spectral_criteria", planes, *arguments)]
        elif self._in_words:
            return self._word_stages(criteria)
        else:
            thresholds = (
                np.uint8(criteria.sector_threshold),
                np.uint8(criteria.ring_threshold),
                np.int8(corrosion),
            )
            images = (b["binary"], b["mask"], rows, step)
            stages = [
                self._dense(
                    "rapid_criteria", planes, *images, *thresholds, np.uint8(0), b["responses"]
                )
            ]
        if self.config.contrast is not None:
            stages += self._lists("candidates", planes, b["responses"], self.candidate_room, 0)
        return stages

    def _word_stages(self, criteria: RapidCriteria) -> list[Launch]:
        """The criteria on words, and the list of their candidates."""
        rows, step, words = (np.uint32(n) for n in (self.working[0], self.step, self.plane_words))
        room = np.uint32(self.candidate_room)
        planes = self.frames * self.masks
        b = self.arrays
        thresholds = (
            np.int32(criteria.sector_threshold),
            np.int32(criteria.ring_threshold),
            np.int32(criteria.corrosion_threshold or 0),
        )
        band_rows = np.uint32(self._band_rows)
        contrast = np.int32 if self.dtype == np.uint16 else np.int16
        stages = [
            self._stage(
                "rapid_criteria_words",
                (self.plane_words // 8, planes),
                (WORDS // 8, 1),
                b["words"],
                b["mask"],
                step,
                words,
                *thresholds,
                b["candidate_words"],
                b["totals"],
            ),
        ]
        if self.config.contrast is None:
            sizes = (rows, step, words, room, band_rows, contrast(criteria.sector_threshold))
            found = (b["words"], b["candidate_words"], *sizes)
            lists = (b["totals"], b["row_starts"], b["sector_response"])
            stages.append(self._banded("sector_responses", planes, *found, *lists))
        return stages

    def _spectral(self, criteria: SpectralCriteria, corrosion: np.int8) -> Sequence[Any]:
        inner, outer = spectrum.response_tables()
        return (
            self.buffers["binary"],
            self.buffers["mask"],
            self._constant(inner),
            self._constant(outer),
            self._constant(spectrum.least_correlation(criteria.correlation)),
            np.uint32(self.working[0]),
            np.uint32(self.step),
            np.int32(spectrum.phase_bound(criteria.phase)),
            corrosion,
            self.buffers["responses"],
        )

    def _lists(
        self, what: str, planes: int, image: cl.Buffer, room: int, place: int
    ) -> list[Launch]:
        """The two stages that list the pixels of an image that are not 0."""
        rows, columns, step = (np.uint32(n) for n in (*self.working, self.step))
        b = self.arrays
        counts = (image, rows, columns, step, b["row_counts"])
        listed = (image, b["row_counts"], rows, columns, step, np.uint32(room), np.uint32(place))
        return [
            self._rows(f"count_{what}", self.working[0], planes, *counts),
            self._rows(
                f"list_{what}",
                self.working[0],
                planes,
                *listed,
                b["candidates" if what == "candidates" else "corners"],
                b["totals"],
            ),
        ]

    def _gate_stages(self, gate: SectorContrast) -> list[Launch]:
        rows, columns, step = (np.uint32(n) for n in (*self.working, self.step))
        b, room = self.arrays, np.uint32(self.candidate_room)
        planes = self.frames * self.masks
        deep = self.dtype == np.uint16
        pixel = np.uint16 if deep else np.uint8
        contrast = [b[name] for name in CONTRASTS]
        levels = np.arange(2**16 if deep else 2**8)
        floor = math.ceil(gate.minimum * self.config.grey_levels(self.dtype) / 255)
        limit = self._constant(
            np.maximum(np.ceil(np.float64(gate.relative) * levels), floor).astype(np.int32)
        )
        factor = math.floor(6.68 * (gate.noise if self.masks == 1 else max(gate.noise, 3)) + 0.5)
        parts = np.uint32(self._parts)
        bands = self._bands
        curvature = np.int32 if deep else np.int16
        stages = []
        if not self._in_words:
            noise = (self.image, rows, step, curvature(0), b["noise_sums"])
            summed = (b["noise_sums"], columns, step, b["noise"])
            stages += [
                self._stage("noise", (self.step, bands, self.frames), (self._width, 1, 1), *noise),
                self._rows("noise_of_band", bands, self.frames, *summed),
            ]
        criteria = self.config.criteria
        signed = np.int32 if deep else np.int16
        listed = (b["candidates"], b["totals"]) if not self._in_words else ()
        if self._in_words and isinstance(criteria, RapidCriteria):
            words = (b["words"], b["candidate_words"])
            sizes = (rows, step, np.uint32(self.plane_words), room, np.uint32(self._band_rows))
            threshold = signed(criteria.sector_threshold)
            lists = (b["totals"], b["row_starts"], *contrast, b["bins"])
            stages.append(
                self._banded("gate_words", planes, self.image, *words, *sizes, threshold, *lists)
            )
        elif isinstance(criteria, RapidCriteria):
            threshold = signed(criteria.sector_threshold)
            stages += [
                self._list(
                    "sample_rings", self.image, b["binary"], *listed, rows, step, room, b["samples"]
                ),
                self._list("sector_contrast", b["samples"], room, threshold, pixel(0), *contrast),
            ]
        else:
            arguments = (self.image, b["binary"], *listed, rows, step, room, *contrast[:3])
            stages.append(self._list("sector_contrast_any", *arguments))
        for shift in (8, 0) if deep else (0,):
            bits = np.uint32(shift)
            histogram = (contrast[0], b["totals"], b["found"], room, bits, parts, b["bins"])
            percentile = (b["bins"], b["totals"], b["noise"], limit, rows, columns)
            sizes = (np.uint32(bands), room, bits, parts, np.uint32(factor))
            if not self._in_words or (deep and shift == 0):
                stages.append(self._rows("histogram", self._parts, planes, *histogram))
            stages.append(
                self._rows("percentile", planes, 1, *percentile, *sizes, b["found"], b["bounds"])
            )
        if not self._in_words:
            keep = (*contrast[1:], *listed, b["bounds"], rows, step, room, b["responses"])
            stages.append(self._list("keep", *keep))
        return stages

    def _banded(self, name: str, planes: int, *arguments: Any) -> Launch:
        """A kernel with one work-item per band of rows."""
        return self._stage(name, (self._bands, planes), (1, 1), *arguments)

    def _suppression_in_bands(self) -> list[Launch]:
        rows, step = np.uint32(self.working[0]), np.uint32(self.step)
        b = self.arrays
        self.response = b["response"]
        gate = self.config.contrast is not None
        room = np.uint32(self.candidate_room)
        sizes = (rows, step, np.uint32(self.plane_words), room, np.uint32(self._band_rows))
        gated = (b["contrast"], b["mean_difference"], b["bounds"]) if gate else ()
        lists = (b["candidate_words"], b["row_starts"], *gated, b["sector_response"])
        found = (b["kept"], b["response"], b["maxima"], b["row_counts"])
        place = np.uint32(self.frames * self.masks)
        corner_room = np.uint32(self.corner_room)
        listed = (b["maxima"], b["row_counts"], rows, step, corner_room, place, sizes[-1])
        return [
            self._banded("suppress_bands", self.frames, *lists, *sizes, *found),
            self._banded("list_maxima_words", self.frames, *listed, b["corners"], b["totals"]),
        ]

    def _suppression_stages(self) -> list[Launch]:
        rows, step = np.uint32(self.working[0]), np.uint32(self.step)
        rapid = isinstance(self.config.criteria, RapidCriteria)
        zero = np.uint16(0) if rapid else np.int32(0)
        b = self.arrays
        stages = []
        self.response = b["responses"]
        if self.masks == 3:
            self.response = b["response"]
            stages.append(
                self._dense("combine", self.frames, b["responses"], rows, step, self.response)
            )
        key, rest = b["key"], b["tent"]
        common = (rows, step, zero)
        # What the binary image was needed for is over: the maxima take its place.
        return [
            *stages,
            self._dense("tent_rows", self.frames, self.response, *common, rest),
            self._dense("score", self.frames, self.response, rest, b["zeros"], *common, key),
            self._dense("row_maximum", self.frames, key, *common, rest),
            self._dense("maximum", self.frames, key, rest, b["zeros"], *common, b["binary"]),
            *self._lists(
                "maxima", self.frames, b["binary"], self.corner_room, self.frames * self.masks
            ),
        ]

    def _refinement_stages(self) -> list[Launch]:
        """From the maxima to positions."""
        refinement = self.config.refinement
        rows, step = np.uint32(self.working[0]), np.uint32(self.step)
        b = self.arrays
        lists = (b["corners"], b["totals"], rows, step, *self._corner_rows)
        if self._by_eight:
            arguments = (self.response, b["image"], *lists, self._largest_shift)
            between = (b["start"], b["lines"]) if isinstance(refinement, EdgeStep) else ()
            stages = [self._corners("refine_eight", 8, *arguments, *between, b["result"])]
        else:
            scale, size = np.float32(self.scale or 1), (np.uint32(n) for n in self.shape)
            places = (scale, *size, b["start"], b["result"])
            stages = [self._corners("centroid", 1, self.response, *lists, *places)]
            if refinement is not None:
                stages += self._edge_stages(refinement)
        if isinstance(refinement, EdgeStep):
            stages.append(self._step_stage(refinement))
        return stages

    def _edge_stages(self, refinement: EdgeLines | EdgeStep | Midlines) -> list[Launch]:
        """From the starts to edge points and where their lines meet, one by one."""
        b = self.arrays
        grey, corners = (b["image"], b["start"], b["totals"]), self._corner_rows
        if self.scale is None:
            samples = b["edge_samples"]
            size = (np.uint32(self.shape[0]), np.uint32(self.full_step))
            stages = [
                self._corners("sample_edges", 1, *grey, *size, *corners, samples),
                self._corners("edge_points", 1, samples, b["totals"], *corners, b["points"]),
            ]
        else:
            full = (*(np.uint32(n) for n in self.shape), np.uint32(self.full_step))
            scaled = (*full, *corners, np.float32(self.scale))
            stages = [self._corners("edge_points", 1, *grey, *scaled, b["points"])]
        points = (b["points"], b["start"], b["totals"], *corners, self._largest_shift)
        if isinstance(refinement, Midlines):
            return [*stages, self._corners("midlines", 1, *points, b["result"])]
        between = (b["lines"],) if isinstance(refinement, EdgeStep) else ()
        return [*stages, self._corners("edge_lines", 1, *points, *between, b["result"])]

    def _step_stage(self, refinement: EdgeStep) -> Launch:
        b, factor = self.arrays, self.scale or 1.0
        radius = min(max(0.75 * refinement.cell * factor, 4.5), 9.0) / factor
        size = (*(np.uint32(n) for n in self.shape), np.uint32(self.full_step))
        lengths = (np.float32(radius), np.float32(factor))
        between = (b["image"], b["start"], b["lines"], b["totals"])
        if self._by_eight:
            size = (np.uint32(self.shape[0]), np.uint32(self.full_step))
            lists = (*between, *size, *self._corner_rows, lengths[0], b["result"])
            return self._corners("edge_step_eight", 8, *lists)
        arguments = (*between, *size, *self._corner_rows, *lengths, b["result"])
        return self._corners("edge_step", 1, *arguments)

    @property
    def _corner_rows(self) -> tuple[np.uint32, np.uint32, np.uint32]:
        """What says where a corner's row is: room of a frame, place of its total, all rows."""
        return (
            np.uint32(self.corner_room),
            np.uint32(self.frames * self.masks),
            np.uint32(self.frames * self.corner_room),
        )

    @property
    def _largest_shift(self) -> np.float32:
        """Of a refined position from its start, px of the image."""
        refinement = self.config.refinement
        shift = refinement.max_shift if isinstance(refinement, EdgeLines | Midlines) else 2.0
        return np.float32(shift / (self.scale or 1.0))

    def _corners(self, name: str, each: int, *arguments: Any) -> Launch:
        """A kernel whose work-items take `each` corners of the list."""
        items = (self.corner_room // each, self.frames)
        return self._stage(name, items, (GROUP if each == 1 else 1, 1), *arguments)

    # What happens in a frame

    def upload(self, queue: cl.CommandQueue, frames: Sequence[GreyImage]) -> None:
        """Start to copy the frames to the device; they may be changed once `uploads` are over."""
        size = self.dtype.itemsize
        for n, frame in enumerate(frames):
            pitch = frame.strides[0] if frame.shape[0] > 1 else frame.shape[1] * size
            host = frame if frame.flags.c_contiguous else _flat(frame, pitch)
            copy = _copy_rectangle(
                queue,
                self.buffers["image"],
                host,
                buffer_origin=(self.pad * size, n * self.shape[0] + 1, 0),
                host_origin=(0, 0, 0),
                region=(self.shape[1] * size, self.shape[0], 1),
                buffer_pitches=(self.full_step * size, 0),
                host_pitches=(pitch, 0),
                is_blocking=False,
            )
            self.uploads.append(copy)
        queue.flush()

    def launch(self, stages: Sequence[Launch]) -> None:
        """Enqueue the stages in order, after the upload."""
        queue, enqueue = self.queue, cl.enqueue_nd_range_kernel
        profile = queue.properties & cl.command_queue_properties.PROFILING_ENABLE
        before = self.uploads
        for stage, kernel, items, group, _ in stages:
            self._last = enqueue(queue, kernel, items, group, wait_for=before)
            before = []
            if profile:
                self.events.append((stage, self._last))
        queue.flush()

    def read(self, queue: cl.CommandQueue) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """The results, (fields, frames, most corners of a frame) float32, and the number of
        corners of each frame, once the launches are done; raises Overflow."""
        planes = self.frames * self.masks
        columns = self._fetch(queue, self._likely)
        self.uploads.clear()
        totals = columns[RESULT_FIELDS].reshape(-1)[: planes + self.frames].view(np.uint32)
        candidates, counts = int(totals[:planes].max()), totals[planes:]
        most = int(counts.max())
        if candidates > self.candidate_room or most > self.corner_room:
            raise Overflow(candidates, most)
        if most > columns.shape[2]:
            columns = self._fetch(queue, most)
        self._likely = min(max(most * 9 // 8, len(totals)), self.corner_room)
        return columns[:RESULT_FIELDS, :, :most], counts

    def _fetch(self, queue: cl.CommandQueue, most: int) -> NDArray[np.float32]:
        """The first columns of the result; of its last row as many as there are totals."""
        columns = np.empty((RESULT_FIELDS + 1, self.frames, most), np.float32)
        _copy_rectangle(
            queue,
            columns,
            self.buffers["result"],
            buffer_origin=(0, 0, 0),
            host_origin=(0, 0, 0),
            region=(4 * most, self.frames, RESULT_FIELDS + 1),
            buffer_pitches=(4 * self.corner_room, 4 * self.frames * self.corner_room),
            host_pitches=(4 * most, 4 * self.frames * most),
            wait_for=[self._last],
        )
        return columns

    def grow(self, overflow: Overflow) -> None:
        """Make room for what did not fit; the frames stay on the device."""
        if overflow.candidates > self.candidate_room:
            self.candidate_room = _multiple(overflow.candidates * 5 // 4, GROUP)
        if overflow.corners > self.corner_room:
            self.corner_room = _multiple(overflow.corners * 5 // 4, GROUP)
        image = self.buffers.pop("image")
        self.release()
        self.buffers["image"] = image
        self._allocate()
        self._bind()


_copy_rectangle: Any = cl.enqueue_copy  # whose stub does not know the form for rectangles


def _multiple(value: int, of: int) -> int:
    """The least multiple that is not below the value, and not 0."""
    return max(-(-value // of), 1) * of


def _flat(frame: GreyImage, pitch: int) -> NDArray[Any]:
    """The memory from the first to the last pixel of rows that lie apart, as it is."""
    count = ((frame.shape[0] - 1) * pitch + frame.shape[1] * frame.itemsize) // frame.itemsize
    return np.lib.stride_tricks.as_strided(frame, (count,), (frame.itemsize,), writeable=False)
