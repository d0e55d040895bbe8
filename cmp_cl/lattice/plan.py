"""The plan of the lattice: buffers and bound kernels from the corners of a frame to its board.

A plan serves frames of one shape and pixel type, with up to `capacity` corners. It allocates once.
"""

from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.image import GreyImage
from cmp_cl.lattice import links, nodes, parts, votes
from cmp_cl.lattice.arrays import Board, Parts, Units, Votes, Whole
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.launches import GROUP, Binder, Launch, multiple
from cmp_cl.opencl.program import Programs
from cmp_cl.opencl.shared import shared_buffer, shares_memory
from cmp_cl.stages.layout import LEAST_PAD
from cmp_cl.stages.refine import (
    EDGES,
    METHOD,
    POSITION,
    RESULT_FIELDS,
    RESULT_HEAD,
    VARIANCE,
)

FILES = ("bins", "links", "faces", "parts", "votes", "nodes")
SHARED = ("image", "corners")  # buffers that the host writes
ONE_GROUP = 256  # work-items of a kernel that is one work-group
PLACES = 16384  # of a board with few corners
MOST_PASSES = 8  # that are launched at a time; one that is not needed does nothing
ROWS = 64  # work-items, of which each takes rows of a board, on a CPU
LANES = 8  # the fields of the corners have a multiple of so many elements


class LatticePlan(Binder):
    """Buffers and bound kernels for one frame at a time.

    shape: (H, W) of a frame. dtype: uint8 or uint16. full_scale: its largest grey level. capacity:
    the most corners. constants: those of the lattice. pad: columns of padding on either side of the
    image; step: elements of a row; start: the first element of the first row.
    """

    def __init__(
        self,
        *,
        queue: cl.CommandQueue,
        programs: Programs,
        device: Device,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        full_scale: int,
        capacity: int,
        constants: LatticeConstants,
    ) -> None:
        super().__init__(queue, device)
        self.shape = shape
        self.dtype = dtype
        self.full_scale = full_scale
        self.capacity = multiple(capacity, GROUP)
        self.constants = constants
        self.pad = LEAST_PAD
        self.step = multiple(shape[1] + 2 * self.pad, GROUP)
        self.start = self.step
        self.kernels = programs.kernels(FILES, self._defines)
        self._here: dict[str, NDArray[Any]] = {}
        self.buffers = {name: self._buffer(name, size) for name, size in self.sizes.items()}
        self.nats = self.constant(nodes.nats(self))
        self.launches = [*links.launches(self), *parts.launches(self), *nodes.first_board(self)]
        self.find_votes = votes.launches(self)
        self.lay = nodes.lay(self)
        self.a_pass = nodes.a_pass(self)

    @property
    def _defines(self) -> dict[str, str | int]:
        whole = self.dtype == np.uint8 and self.full_scale == 255
        return {
            "PIXEL": "uchar" if self.dtype == np.uint8 else "ushort",
            "PAD": self.pad,
            "WHOLE_LEVELS": int(whole),
            "HEAD": RESULT_HEAD,
            "EDGES_FIELD": EDGES.start,
            "METHOD_FIELD": METHOD,
            "VARIANCE_FIELD": VARIANCE,
            "SIDE_STEP": 4 // (len(self.constants.side_points) - 1),
        }

    @property
    def sizes(self) -> dict[str, int]:
        """Return the bytes of every buffer, by name."""
        return {
            "image": (self.shape[0] + 2) * self.step * self.dtype.itemsize,
            "corners": 4 * (RESULT_HEAD + RESULT_FIELDS * self.capacity),
            **links.sizes(self),
            **parts.sizes(self),
            **votes.sizes(self),
            **nodes.sizes(self),
        }

    def _buffer(self, name: str, size: int) -> cl.Buffer:
        """Return a buffer, in memory shared with the host if it is one of SHARED and the device
        can."""
        if name in SHARED and shares_memory(self.device.handle):
            buffer, self._here[name] = shared_buffer(self.queue.context, size)
            return buffer
        return cl.Buffer(self.queue.context, cl.mem_flags.READ_WRITE, size)

    @property
    def places(self) -> int:
        """Return the places of the largest board: four for each corner, beside its margins."""
        return 4 * self.capacity + PLACES

    # How kernels are bound

    @property
    def size(self) -> dict[str, Any]:
        """Return the rows and columns of the image, by argument."""
        return {"rows": np.uint32(self.shape[0]), "columns": np.uint32(self.shape[1])}

    @property
    def levels(self) -> dict[str, Any]:
        """Return the smoothed image, by argument."""
        return {
            "levels": self.buffers["levels"],
            "level_step": np.uint32(self.step),
            **self.size,
        }

    @property
    def corners(self) -> dict[str, Any]:
        """Return the corners in the layout of kernels/result.clh, by argument."""
        return {"corners": self.buffers["corners"], "capacity": np.uint32(self.capacity)}

    @property
    def width(self) -> int:
        """Return the work-items of a group of a kernel over pixels: on a CPU a whole row."""
        return self.step if self.device.kind is DeviceKind.CPU else GROUP

    def of_corners(self, name: str, **arguments: Any) -> Launch:
        """Bind a kernel with one work-item per corner."""
        return self.stage(name, (self.capacity,), (GROUP,), **arguments)

    def of_half_edges(self, name: str, **arguments: Any) -> Launch:
        """Bind a kernel with one work-item per half-edge."""
        return self.stage(name, (4 * self.capacity,), (GROUP,), **arguments)

    def of_places(self, name: str, **arguments: Any) -> Launch:
        """Bind a kernel over the places of a board; on a CPU a work-item takes some rows."""
        if self.device.kind is DeviceKind.CPU:
            return self.stage(name, (1, ROWS), (1, 1), **arguments)
        return self.stage(name, (GROUP, 4 * ROWS), (GROUP, 1), **arguments)

    def one_group(self, name: str, **arguments: Any) -> Launch:
        """Bind a kernel that is one work-group; on a CPU it is one work-item."""
        items = 1 if self.device.kind is DeviceKind.CPU else ONE_GROUP
        return self.stage(name, (items,), (items,), **arguments)

    # What happens in a frame

    def take(
        self,
        image: GreyImage,
        xy: NDArray[np.float32],
        edges: NDArray[np.float32],
        sigma: NDArray[np.float32],
        refusal: NDArray[np.uint8],
    ) -> None:
        """Give the plan an image and its corners: (H, W), (N, 2) px, (N, 4) rad, (N,) px, (N,)."""
        count, pad = len(xy), self.pad
        padded = np.zeros((self.shape[0] + 2, self.step), self.dtype)
        padded[1:-1, pad : pad + self.shape[1]] = image
        padded[1:-1, :pad] = image[:, :1]
        padded[1:-1, pad + self.shape[1] :] = image[:, -1:]
        length = multiple(count, LANES)
        numbers = np.zeros(RESULT_HEAD + RESULT_FIELDS * length, np.float32)
        numbers[:1].view(np.uint32)[0] = count
        fields = numbers[RESULT_HEAD:].reshape(RESULT_FIELDS, length)
        fields[POSITION].reshape(-1)[: xy.size] = xy.ravel()
        fields[EDGES].reshape(-1)[: edges.size] = edges.ravel()
        fields[METHOD].view(np.uint8)[length : length + count] = refusal
        fields[VARIANCE, :count] = sigma * sigma
        self._write("image", padded)
        self._write("corners", numbers)

    def _write(self, name: str, values: NDArray[Any], first: int = 0) -> None:
        """Write an array to a buffer, from element `first` on."""
        if name in self._here:
            self._here[name].view(values.dtype)[first : first + values.size] = values.ravel()
        else:
            copy: Any = cl.enqueue_copy  # whose stub does not know offsets
            copy(
                self.queue,
                self.buffers[name],
                np.ascontiguousarray(values),
                dst_offset=first * values.itemsize,
            )

    def enqueue(self, launches: list[Launch]) -> None:
        """Enqueue launches, in order."""
        for _, kernel, items, group, _ in launches:
            cl.enqueue_nd_range_kernel(self.queue, kernel, items, group)

    def find_parts(self) -> None:
        """Number the parts of the frame, and the corners of the largest."""
        self.enqueue(self.launches)

    def parts(self) -> Parts:
        """Return the parts of the frame, by half-edge."""
        count = 4 * int(self.read("corners", np.uint32, 1)[0])

        def whole(name: str) -> Whole:
            return self.read(name, np.int32, count).astype(np.int64)

        twin, face, beyond, root = (whole(name) for name in ("twin", "face", "beyond", "part"))
        state = self.read("state", np.int32, 4 * count).reshape(count, 4).astype(np.int64)
        column, row, direction, _ = np.where(root[:, None] >= 0, state, 0).T
        faces = whole("faces_of_part")
        closed = face >= 0
        cut = np.where(closed, self.read("cut", np.uint8, count)[np.maximum(face, 0)], 0)
        return Parts(
            twin=twin,
            face=face,
            agree=beyond >= 0,
            cut=cut,
            root=root,
            column=column,
            row=row,
            direction=direction,
            contradicted=closed & (faces[np.maximum(root, 0)] == 0),
        )

    def votes(self, units: Units) -> Votes:
        """Return the ways across tears between the rims of parts."""
        return votes.votes(self, units)

    def settled(self, board: Board) -> Board:
        """Return the board after rounds of dropping and finding nodes, without its margins."""
        row, column = np.nonzero(board.owner >= 0)
        numbers = np.zeros((self.capacity, 4), np.int32)
        turn = (row + column + (board.sign < 0)) % 2  # only its parity counts
        numbers[board.owner[row, column]] = np.stack([column, row, turn, row * 0 + 1], axis=1)
        return self.settle(numbers)

    def settle(self, numbers: NDArray[np.int32] | None = None) -> Board:
        """Return the board of numbered corners once no pass changes its nodes.

        numbers: (N, 4), column, row, quarter turn, and 1 for a corner that has them; None for those
            of the largest part.

        Raises CapacityError if the numbers reach too far.
        """
        if numbers is not None:
            self._write("numbers", np.ascontiguousarray(numbers, np.int32))
        self.enqueue(self.lay)
        passes = 1  # that are launched before the host looks whether they are enough
        while True:
            self.enqueue(self.a_pass * passes)
            passes = min(2 * passes, MOST_PASSES)
            layout = self.read("layout", np.int32)
            if layout[nodes.STATE] != nodes.RUNS or not (
                layout[nodes.DROPPED] or layout[nodes.ENTERED]
            ):
                break
        shape = int(layout[nodes.ROWS]), int(layout[nodes.COLUMNS])
        count = shape[0] * shape[1]
        x, y = self.read("seen", np.float32, 2 * count).reshape(-1, 2).T
        return Board(
            x=x.reshape(shape),
            y=y.reshape(shape),
            owner=self.read("owner", np.int32, count).reshape(shape).astype(np.int64),
            torn=self.read("torn", np.bool_, count).reshape(shape),
            sign=int(layout[nodes.SIGN]),
        )

    def read(self, name: str, dtype: Any, count: int | None = None) -> NDArray[Any]:
        """Return the first elements of a buffer, or all, once the launches are done."""
        most = self.sizes[name] // np.dtype(dtype).itemsize
        values = np.empty(most if count is None else count, dtype)
        if values.size:
            cl.enqueue_copy(self.queue, values, self.buffers[name])
        return values
