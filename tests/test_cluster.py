"""A recording on two worker processes: the corners of one process, even if a worker is killed."""

import itertools
import os
import threading
import time

import distributed
import pytest
from comparison import assert_same_bytes
from workers import broken_frame, colour_frame, frame, slow_frame

from cmp_cl import Detector, DetectorConfig, EdgeLines, cluster
from cmp_cl.errors import ConfigError, ImageError

COUNT, PART = 46, 5
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
        distributed.Client(local) as connected,
    ):
        yield connected


def assert_right(found, numbers, config=None):
    found = list(found)
    assert len(found) == len(numbers)
    with Detector(shape=frame(0).shape, config=config) as detector:
        for corners, number in zip(found, numbers, strict=True):
            assert_same_bytes(corners, detector(frame(number)))
    assert len(found[0]) > 20


@pytest.mark.parametrize("config", [None, DetectorConfig(refinement=EdgeLines())])
def test_every_frame_comes_in_order_as_one_process_finds_it(client, config):
    numbers = [*range(30), 7, 3]
    found = cluster.detect(client, frame, numbers, config=config, part=PART)
    assert_right(found, numbers, config)


def test_a_killed_worker_loses_no_frame_and_repeats_none(client):
    before = set(client.run(os.getpid).values())
    found = cluster.detect(client, slow_frame, range(COUNT), part=PART)
    first = next(found)
    victim = min(before)
    killer = threading.Thread(target=lambda: (time.sleep(0.3), os.kill(victim, 9)))
    killer.start()
    assert_right(itertools.chain([first], found), range(COUNT))
    killer.join()
    client.wait_for_workers(2, timeout=30)
    assert victim not in client.run(os.getpid).values()


def test_a_few_parts_are_on_their_way_and_those_that_nobody_wants_are_cancelled(client):
    found = cluster.detect(client, frame, range(10**9), part=2)
    next(found)
    assert len(client.futures) < 20
    found.close()
    assert not [name for name in client.futures if "_work" in str(name)]


def test_errors_of_a_worker_are_raised_where_the_corners_are_asked_for(client):
    with pytest.raises(OSError, match="frame 17"):
        list(cluster.detect(client, broken_frame, range(COUNT), part=PART))
    with pytest.raises(ImageError, match="cvtColor"):
        next(cluster.detect(client, colour_frame, range(2)))
    with pytest.raises(ConfigError, match="part must be"):
        next(cluster.detect(client, frame, range(2), part=0))
    assert list(cluster.detect(client, frame, [])) == []
