"""A base for classes that a with statement closes."""

from typing import Self


class Closing:
    """A class with a method `close`, which a with statement calls at its end."""

    def close(self) -> None:
        """Release the resources."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
