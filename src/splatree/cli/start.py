"""Where the program starts: it loads the rest only where an interruption is told in one line."""

import sys


def main() -> int:
    """Run the command line of this process; return its exit code."""
    try:
        from splatree.cli.main import main as run

        code = run()
        _listen_no_more()
        _let_go_of_messages()
        return code
    except KeyboardInterrupt:
        _listen_no_more()
        if sys.stderr is not None:
            print("splatree: interrupted", file=sys.stderr)
        return 130


def _let_go_of_messages() -> None:
    """Let messages that their stream does not take go nowhere, as Python would end with the code 120 for them."""
    import os

    if sys.stderr is None:
        return
    try:
        sys.stderr.flush()
    except (OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _listen_no_more() -> None:
    """Ignore interruptions from here on: the work is done, and Python's own end would show a traceback."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
