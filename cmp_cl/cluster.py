"""Detection on a Dask cluster: frames go out in parts, corners come back in order.

    from dask.distributed import Client
    client = Client("tcp://scheduler:8786")
    for corners in cmp_cl.cluster.detect(client, read_frame, range(1_000_000), config=config):
        ...

Run one worker process per device, with one thread; its variable CMP_CL_DEVICE names the device.
Dask keeps the parts that are done until they are asked for, and gives the parts of a worker that
dies to another one.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Any

from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import kept_detector
from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage, check_image

_ONE_PART = threading.Lock()  # at a time in a worker process
_LEAST_AHEAD = 8  # parts that are on their way, although no worker may have come yet


def detect(
    client: Any,
    read: Callable[[int], GreyImage],
    frames: Sequence[int],
    *,
    config: DetectorConfig | None = None,
    part: int = 64,
) -> Iterator[Corners]:
    """Yield the corners of frames on a cluster, in the order of `frames`.

    client: a dask.distributed.Client.
    read: read(n) gives frame n, (H, W) uint8 or uint16, on a worker; it travels there by pickle,
        so it is a function of a module that workers can import, or a closure.
    frames: numbers of frames, such as range(1000).
    config: None means DetectorConfig().
    part: how many frames a worker is given at a time.

    A few parts are on their way while one is used, so memory is bounded. Raises ConfigError if part
    is under 1, the errors of `read` and of the detector on a worker, and distributed.KilledWorker
    if a part has ended several workers.
    """
    if part < 1:
        raise ConfigError(f"part must be 1 or more, not {part}")
    config = DetectorConfig() if config is None else config
    waiting: deque[Any] = deque()
    try:
        for start in range(0, len(frames), part):
            numbers = frames[start : start + part]
            waiting.append(client.submit(_work, read, numbers, config, pure=False))
            if len(waiting) >= max(_LEAST_AHEAD, 2 * sum(client.nthreads().values())):
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()
    finally:
        client.cancel(list(waiting))


def _work(
    read: Callable[[int], GreyImage],
    numbers: Sequence[int],
    config: DetectorConfig,
) -> list[Corners]:
    """Return the corners of a part; on a worker."""
    first = check_image(read(numbers[0]))
    with _ONE_PART:
        detector = kept_detector(first.shape, first.dtype, config)
        return list(detector.stream(chain([first], map(read, numbers[1:]))))
