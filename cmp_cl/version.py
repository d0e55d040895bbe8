"""The version of the package that is installed."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Return the version; `unknown` where the package is on the path and not installed."""
    try:
        return version("cmp-cl")
    except PackageNotFoundError:
        return "unknown"
