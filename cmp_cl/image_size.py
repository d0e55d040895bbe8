"""The size of an image from the first bytes of its file, before anything is decoded."""

import re
import struct
from collections.abc import Callable, Iterator

Size = tuple[int, int]  # width and height, px

_PNM = re.compile(rb"P[1-6](?:\s|#.*\n)+(\d{1,9})(?:\s|#.*\n)+(\d{1,9})\s")
_TIFF_PAGES = 1 << 20  # more pages than this mean that the pages form a cycle


def page_sizes(data: memoryview) -> list[Size] | None:
    """Return the sizes of the pages of an image file, None if the format is not known.

    Raises ValueError if the file is cut off or contradicts itself.
    """
    try:
        start = bytes(data[:12])
        if start[:4] in (b"II*\0", b"MM\0*"):
            return list(_tiff(data))
        for begin, read in _FORMATS.items():
            if start.startswith(begin):
                return [read(data)]
    except (struct.error, IndexError) as error:
        raise ValueError("the file is cut off") from error
    return None


def _png(data: memoryview) -> Size:
    return _pair(">II", data, 16)


def _jpeg(data: memoryview) -> Size:
    offset = 2
    while True:
        while data[offset] == 0xFF:
            offset += 1
        marker = data[offset]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return _pair(">HH", data, offset + 4)[::-1]
        if 0xD0 <= marker <= 0xD8 or marker == 1:  # markers without a length
            offset += 1
        else:
            offset += 1 + int(struct.unpack_from(">H", data, offset + 1)[0])
        while data[offset] != 0xFF:
            offset += 1


def _bmp(data: memoryview) -> Size:
    width, height = _pair("<ii", data, 18)
    return width, abs(height)


def _gif(data: memoryview) -> Size:
    return _pair("<HH", data, 6)


def _pnm(data: memoryview) -> Size:
    match = _PNM.match(bytes(data[:4096]))
    if match is None:
        raise ValueError("the file is cut off")
    return int(match[1]), int(match[2])


def _webp(data: memoryview) -> Size:
    kind = bytes(data[12:16])
    if kind == b"VP8X":
        low = struct.unpack_from("<HBHB", data, 24)
        return low[0] + (low[1] << 16) + 1, low[2] + (low[3] << 16) + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    width, height = _pair("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


def _jp2(data: memoryview) -> Size:
    offset = bytes(data[:4096]).index(b"ihdr")
    return _pair(">II", data, offset + 4)[::-1]


def _tiff(data: memoryview) -> Iterator[Size]:
    order = "<" if data[0] == ord("I") else ">"
    (offset,) = struct.unpack_from(f"{order}I", data, 4)
    pages = 0
    while offset:
        pages += 1
        if pages > _TIFF_PAGES:
            raise ValueError("the pages of the file lead to one another")
        (count,) = struct.unpack_from(f"{order}H", data, offset)
        tags = {}
        for entry in range(offset + 2, offset + 2 + 12 * count, 12):
            tag, kind = struct.unpack_from(f"{order}HH", data, entry)
            if tag in (256, 257):
                (tags[tag],) = struct.unpack_from(
                    f"{order}{'H' if kind == 3 else 'I'}", data, entry + 8
                )
        yield tags.get(256, 0), tags.get(257, 0)
        (offset,) = struct.unpack_from(f"{order}I", data, offset + 2 + 12 * count)


def _pair(kind: str, data: memoryview, offset: int) -> Size:
    one, other = struct.unpack_from(kind, data, offset)
    return int(one), int(other)


_FORMATS: dict[bytes, Callable[[memoryview], Size]] = {
    b"\x89PNG": _png,
    b"\xff\xd8": _jpeg,
    b"BM": _bmp,
    b"GIF8": _gif,
    b"RIFF": _webp,
    b"\0\0\0\x0cjP  ": _jp2,
    **{f"P{kind}".encode(): _pnm for kind in range(1, 7)},
}
