"""Tables of numbers as text, many numbers at a time."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_DECIMALS = 9
_LEAST, _MOST = 1e-2, 999_999.0  # of a column's largest number: it then has 7 to 15 digits
_DIGITS = 16  # of a number: 6 before the point, the point, 9 after it
_WIDEST = 24  # letters of a number that is written alone, %.9g
_THREE = np.array([[n // 100, n // 10 % 10, n % 10] for n in range(1000)], np.uint8).T + ord("0")


def rows_of(begin: str, columns: Sequence[NDArray[np.generic]]) -> bytes:
    """Return the lines `begin,number,...` of a table in CSV.

    columns: (N,) each. Numbers have 9 decimals without the zeros at their end; in columns whose
    largest number is below .01 or not below 999 999 they have 9 digits, %.9g. Whole
    numbers are as they are.
    """
    values = np.stack([column.astype(np.float64) for column in columns])
    missing = np.isnan(values)
    largest = np.where(missing, 0, np.abs(values)).max(axis=1)
    plain = (largest == 0) | ((largest >= _LEAST) & (largest < _MOST))
    count = values.shape[1]
    # A comma, a sign and the number; 0 where there is no letter.
    text = np.zeros((count, len(columns), 2 + (_DIGITS if plain.all() else _WIDEST)), np.uint8)
    text[:, :, 0] = ord(",")
    fixed = _fixed(np.where(missing | ~plain[:, None], 0, values))
    text[:, :, 1 : 2 + _DIGITS] = fixed.transpose(2, 1, 0)
    for number in np.flatnonzero(~plain).tolist():
        form = b"%.9g" if columns[number].dtype.kind == "f" else b"%d"
        alone = np.array([form % each for each in columns[number].tolist()], np.bytes_)
        width = alone.dtype.itemsize
        text[:, number, 1:] = 0
        text[:, number, 1 : 1 + width] = alone.view(np.uint8).reshape(count, width)
    if missing.any():
        column, row = np.nonzero(missing)
        text[row, column, 1:] = 0
        text[row, column, 1:4] = np.frombuffer(b"nan", np.uint8)
    first = np.broadcast_to(np.frombuffer(begin.encode(), np.uint8), (count, len(begin)))
    last = np.full((count, 1), ord("\n"), np.uint8)
    whole = np.concatenate([first, text.reshape(count, -1), last], axis=1)
    return whole.tobytes().translate(None, b"\0")


def _fixed(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the letters of numbers (K, N) below a million: (17, K, N), sign, digits, decimals."""
    size = np.abs(values)
    units = size.astype(np.uint32)
    decimals = np.rint((size - units) * 10**_DECIMALS).astype(np.uint32)
    full = decimals == 10**_DECIMALS
    units[full] += 1
    decimals[full] = 0
    text = np.empty((1 + _DIGITS, *values.shape), np.uint8)
    chunks = (units // 1000, units % 1000, decimals // 10**6, decimals // 1000 % 1000)
    for place, chunk in zip((1, 4, 8, 11, 14), (*chunks, decimals % 1000), strict=True):
        for digit in range(3):
            np.take(_THREE[digit], chunk, out=text[place + digit])
    zero = ord("0")
    seen = np.zeros(values.shape, np.bool_)
    for place in range(1, 6):  # zeros before the first digit, but for that of the units
        seen |= text[place] != zero
        text[place] *= seen
    seen[:] = False
    for place in range(16, 7, -1):  # zeros after the last digit
        seen |= text[place] != zero
        text[place] *= seen
    text[7] = ord(".") * seen
    text[0] = ord("-") * ((values < 0) & ((units > 0) | (decimals > 0)))
    return text
