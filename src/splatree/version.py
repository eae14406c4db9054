"""Which version of splatree this is."""


def program_version() -> str:
    """Version of the installed package; "of a source tree" if it runs without being installed."""
    from importlib.metadata import PackageNotFoundError, version  # 15 ms, which most commands need not wait for

    try:
        return version("splatree")
    except PackageNotFoundError:
        return "of a source tree"
