"""The version of the package that is installed."""

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """Return the version of the installed package, or `unknown` if it is not installed."""
    try:
        return version("cmp-cl")
    except PackageNotFoundError:
        return "unknown"
