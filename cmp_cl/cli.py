"""The command line: `cmp-cl devices | detect | render | demo | run | calibrate | tune | bench`.

Exit status: 0 done, 1 no device was found by `devices`, 2 something asked for could not be
done (one line on stderr says what), 130 interrupted.
"""

import argparse
import contextlib
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np

import cmp_cl
from cmp_cl import benchmark, io
from cmp_cl.commands import calibrate, demo, run, tune
from cmp_cl.commands.common import Progress, add_device, add_full_scale, one_line, shown
from cmp_cl.config import DetectorConfig
from cmp_cl.detector import Detector
from cmp_cl.device import DEVICE_VARIABLE, Device
from cmp_cl.errors import CmpClError, ConfigError, ImageError, KernelBuildError
from cmp_cl.results import Corners, GreyImage
from cmp_cl.synthetic import Indenter, Mode, Scene, render
from cmp_cl.viz import corner_overlay

INSTALL = """\
What to install for a device:
  Linux, x86-64      pip install "pyopencl[pocl]": PoCL, runs on every such CPU, needs no rights
  Linux, other CPUs  apt install pocl-opencl-icd (Debian, Ubuntu) or dnf install pocl (Fedora)
  Windows            the graphics driver of NVIDIA, AMD or Intel, or Intel's CPU Runtime for OpenCL
  macOS              conda install -c conda-forge pyopencl pocl; for Apple's own OpenCL
                     ocl_icd_wrapper_apple in the place of pocl
  Jetson             NVIDIA ships no OpenCL there: apt install pocl-opencl-icd, for its CPU
  NVIDIA             the driver; on Debian also nvidia-opencl-icd; in a container
                     NVIDIA_DRIVER_CAPABILITIES=compute,utility and a file
                     /etc/OpenCL/vendors/nvidia.icd that says libnvidia-opencl.so.1
  Intel              GPU: apt install intel-opencl-icd; CPU: Intel's CPU Runtime for OpenCL
  AMD                ROCm's rocm-opencl-runtime, or apt install mesa-opencl-icd and
                     RUSTICL_ENABLE=radeonsi
PoCL is not found where it cannot write its cache: XDG_CACHE_HOME names another folder."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; argv without the program's name, sys.argv where None."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # OpenCV 4 and 5 call it differently; 0 is silent.
    set_log_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_log_level(0)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    arguments = _parser().parse_args(argv)
    run: Callable[[argparse.Namespace], int] = arguments.run
    try:
        return run(arguments)
    except KernelBuildError as error:
        return _fail(str(error))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (CmpClError, OSError) as error:
        return _fail(one_line(error))
    except KeyboardInterrupt:
        return _fail("interrupted", status=130)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; {self.prog} --help says more\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="cmp-cl", description="Corners of deformed checkerboards on any OpenCL device."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_devices(commands)
    _add_detect(commands)
    _add_render(commands)
    demo.add_parser(commands)
    run.add_parser(commands)
    calibrate.add_parser(commands)
    tune.add_parser(commands)
    benchmark.add_parser(commands)
    return parser


def _fail(message: str, *, status: int = 2) -> int:
    print(f"cmp-cl: {message}", file=sys.stderr)
    return status


# devices


def _add_devices(commands: Any) -> None:
    parser = commands.add_parser(
        "devices",
        help="the OpenCL devices there are, and the one used by default",
        description="Lists the OpenCL devices and says which one is used by default, and why.",
    )
    parser.set_defaults(run=_devices)


def _devices(arguments: argparse.Namespace) -> int:
    devices = cmp_cl.list_devices()
    if not devices:
        print(f"cmp-cl: no OpenCL device was found: {_why_none()}", file=sys.stderr)
        print(INSTALL, file=sys.stderr)
        return 1
    rows = [("index", "name", "platform", "driver", "kind", "memory MB")]
    rows += [
        (d.index, d.name, d.platform, d.driver, d.kind.value, str(d.memory >> 20)) for d in devices
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )
    chosen = cmp_cl.select_device()
    wanted = os.environ.get(DEVICE_VARIABLE)
    why = f"the first {chosen.kind.value.upper()}"
    if wanted is not None:
        why = f"{DEVICE_VARIABLE} is {wanted!r}"
    print(f"used by default: {chosen.index}, {chosen}: {why}")
    return 0


def _why_none() -> str:
    place = os.environ.get("OCL_ICD_VENDORS", "/etc/OpenCL/vendors")
    if os.path.isdir(place):
        drivers = sorted(name for name in os.listdir(place) if name.endswith(".icd"))
    else:
        drivers = [place] if os.path.isfile(place) else []
    if drivers:
        return f"{', '.join(drivers)} in {place} cannot be loaded or have no device"
    return f"no driver is registered in {place}"


# detect


def _add_detect(commands: Any) -> None:
    parser = commands.add_parser(
        "detect",
        help="find the corners in images, folders of images and videos",
        description="Finds the corners of checkerboard-like patterns. Colour becomes grey. "
        "One line for each file says how many corners were found, on which device, and in how "
        "many milliseconds: from the image in host memory to the corners in host memory, "
        "without reading the file and without building the kernels.",
    )
    parser.add_argument("inputs", nargs="+", metavar="IMAGE", help="image, video or folder")
    parser.add_argument(
        "--out",
        metavar="CSV",
        help="write the corners of all inputs to this CSV file; positions in px, (0, 0) is the "
        "centre of the top-left pixel",
    )
    parser.add_argument(
        "--overlay",
        metavar="PNG",
        help="write the image with its corners marked; for several images or a video the name "
        "of a folder, made if missing, that gets one NAME-corners.png each",
    )
    parser.add_argument(
        "--config",
        metavar="TOML",
        help="settings of the detector; without it the cell size is estimated from each image, "
        "in a video until corners are found",
    )
    add_full_scale(parser)
    add_device(parser)
    parser.set_defaults(run=_detect)


def _detect(arguments: argparse.Namespace) -> int:
    config = None if arguments.config is None else DetectorConfig.load(arguments.config)
    if config is not None and arguments.full_scale is not None:
        config = config.replace(full_scale=arguments.full_scale)
    paths = io.find_inputs(arguments.inputs)
    overlays = _overlay_paths(arguments.overlay, paths)
    out = _csv_path(arguments.out)
    _refuse_to_overwrite(paths, [*overlays.values(), *([] if out is None else [out])])
    device = None if arguments.device is None else cmp_cl.select_device(arguments.device)
    status = 0
    with contextlib.ExitStack() as stack:
        table = None
        if out is not None:
            table = io.CornersCsv(stack.enter_context(io.whole_file(out)))
        finder = stack.enter_context(
            contextlib.closing(_Finder(config, arguments.full_scale, device))
        )
        progress = stack.enter_context(Progress(_frames_in(paths), "frames"))
        for path in paths:
            tally = _Tally()
            try:
                for frame, corners in finder.find(path, tally):
                    if table is not None:
                        table.write(str(path), frame.index, corners)
                    if path in overlays and frame.image is not None:
                        name = _of_frame(overlays[path], path, frame.index)
                        io.write_image(name, corner_overlay(frame.image, corners))
                        tally.overlays.append(name)
                    progress.step()
            except ImageError as error:
                progress.say(f"cmp-cl: {one_line(error)}", sys.stderr)
                status = 2
            if tally.broken:
                progress.say(f"cmp-cl: {shown(path)}: {tally.broken_line()}", sys.stderr)
            if tally.counts:
                progress.say(f"{shown(path)}: {tally.line()}", sys.stdout)
            if tally.is_dark():
                progress.say(
                    f"cmp-cl: {shown(path)}: the brightest of its 16-bit pixels is "
                    f"{tally.brightest}; for a camera of 12 bits say --full-scale 4095",
                    sys.stderr,
                )
    if table is not None:
        print(f"wrote {shown(out)}: {table.rows} corners")
    return status


class _Tally:
    """What was found in a file."""

    def __init__(self) -> None:
        self.counts: list[int] = []
        self.milliseconds: list[float] = []
        self.broken: list[int] = []
        self.overlays: list[Path] = []
        self.brightest = 0
        self.device = ""

    def add(self, corners: Corners, milliseconds: float) -> None:
        self.counts.append(len(corners))
        self.milliseconds.append(milliseconds)
        self.device = corners.device

    def line(self) -> str:
        least, most = min(self.counts), max(self.counts)
        corners = f"{least} corners" if least == most else f"{least} to {most} corners"
        time_of_one = f"{statistics.median(self.milliseconds):.2f} ms"
        if len(self.counts) > 1:
            corners = f"{len(self.counts)} frames, {corners} each,"
            time_of_one = f"a median of {time_of_one} each"
        line = f"{corners} in {time_of_one} (upload, kernels, download) on {self.device}"
        if self.overlays:
            last = f" to {shown(self.overlays[-1])}" if len(self.overlays) > 1 else ""
            line += f"; wrote {shown(self.overlays[0])}{last}"
        return line

    def is_dark(self) -> bool:
        """Whether a 16-bit file holds less than 16 bits, and nothing was found in it."""
        return 0 < self.brightest < 2**14 and not any(self.counts)

    def broken_line(self) -> str:
        noun = "frame" if len(self.broken) == 1 else "frames"
        some = ", ".join(map(str, self.broken[:8]))
        more = ", ..." if len(self.broken) > 8 else ""
        return f"skipped {len(self.broken)} {noun} that could not be read: {some}{more}"


class _Finder:
    """Finds corners in images as they come; a detector is kept while it fits."""

    def __init__(
        self, config: DetectorConfig | None, full_scale: int | None, device: Device | None
    ) -> None:
        self._config = config
        self._full_scale = full_scale
        self._device = device
        self._key: object = None
        self._kept = contextlib.ExitStack()
        self._detector: Detector

    def find(self, path: Path, tally: _Tally) -> Iterator[tuple[io.Frame, Corners]]:
        """The frames of a file that can be read, and their corners.

        Without a configuration it is estimated from each frame until one has corners.
        """
        config = self._config
        for frame in io.read_frames(path):
            if frame.image is None:
                tally.broken.append(frame.index)
                continue
            chosen = config or self._estimated(frame.image)
            self._fit(frame.image, chosen)
            start = time.perf_counter()
            corners = self._detector(frame.image)
            tally.add(corners, (time.perf_counter() - start) * 1e3)
            if frame.image.dtype == np.uint16 and chosen.full_scale is None:
                tally.brightest = max(tally.brightest, int(frame.image.max()))
            if len(corners):
                config = chosen
            yield frame, corners
        if not tally.counts:
            raise ImageError(f"{str(path)!r} has no frame that can be read")

    def _estimated(self, image: GreyImage) -> DetectorConfig:
        return DetectorConfig.for_image(image).replace(full_scale=self._full_scale)

    def _fit(self, image: GreyImage, config: DetectorConfig) -> None:
        """Make a detector for such an image, and run it once: some devices compile only then."""
        key = (image.shape, image.dtype, config)
        if key == self._key:
            return
        self.close()
        self._detector = self._kept.enter_context(
            Detector(shape=image.shape, dtype=image.dtype, config=config, device=self._device)
        )
        self._detector(image)
        self._key = key

    def close(self) -> None:
        self._key = None
        self._kept.close()


def _frames_in(paths: Sequence[Path]) -> int | None:
    """How many frames there are, None where nobody watches."""
    if not sys.stderr.isatty():
        return None
    total = 0
    for path in paths:
        with contextlib.suppress(ImageError, OSError):
            total += io.count_frames(path) or 1
    return total


def _csv_path(out: str | None) -> Path | None:
    if out is None:
        return None
    if not out:
        raise ConfigError("--out needs the name of a file")
    return Path(out) / "corners.csv" if os.path.isdir(out) else Path(out)


def _overlay_paths(overlay: str | None, paths: Sequence[Path]) -> dict[Path, Path]:
    """Where the overlay of each input goes; a missing folder is made."""
    if overlay is None:
        return {}
    if not overlay:
        raise ConfigError("--overlay needs the name of a picture or of a folder")
    suffix = Path(overlay).suffix.lower()
    if suffix in io.IMAGE_SUFFIXES and not os.path.isdir(overlay):
        if len(paths) > 1 or io.is_video(paths[0]):
            what = f"there are {len(paths)} inputs" if len(paths) > 1 else "the input is a video"
            raise ConfigError(
                f"--overlay {shown(overlay)} is one picture, but {what}; name a folder"
            )
        return {paths[0]: Path(overlay)}
    folder = Path(overlay)
    if suffix and not folder.is_dir() and not overlay.endswith(("/", os.sep)):
        raise ConfigError(
            f"--overlay {shown(overlay)} is neither a folder nor a picture that can be written; "
            "end it in .png"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if any(os.path.realpath(path.parent) == os.path.realpath(folder) for path in paths):
        raise ConfigError(f"--overlay {shown(overlay)} holds inputs; name another folder")
    names: dict[Path, Path] = {}
    for path in dict.fromkeys(paths):
        name = folder / f"{path.stem}-corners.png"
        number = 2
        while name in names.values():
            name = folder / f"{path.stem}-{number}-corners.png"
            number += 1
        names[path] = name
    return names


def _of_frame(overlay: Path, path: Path, index: int) -> Path:
    """The overlay of one frame of a video, or of one page of an image."""
    if index == 0 and not io.is_video(path):
        return overlay
    return overlay.with_stem(f"{overlay.stem}-{index:06}")


def _refuse_to_overwrite(inputs: Iterable[Path], outputs: Iterable[Path]) -> None:
    read = {os.path.realpath(path) for path in inputs}
    for path in outputs:
        if os.path.realpath(path) in read:
            raise ConfigError(f"{shown(path)} is an input and would be overwritten")


# render


def _add_render(commands: Any) -> None:
    usual = Scene()
    parser = commands.add_parser(
        "render",
        help="draw a frame of a pressed gel with known corners",
        description="Draws one frame of a pressed gel that carries a checkerboard, and where "
        "its corners are. The same options give the same picture.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--out", metavar="PNG", required=True, help="the picture to write")
    parser.add_argument("--truth", metavar="CSV", help="write the true corners, px")
    parser.add_argument(
        "--markers", type=int, default=usual.markers, help="corners along each side"
    )
    parser.add_argument(
        "--severity",
        type=float,
        default=usual.severity,
        help="0 to 2; 1 presses 2 mm, shears 1.2 mm or twists 20 degrees",
    )
    for name, default in (("indenter", usual.indenter), ("mode", usual.mode)):
        choices = [member.value for member in type(default)]
        parser.add_argument(
            f"--{name}",
            choices=choices,
            default=default.value,
            help="what presses" if name == "indenter" else "how it moves",
        )
    parser.add_argument(
        "--shape",
        type=int,
        nargs=2,
        metavar=("ROWS", "COLUMNS"),
        default=usual.shape,
        help="size of the picture, px",
    )
    parser.add_argument(
        "--corrosion", type=float, default=usual.corrosion, help="wear of the print, 0 to 3"
    )
    parser.add_argument(
        "--noise", type=float, default=usual.noise, help="standard deviation, 1/255 of white"
    )
    parser.add_argument(
        "--bits", type=int, choices=(8, 12), default=usual.bits, help="grey levels of the camera"
    )
    parser.add_argument("--seed", type=int, default=usual.seed, help="of noise, tears and light")
    parser.set_defaults(run=_render)


def _render(arguments: argparse.Namespace) -> int:
    scene = Scene(
        markers=arguments.markers,
        shape=tuple(arguments.shape),
        indenter=Indenter(arguments.indenter),
        mode=Mode(arguments.mode),
        severity=arguments.severity,
        corrosion=arguments.corrosion,
        noise=arguments.noise,
        bits=arguments.bits,
        seed=arguments.seed,
    )
    rendered = render(scene)
    io.write_image(arguments.out, rendered.image)
    rows, columns = scene.shape
    count = rendered.truth.shape[0] * rendered.truth.shape[1]
    print(
        f"wrote {shown(arguments.out)}: {columns} x {rows} px, {count} corners, "
        f"cells of {rendered.cell:.1f} px"
    )
    if arguments.truth is not None:
        io.write_csv(
            arguments.truth,
            ("row", "column", "x_px", "y_px"),
            ([*index, *rendered.truth[index]] for index in np.ndindex(rendered.truth.shape[:2])),
        )
        print(f"wrote {shown(arguments.truth)}: {count} corners")
    return 0
