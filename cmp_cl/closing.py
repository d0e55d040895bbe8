"""What a with statement closes."""

from typing import Self


class Closing:
    """Something with a `close`, which a with statement calls at its end."""

    def close(self) -> None:
        """Release the resources."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
