"""The methods that cmp_cl is compared with, one small adapter each.

A peer is told the number of corners of the pattern, as its documentation asks. All else is in its
settings, which `search.py` finds on separate scenes and keeps in results/peer_settings.json.

`PEERS[name].make(settings, pattern)` gives a function image -> (N, 2) positions, px; it
raises Unavailable with the reason if a package that it needs is not installed.
"""

import ctypes
import dataclasses
import importlib
import json
import os
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

Detect = Callable[[np.ndarray], np.ndarray]
Settings = dict[str, Any]
FOUND_SETTINGS = Path(__file__).with_name("results") / "peer_settings.json"


class Unavailable(Exception):
    """This peer cannot run here; says why."""


class Pattern(NamedTuple):
    """markers: inner corners a side. views: pictures of the pattern in the image."""

    markers: int
    views: int = 1


class Peer(NamedTuple):
    """label: as tables show it. make: settings and pattern -> detect. search: the values that
    each setting is tried at, the first being the usual one. slow: takes more than 50 ms."""

    label: str
    make: Callable[[Settings, Pattern], Detect]
    search: dict[str, list[Any]]
    slow: bool = False

    def settings(self, markers: int) -> Settings:
        """Return what the search found for that density, or the usual values where it has none."""
        usual = {name: values[0] for name, values in self.search.items()}
        if FOUND_SETTINGS.is_file():
            found = json.loads(FOUND_SETTINGS.read_text())
            usual |= found.get(NAMES[self.label], {}).get(str(markers), {})
        return usual


# OpenCV


def _points(xy: np.ndarray | None) -> np.ndarray:
    """Return what OpenCV found as (N, 2), also if it is None."""
    return np.empty((0, 2), np.float32) if xy is None else xy.reshape(-1, 2)


def _good_features(settings: Settings, pattern: Pattern) -> Detect:
    # The paper's Table 2: the corners and, where the pattern ends, its junctions.
    count = pattern.views * (pattern.markers + settings["margin"]) ** 2
    given = count, settings["quality"], settings["distance"]
    sizes = {"blockSize": settings["block"], "gradientSize": settings["gradient"]}
    window = (settings["window"], settings["window"])
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, settings["rounds"], 0.01)

    def detect(image: np.ndarray) -> np.ndarray:
        start = cv2.goodFeaturesToTrack(image, *given, mask=None, **sizes)
        if start is None:
            return _points(None)
        return cv2.cornerSubPix(image, start, window, (-1, -1), criteria).reshape(-1, 2)

    return detect


def _find_chessboard(settings: Settings, pattern: Pattern) -> Detect:
    size = (pattern.markers, pattern.markers)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH * settings["adaptive"]
    flags |= cv2.CALIB_CB_NORMALIZE_IMAGE * settings["normalize"]
    return lambda image: _points(cv2.findChessboardCorners(image, size, flags=flags)[1])


def _find_chessboard_sb(settings: Settings, pattern: Pattern) -> Detect:
    size = (pattern.markers, pattern.markers)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE * settings["normalize"]
    flags |= cv2.CALIB_CB_EXHAUSTIVE * settings["exhaustive"]
    flags |= cv2.CALIB_CB_ACCURACY * settings["accuracy"]
    return lambda image: _points(cv2.findChessboardCornersSB(image, size, flags=flags)[1])


# ChESS and Zhang's spectrum, written from the papers


def _ring_peer(settings: Settings, pattern: Pattern) -> Detect:
    from opencl_peers import RingPeer

    return RingPeer(settings)


# chess-corners, PyPI


def _module(name: str, install: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise Unavailable(f"not installed; {install}") from error


def _chess_corners(refiner: str) -> Callable[[Settings, Pattern], Detect]:
    def make(settings: Settings, pattern: Pattern) -> Detect:
        package = _module("chess_corners", "pip install chess_corners")
        config = (
            package.DetectorConfig()
            .with_threshold(settings["threshold"])
            .without_orientation()
            .with_uncertainty(package.Uncertainty.OFF)
            .with_chess(refiner=getattr(package.ChessRefiner, refiner)())
        )
        detector = package.Detector(config)
        return lambda image: detector.detect(image).xy

    return make


# calib-targets, PyPI: numbers boards whose corners chess-corners finds


def _calib_targets(settings: Settings, pattern: Pattern) -> Detect:
    package = _module("calib_targets", "pip install calib-targets")
    usual = package.ChessboardParams()
    wider = settings["tolerance"]  # of everything that a deformed lattice strains
    angles = ("cluster_tol_deg", "attach_axis_tol_deg", "edge_axis_tol_deg", "weak_cluster_tol_deg")
    lengths = ("step_tol", "attach_search_rel", "geometry_recovery_tol_rel")
    topology = {
        name: wider * getattr(usual.topological, name)
        for name in ("axis_align_tol_rad", "cluster_axis_tol_rad")
    }
    params = dataclasses.replace(
        usual,
        min_corner_strength=settings["strength"],
        max_components=max(usual.max_components, pattern.views),
        topological=dataclasses.replace(usual.topological, **topology),
        **{name: wider * getattr(usual, name) for name in (*angles, *lengths)},
    )
    corners = package.ChessConfig(threshold=settings["threshold"])

    def detect(image: np.ndarray) -> np.ndarray:
        boards = package.detect_chessboard_all(image, chess_cfg=corners, params=params)
        boards = sorted(boards, key=lambda board: -len(board.corners))[: pattern.views]
        xy = [corner.position for board in boards for corner in board.corners]
        return np.array(xy, np.float32).reshape(-1, 2)

    return detect


# libcbdetect (Geiger), PyPI; its upstream is under the GPL


def _libcbdetect(settings: Settings, pattern: Pattern) -> Detect:
    package = _module("libCBDetect", "pip install libcbdetect (GPL)")
    detector = package.Checkerboard()
    detector.show_processing = False
    detector.norm = settings["norm"]
    detector.init_loc_thr = settings["start"]
    detector.score_thr = settings["score"]

    def detect(image: np.ndarray) -> np.ndarray:
        detector.array_to_image(image.astype(np.float64).ravel(), *image.shape)
        detector.find_corners()
        detector.refine_corners()
        xy = np.zeros((2, detector.number_of_corners))
        detector.get_corners(xy[0], xy[1])
        return xy.T.copy()

    return detect


# mrgingham, Debian: its binding belongs to the system's Python, so it runs in a process of its own

_PYTHON = "/usr/bin/python3"
_WORKER = """
import struct, sys, time
import mrgingham, numpy
read, write = sys.stdin.buffer, sys.stdout.buffer
while len(head := read.read(16)) == 16:
    rows, columns = struct.unpack("<qq", head)
    image = numpy.frombuffer(read.read(rows * columns), numpy.uint8).reshape(rows, columns)
    start = time.perf_counter()
    answer = mrgingham.find_chessboard_corners(image)
    spent = time.perf_counter() - start
    answer = numpy.ascontiguousarray(answer, dtype=numpy.float64)
    write.write(struct.pack("<dq", spent, answer.size) + answer.tobytes())
    write.flush()
"""


class _Mrgingham:
    """A process that runs mrgingham. `seconds`: the time of the last call, taken inside it."""

    def __init__(self) -> None:
        if subprocess.run([_PYTHON, "-c", "import mrgingham"], capture_output=True).returncode:
            raise Unavailable("not installed; apt-get install python3-mrgingham")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._process = subprocess.Popen([_PYTHON, "-c", _WORKER], **pipes)
        self.seconds = 0.0

    def __call__(self, image: np.ndarray) -> np.ndarray:
        to, back = self._process.stdin, self._process.stdout
        to.write(struct.pack("<qq", *image.shape) + image.tobytes())
        to.flush()
        self.seconds, size = struct.unpack("<dq", back.read(16))
        return np.frombuffer(back.read(8 * size), np.float64).reshape(-1, 2)


_CHESS: dict[str, list[Any]] = {
    "threshold": [0.2, 0.05, 0.1, 0.15, 0.3, 0.4],
    "sigma": [0.0, 0.7, 1.0, 1.3],
    "radius": [3, 2, 4],
}
_SPECTRUM = {**_CHESS, "weight": [1.0, 0.5, 0.75]}
_LEAN: dict[str, list[Any]] = {"threshold": [100.0, 10.0, 20.0, 30.0, 50.0, 200.0]}

PEERS: dict[str, Peer] = {
    "good_features": Peer(
        "goodFeaturesToTrack + cornerSubPix",
        _good_features,
        {
            "margin": [2, 0],
            "quality": [0.01, 0.05, 0.15],
            "distance": [8, 6, 4],
            "block": [3, 5, 7],
            "gradient": [3, 5],
            "window": [3, 2, 4, 5],
            "rounds": [20, 5],
        },
    ),
    "find_chessboard": Peer(
        "findChessboardCorners",
        _find_chessboard,
        {"adaptive": [True], "normalize": [True, False]},
        slow=True,
    ),
    "find_chessboard_sb": Peer(
        "findChessboardCornersSB",
        _find_chessboard_sb,
        {"normalize": [False, True], "exhaustive": [False, True], "accuracy": [False, True]},
        slow=True,
    ),
    "chess_opencl": Peer("ChESS, OpenCL", _ring_peer, _CHESS),
    "spectrum_opencl": Peer("Zhang's spectrum, OpenCL", _ring_peer, _SPECTRUM),
    "chess_corners_lean": Peer(
        "chess-corners, lean, centre of mass", _chess_corners("center_of_mass"), _LEAN
    ),
    "chess_corners_saddle": Peer(
        "chess-corners, lean, saddle", _chess_corners("saddle_point"), _LEAN
    ),
    "calib_targets": Peer(
        "calib-targets, its own grid",
        _calib_targets,
        {
            "threshold": [15.0, 5.0, 50.0],
            "strength": [33.0, 0.0],
            "tolerance": [1.0, 1.4, 2.0],
        },
        slow=True,
    ),
    "mrgingham": Peer("mrgingham, corners only", lambda settings, pattern: _Mrgingham(), {}),
    "libcbdetect": Peer(
        "libcbdetect",
        _libcbdetect,
        {"norm": [False, True], "start": [0.01, 0.003, 0.03], "score": [0.01, 0.003, 0.03]},
        slow=True,
    ),
}
NAMES = {peer.label: name for name, peer in PEERS.items()}


def available() -> list[str]:
    """Return the names of the peers that run here, and say why the others do not."""
    _keep_freed_memory()
    names = []
    for name, peer in PEERS.items():
        try:
            peer.make(peer.settings(40), Pattern(40))
            names.append(name)
        except (Unavailable, OSError) as reason:  # a system without that Python
            print(f"left out: {peer.label}: {reason}")
    return names


def _keep_freed_memory() -> None:
    """Keep freed memory in the process from now on, if malloc is glibc's.

    OpenCV makes its images anew for every frame. Whether malloc returns their memory to the system
    each time depends on the rest of the memory, and goodFeaturesToTrack at 1600 x 1200 takes twice
    as long if it does. So every peer gets the faster behaviour, in every run.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(-1, 2**30)  # M_TRIM_THRESHOLD
        mallopt(-3, 2**25)  # M_MMAP_THRESHOLD, the most that it takes
