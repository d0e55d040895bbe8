"""Optional packages, and the extras that install them."""

import contextlib
from collections.abc import Iterator

from cmp_cl.errors import ConfigError


@contextlib.contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Import in this block; if that fails, raise ConfigError, which names the extra to install."""
    try:
        yield
    except ImportError as error:
        missing = f" ({error.name} is not installed)" if error.name else ""
        raise ConfigError(f"{what} needs pip install 'cmp-cl[{name}]'{missing}") from error
