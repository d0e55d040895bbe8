"""The version of the package that is installed."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """The version, `unknown` where the package is only on the path and not installed."""
    try:
        return version("cmp-cl")
    except PackageNotFoundError:
        return "unknown"
