"""The plan of the lattice: buffers and bound kernels from the corners of a frame to its board.

A plan serves frames of one shape and pixel type, with up to `capacity` corners. It allocates once.
"""

import functools
import threading
from collections.abc import Iterable
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.image import GreyImage
from cmp_cl.lattice import kernels, parts
from cmp_cl.lattice.arrays import Board, Border, Units, Votes
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.kernels import Kernel, Over
from cmp_cl.opencl.device import Device, DeviceKind, check_process, clear_errors
from cmp_cl.opencl.launches import GROUP, Launch, bound, enqueue, multiple
from cmp_cl.opencl.memory import Memory
from cmp_cl.opencl.program import Programs, programs_of
from cmp_cl.stages.layout import LEAST_PAD, PlanBase
from cmp_cl.stages.refine import (
    EDGES,
    METHOD,
    POSITION,
    RESULT_FIELDS,
    RESULT_HEAD,
    VARIANCE,
)

ONE_GROUP = 256  # work-items of a kernel that is one work-group
PLACES = 16384  # of a board with few corners
ROWS = 64  # work-items, of which each takes rows of a board, on a CPU
LANES = 8  # the fields of the corners have a multiple of so many elements
MOST_PLANS = 4  # that are kept for corners that come from the host


class LatticePlan:
    """Buffers and bound kernels for one frame at a time.

    shape: (H, W) of a frame. dtype: uint8 or uint16. full_scale: its largest grey level. capacity:
    the most corners. detection: the plan on whose queue the image and the corners are found;
    without it they come from the host, see `take`. programs: those of its context.
    """

    def __init__(
        self,
        device: Device,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        full_scale: int,
        capacity: int,
        constants: LatticeConstants | None = None,
        *,
        detection: PlanBase | None = None,
        programs: Programs | None = None,
    ) -> None:
        programs = programs or programs_of(device.handle)
        self.queue = detection.queue if detection else cl.CommandQueue(programs.context)
        self.device = device
        self.shape = shape
        self.dtype = dtype
        self.full_scale = full_scale
        self.constants = LatticeConstants() if constants is None else constants
        self.lock = threading.RLock()  # held by who uses the plan
        if detection:
            self.capacity, self.pad, self.step = capacity, detection.pad, detection.step
            given = {"image": detection.arrays["image"], "corners": detection.arrays["result"]}
        else:
            self.capacity, self.pad = multiple(capacity, GROUP), LEAST_PAD
            self.step, given = multiple(shape[1] + 2 * self.pad, GROUP), {}
        self.kernels = programs.kernels(kernels.FILES, self._defines)
        self.values = kernels.tables(self.constants, self.queue.context) | self._numbers
        sizes = {n: size for n, size in self._sizes.items() if n not in given}
        self.memory = Memory(self.queue, {n: ((size,), np.uint8) for n, size in sizes.items()})
        self.buffers = given | self.memory.parts
        self.make_room(kernels.ROOM * self.capacity)
        self.launches = self._bound(kernels.PARTS_OF_CORNERS)
        self.lay = self._bound(kernels.BOARD_OF_NUMBERS)
        self._likely = 0  # places of a board, as of the frame before
        self.gained = 0  # lines that the last board has more than were laid out

    @classmethod
    def of(cls, detection: PlanBase, programs: Programs) -> "LatticePlan":
        """Return a plan that numbers the corners of a detection where they lie, one frame of it."""
        return cls(
            detection.device,
            detection.shape,
            detection.dtype,
            detection.config.grey_levels(detection.dtype),
            detection.corner_capacity,
            detection=detection,
            programs=programs,
        )

    @property
    def corners_of(self) -> cl.Buffer:
        """Return the buffer of the corners."""
        return self.buffers["corners"]

    @property
    def _defines(self) -> dict[str, str | int]:
        whole = self.dtype == np.uint8 and self.full_scale == 255
        return {
            **kernels.macros(self.constants),
            "PIXEL": "uchar" if self.dtype == np.uint8 else "ushort",
            "PAD": self.pad,
            "WHOLE_LEVELS": int(whole),
            "HEAD": RESULT_HEAD,
            "EDGES_FIELD": EDGES.start,
            "METHOD_FIELD": METHOD,
            "VARIANCE_FIELD": VARIANCE,
        }

    @property
    def _sizes(self) -> dict[str, int]:
        """Return the bytes of the buffers."""
        rows, columns = self.shape
        room = {"corners": self.capacity, "places": self.places}
        return {
            "image": (rows + 2) * self.step * self.dtype.itemsize,
            **kernels.sizes(**room, rows=rows, columns=columns, step=self.step),
        }

    @property
    def _numbers(self) -> dict[str, Any]:
        """Return the arguments that tell of the frame, and how much room there is."""
        count = {
            "capacity": self.capacity,
            "step": self.step,
            "level_step": self.step,
            "full_scale": self.full_scale,
            "rows": self.shape[0],
            "columns": self.shape[1],
        }
        numbers = {name: np.uint32(value) for name, value in count.items()}
        return {**numbers, "places": np.int32(self.places)}

    @property
    def bytes(self) -> int:
        """Return the bytes allocated on the device."""
        return int(self.memory.buffer.size + self._votes.buffer.size)

    @property
    def places(self) -> int:
        """Return the places of the largest board: four for each corner, beside its margins."""
        return 4 * self.capacity + PLACES

    def _bound(self, table: Iterable[Kernel]) -> list[Launch]:
        """Bind kernels to their arguments.

        On a CPU a kernel over pixels has groups of whole rows, as far as the device has so large
        ones, one over the places of a board some rows for each work-item, and one work-group is one
        work-item. Groups of corners are small there, because PoCL gives a thread 32 of them at a
        time.
        """
        cpu = self.device.kind is DeviceKind.CPU
        rows = cpu and self.step <= self.device.handle.max_work_group_size
        items_and_group = {
            Over.PIXELS: ((self.step, self.shape[0]), (self.step if rows else GROUP, 1)),
            Over.CORNERS: ((self.capacity,), (GROUP // 4 if cpu else GROUP,)),
            Over.HALF_EDGES: ((4 * self.capacity,), (GROUP,)),
            Over.PLACES: ((1, ROWS), (1, 1)) if cpu else ((GROUP, 4 * ROWS), (GROUP, 1)),
            Over.GROUP: ((1,), (1,)) if cpu else ((ONE_GROUP,), (ONE_GROUP,)),
        }
        given = {**self.values, **self.buffers}
        return [bound(self.kernels, given, name, *items_and_group[over]) for name, over in table]

    # What happens in a frame

    def take(self, image: GreyImage, corners: Corners) -> None:
        """Give the plan an image, (H, W), and its corners."""
        count = len(corners)
        after = self.step - self.pad - self.shape[1]
        padded = np.pad(image, ((1, 1), (self.pad, after)), mode="edge")
        length = multiple(count, LANES)
        numbers = np.zeros(RESULT_HEAD + RESULT_FIELDS * length, np.float32)
        numbers[:1].view(np.uint32)[0] = count
        fields = numbers[RESULT_HEAD:].reshape(RESULT_FIELDS, length)
        fields[POSITION].reshape(-1)[: 2 * count] = corners.xy.ravel()
        fields[EDGES].reshape(-1)[: 4 * count] = corners.edges.ravel()
        fields[METHOD].view(np.uint8)[length : length + count] = corners.refusal
        fields[VARIANCE, :count] = np.square(corners.sigma)
        self.write("image", padded)
        self.write("corners", numbers)

    def write(self, name: str, values: NDArray[Any]) -> None:
        """Write the first elements of an array."""
        with clear_errors(self.queue.device):
            self.queue.finish()
        self.memory.arrays[name].view(values.dtype)[: values.size] = values.ravel()
        self.memory.upload(name)

    def _set(self, place: int, value: int) -> None:
        """Enqueue the writing of a number of the layout."""
        layout = self.memory.parts["layout"]
        with clear_errors(self.queue.device):
            cl.enqueue_fill_buffer(self.queue, layout, np.full(1, value, np.int32), 4 * place, 4)

    def enqueue(self, launches: list[Launch]) -> None:
        """Enqueue launches, in order."""
        enqueue(self.queue, launches)

    def start(self) -> None:
        """Enqueue what leads from the corners to the parts, and if one part is large enough, to its
        board. Nothing is waited for."""
        self.enqueue([*self.launches, *self.lay])

    def alone(self) -> Board | None:
        """Wait for the parts. Return the board if one part is large enough, (0, 0) without any,
        None if several are."""
        layout, board = self._board()
        return None if layout[kernels.PARTS] > 1 else board

    def parts(self, xy: NDArray[np.float32]) -> tuple[Units, Votes]:
        """Return the nodes of a frame of several parts, and the votes for where these lie; xy:
        (N, 2), the corners, px."""
        self.enqueue(self.find_votes)
        count, votes = 4 * len(xy), int(self.read("layout", np.int32)[kernels.VOTES])
        if votes > self.values["room"]:  # which of them are kept is chance
            self.make_room(votes)
            self._set(kernels.VOTES, 0)
            self.enqueue(self.find_votes)
        self._votes.download(votes=kernels.VOTE * votes)
        root, state, faces = self.fetch(
            ("part", np.int32, count),
            ("state", np.int32, 4 * count),
            ("faces_of_part", np.int32, count),
        )
        found = self._votes.arrays["votes"][: kernels.VOTE * votes].copy()
        return parts.parts_of(root, state, faces, found, xy)

    def make_room(self, votes: int) -> None:
        """Make the list of votes anew, with room for so many."""
        room = multiple(votes, GROUP)
        self._votes = Memory(self.queue, {"votes": ((kernels.VOTE * room,), np.int32)})
        self.buffers |= self._votes.parts
        self.values["room"] = np.int32(room)
        self.find_votes = self._bound(kernels.VOTES_OF_PARTS)

    def settle(self, numbers: NDArray[np.int32]) -> Board:
        """Return the board of numbered corners, its nodes settled, as `_board`.

        numbers: (N, 4), column, row, quarter turn, and 1 for a corner that has them, TAKEN for one
            that cannot be a node. A number that several corners have goes to the first of them. The
            board is empty if they reach farther than four places for each corner.
        """
        self.write("numbers", numbers)
        self._set(kernels.PARTS, 1)
        self.enqueue(self.lay)
        return self._board()[1]

    def _board(self) -> tuple[NDArray[np.int32], Board]:
        """Wait. Return the layout, and the board as it is: upright, with its border, without outer
        lines that hold too few of their places in view."""
        count = -1
        while count < 0 or count > self._likely:
            self._likely = max(count, self._likely)
            layout, found, at, owner, kind, spread = self.fetch(
                ("layout", np.int32, kernels.LAYOUT),
                ("border", np.int32, kernels.FOUND),
                ("result", np.float32, 2 * self._likely),
                ("owner", np.int32, self._likely),
                ("kind", np.uint8, self._likely),
                ("spread", np.float32, self._likely),
            )
            laid = layout.tolist()
            rows, columns = laid[kernels.BOARD_ROWS], laid[kernels.BOARD_COLUMNS]
            count = rows * columns
        self._likely = count or self._likely
        top, bottom, left, right = found[: kernels.SIDES].tolist()
        larger = max(bottom - top - rows, right - left - columns)
        self.gained = larger + 2 * (kernels.ROUNDS + 2) if count else 0

        def held(values: NDArray[Any], *more: int) -> NDArray[Any]:
            return values.reshape(rows, columns, *more)[top:bottom, left:right]

        kinds, xy = held(kind[:count]), held(at[: 2 * count], 2)
        board = Board(
            x=xy[..., 0],
            y=xy[..., 1],
            owner=held(owner[:count]),
            torn=kinds == kernels.ROUGH,
            firm=kinds == kernels.FIRM,
            spread=held(spread[:count]),
            sign=laid[kernels.SIGN] * (1 - 2 * ((top + left) % 2)),
            border=Border.of(found[kernels.SIDES :]),
        )
        return layout, board.upright()

    def fetch(self, *wanted: tuple[str, Any, int]) -> list[NDArray[Any]]:
        """Return the first elements of arrays after the launches: names, dtypes, counts."""
        counts = {name: count * np.dtype(dtype).itemsize for name, dtype, count in wanted}
        self.memory.download(**counts)
        with clear_errors(self.queue.device):
            self.queue.finish()
        return [
            self.memory.arrays[name][: counts[name]].copy().view(dtype) for name, dtype, _ in wanted
        ]

    def read(self, name: str, dtype: Any, count: int | None = None) -> NDArray[Any]:
        """Return the first elements of a buffer, or all, once the launches are done."""
        most = self.buffers[name].size // np.dtype(dtype).itemsize
        return self.fetch((name, dtype, most if count is None else count))[0]


def lattice_plan(
    device: Device, shape: tuple[int, int], dtype: np.dtype[Any], full_scale: int, count: int
) -> LatticePlan:
    """Return a plan for so many corners that come from the host. The last few plans are kept; hold
    its `lock` while you use it."""
    check_process()
    capacity = 1 << max(count - 1, GROUP).bit_length()
    return _kept(device, shape, np.dtype(dtype), full_scale, capacity)


_kept = functools.lru_cache(maxsize=MOST_PLANS)(LatticePlan)
