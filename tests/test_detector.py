"""Detector and detect: what users call, on the device under test."""

import dataclasses
import gc
from concurrent.futures import ThreadPoolExecutor
from types import NoneType

import cv2
import images
import numpy as np
import pyopencl as cl
import pytest
from cases import some
from comparison import assert_same_bytes
from configs import ANY_RINGS, all_settings, rings, settings_of
from corner_images import board, to_nearest

import cmp_cl
from cmp_cl import BinaryRings, Detector, DetectorConfig, Method, errors
from cmp_cl.errors import (
    CalibrationError,
    CapacityError,
    CmpClError,
    ConfigError,
    DeviceError,
    FieldError,
    GridError,
    ImageError,
    KernelBuildError,
)
from cmp_cl.opencl.launches import sum_times

EIGHT = images.eight_bits()
BOARD, TRUTH = board(*images.SHAPE, 12)
FRAMES = [EIGHT[name] for name in ("scene", "board", "texture", "black", "worn scene")]


@pytest.fixture
def detector(detector_for) -> Detector:
    """Return the default detector for images.SHAPE."""
    return detector_for(BOARD)


# --- the result ----------------------------------------------------------------------------


def test_the_result_has_the_stated_shapes_and_types(detector, device):
    corners = detector(BOARD)
    count = len(corners)
    assert count > 20
    expected = {
        "xy": ((count, 2), np.float32),
        "pixel": ((count, 2), np.int32),
        "response": ((count,), np.float32),
        "method": ((count,), np.uint8),
        "refusal": ((count,), np.uint8),
        "sigma": ((count,), np.float32),
        "edges": ((count, 4), np.float32),
        "doubtful": ((count,), np.bool_),
    }
    for name, (shape, dtype) in expected.items():
        values = getattr(corners, name)
        assert values.shape == shape, name
        assert values.dtype == dtype, name
        assert values.flags.c_contiguous, name
        assert values.flags.writeable, name
    assert corners.device == str(device)
    assert corners.to_opencv().shape == (count, 1, 2)
    assert np.array_equal(np.isnan(corners.sigma), corners.method == Method.KEPT)
    x, y = corners.pixel.T
    assert (np.diff(y * 83 + x) > 0).all()
    assert to_nearest(TRUTH, corners.xy).max() < 0.1


def test_a_result_is_yours_to_keep(detector):
    first = detector(BOARD)
    copy = dataclasses.replace(first, xy=first.xy.copy(), edges=first.edges.copy())
    detector(EIGHT["texture"])
    detector(BOARD).xy[:] = 0
    assert_same_bytes(first, copy)


# --- stream and batch ----------------------------------------------------------------------


def test_empty_streams_and_batches_give_nothing(detector):
    assert list(detector.stream([])) == []
    assert detector.batch([]) == []
    assert detector.batch(np.empty((0, *images.SHAPE), np.uint8)) == []


def test_a_stream_may_reuse_its_buffer(detector):
    buffer = np.empty(images.SHAPE, np.uint8)

    def camera():
        for frame in FRAMES:
            buffer[:] = frame
            yield buffer

    for corners, frame in zip(detector.stream(camera()), FRAMES, strict=True):
        assert_same_bytes(corners, detector(frame))


def test_a_stream_reads_one_frame_ahead(detector):
    expected, taken = detector(BOARD), []

    def camera():
        for number, frame in enumerate(FRAMES):
            taken.append(number)
            yield frame

    stream = detector.stream(camera())
    assert taken == []
    next(stream)
    assert taken == [0, 1]
    stream.close()
    assert taken == [0, 1]
    assert_same_bytes(detector(BOARD), expected)


def test_a_wrong_frame_ends_a_stream_after_the_corners_of_those_before(detector):
    found = []
    with pytest.raises(ImageError, match="make a Detector"):
        found.extend(detector.stream([BOARD, FRAMES[0], BOARD[1:], BOARD]))
    for one, frame in zip(found, (BOARD, FRAMES[0]), strict=True):
        assert_same_bytes(one, detector(frame))


def test_streams_and_calls_may_alternate(detector):
    alone = [detector(frame) for frame in FRAMES]
    for k, (one, other) in enumerate(
        zip(detector.stream(FRAMES), detector.stream(FRAMES[::-1]), strict=True)
    ):
        assert_same_bytes(one, alone[k])
        assert_same_bytes(detector(EIGHT["texture"]), alone[2])
        assert_same_bytes(detector.batch(FRAMES[:2])[1], alone[1])
        detector.maps(EIGHT["noise"])
        assert_same_bytes(other, alone[-1 - k])


# --- queues, profiles, closing -------------------------------------------------------------


def test_a_detector_runs_in_the_callers_queue(device, detector):
    context = cl.Context([device.handle])
    with cl.CommandQueue(context) as queue:
        with Detector(shape=images.SHAPE, queue=queue) as own:
            assert own.device == device
            assert_same_bytes(own(BOARD), detector(BOARD))
        queue.finish()
        with pytest.raises(DeviceError, match="not both"):
            Detector(shape=images.SHAPE, queue=queue, device=device)
    with pytest.raises(DeviceError, match=r"queue must be a pyopencl\.CommandQueue"):
        Detector(shape=images.SHAPE, queue="q")


def test_a_queue_without_order_is_refused(device):
    disordered = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
    if not device.handle.queue_properties & disordered:
        pytest.skip("this device has no such queue")
    with (
        cl.CommandQueue(cl.Context([device.handle]), properties=disordered) as queue,
        pytest.raises(DeviceError, match="in order"),
    ):
        Detector(shape=images.SHAPE, queue=queue)


def test_every_stage_has_a_time(device, detector):
    assert detector.times == {}
    with Detector(shape=images.SHAPE, device=device, profile=True) as profiled:
        assert_same_bytes(profiled(BOARD), detector(BOARD))
        assert set(profiled.times) == {launch.stage for launch in profiled._plans.lend().launches}
        assert all(ms >= 0 for ms in profiled.times.values())
        launches = len(profiled._plans.lend().events)
        for _ in range(3):
            profiled(BOARD)
        assert len(profiled._plans.lend().events) == launches  # of the last frame alone
        for _ in profiled.stream([BOARD] * 3):
            pass
        profiled(BOARD)
        assert profiled.times == sum_times(profiled._plans.lend().events, {})


def test_a_closed_detector_raises_an_error(device):
    detector = Detector(shape=images.SHAPE, device=device)
    stream = detector.stream([BOARD] * 3)
    next(stream)
    assert detector.memory > 0
    detector.close()
    detector.close()
    assert detector.memory == 0
    for use in (
        lambda: detector(BOARD),
        lambda: next(stream),
        lambda: list(detector.stream([BOARD])),
        lambda: detector.batch([BOARD]),
        lambda: detector.maps(BOARD),
    ):
        with pytest.raises(DeviceError, match="closed"):
            use()


def test_streams_that_are_begun_and_dropped_keep_nothing(device):
    with Detector(shape=images.SHAPE, device=device) as detector:
        expected = detector(BOARD)
        list(detector.stream(FRAMES))
        usual = detector.memory
        for _ in range(3):
            begun = [detector.stream(FRAMES) for _ in range(5)]
            results = [next(stream) for stream in begun]
            assert detector.memory > usual
            second = [next(stream) for stream in begun]
            del begun
            gc.collect()
            assert_same_bytes(detector(BOARD), expected)
            assert detector.memory == usual
        for result in results:
            assert_same_bytes(result, detector(FRAMES[0]))
        for result in second:
            assert_same_bytes(result, detector(FRAMES[1]))


def test_batches_of_many_sizes_take_the_memory_of_one(device):
    with Detector(shape=images.SHAPE, device=device) as detector:
        memory = []
        for size in (5, 2, 3, 5):
            detector.batch([BOARD] * size)
            memory.append(detector.memory)
    assert memory[0] == memory[-1]
    assert max(memory) == memory[0]


def test_threads_wait_for_one_another(detector):
    expected = [detector(frame) for frame in FRAMES]

    def work(_):
        for _ in range(5):
            for frame, corners in zip(FRAMES, expected, strict=True):
                assert_same_bytes(detector(frame), corners)

    with ThreadPoolExecutor(3) as threads:
        list(threads.map(work, range(3)))  # raises what a thread raised


# --- capacity ------------------------------------------------------------------------------


def test_a_batch_and_a_stream_enlarge_the_lists_too(device):
    image = images.salt_and_pepper((400, 80), 0.9)
    calm = np.full_like(image, 128)
    config = rings(contrast=None, criteria=ANY_RINGS, nms_radius=1, max_corners=1)
    with Detector(shape=image.shape, config=config, device=device) as detector:
        results = detector.batch([calm, image, image[::-1].copy()])
        assert detector.regrown == 1
        streamed = list(detector.stream([image, calm, image, image]))
        assert_same_bytes(streamed[0], detector(image))
        assert_same_bytes(streamed[2], streamed[0])
        assert_same_bytes(results[1], streamed[0])
        assert len(streamed[1]) == len(results[0]) == 0


def test_a_shape_beyond_the_memory_of_the_device_is_refused(device):
    with pytest.raises(CapacityError, match=r"the plan needs \d+ bytes, .* has \d+; use smaller"):
        Detector(shape=(1_000_000, 1_000_000), device=device)


# --- wrong images --------------------------------------------------------------------------


WRONG = {
    "float": (BOARD.astype(np.float32), r"uint8.*float32.*astype"),
    "big endian": (BOARD.astype(">u2"), r"of >u2; .*astype"),
    "colour": (np.dstack([BOARD] * 3), r"cvtColor\(image, cv2.COLOR_BGR2GRAY\)"),
    "stack": (np.stack([BOARD] * 7), r"got shape \(7, 61, 83\) .*one frame of it"),
    "row": (BOARD[0], r"got shape \(83,\) .*reshape"),
    "empty": (BOARD[:0], r"got shape \(0, 83\) .*it must have pixels"),
    "list": ([[1, 2]], r"got list; .*numpy.asarray"),
    "every second column": (BOARD[:, ::2], r"numpy.ascontiguousarray"),
    "None": (None, r"got NoneType; cv2.imread"),
    "mirrored": (BOARD[:, ::-1], r"numpy.ascontiguousarray"),
    "one row repeated": (np.broadcast_to(BOARD[0], images.SHAPE), r"numpy.ascontiguousarray"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_image_is_refused_with_the_remedy(detector, name):
    image, message = WRONG[name]
    for use in (
        lambda: detector(image),
        lambda: list(detector.stream([image])),
        lambda: detector.batch([image]),
        lambda: detector.maps(image),
        lambda: cmp_cl.detect(image),
    ):
        with pytest.raises(ImageError, match=message):
            use()


@pytest.mark.parametrize(
    "image", [BOARD[:-1], BOARD[:, :-1], np.zeros((1, 1), np.uint8), BOARD.astype(np.uint16)]
)
def test_an_image_of_another_shape_or_type_is_refused(detector, image):
    with pytest.raises(ImageError, match=r"takes \(61, 83\) uint8, got .* make a Detector"):
        detector(image)


SMALL = np.ones((2, 2), np.bool_)
WRONG_ARGUMENTS = {
    "shape": ("shape must be", [(3,), (3, 4, 5), "ab", 10, None, (-1, 4), (0, 4), (4.5, 5)]),
    "dtype": ("dtype must be uint8 or uint16", [np.float32, np.int16, bool, ">u2", "no", object()]),
    "mask": (
        r"mask must be \(61, 83\) of bool",
        [SMALL, SMALL[0], np.ones(images.SHAPE), "all", [[1, 2], [3]]],
    ),
}


@pytest.mark.parametrize("name", WRONG_ARGUMENTS)
def test_a_wrong_argument_is_refused(device, name):
    said, values = WRONG_ARGUMENTS[name]
    for value in values:
        with pytest.raises(ImageError, match=said):
            Detector(**{"shape": images.SHAPE, "device": device, name: value})


def test_errors_have_one_root():
    of_arguments = {CalibrationError, ConfigError, FieldError, GridError, ImageError}
    of_devices = {CapacityError, DeviceError, KernelBuildError}
    assert all(issubclass(error, ValueError) for error in of_arguments)
    assert all(issubclass(error, RuntimeError) for error in of_devices)
    assert all(issubclass(error, CmpClError) for error in of_arguments | of_devices)
    classes = {value for value in vars(errors).values() if isinstance(value, type)}
    raised = {value for value in classes if issubclass(value, Exception)}
    assert raised == of_arguments | of_devices | {CmpClError}


# --- the configuration ---------------------------------------------------------------------

INK = np.kron(np.indices((4, 4)).sum(0) % 2, np.ones((40, 40))).astype(np.uint8) * 255
INK = cv2.GaussianBlur(cv2.erode(INK, np.ones((7, 7))), (0, 0), 0.7)
SHOWN = [EIGHT["texture"], EIGHT["noise"], EIGHT["faint board"], images.scene(1.5, seed=3).image]
SHOWN += [images.sixteen_bits()["12-bit board"], INK]
SETTINGS = [each for each in all_settings() if each.name != "max_corners"]  # of memory alone
QUICK = [each for each in SETTINGS if each.name in ("fine", "nms_radius", "outer_radius")]


def values_of(setting):
    """Yield the bounds of a number, every other value of a setting, or parts of each kind."""
    for kind in setting.kinds:
        if kind is NoneType:
            yield None
        elif dataclasses.is_dataclass(kind):
            yield kind()
            for inner in settings_of(kind):
                yield from (kind(**{inner.name: value}) for value in values_of(inner))
        elif kind is bool:
            yield from (False, True)
        else:
            yield from setting.limits[:2] if setting.limits else kind


def config_of(part):
    """Return a configuration that has this part."""
    if isinstance(part, DetectorConfig):
        return part
    (place, *_) = [each for each in all_settings() if type(part) in each.kinds]
    return config_of(place.part(**{place.name: part}))


@pytest.mark.parametrize("setting", some(SETTINGS, QUICK), ids=lambda each: each.name)
def test_another_value_of_a_setting_changes_the_corners_of_some_image(detector_for, setting):
    usual = {"detection": BinaryRings()} if setting.part is DetectorConfig else {}
    before = config_of(setting.part(**usual))
    for value in values_of(setting):
        after = config_of(setting.part(**usual | {setting.name: value}))
        for image in SHOWN:
            one, other = detector_for(image, before)(image), detector_for(image, after)(image)
            for name in ("xy", "response", "sigma", "edges"):
                if not np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True):
                    return
    pytest.fail("no corner has changed")
