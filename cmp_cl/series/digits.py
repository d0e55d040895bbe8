"""Numbers as text, many at a time.

A text is put together from words of four letters. Each word is looked up by three digits of a
number. Unused letters are 0, and are deleted at the end.
"""

import functools
import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint32]  # four letters each
Array = NDArray[np.float64]

_WORD = np.dtype("<u4")
_SIGN = np.uint32(ord("-") << 24)  # as the last letter of a word
# If the largest number lies between these, all numbers have 7 to 15 digits. If it is below _TINY,
# or from _MOST on, each number is formatted by itself, in _ALONE words.
_LEAST, _MOST = 1e-2, 999_999.0
_TINY = 1e-90
_ALONE = 6


def rows_of(begin: str, columns: Sequence[NDArray[np.generic]]) -> bytes:
    """Return the lines `begin,number,...` of a table in CSV.

    columns: (N,) each. Numbers have 9 decimals without trailing zeros. In a column whose largest
    number is below 0.01 they have an exponent that is a multiple of three, as in 12.5e-6; if it is
    not below 999 999 they have 9 digits, %.9g. Integers are written as they are.
    """
    count = len(columns[0])
    first = _words(f"\n{begin}")
    parts = [np.broadcast_to(first, (count, len(first)))] * (1 + len(columns))
    exact = [column.dtype.kind != "f" for column in columns]
    for whole in (True, False):
        if chosen := [number for number, same in enumerate(exact) if same == whole]:
            values = np.stack([columns[number] for number in chosen]).astype(np.float64)
            numbers = _numbers(values, whole, _words(","), ("nan", "inf", "-inf"))
            for at, text in zip(chosen, numbers, strict=True):
                parts[1 + at] = text
    return _joined(np.concatenate(parts, axis=1))[1:] + b"\n"


def nested(values: NDArray[np.generic]) -> bytes:
    """Return an array of numbers as JSON: nested lists, with null for numbers that are not finite.

    The numbers are formatted like one column of `rows_of`.
    """
    if values.dtype.kind not in "iuf" or not values.ndim or not values.size:
        return json.dumps(plain(values)).encode()
    flat = values.reshape(1, -1).astype(np.float64)
    numbers = _numbers(flat, values.dtype.kind != "f", _brackets(values.shape), ("null",) * 3)
    return _joined(numbers) + b"]" * values.ndim


def plain(value: NDArray[np.generic]) -> Any:
    """Return an array as nested lists for JSON, with None for NaN."""
    finite = np.isfinite(value) if value.dtype.kind == "f" else np.True_
    if np.all(finite):
        return value.tolist()
    numbers = value.astype(object)
    numbers[~finite] = None
    return numbers.tolist()


def _joined(text: Words) -> bytes:
    return text.tobytes().translate(None, b"\0")


def _words(text: str, count: int = 0) -> Words:
    """Return a text as words; the last letter of the last one is free."""
    letters = text.encode()
    return np.frombuffer(letters.ljust(4 * max(count, len(letters) // 4 + 1), b"\0"), _WORD)


@functools.lru_cache(maxsize=16)
def _brackets(shape: tuple[int, ...]) -> Words:
    """Return the brackets and commas before each number of nested lists, (1, N, W)."""
    size, depth = math.prod(shape), len(shape)
    words = np.empty((1, size, (2 * depth - 1) // 4 + 1), _WORD)
    for closed in range(depth):  # number of lists that end before a number
        step = math.prod(shape[depth - closed :])
        words[:, ::step] = _words("]" * closed + "," + "[" * closed, words.shape[2])
    words[:, 0] = _words("[" * depth, words.shape[2])
    return words


def _numbers(values: Array, exact: bool, before: Words, unknown: tuple[str, str, str]) -> Words:
    """Return numbers (K, N) as words (K, N, W); the numbers of a row have one format.

    exact: whether they are integers. before: the words before each number, the last letter free,
    (K, N, B) or an array that broadcasts to it. unknown: the texts for NaN, inf and -inf.
    """
    finite = np.isfinite(values)
    size = np.where(finite, np.abs(values), 0)
    largest = size.max(axis=1)
    alone = (largest >= _MOST) | ((largest < _TINY) & (largest > 0))
    size[alone] = 0
    small = np.flatnonzero((largest > 0) & (largest < _LEAST) & ~alone)
    thousands = np.ceil(-np.log10(largest[small]) / 3).astype(np.int64)
    size[small] *= 1000.0 ** thousands[:, None]
    digits, zero = _digits(size)
    first = before.shape[-1]
    words = max(len(digits) + (len(small) > 0), _ALONE if alone.any() else 0)
    text = np.zeros((*values.shape, first + words), _WORD)
    text[..., :first] = before
    text[..., first - 1] += np.where((values < 0) & ~zero, _SIGN, np.uint32(0))
    for number, part in enumerate(digits):
        text[..., first + number] = part
    for row, power in zip(small.tolist(), thousands.tolist(), strict=True):
        text[row, :, first + len(digits)] = _words(f"e-{3 * power}")[0]
    for row in np.flatnonzero(alone).tolist():
        form = "%d" if exact else "%.9g"
        for column in np.flatnonzero(finite[row]).tolist():
            text[row, column, first:] = _words(form % values[row, column], words)
    if not finite.all():
        odd = np.isnan(values), values == np.inf, values == -np.inf
        for which, name in zip(odd, unknown, strict=True):
            text[which, first:] = _words(name, words)[:words]
    return text


def _digits(size: Array) -> tuple[list[Words], NDArray[np.bool_]]:
    """Return the words of the numbers from 0 to a million, and a mask of those whose digits are all
    0."""
    tables = _tables()
    units = size.astype(np.int64)
    decimals = np.rint((size - units) * 10.0**9).astype(np.int64)
    full = decimals == 10**9
    units += full
    decimals -= 10**9 * full
    zero = (units == 0) & (decimals == 0)
    words = []
    head = units // 1000
    if head.any():
        words.append(tables.opening[np.where(head, head, 1000)])
        units += 1000 * (head > 0) - 1000 * head
    words.append(tables.units[units])
    if decimals.any():
        first = decimals // 10**6
        decimals -= 10**6 * first
        second = decimals // 1000
        third = decimals - 1000 * second
        words.append(tables.point[first + 1000 * (decimals > 0)])
        words.append(tables.middle[second + 1000 * (third > 0)])
        words.append(tables.middle[third])
    return words, zero


class _Tables(NamedTuple):
    """Words of three digits: (1000,), and then (1000,) where digits that are not 0 lie beyond.

    opening: without zeros before it; a last one is empty. units: the same, with the 0 of zero, and
    with all zeros behind an opening. point: with the point before it. point, middle: without
    zeros after it, and with all of them before another.
    """

    opening: Words
    units: Words
    point: Words
    middle: Words


@functools.cache
def _tables() -> _Tables:
    def table(texts: Iterable[str]) -> Words:
        return np.array([text.encode() for text in texts], "S4").view(_WORD)

    all_three = [f"{number:03}" for number in range(1000)]
    trimmed = [text.rstrip("0") for text in all_three]
    return _Tables(
        opening=table([*map(str, range(1000)), ""]),
        units=table([*map(str, range(1000)), *all_three]),
        point=table(["." * bool(text) + text for text in trimmed] + [f".{t}" for t in all_three]),
        middle=table([*trimmed, *all_three]),
    )
