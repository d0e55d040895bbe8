"""What a calibration file must keep to before it is parsed."""

from os import PathLike

from cmp_cl.errors import CalibrationError

_MOST_NESTED = 4000  # OpenCV's parsers recurse, and overrun the stack from some 20 000 levels on
_OPENING = (b"[", b"{", b"<", b"- ", b"-\t", b"-\n")


def check_nesting(data: bytes, path: str | PathLike[str]) -> None:
    """Raise CalibrationError where a YAML, JSON or XML file could be nested too deep to parse.

    It counts whatever may open a level, whether it is in a string or closed again: a rig has
    some dozen of these.
    """
    levels = sum(data.count(opening) for opening in _OPENING)
    if levels > _MOST_NESTED:
        raise CalibrationError(
            f"{path}: over {_MOST_NESTED} brackets, tags or dashes, no calibration file"
        )
