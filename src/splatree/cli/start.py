"""Where the program starts: it loads the rest only where an interruption is told in one line."""

import sys


def main() -> int:
    """Run the command line of this process; return its exit code."""
    try:
        from splatree.cli.main import main as run

        code = run()
        _listen_no_more()
        return code
    except KeyboardInterrupt:
        _listen_no_more()
        if sys.stderr is not None:
            print("splatree: interrupted", file=sys.stderr)
        return 130


def _listen_no_more() -> None:
    """Ignore interruptions from here on: the work is done, and Python's own end would show a traceback."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
